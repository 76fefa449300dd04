//! Points that stand field after field, once they are decompressed.
//!
//! The whole must be decompressed before one point is known. Up to 32 MiB stay in memory; more
//! goes to a temporary file without a name, so memory does not depend on the input.

use std::fs::File;
use std::io::Write;

use super::lzf;
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
    points: u64,
    /// Bytes of each field of a point.
    widths: Vec<usize>,
    row_bytes: usize,
}

impl ColumnRows {
    /// Decompresses the points that stand behind the two sizes at a byte.
    pub fn new(
        file: &PositionedFile,
        start: u64,
        points: u64,
        fields: &[Field],
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
        if compressed > file.bytes() - data {
            return fault(format!(
                "{compressed} bytes of compressed points, the file has {}",
                file.bytes() - data
            ));
        }
        if expected > compressed.saturating_mul(lzf::MOST_EXPANSION) {
            return fault(format!("{compressed} bytes cannot hold {expected} bytes of points"));
        }
        let bytes = if expected <= MOST_HELD_BYTES {
            let mut held = Vec::new();
            lzf::decompress(file, data, compressed, expected, &mut |piece| {
                held.extend_from_slice(piece);
                Ok(())
            })?;
            Bytes::Held(held)
        } else {
            Bytes::Filed(decompress_to_file(file, data, compressed, expected)?)
        };
        Ok(ColumnRows { bytes, points, widths, row_bytes })
    }
}

fn decompress_to_file(
    file: &PositionedFile,
    data: u64,
    compressed: u64,
    expected: u64,
) -> Result<PositionedFile, ForeignFault> {
    let fault = |action: &str, error: std::io::Error| {
        ForeignFault::at(format!("cannot {action} a temporary file"), error.to_string())
    };
    let mut spool: File = tempfile::tempfile().map_err(|error| fault("make", error))?;
    lzf::decompress(file, data, compressed, expected, &mut |piece| {
        spool.write_all(piece).map_err(|error| fault("write", error))
    })?;
    Ok(PositionedFile::new(spool, expected))
}

impl Rows for ColumnRows {
    fn block_count(&self) -> usize {
        self.points.div_ceil(MOST_BLOCK_ROWS) as usize
    }

    fn read(&self, block: usize, packed: &mut Vec<u8>) -> Result<Option<u32>, ForeignFault> {
        let first = block as u64 * MOST_BLOCK_ROWS;
        let count = MOST_BLOCK_ROWS.min(self.points - first) as usize;
        packed.resize(count * self.row_bytes, 0);
        let (mut column_start, mut at) = (0u64, 0);
        for &width in &self.widths {
            let start = column_start + first * width as u64;
            let bytes = count * width;
            let filed;
            let column = match &self.bytes {
                Bytes::Held(held) => &held[start as usize..start as usize + bytes],
                Bytes::Filed(file) => {
                    filed = file.read_range(start..start + bytes as u64)?;
                    &filed
                }
            };
            let rows = packed.chunks_exact_mut(self.row_bytes);
            for (row, value) in rows.zip(column.chunks_exact(width)) {
                row[at..at + width].copy_from_slice(value);
            }
            at += width;
            column_start += self.points * width as u64;
        }
        Ok(None)
    }
}
