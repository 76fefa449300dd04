//! Rows of text: one per line, numbers between blanks.
//!
//! Lines are found in one pass and read in parallel afterwards. Coordinates are read as f64
//! whatever the file declares, so that decimal text keeps its digits; everything else becomes its
//! declared type.

use std::ops::Range;
use std::sync::Mutex;

use super::plan::{Field, RowPlan};
use super::reader::Rows;
use crate::input::foreign::{ForeignFault, MOST_BLOCK_ROWS};
use crate::input::positioned_file::PositionedFile;
use crate::points::Scalar;

const PIECE_BYTES: usize = 1 << 20;
/// Longest line that is accepted.
const MOST_LINE_BYTES: usize = 1 << 20;
/// More digits after the point than any lattice takes.
const MANY_DIGITS: i64 = 18;

/// What the words of a line become.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Word {
    /// A coordinate that is declared as that type, into 8 bytes.
    Coordinate(Scalar),
    /// A number of that type.
    Value(Scalar),
    /// A list: its length, and as many words.
    List,
}

/// One part of the text.
#[derive(Clone, Debug)]
struct Lines {
    bytes: Range<u64>,
    first_line: u64,
}

/// Rows of a part of a text file.
#[derive(Debug)]
pub struct AsciiRows {
    file: PositionedFile,
    words: Vec<Word>,
    row_bytes: usize,
    blocks: Vec<Lines>,
    /// Whether rows that cannot be read are left out.
    salvages: bool,
    /// The first such row's line, and what is wrong with it.
    left_out: Mutex<Option<(u64, ForeignFault)>>,
}

/// An entry of a declared row.
pub enum Entry {
    /// Numbers.
    Field(Field),
    /// A list, which is left out.
    List,
}

impl AsciiRows {
    /// The fields of packed rows: coordinates become f64.
    pub fn packed_fields(entries: &[Entry]) -> Vec<Field> {
        let fields = entries.iter().filter_map(|entry| match entry {
            Entry::Field(field) => Some(field),
            Entry::List => None,
        });
        let packed = fields.map(|field| {
            let scalar = if is_axis(field) { Scalar::F64 } else { field.scalar };
            Field { scalar, ..field.clone() }
        });
        packed.collect()
    }

    /// Finds the lines of `rows` rows that start at a byte, which is in line `first_line`, after
    /// `skipped` further lines. Blank lines do not count. If it `salvages`, rows that are missing
    /// or cannot be read are left out.
    pub fn new(
        file: PositionedFile,
        (start, first_line): (u64, u64),
        skipped: u64,
        rows: u64,
        entries: &[Entry],
        plan: &RowPlan,
        salvages: bool,
    ) -> Result<Self, ForeignFault> {
        let words = entries.iter().flat_map(|entry| match entry {
            Entry::List => vec![Word::List],
            Entry::Field(field) if is_axis(field) => vec![Word::Coordinate(field.scalar)],
            Entry::Field(field) => vec![Word::Value(field.scalar); usize::from(field.count)],
        });
        let words = words.collect();
        let mut finder = LineFinder { file: &file, at: start, line: first_line };
        finder.pass(skipped, |_, _| {})?;
        let mut blocks: Vec<Lines> = Vec::new();
        let mut rows_in_block = MOST_BLOCK_ROWS;
        let outcome = finder.pass(rows, |line, bytes| match blocks.last_mut() {
            Some(block)
                if rows_in_block < MOST_BLOCK_ROWS
                    && bytes.end - block.bytes.start <= PIECE_BYTES as u64 =>
            {
                block.bytes.end = bytes.end;
                rows_in_block += 1;
            }
            _ => {
                blocks.push(Lines { bytes, first_line: line });
                rows_in_block = 1;
            }
        });
        let left_out = match outcome {
            Ok(()) => None,
            Err(fault) if salvages => Some((finder.line, fault)),
            Err(fault) => return Err(fault),
        };
        let (row_bytes, left_out) = (plan.row_bytes, Mutex::new(left_out));
        Ok(AsciiRows { words, row_bytes, blocks, file, salvages, left_out })
    }

    /// Remembers the first row that is left out.
    fn leave_out(&self, line: u64, fault: ForeignFault) {
        let mut first = self.left_out.lock().expect("no holder of the lock panics");
        if first.as_ref().is_none_or(|(before, _)| line < *before) {
            *first = Some((line, fault));
        }
    }

