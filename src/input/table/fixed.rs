//! Binary rows of one size, one after the other.

use super::reader::Rows;
use crate::input::foreign::{ForeignFault, MOST_BLOCK_ROWS};
use crate::input::positioned_file::PositionedFile;

/// Most bytes of a block; a single row may be longer.
const MOST_BLOCK_BYTES: u64 = 4 << 20;

/// Rows of a part of a file.
#[derive(Debug)]
pub struct FixedRows {
    file: PositionedFile,
    start: u64,
    rows: u64,
    row_bytes: usize,
    block_rows: u64,
    /// Sizes of the numbers of a row, one after the other, if their bytes stand in big-endian
    /// order.
    swapped: Option<Vec<u8>>,
}

impl FixedRows {
    /// Rows from a byte on; refused if the file ends before the last, unless those that are there
    /// are wanted.
    pub fn new(
        file: PositionedFile,
        start: u64,
        rows: u64,
        row_bytes: usize,
        swapped: Option<Vec<u8>>,
        salvage: bool,
    ) -> Result<Self, ForeignFault> {
        let bytes = row_bytes as u64;
        let whole = file.bytes().saturating_sub(start) / bytes;
        if whole < rows && !salvage {
            let reason = format!(
                "truncated in row {} of {rows}: rows have {bytes} bytes and the file ends at byte \
                 {}",
                whole + 1,
                file.bytes()
            );
            return Err(ForeignFault::at_byte(start.saturating_add(whole * bytes), reason));
        }
        let block_rows = (MOST_BLOCK_BYTES / bytes).clamp(1, MOST_BLOCK_ROWS);
        let rows = rows.min(whole);
        Ok(FixedRows { file, start, rows, row_bytes, block_rows, swapped })
    }
}

impl Rows for FixedRows {
    fn block_count(&self) -> usize {
        self.rows.div_ceil(self.block_rows) as usize
    }

    fn read(&self, block: usize, packed: &mut Vec<u8>) -> Result<Option<u32>, ForeignFault> {
        let first = block as u64 * self.block_rows;
        let count = self.block_rows.min(self.rows - first);
        packed.resize(count as usize * self.row_bytes, 0);
        let start = self.start + first * self.row_bytes as u64;
        self.file.read_exact_at(packed, start)?;
        if let Some(sizes) = &self.swapped {
            for row in packed.chunks_exact_mut(self.row_bytes) {
                swap(row, sizes);
            }
        }
        Ok(None)
    }
}

/// Turns the bytes of each number around.
pub(super) fn swap(mut row: &mut [u8], sizes: &[u8]) {
    for &size in sizes {
        let (number, rest) = row.split_at_mut(usize::from(size));
        number.reverse();
        row = rest;
    }
}
