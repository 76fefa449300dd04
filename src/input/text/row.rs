//! Rows of numbers out of text, and what is wrong with those that are none.
//!
//! One loop serves opening and reading: it splits lines into fields and hands each number to a
//! sink. Empty lines and comments (`#`, `//`) are passed over anywhere.

use super::number::{Number, read_plain, read_token};

/// Longest line that is read, bytes. Bounds what a reader holds of a file without line ends.
pub const MOST_LINE_BYTES: usize = 64 << 10;

/// Most columns of a row.
pub const MOST_COLUMNS: usize = 256;

/// What stands between the fields of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Separator {
    /// Any run of spaces and tabs; a cell cannot be empty.
    Blanks,
    /// One comma, semicolon or tab, spaces around it ignored; a cell may be empty.
    Byte(u8),
}

impl Separator {
    /// Its name in messages.
    pub fn name(self) -> &'static str {
        match self {
            Separator::Blanks => "space",
            Separator::Byte(b',') => "comma",
            Separator::Byte(b';') => "semicolon",
            Separator::Byte(_) => "tab",
        }
    }

    fn byte(self) -> u8 {
        match self {
            Separator::Blanks => b' ',
            Separator::Byte(byte) => byte,
        }
    }

    /// The fields of a line, without blanks around them. Quotes hide separators.
    pub fn split(self, line: &[u8]) -> Vec<&[u8]> {
        match self {
            Separator::Blanks => {
                let words = line.split(|byte| is_blank(*byte));
                words.filter(|word| !word.is_empty()).collect()
            }
            Separator::Byte(separator) => {
                let mut cells = Vec::new();
                let mut at = 0;
                loop {
                    let start = skip_blanks(line, at, Some(separator));
                    let end = skip_cell(line, start, self);
                    cells.push(line[start..end].trim_ascii());
                    if line.get(end) != Some(&separator) {
                        return cells;
                    }
                    at = end + 1;
                }
            }
        }
    }
}

/// How rows are laid out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RowFormat {
    /// Between fields.
    pub separator: Separator,
    /// Which fields are passed over unread, one entry per field.
    pub is_skipped: Vec<bool>,
}

impl RowFormat {
    /// Fields in a row.
    pub fn width(&self) -> usize {
        self.is_skipped.len()
    }
}

/// Takes the numbers of rows.
pub trait RowSink {
    /// A row begins; what an unfinished row before it brought does not count.
    fn begin(&mut self);
    /// The number in a field that is not skipped; fields come in order.
    fn number(&mut self, field: usize, number: &Number);
    /// All fields of the row were there.
    fn end(&mut self);
}

/// What to do with a row that is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BadRows {
    /// The first one ends the reading.
    Refuse,
    /// They are left out and counted.
    LeaveOut,
}

/// What a run over lines met.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Lines of any kind.
    pub lines: u64,
    /// Rows that were left out because something is wrong with them.
    pub bad_rows: u64,
}

/// A row that is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RowFault {
    /// Its line, counted from 0 at the start of the text given.
    pub line: u64,
    /// Its column, counted from 1, where one is to blame.
    pub column: Option<usize>,
    /// What is wrong.
    pub reason: String,
}

/// Reads all rows of a text that begins and ends at line ends.
pub fn read_rows<S: RowSink>(
    text: &[u8],
    format: &RowFormat,
    bad_rows: BadRows,
    sink: &mut S,
) -> Result<Tally, RowFault> {
    let mut tally = Tally::default();
    let mut at = 0;
    // A tab before the first cell is an empty cell where tabs separate.
    let kept = (format.separator != Separator::Blanks).then(|| format.separator.byte());
    while at < text.len() {
        let start = at;
        at = skip_blanks(text, at, kept);
        let outcome = match text.get(at) {
            None => break,
            Some(b'\n') => Ok(at + 1),
            Some(b'\r') => end_of_line(text, at).ok_or_else(|| stray_byte(text, at)),
            Some(b'#') => Ok(next_line(text, at)),
            Some(b'/') if text.get(at + 1) == Some(&b'/') => Ok(next_line(text, at)),
            Some(_) => {
                sink.begin();
                let end = read_row(text, at, format, sink);
                if end.is_ok() {
                    sink.end();
                }
                end
            }
        };
        let outcome = match outcome {
            Ok(end) if end - start > MOST_LINE_BYTES => Err(Wrong::line(too_long())),
            other => other,
        };
        at = match (outcome, bad_rows) {
            (Ok(end), _) => end,
            (Err(wrong), BadRows::Refuse) => {
                return Err(RowFault {
                    line: tally.lines,
                    column: wrong.field.map(|field| field + 1),
                    reason: wrong.reason,
                });
            }
            (Err(_), BadRows::LeaveOut) => {
                tally.bad_rows += 1;
                next_line(text, start)
            }
        };
        tally.lines += 1;
    }
    Ok(tally)
}

