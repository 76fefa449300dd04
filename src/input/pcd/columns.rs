//! Points that stand field after field, once they are decompressed.
//!
//! The whole must be decompressed before one point is known. Up to 32 MiB stay in memory; more
//! goes to a temporary file without a name, so memory does not depend on the input.

use std::cell::Cell;
use std::fs::File;
use std::io::Write;
use std::sync::Mutex;

use super::lzf;
use crate::input::detect::ReadOptions;
use crate::input::foreign::{ForeignFault, MOST_BLOCK_ROWS};
use crate::input::positioned_file::PositionedFile;
use crate::input::table::{Field, Rows};

/// Most bytes that are kept in memory.
const MOST_HELD_BYTES: u64 = 32 << 20;

/// Decompressed bytes.
#[derive(Debug)]
enum Bytes {
    Held(Vec<u8>),
    Filed(PositionedFile),
}

/// Fields one after the other.
#[derive(Debug)]
pub struct ColumnRows {
    bytes: Bytes,
    /// How many bytes there are; fewer than declared in a damaged file that is salvaged.
    decoded: u64,
    /// Points that the file declares.
    declared: u64,
    /// Of these so many have coordinates.
    points: u64,
    names: Vec<String>,
    fault: Mutex<Option<ForeignFault>>,
    /// Bytes of each field of a point.
    widths: Vec<usize>,
    row_bytes: usize,
}

impl ColumnRows {
    /// Decompresses the points that stand behind the two sizes at a byte. When salvaging, what can be
    /// decompressed counts: points whose coordinates are among it, with zeros for what is not.
    pub fn new(
        file: &PositionedFile,
        start: u64,
        points: u64,
        fields: &[Field],
        options: &ReadOptions,
    ) -> Result<Self, ForeignFault> {
        let widths: Vec<usize> = fields.iter().map(Field::bytes).collect();
        let row_bytes = widths.iter().sum();
        let data = start + 8;
        if file.bytes() < data {
            return Err(ForeignFault::at_byte(start, "the file ends before the compressed points"));
        }
        let mut sizes = [0; 8];
        file.read_exact_at(&mut sizes, start)?;
        let word = |at: usize| {
            let bytes = sizes[at..at + 4].try_into().expect("the slice has 4 bytes");
            u64::from(u32::from_le_bytes(bytes))
        };
        let (compressed, expected) = (word(0), word(4));
        let needed = points.saturating_mul(row_bytes as u64);
        let fault = |reason| Err(ForeignFault::at_byte(start, reason));
        if expected != needed {
            return fault(format!("{expected} bytes of points, {points} points have {needed}"));
        }
        let there = file.bytes() - data;
        let is_cut = options.salvage && compressed > there;
        let compressed = if is_cut { there } else { compressed };
        if compressed > there {
            return fault(format!(
                "{compressed} bytes of compressed points, the file has {}",
                file.bytes() - data
            ));
        }
        if !is_cut && expected > compressed.saturating_mul(lzf::MOST_EXPANSION) {
            return fault(format!("{compressed} bytes cannot hold {expected} bytes of points"));
        }
        let decoded = Cell::new(0);
        let (bytes, outcome) = if expected <= MOST_HELD_BYTES {
            let mut held = Vec::new();
            let outcome = lzf::decompress(file, data, compressed, expected, &mut |piece| {
                held.extend_from_slice(piece);
                decoded.set(decoded.get() + piece.len() as u64);
                Ok(())
            });
            (Bytes::Held(held), outcome)
        } else {
            let fault = |action: &str, error: std::io::Error| {
                ForeignFault::at(format!("cannot {action} a temporary file"), error.to_string())
            };
            let made = match &options.temp_dir {
                Some(folder) => tempfile::tempfile_in(folder),
                None => tempfile::tempfile(),
            };
            let mut spool: File = made.map_err(|error| fault("make", error))?;
            let mut is_full = None;
            let outcome = lzf::decompress(file, data, compressed, expected, &mut |piece| {
                let written = spool.write_all(piece).map_err(|error| fault("write", error));
                is_full = written.as_ref().err().map(|fault| fault.to_string());
                decoded.set(decoded.get() + piece.len() as u64);
                written
            });
            if is_full.is_some() {
                // That is not the file's damage.
                outcome?;
                return Err(ForeignFault::at_byte(start, is_full.unwrap_or_default()));
            }
            (Bytes::Filed(PositionedFile::new(spool, decoded.get())), outcome)
        };
        let decoded = decoded.get().min(expected);
        let fault = match outcome {
            Ok(()) => None,
            Err(fault) if options.salvage => Some(fault),
            Err(fault) => return Err(fault),
        };
        let names = fields.iter().map(|field| field.name.clone()).collect();
        let fault = Mutex::new(fault);
        let rows = ColumnRows {
            bytes,
            decoded,
            declared: points,
            points,
            names,
            fault,
            widths,
            row_bytes,
        };
        let with_coordinates = |(column, field): (usize, &Field)| {
            let is_axis = ["x", "y", "z"].contains(&field.name.to_ascii_lowercase().as_str());
            is_axis.then(|| rows.there(column))
        };
        let there = fields.iter().enumerate().filter_map(with_coordinates).min();
        Ok(ColumnRows { points: there.unwrap_or(points), ..rows })
    }

    /// Of how many points a column is there.
    fn there(&self, column: usize) -> u64 {
        let before: u64 = self.widths[..column].iter().map(|&width| width as u64).sum();
        let bytes = self.decoded.saturating_sub(before * self.declared);
        (bytes / (self.widths[column] as u64).max(1)).min(self.declared)
    }

    /// Which columns are zero from which point on, because they were lost.
    pub fn zeros(&self) -> Option<String> {
        let lost = (0..self.widths.len()).filter(|&column| self.there(column) < self.points);
        let lost = lost.map(|c| format!("{} from point {} on", self.names[c], self.there(c)));
        let lost: Vec<String> = lost.collect();
        (!lost.is_empty()).then(|| format!("what was lost is zero: {}", lost.join(", ")))
    }
}

impl Rows for ColumnRows {
    fn block_count(&self) -> usize {
        self.points.div_ceil(MOST_BLOCK_ROWS) as usize
    }

    fn read(&self, block: usize, packed: &mut Vec<u8>) -> Result<Option<u32>, ForeignFault> {
        let first = block as u64 * MOST_BLOCK_ROWS;
        let count = MOST_BLOCK_ROWS.min(self.points - first) as usize;
        packed.clear();
        packed.resize(count * self.row_bytes, 0);
        let (mut column_start, mut at) = (0u64, 0);
        for &width in &self.widths {
            let start = (column_start + first * width as u64).min(self.decoded);
            let bytes = (count as u64 * width as u64).min(self.decoded - start);
            let filed;
            let column = match &self.bytes {
                Bytes::Held(held) => &held[start as usize..(start + bytes) as usize],
                Bytes::Filed(file) => {
                    filed = file.read_range(start..start + bytes)?;
                    &filed
                }
            };
            let rows = packed.chunks_exact_mut(self.row_bytes);
            for (row, value) in rows.zip(column.chunks_exact(width.max(1))) {
                row[at..at + width].copy_from_slice(value);
            }
            at += width;
            column_start += self.declared * width as u64;
        }
        Ok(None)
    }

    fn left_out(&self) -> Option<ForeignFault> {
        self.fault.lock().expect("no holder of the lock panics").take()
    }
}