    fn read_line(
        &self,
        text: &[u8],
        packed: &mut Vec<u8>,
        digits: &mut Option<u32>,
    ) -> Result<(), String> {
        let mut words = text.split(|b| b.is_ascii_whitespace()).filter(|word| !word.is_empty());
        for (index, word) in self.words.iter().enumerate() {
            let missing = || format!("{index} numbers, expected {}", self.words.len());
            let text = words.next().ok_or_else(missing)?;
            match *word {
                Word::Coordinate(scalar) => {
                    let value = number(text)?;
                    let fits = scalar != Scalar::F32 || (value as f32).is_finite();
                    let value = if fits { value } else { f64::NAN };
                    packed.extend_from_slice(&value.to_le_bytes());
                    if value.is_finite() {
                        *digits = digits.zip(decimal_digits(text)).map(|(a, b)| a.max(b));
                    }
                }
                Word::Value(scalar) => push_value(text, scalar, packed)?,
                Word::List => {
                    let count = integer(text)?;
                    for _ in 0..count {
                        words.next().ok_or_else(missing)?;
                    }
                }
            }
        }
        match words.next() {
            None => Ok(()),
            Some(_) => Err(format!("more than {} numbers", self.words.len())),
        }
    }
}

impl Rows for AsciiRows {
    fn block_count(&self) -> usize {
        self.blocks.len()
    }

    fn read(&self, block: usize, packed: &mut Vec<u8>) -> Result<Option<u32>, ForeignFault> {
        let Lines { bytes, first_line } = &self.blocks[block];
        let text = self.file.read_range(bytes.clone())?;
        packed.clear();
        let mut digits = Some(0);
        for (line, text) in (*first_line..).zip(text.split(|&byte| byte == b'\n')) {
            if text.iter().all(u8::is_ascii_whitespace) {
                continue;
            }
            let (length, digits_before) = (packed.len(), digits);
            if let Err(reason) = self.read_line(text, packed, &mut digits) {
                let fault = ForeignFault::at_line(line, reason);
                if !self.salvages {
                    return Err(fault);
                }
                packed.truncate(length);
                digits = digits_before;
                self.leave_out(line, fault);
            }
        }
        debug_assert!(packed.len().is_multiple_of(self.row_bytes));
        Ok(digits)
    }

    fn left_out(&self) -> Option<ForeignFault> {
        let mut first = self.left_out.lock().expect("no holder of the lock panics");
        first.take().map(|(_, fault)| fault)
    }
}

fn is_axis(field: &Field) -> bool {
    field.count == 1 && ["x", "y", "z"].contains(&field.name.to_ascii_lowercase().as_str())
}

/// Goes through lines without keeping more than a piece of the file.
struct LineFinder<'a> {
    file: &'a PositionedFile,
    at: u64,
    line: u64,
}

impl LineFinder<'_> {
    /// Passes over lines that are not blank, and tells number and place of each.
    fn pass(
        &mut self,
        count: u64,
        mut tell: impl FnMut(u64, Range<u64>),
    ) -> Result<(), ForeignFault> {
        let mut piece = Vec::new();
        let mut found = 0;
        while found < count {
            let left = self.file.bytes() - self.at;
            if left == 0 {
                let reason = format!("the file ends after row {found} of {count}");
                return Err(ForeignFault::at_line(self.line, reason));
            }
            let bytes = left.min((PIECE_BYTES + MOST_LINE_BYTES) as u64);
            piece.resize(bytes as usize, 0);
            self.file.read_exact_at(&mut piece, self.at)?;
            let mut at = 0;
            while found < count && at < piece.len() {
                let end = piece[at..].iter().position(|&byte| byte == b'\n');
                let end = match end {
                    Some(length) => at + length + 1,
                    None if bytes == left => piece.len(),
                    None if at > 0 => break,
                    None => {
                        let reason = format!("no line ends within {MOST_LINE_BYTES} bytes");
                        return Err(ForeignFault::at_line(self.line, reason));
                    }
                };
                if !piece[at..end].iter().all(u8::is_ascii_whitespace) {
                    tell(self.line, self.at + at as u64..self.at + end as u64);
                    found += 1;
                }
                self.line += 1;
                at = end;
            }
            self.at += at as u64;
        }
        Ok(())
    }
}