/// What is wrong with a line that never ends.
pub fn too_long() -> String {
    format!("longer than {MOST_LINE_BYTES} bytes, the most that a line may have")
}

/// Whether a line holds no row: empty, or a comment.
pub fn is_passed_over(line: &[u8]) -> bool {
    let line = line.trim_ascii();
    line.is_empty() || line[0] == b'#' || line.starts_with(b"//")
}

/// Bytes of the file as they can stand in a message.
pub fn quote(bytes: &[u8]) -> String {
    let shown = bytes[..bytes.len().min(24)].escape_ascii();
    let more = if bytes.len() > 24 { "..." } else { "" };
    format!("\"{shown}{more}\"")
}

/// The place after the line end that follows `at`, or the end of the text.
pub fn next_line(text: &[u8], at: usize) -> usize {
    memchr::memchr(b'\n', &text[at..]).map_or(text.len(), |length| at + length + 1)
}

/// Why these bytes are no number.
pub fn not_a_number(token: &[u8]) -> String {
    let is_digit = |index: usize| token.get(index).is_some_and(u8::is_ascii_digit);
    let comma = token.iter().position(|&byte| byte == b',');
    if comma.is_some_and(|comma| is_digit(comma + 1)) && !token.iter().any(u8::is_ascii_alphabetic)
    {
        return format!("{} has a decimal comma; numbers need a decimal point", quote(token));
    }
    if token.contains(&0) {
        return "a NUL byte: the text is damaged, binary or UTF-16".to_string();
    }
    format!("{} is not a number", quote(token))
}

struct Wrong {
    field: Option<usize>,
    reason: String,
}

impl Wrong {
    fn line(reason: String) -> Wrong {
        Wrong { field: None, reason }
    }
}

/// Reads one row whose first field begins at `at`; gives where the next line begins.
#[inline(always)]
fn read_row<S: RowSink>(
    text: &[u8],
    mut at: usize,
    format: &RowFormat,
    sink: &mut S,
) -> Result<usize, Wrong> {
    let separator = format.separator.byte();
    let width = format.is_skipped.len();
    for (field, &is_skipped) in format.is_skipped.iter().enumerate() {
        if is_skipped {
            at = skip_cell(text, at, format.separator);
        } else {
            match read_plain(text, at) {
                Some((number, end)) if ends_field(text, end, separator) => {
                    sink.number(field, &number);
                    at = end;
                }
                _ => {
                    let (number, end) = read_cell(text, at, field, format)?;
                    sink.number(field, &number);
                    at = end;
                }
            }
        }
        if field + 1 < width {
            at = next_field(text, at, format.separator)
                .ok_or_else(|| wrong_between(text, at, field, width))?;
        }
    }
    // A separator after the last field is an empty cell that means nothing.
    at = skip_blanks(text, at, None);
    if format.separator != Separator::Blanks {
        while text.get(at) == Some(&separator) {
            at = skip_blanks(text, at + 1, None);
        }
    }
    end_of_line(text, at).ok_or_else(|| match text[at] {
        b'\r' | 0 => stray_byte(text, at),
        _ => Wrong::line(format!("more than the {width} columns of the rows before")),
    })
}

