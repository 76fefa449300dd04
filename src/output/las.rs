//! LAS and LAZ files from raw records.
//!
//! What the scan said about itself is written back byte for byte; counts, counts by return and
//! bounds are those of the points that were written. LAZ chunks hold 50,000 points and are
//! compressed in parallel; their bytes do not depend on the number of threads. The file stands
//! under a temporary name beside its target until it is complete.
//!
//! Source: ASPRS, "LAS Specification 1.4 - R15"; Isenburg, "LASzip", 2013.

use std::io::Read;
use std::path::Path;

use super::error::WriteError;
use super::file::OutputFile;
use super::las_frame::{Tally, copy_evlrs, put, vlr_region};
use super::laz_coding::{ChunkSize, FixedChunks, LazCoding, NO_CHUNK_TABLE};
use crate::input::{LasHeader, LasTemplate, describes_extra_bytes, place};
use crate::points::Schema;

/// How points are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Compression {
    /// Plain records: LAS.
    None,
    /// Chunks of compressed records: LAZ.
    Laz,
}

/// What was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WriteReport {
    /// Points.
    pub points: u64,
    /// Length of the file.
    pub bytes: u64,
}

/// Writes one LAS or LAZ file. Dropped before [`finish`](Self::finish), it leaves nothing behind.
pub struct LasWriter {
    file: OutputFile,
    template: LasHeader,
    describes_extra_bytes: bool,
    header: Vec<u8>,
    tally: Tally,
    laz: Option<FixedChunks>,
}

impl LasWriter {
    /// Starts a file of the template's version and point format, for records of that schema.
    pub fn create(
        path: &Path,
        template: &LasTemplate,
        schema: &Schema,
        compression: Compression,
    ) -> Result<Self, WriteError> {
        let parsed = template.header();
        let expected = parsed.record_bytes;
        if schema.record_bytes != u32::from(expected) {
            let (found, path) = (schema.record_bytes, path.to_path_buf());
            return Err(WriteError::RecordBytes { found, expected, path });
        }
        let laz = match compression {
            Compression::None => None,
            Compression::Laz => {
                let coding = LazCoding::new(parsed.point_format, expected, ChunkSize::Fixed);
                Some(FixedChunks::new(coding.map_err(|reason| compress_error(reason, path))?))
            }
        };
        let laszip = laz.as_ref().map(|laz| laz.coding().record());
        let (region, count) = vlr_region(template, laszip.as_deref());
        let points_start = u32::try_from(template.header_bytes().len() + region.len());
        let points_start = points_start.map_err(|_| WriteError::TooManyRecords {
            bytes: region.len(),
            path: path.to_path_buf(),
        })?;

        let mut header = template.header_bytes().to_vec();
        put(&mut header, place::POINT_DATA_OFFSET, &points_start.to_le_bytes());
        put(&mut header, place::VLR_COUNT, &count.to_le_bytes());
        let compressed_bit = if laz.is_some() { 0x80 } else { 0 };
        header[place::POINT_FORMAT] = parsed.point_format.number() | compressed_bit;

        let file = OutputFile::create(path)?;
        let tally = Tally::NONE;
        let describes_extra_bytes = template.vlrs().iter().any(describes_extra_bytes);
        let mut writer =
            LasWriter { file, tally, template: parsed, describes_extra_bytes, header, laz };
        // Counts are still the template's; the finished header takes this one's place.
        writer.file.put(&writer.header)?;
        writer.file.put(&region)?;
        if writer.laz.is_some() {
            writer.file.put(&NO_CHUNK_TABLE.to_le_bytes())?;
        }
        Ok(writer)
    }

    /// Appends whole records.
    pub fn write(&mut self, records: &[u8]) -> Result<(), WriteError> {
        let record_bytes = usize::from(self.template.record_bytes);
        assert!(records.len().is_multiple_of(record_bytes), "records are written whole");
        self.tally.add(records, &self.template);
        if self.laz.is_none() {
            return self.file.put(records);
        }
        let mut rest = records;
        while !rest.is_empty() {
            let laz = self.laz.as_mut().expect("compression was asked for");
            rest = laz.fill(rest);
            if laz.is_full() {
                self.compress()?;
            }
        }
        Ok(())
    }

    /// Ends the points, appends the extended records that `evlrs` gives (whole, one after the
    /// other; `io::empty()` for none), and puts the file under its name.
    pub fn finish(mut self, evlrs: &mut dyn Read) -> Result<WriteReport, WriteError> {
        self.finish_points()?;
        self.append_evlrs(evlrs)?;
        self.tally.put_into(&mut self.header, &self.template, self.file.path())?;
        self.file.put_at(0, &self.header)?;
        let report = WriteReport { points: self.tally.points, bytes: self.file.end() };
        self.file.finish()?;
        Ok(report)
    }

    fn finish_points(&mut self) -> Result<(), WriteError> {
        if self.laz.is_none() {
            return Ok(());
        }
        self.compress()?;
        let table_start = self.file.end();
        let laz = self.laz.as_ref().expect("compression was asked for");
        self.file.put(&laz.table_bytes())?;
        let at = place::POINT_DATA_OFFSET;
        let points_start = self.header[at..at + 4].try_into().expect("the slice has 4 bytes");
        let points_start = u64::from(u32::from_le_bytes(points_start));
        self.file.put_at(points_start, &table_start.to_le_bytes())
    }

    /// Compresses the chunks at hand and writes them.
    fn compress(&mut self) -> Result<(), WriteError> {
        let laz = self.laz.as_mut().expect("compression was asked for");
        let chunks = laz.compress().map_err(|reason| compress_error(reason, self.file.path()))?;
        for chunk in chunks {
            self.file.put(chunk)?;
        }
        Ok(())
    }

    fn append_evlrs(&mut self, evlrs: &mut dyn Read) -> Result<(), WriteError> {
        let first = self.file.end();
        let copied = copy_evlrs(&mut self.file, evlrs, self.describes_extra_bytes)?;
        if self.template.minor >= 4 {
            let start = if copied.count > 0 { first } else { 0 };
            put(&mut self.header, place::EVLR_START, &start.to_le_bytes());
            put(&mut self.header, place::EVLR_COUNT, &copied.count.to_le_bytes());
        }
        if self.template.waveform_start.is_some() {
            put(&mut self.header, place::WAVEFORM_START, &copied.waveforms.to_le_bytes());
        }
        Ok(())
    }
}

pub(super) fn compress_error(reason: String, path: &Path) -> WriteError {
    WriteError::Compress { reason, path: path.to_path_buf() }
}
