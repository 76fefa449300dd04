//! Binary elements with lists: rows of different sizes, found one after the other.

use super::header::{Element, Property};
use crate::input::foreign::{ForeignFault, MOST_BLOCK_ROWS};
use crate::input::positioned_file::PositionedFile;
use crate::input::table::Rows;
use crate::points::Scalar;

const WINDOW_BYTES: usize = 1 << 20;
const MOST_BLOCK_BYTES: u64 = 4 << 20;

/// Where the rows of elements end that start at a byte.
pub fn pass_over(
    file: &PositionedFile,
    start: u64,
    elements: &[Element],
    swaps: bool,
) -> Result<u64, ForeignFault> {
    let mut at = start;
    for element in elements {
        if element.has_lists() {
            let mut walk = Walk::new(file, at, swaps);
            for row in 0..element.count {
                walk.row(element, None).map_err(|fault| in_row(fault, element, row))?;
            }
            at = walk.at;
        } else {
            let sizes = element.properties.iter().map(|property| match property {
                Property::Number { scalar, .. } => scalar.bytes() as u64,
                Property::List { .. } => 0,
            });
            let bytes = sizes.sum::<u64>().checked_mul(element.count);
            let end = bytes.and_then(|bytes| at.checked_add(bytes));
            at = end.filter(|&end| end <= file.bytes()).ok_or_else(|| {
                let (count, name) = (element.count, &element.name);
                let reason = format!("the file ends within the {count} rows of \"{name}\"");
                ForeignFault::at_byte(at, reason)
            })?;
        }
    }
    Ok(at)
}

fn in_row(fault: ForeignFault, element: &Element, row: u64) -> ForeignFault {
    let reason =
        format!("{} in row {} of {} of \"{}\"", fault.reason, row + 1, element.count, element.name);
    ForeignFault { reason, ..fault }
}

/// Goes from row to row of a file.
struct Walk<'a> {
    file: &'a PositionedFile,
    at: u64,
    window: Vec<u8>,
    window_start: u64,
    swaps: bool,
}

impl<'a> Walk<'a> {
    fn new(file: &'a PositionedFile, at: u64, swaps: bool) -> Self {
        Walk { file, at, window: Vec::new(), window_start: at, swaps }
    }

    /// Passes over a row; its numbers, without lists, go little-endian into `packed`.
    fn row(
        &mut self,
        element: &Element,
        mut packed: Option<&mut Vec<u8>>,
    ) -> Result<(), ForeignFault> {
        for property in &element.properties {
            match *property {
                Property::Number { scalar, .. } => {
                    let bytes = self.number(scalar)?;
                    if let Some(packed) = &mut packed {
                        packed.extend_from_slice(&bytes[..scalar.bytes()]);
                    }
                }
                Property::List { count, item, .. } => {
                    let length = count.read(&self.number(count)?);
                    let left = self.file.bytes() - self.at;
                    let bytes = length * item.bytes() as f64;
                    if !(0.0..=left as f64).contains(&bytes) {
                        let reason = format!("a list of {length} numbers leaves the file");
                        return Err(ForeignFault::at_byte(self.at, reason));
                    }
                    self.at += bytes as u64;
                }
            }
        }
        Ok(())
    }

    /// The next number, little-endian.
    fn number(&mut self, scalar: Scalar) -> Result<[u8; 8], ForeignFault> {
        let size = scalar.bytes();
        let end = self.at + size as u64;
        if end > self.file.bytes() {
            return Err(ForeignFault::at_byte(self.at, "the file ends"));
        }
        let window_end = self.window_start + self.window.len() as u64;
        if self.at < self.window_start || end > window_end {
            let bytes = (self.file.bytes() - self.at).min(WINDOW_BYTES as u64) as usize;
            self.window.resize(bytes, 0);
            self.window_start = self.at;
            self.file.read_exact_at(&mut self.window, self.at)?;
        }
        let start = (self.at - self.window_start) as usize;
        let mut number = [0; 8];
        number[..size].copy_from_slice(&self.window[start..start + size]);
        if self.swaps {
            number[..size].reverse();
        }
        self.at = end;
        Ok(number)
    }
}

/// Rows with lists among their numbers, which are left out.
#[derive(Debug)]
pub struct ListedRows {
    file: PositionedFile,
    element: Element,
    swaps: bool,
    /// Start and number of rows of each block.
    blocks: Vec<(u64, u64)>,
}

impl ListedRows {
    /// Finds where the rows stand, from a byte on.
    pub fn new(
        file: PositionedFile,
        start: u64,
        element: &Element,
        swaps: bool,
    ) -> Result<Self, ForeignFault> {
        let mut walk = Walk::new(&file, start, swaps);
        let mut blocks: Vec<(u64, u64)> = Vec::new();
        for row in 0..element.count {
            match blocks.last_mut() {
                Some((start, rows))
                    if *rows < MOST_BLOCK_ROWS && walk.at - *start < MOST_BLOCK_BYTES =>
                {
                    *rows += 1;
                }
                _ => blocks.push((walk.at, 1)),
            }
            walk.row(element, None).map_err(|fault| in_row(fault, element, row))?;
        }
        Ok(ListedRows { element: element.clone(), swaps, blocks, file })
    }
}

impl Rows for ListedRows {
    fn block_count(&self) -> usize {
        self.blocks.len()
    }

    fn read(&self, block: usize, packed: &mut Vec<u8>) -> Result<Option<u32>, ForeignFault> {
        let (start, rows) = self.blocks[block];
        let mut walk = Walk::new(&self.file, start, self.swaps);
        packed.clear();
        for row in 0..rows {
            walk.row(&self.element, Some(packed))
                .map_err(|fault| in_row(fault, &self.element, row))?;
        }
        Ok(None)
    }
}