/// A field that is no plain number: an empty cell, a number written otherwise, or none.
#[cold]
#[inline(never)]
fn read_cell(
    text: &[u8],
    at: usize,
    field: usize,
    format: &RowFormat,
) -> Result<(Number, usize), Wrong> {
    let separator = format.separator.byte();
    let mut end = at;
    while !ends_field(text, end, separator) {
        end += 1;
    }
    let token = &text[at..end];
    if token.is_empty() {
        return match text.get(at) {
            Some(0) => Err(Wrong { field: Some(field), reason: not_a_number(&[0]) }),
            _ => Ok((Number::EMPTY, end)),
        };
    }
    let refused = || Wrong { field: Some(field), reason: not_a_number(token) };
    read_token(token).map(|number| (number, end)).ok_or_else(refused)
}

/// Where the field after the one that ended at `at` begins; `None` if there is none.
#[inline(always)]
fn next_field(text: &[u8], at: usize, separator: Separator) -> Option<usize> {
    match separator {
        Separator::Blanks => {
            let next = skip_blanks(text, at, None);
            let is_field = next > at && !matches!(text.get(next), None | Some(b'\n' | b'\r'));
            is_field.then_some(next)
        }
        Separator::Byte(byte) => {
            let at = skip_blanks(text, at, Some(byte));
            (text.get(at) == Some(&byte)).then(|| skip_blanks(text, at + 1, Some(byte)))
        }
    }
}

#[cold]
fn wrong_between(text: &[u8], at: usize, field: usize, width: usize) -> Wrong {
    let at = skip_blanks(text, at, None);
    match text.get(at) {
        None | Some(b'\n') => {
            let count = field + 1;
            Wrong::line(format!("{count} columns, expected {width} as in the rows before"))
        }
        Some(b'\r' | 0) => stray_byte(text, at),
        Some(_) => {
            let end =
                text[at..].iter().position(|byte| *byte <= b' ').map_or(text.len(), |n| at + n);
            let found = quote(&text[at..end]);
            Wrong { field: Some(field), reason: format!("{found} where the field should end") }
        }
    }
}

/// The end of a cell that is not read; quotes may hide separators in it.
fn skip_cell(text: &[u8], at: usize, separator: Separator) -> usize {
    let rest = &text[at..];
    let is_end = |byte: &u8| match separator {
        Separator::Blanks => *byte <= b' ',
        Separator::Byte(separator) => *byte == separator || *byte == b'\n' || *byte == b'\r',
    };
    let mut from = 0;
    if rest.first() == Some(&b'"') {
        let closing = rest[1..].iter().position(|byte| matches!(byte, b'"' | b'\n'));
        from = closing.map_or(0, |length| length + 1);
    }
    rest[from..].iter().position(is_end).map_or(text.len(), |length| at + from + length)
}

/// Control bytes end a field too, so that what follows it tells what they are.
#[inline(always)]
fn ends_field(text: &[u8], at: usize, separator: u8) -> bool {
    text.get(at).is_none_or(|&byte| byte <= b' ' || byte == separator)
}

fn is_blank(byte: u8) -> bool {
    byte == b' ' || byte == b'\t'
}

#[inline(always)]
fn skip_blanks(text: &[u8], mut at: usize, separator: Option<u8>) -> usize {
    while text.get(at).is_some_and(|&byte| is_blank(byte) && Some(byte) != separator) {
        at += 1;
    }
    at
}

/// The place after a line end at `at`; `None` if there is none.
#[inline(always)]
fn end_of_line(text: &[u8], at: usize) -> Option<usize> {
    match text.get(at) {
        None => Some(at),
        Some(b'\n') => Some(at + 1),
        Some(b'\r') => match text.get(at + 1) {
            None => Some(at + 1),
            Some(b'\n') => Some(at + 2),
            Some(_) => None,
        },
        Some(_) => None,
    }
}

