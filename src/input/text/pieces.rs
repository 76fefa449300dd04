//! A text as pieces of whole lines, read in order.

use std::ops::Range;

use rayon::prelude::*;

use super::row::{MOST_LINE_BYTES, next_line, too_long};
use crate::input::foreign::{ForeignFault, MOST_BLOCK_ROWS};
use crate::input::positioned_file::PositionedFile;

/// Bytes that are worked on at once by one thread, and of a block, but for the end of their last
/// line. The shortest row of a point, "1 1 1" with its line end, has 6 bytes, so no block has more
/// rows than blocks may have.
pub const SLICE_BYTES: usize = 6 * MOST_BLOCK_ROWS as usize;

/// Most bytes read in one go: a few slices for each thread.
const MOST_PIECE_BYTES: usize = 96 * SLICE_BYTES;

/// Reads a file from some byte to its end.
#[derive(Debug)]
pub struct Pieces<'a> {
    file: &'a PositionedFile,
    /// Where `buffer` begins in the file.
    start: u64,
    buffer: Vec<u8>,
    /// Bytes at the end of the buffer that belong to the next piece.
    rest: usize,
}

/// Whole lines of the file.
#[derive(Debug)]
pub struct Piece<'a> {
    /// Where they begin in the file.
    pub start: u64,
    /// The lines.
    pub text: &'a [u8],
    /// The text in slices of whole lines.
    pub slices: Vec<Range<usize>>,
}

impl<'a> Pieces<'a> {
    /// From a byte that begins a line.
    pub fn new(file: &'a PositionedFile, start: u64) -> Pieces<'a> {
        Pieces { file, start, buffer: Vec::new(), rest: 0 }
    }

    /// The next piece; `None` at the end. `lines` is the number of lines before it, for errors.
    pub fn next(&mut self, lines: u64) -> Result<Option<Piece<'_>>, ForeignFault> {
        self.start += (self.buffer.len() - self.rest) as u64;
        let used = self.buffer.len() - self.rest;
        self.buffer.copy_within(used.., 0);
        let left = self.file.bytes() - self.start;
        let most = (8 * rayon::current_num_threads() * SLICE_BYTES).min(MOST_PIECE_BYTES);
        let length = (most as u64).min(left) as usize;
        let kept = self.rest.min(length);
        self.buffer.resize(length, 0);
        if length == 0 {
            return Ok(None);
        }
        let begin = self.start + kept as u64;
        let file = self.file;
        let fresh = self.buffer[kept..].par_chunks_mut(SLICE_BYTES).enumerate();
        let outcome = fresh.try_for_each(|(index, chunk)| {
            file.read_exact_at(chunk, begin + (index * SLICE_BYTES) as u64)
        });
        outcome.map_err(ForeignFault::from)?;
        let end = if length as u64 == left {
            length
        } else {
            let tail = &self.buffer[length - (MOST_LINE_BYTES + 1)..];
            let last = memchr::memrchr(b'\n', tail);
            let last = last.ok_or_else(|| {
                let lines = lines + memchr::memchr_iter(b'\n', &self.buffer).count() as u64;
                ForeignFault::at_line(lines + 1, too_long())
            })?;
            length - tail.len() + last + 1
        };
        self.rest = length - end;
        let text = &self.buffer[..end];
        Ok(Some(Piece { start: self.start, text, slices: slices(text) }))
    }
}

/// Cuts whole lines into slices of whole lines.
fn slices(text: &[u8]) -> Vec<Range<usize>> {
    let mut slices = Vec::with_capacity(text.len() / SLICE_BYTES + 1);
    let mut at = 0;
    while at < text.len() {
        let end = match text.len() - at {
            0..=SLICE_BYTES => text.len(),
            _ => next_line(text, at + SLICE_BYTES - 1),
        };
        slices.push(at..end);
        at = end;
    }
    slices
}
