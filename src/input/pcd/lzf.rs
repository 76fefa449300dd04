//! LZF, the compression of PCD files: literals and references at most 8 KiB back.
//!
//! Format after: Lehmann, LibLZF (the byte layout; the decoder is our own).

use crate::input::foreign::ForeignFault;
use crate::input::positioned_file::PositionedFile;

const READ_BYTES: usize = 1 << 20;
const FLUSH_BYTES: usize = 1 << 20;
/// Farthest reference.
const REACH_BYTES: usize = 1 << 13;
/// Most bytes that three bytes of input can become.
pub const MOST_EXPANSION: u64 = 88;

/// Input bytes one by one.
struct Input<'a> {
    file: &'a PositionedFile,
    window: Vec<u8>,
    used: usize,
    /// Place of the byte after the window, and of the end of the input.
    next: u64,
    end: u64,
}

impl Input<'_> {
    fn place(&self) -> u64 {
        self.next - (self.window.len() - self.used) as u64
    }

    fn fill(&mut self) -> Result<(), ForeignFault> {
        let bytes = (self.end - self.next).min(READ_BYTES as u64) as usize;
        if bytes == 0 {
            return Err(ForeignFault::at_byte(self.end, "the compressed points end too early"));
        }
        self.window.resize(bytes, 0);
        self.file.read_exact_at(&mut self.window, self.next)?;
        self.next += bytes as u64;
        self.used = 0;
        Ok(())
    }

    fn byte(&mut self) -> Result<usize, ForeignFault> {
        if self.used == self.window.len() {
            self.fill()?;
        }
        self.used += 1;
        Ok(usize::from(self.window[self.used - 1]))
    }

    fn copy(&mut self, mut count: usize, output: &mut Vec<u8>) -> Result<(), ForeignFault> {
        while count > 0 {
            if self.used == self.window.len() {
                self.fill()?;
            }
            let part = count.min(self.window.len() - self.used);
            output.extend_from_slice(&self.window[self.used..self.used + part]);
            self.used += part;
            count -= part;
        }
        Ok(())
    }
}

/// Decompresses a part of a file, which the caller has checked to lie in it, into exactly
/// `expected` bytes, handed out in pieces. What stands before damage is handed out, too.
pub fn decompress(
    file: &PositionedFile,
    start: u64,
    compressed: u64,
    expected: u64,
    take: &mut dyn FnMut(&[u8]) -> Result<(), ForeignFault>,
) -> Result<(), ForeignFault> {
    let mut input =
        Input { file, window: Vec::new(), used: 0, next: start, end: start + compressed };
    // Bytes that were handed out stay in front as far as references reach.
    let mut output: Vec<u8> = Vec::with_capacity(FLUSH_BYTES + 2 * REACH_BYTES);
    let (mut handed_out, mut total) = (0, 0u64);
    let step = |input: &mut Input, output: &mut Vec<u8>| -> Result<(), ForeignFault> {
        let control = input.byte()?;
        if control < 32 {
            return input.copy(control + 1, output);
        }
        let mut length = control >> 5;
        if length == 7 {
            length += input.byte()?;
        }
        let distance = ((control & 0x1f) << 8 | input.byte()?) + 1;
        if distance > output.len() {
            let reason = format!("a reference {distance} bytes back, before the first");
            return Err(ForeignFault::at_byte(input.place(), reason));
        }
        // The reference may run into what it writes.
        for from in output.len() - distance..output.len() - distance + length + 2 {
            output.push(output[from]);
        }
        Ok(())
    };
    while total + (output.len() - handed_out) as u64 != expected {
        if total + (output.len() - handed_out) as u64 > expected {
            let reason = format!("the points decompress to more than {expected} bytes");
            take(&output[handed_out..])?;
            return Err(ForeignFault::at_byte(input.place(), reason));
        }
        if let Err(fault) = step(&mut input, &mut output) {
            take(&output[handed_out..])?;
            return Err(fault);
        }
        if output.len() - handed_out >= FLUSH_BYTES {
            take(&output[handed_out..])?;
            total += (output.len() - handed_out) as u64;
            output.drain(..output.len() - REACH_BYTES);
            handed_out = output.len();
        }
    }
    take(&output[handed_out..])
}