#[cold]
fn stray_byte(text: &[u8], at: usize) -> Wrong {
    Wrong::line(match text[at] {
        0 => not_a_number(&[0]),
        _ => "a carriage return within the line; lines must end with a line feed".to_string(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Default)]
    struct Rows {
        rows: Vec<Vec<f64>>,
        row: Vec<f64>,
    }

    impl RowSink for Rows {
        fn begin(&mut self) {
            self.row.clear();
        }
        fn number(&mut self, _: usize, number: &Number) {
            self.row.push(number.value);
        }
        fn end(&mut self) {
            self.rows.push(self.row.clone());
        }
    }

    fn read(text: &str, separator: Separator, skipped: &[bool]) -> Result<Vec<Vec<f64>>, RowFault> {
        let format = RowFormat { separator, is_skipped: skipped.to_vec() };
        let mut sink = Rows::default();
        read_rows(text.as_bytes(), &format, BadRows::Refuse, &mut sink).map(|_| sink.rows)
    }

    #[test]
    fn lines_of_all_kinds_are_read_or_passed_over() {
        let text = "# a\n  1 2\t3  \r\n\n// b\n\t-1.5 +2. .25\n \r\n7 8 9";
        let rows = read(text, Separator::Blanks, &[false; 3]).expect("all is well");
        assert_eq!(rows, [[1.0, 2.0, 3.0], [-1.5, 2.0, 0.25], [7.0, 8.0, 9.0]]);
        let text = "1 , 2,3\n4,5, 6 ,,\n";
        let rows = read(text, Separator::Byte(b','), &[false; 3]).expect("all is well");
        assert_eq!(rows, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        let rows = read("1\t\t3\n", Separator::Byte(b'\t'), &[false; 3]).expect("all is well");
        assert!(rows[0][0] == 1.0 && rows[0][1].is_nan() && rows[0][2] == 3.0);
    }

    #[test]
    fn skipped_cells_may_hold_anything() {
        let text = "1,\"a,b\",3\n4,what ever,6\n7,,9\n";
        let rows = read(text, Separator::Byte(b','), &[false, true, false]).expect("all is well");
        assert_eq!(rows, [[1.0, 3.0], [4.0, 6.0], [7.0, 9.0]]);
        let rows = read("1 A12 3\n", Separator::Blanks, &[false, true, false]);
        assert_eq!(rows.expect("all is well"), [[1.0, 3.0]]);
    }

    #[test]
    fn faults_name_line_and_column() {
        let blanks = |text: &str| {
            let fault = read(text, Separator::Blanks, &[false; 3]).expect_err("it is wrong");
            (fault.line, fault.column, fault.reason)
        };
        let found = |line, column, reason: &str| (line, column, reason.to_string());
        assert_eq!(blanks("1 2 3\n1 x 3\n"), found(1, Some(2), "\"x\" is not a number"));
        let few = "2 columns, expected 3 as in the rows before";
        assert_eq!(blanks("\n1 2 3\n1 2\n"), found(2, None, few));
        assert_eq!(blanks("1 2 3\n1 2"), found(1, None, few));
        assert_eq!(
            blanks("1 2 3 4\n"),
            found(0, None, "more than the 3 columns of the rows before")
        );
        let comma = "\"1,5\" has a decimal comma; numbers need a decimal point";
        assert_eq!(blanks("1,5 2 3\n"), found(0, Some(1), comma));
        assert!(blanks("1 2\0 3\n").2.contains("NUL"));
        assert!(blanks("1 \0 3\n").2.contains("NUL"));
        assert!(blanks("1 2 3\0\n").2.contains("NUL"));
        assert!(blanks("1 2 3\r4 5 6\n").2.contains("carriage return"));
        assert!(blanks("1 2\r3 4 5 6\n").2.contains("carriage return"));
    }

    #[test]
    fn bad_rows_can_be_left_out() {
        let format = RowFormat { separator: Separator::Blanks, is_skipped: vec![false; 2] };
        let mut sink = Rows::default();
        let text = b"1 2\nx y\n3\n4 5 6\n7 8\n";
        let tally = read_rows(text, &format, BadRows::LeaveOut, &mut sink).expect("none refused");
        assert_eq!(tally, Tally { lines: 5, bad_rows: 3 });
        assert_eq!(sink.rows, [[1.0, 2.0], [7.0, 8.0]]);
    }
}