fn number(text: &[u8]) -> Result<f64, String> {
    let parsed = std::str::from_utf8(text).ok().and_then(|text| text.parse().ok());
    parsed.ok_or_else(|| format!("\"{}\" is no number", shown(text)))
}

fn integer(text: &[u8]) -> Result<i128, String> {
    let word =
        std::str::from_utf8(text).map_err(|_| format!("\"{}\" is no number", shown(text)))?;
    if let Ok(value) = word.parse() {
        return Ok(value);
    }
    // Some programs write whole numbers with a point.
    let value = number(text)?;
    let is_whole = value.fract() == 0.0 && value.abs() < 1e18;
    if is_whole { Ok(value as i128) } else { Err(format!("{value} is no whole number")) }
}

fn shown(text: &[u8]) -> String {
    text[..text.len().min(24)].escape_ascii().to_string()
}

fn push_value(text: &[u8], scalar: Scalar, packed: &mut Vec<u8>) -> Result<(), String> {
    match scalar {
        Scalar::F32 => {
            // Parsed as single precision, because rounding twice is not rounding once.
            let word = std::str::from_utf8(text).ok().and_then(|text| text.parse::<f32>().ok());
            let value = word.ok_or_else(|| format!("\"{}\" is no number", shown(text)))?;
            packed.extend_from_slice(&value.to_le_bytes());
        }
        Scalar::F64 => packed.extend_from_slice(&number(text)?.to_le_bytes()),
        _ => {
            let value = integer(text)?;
            let bits = 8 * scalar.bytes() as u32;
            let (low, high) = match scalar {
                Scalar::U8 | Scalar::U16 | Scalar::U32 | Scalar::U64 => (0, (1i128 << bits) - 1),
                _ => (-(1i128 << (bits - 1)), (1i128 << (bits - 1)) - 1),
            };
            if !(low..=high).contains(&value) {
                return Err(format!("{value} is not in {low}..={high}"));
            }
            packed.extend_from_slice(&value.to_le_bytes()[..scalar.bytes()]);
        }
    }
    Ok(())
}

/// Digits after the point that a number in text needs; nothing if they are very many.
fn decimal_digits(text: &[u8]) -> Option<u32> {
    let exponent_at = text.iter().position(|byte| matches!(byte, b'e' | b'E'));
    let (mantissa, exponent) = match exponent_at {
        Some(at) => {
            let exponent = std::str::from_utf8(&text[at + 1..]).ok()?.parse::<i64>().ok()?;
            (&text[..at], exponent)
        }
        None => (text, 0),
    };
    let fraction = mantissa.iter().position(|&byte| byte == b'.').map_or(&b""[..], |point| {
        let fraction = &mantissa[point + 1..];
        let zeros = fraction.iter().rev().take_while(|&&byte| byte == b'0').count();
        &fraction[..fraction.len() - zeros]
    });
    let digits = fraction.len() as i64 - exponent.clamp(-1000, 1000);
    // Zero needs no digits, however it is written.
    if digits > MANY_DIGITS && mantissa.iter().all(|b| !(b'1'..=b'9').contains(b)) {
        return Some(0);
    }
    (digits <= MANY_DIGITS).then_some(digits.max(0) as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_of_numbers() {
        let cases: [(&str, Option<u32>); 8] = [
            ("12", Some(0)),
            ("-0.0378297", Some(7)),
            ("1.500", Some(1)),
            ("1.25e-05", Some(7)),
            ("1.25e+1", Some(1)),
            ("3e4", Some(0)),
            ("0.0e-300", Some(0)),
            ("1e-30", None),
        ];
        for (text, digits) in cases {
            assert_eq!(decimal_digits(text.as_bytes()), digits, "{text}");
        }
    }

    #[test]
    fn values_must_fit_their_type() {
        let mut packed = Vec::new();
        assert!(push_value(b"255", Scalar::U8, &mut packed).is_ok());
        assert!(push_value(b"255.0", Scalar::U8, &mut packed).is_ok());
        assert_eq!(packed, [255, 255]);
        for (text, scalar) in
            [("256", Scalar::U8), ("-1", Scalar::U16), ("1.5", Scalar::I32), ("x", Scalar::F32)]
        {
            assert!(push_value(text.as_bytes(), scalar, &mut packed).is_err(), "{text}");
        }
        assert!(push_value(b"nan", Scalar::F32, &mut packed).is_ok());
    }
}
