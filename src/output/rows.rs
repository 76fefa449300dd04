//! Files that are a few bytes in front and then one point after the other: PLY and text.

use std::path::Path;

use super::error::WriteError;
use super::file::OutputFile;
use super::las::WriteReport;

/// How rows of a schema become bytes of a file.
pub trait RowFormat: Sync {
    /// What stands before the points, filled up to at least `least_bytes`.
    fn opening(&self, points: u64, least_bytes: usize) -> Vec<u8>;

    /// Appends whole rows.
    fn append(&self, rows: &[u8], out: &mut Vec<u8>);

    /// What the file cannot say, in words.
    fn notes(&self) -> Vec<String>;
}

/// Writes one file of rows. Dropped before [`finish`](Self::finish), it leaves nothing behind.
pub struct RowWriter<'a> {
    format: &'a dyn RowFormat,
    file: OutputFile,
    points: u64,
    opening: Vec<u8>,
}

impl<'a> RowWriter<'a> {
    /// Starts a file. Where the number of points is not known beforehand, room is left for it.
    pub fn create(
        path: &Path,
        format: &'a dyn RowFormat,
        known_points: Option<u64>,
    ) -> Result<Self, WriteError> {
        let opening = match known_points {
            Some(points) => format.opening(points, 0),
            None => format.opening(0, format.opening(u64::MAX, 0).len() + LEAST_FILLING),
        };
        let mut file = OutputFile::create(path)?;
        file.put(&opening)?;
        Ok(RowWriter { format, file, points: 0, opening })
    }

    /// Appends what [`RowFormat::append`] made of so many rows.
    pub fn write(&mut self, encoded: &[u8], points: u64) -> Result<(), WriteError> {
        self.points += points;
        self.file.put(encoded)
    }

    /// Puts the complete file under its name.
    pub fn finish(mut self) -> Result<WriteReport, WriteError> {
        let opening = self.format.opening(self.points, self.opening.len());
        if opening != self.opening {
            assert_eq!(opening.len(), self.opening.len(), "room was left for any number");
            self.file.put_at(0, &opening)?;
        }
        let report = WriteReport { points: self.points, bytes: self.file.end() };
        self.file.finish()?;
        Ok(report)
    }
}

/// Fewest bytes by which an opening can be filled up, if it is at all.
pub(super) const LEAST_FILLING: usize = 8;
