//! What a text is, from its first lines: its kind, its separator, its header.

use super::columns::{self, ColumnList};
use super::number::read_token;
use super::row::{MOST_COLUMNS, Separator, is_passed_over, not_a_number, quote};

/// The kinds of text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextKind {
    /// Each scan begins with a line that counts its rows.
    Pts,
    /// Each scan begins with its columns and rows, its place and a matrix.
    Ptx,
    /// Rows from the first to the last line, perhaps below a header.
    Table,
}

/// Bytes of a file that its kind is told from, and within which its rows must begin.
pub const HEAD_BYTES: usize = 256 << 10;

/// What a file is if it is a text of points, from its first bytes; the more of `HEAD_BYTES` are
/// given, the longer may comments before the points be.
///
/// Texts that are refused with a reason, such as numbers with a decimal comma, count too.
pub fn detect_text(head: &[u8]) -> Option<TextKind> {
    if encoding_fault(head).is_some() {
        return Some(TextKind::Table);
    }
    let mut lines = lines(head).filter(|line| !is_passed_over(line.bytes)).map(|line| line.bytes);
    let first = lines.next()?;
    let (second, third) = (lines.next(), lines.next());
    if first.contains(&0) || second.is_some_and(|line| line.contains(&0)) {
        return None;
    }
    let count_columns = |line: Option<&[u8]>| line.map_or(0, numeric_columns);
    if is_count(first) {
        if second.is_some_and(is_count) && count_columns(third) == 3 {
            return Some(TextKind::Ptx);
        }
        let may_follow = |line: &[u8]| is_count(line) || numeric_columns(line) >= 3;
        return second.is_none_or(may_follow).then_some(TextKind::Pts);
    }
    (numeric_columns(first) >= 3 || count_columns(second) >= 3).then_some(TextKind::Table)
}

/// Why the bytes are no text in an encoding that is read.
pub fn encoding_fault(head: &[u8]) -> Option<String> {
    let utf_16 = head.starts_with(&[0xff, 0xfe]) || head.starts_with(&[0xfe, 0xff]);
    utf_16.then(|| "UTF-16 text is not read; save it as UTF-8 or ASCII".to_string())
}

/// Bytes of the mark that some programs put before UTF-8.
pub fn mark_bytes(head: &[u8]) -> usize {
    if head.starts_with(b"\xef\xbb\xbf") { 3 } else { 0 }
}

/// Whether a line holds one whole number and nothing else.
pub fn is_count(line: &[u8]) -> bool {
    let line = line.trim_ascii();
    !line.is_empty() && line.len() <= 20 && line.iter().all(u8::is_ascii_digit)
}

/// A line of the head.
#[derive(Clone, Copy, Debug)]
pub struct Line<'a> {
    /// Counted from 0.
    pub number: u64,
    /// Where it begins.
    pub start: usize,
    /// Its bytes without the line end.
    pub bytes: &'a [u8],
}

/// The lines of a text, a mark before the first taken off.
pub fn lines(text: &[u8]) -> impl Iterator<Item = Line<'_>> {
    let mut start = mark_bytes(text);
    let mut number = 0;
    std::iter::from_fn(move || {
        let rest = text.get(start..).filter(|rest| !rest.is_empty())?;
        let length = memchr::memchr(b'\n', rest).unwrap_or(rest.len());
        let bytes = &rest[..length];
        let line = Line { number, start, bytes: bytes.strip_suffix(b"\r").unwrap_or(bytes) };
        start += length + 1;
        number += 1;
        Some(line)
    })
}

/// How many fields of a line are numbers, decimal commas let pass, if the first three are.
fn numeric_columns(line: &[u8]) -> usize {
    let separator = guess_separator(line).unwrap_or(Separator::Blanks);
    let is_number = |field: &&&[u8]| {
        let point = field.iter().map(|&byte| if byte == b',' { b'.' } else { byte });
        read_token(&point.collect::<Vec<u8>>()).is_some()
    };
    let fields = separator.split(line);
    let leading = fields.iter().take_while(|field| is_number(field)).count();
    if leading >= 3 { leading } else { fields.iter().filter(is_number).count() }
}

/// What separates the fields of a line; an error if its commas are decimal ones.
pub fn guess_separator(line: &[u8]) -> Result<Separator, String> {
    if line.contains(&b';') {
        return Ok(Separator::Byte(b';'));
    }
    let words = Separator::Blanks.split(line);
    if line.contains(&b',') {
        let has_decimal_comma = |word: &&[u8]| {
            let digit = |index: usize| word.get(index).is_some_and(u8::is_ascii_digit);
            let comma = word.iter().position(|&byte| byte == b',');
            comma.is_some_and(|comma| digit(comma + 1) && !word[comma + 1..].contains(&b','))
        };
        if words.len() >= 3 && words.iter().take(3).all(has_decimal_comma) {
            return Err(not_a_number(words[0]));
        }
        return Ok(Separator::Byte(b','));
    }
    let tabbed = Separator::Byte(b'\t').split(line);
    if line.contains(&b'\t') && tabbed.len() >= words.len() && tabbed.last() != Some(&&b""[..]) {
        return Ok(Separator::Byte(b'\t'));
    }
    Ok(Separator::Blanks)
}

/// What stands before the rows of a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TableHead {
    /// Between the fields of the rows.
    pub separator: Separator,
    /// Fields of the first row.
    pub width: usize,
    /// Names of the columns that a header line gives.
    pub names: Option<Vec<String>>,
    /// Where the first row begins.
    pub rows_start: usize,
    /// Its line, counted from 0.
    pub rows_line: u64,
}

/// Looks for the first row of a table and a header above it: a line whose first field is no
/// number, or a comment that names x, y and z and has as many words as the row.
///
/// Errors come with their line, counted from 0. Where `told` names the columns a header is passed
/// over, whatever it says.
pub fn read_table_head(head: &[u8], told: Option<&ColumnList>) -> Result<TableHead, (u64, String)> {
    let mut header: Option<Line> = None;
    let mut comment: Option<&[u8]> = None;
    let mut last_line = 0;
    for line in lines(head) {
        last_line = line.number;
        let text = line.bytes.trim_ascii();
        if is_passed_over(text) {
            if !text.is_empty() {
                comment = Some(text.trim_start_matches_bytes(b"#/"));
            }
            continue;
        }
        let at_line = |reason: String| (line.number, reason);
        if text.contains(&0) {
            return Err(at_line(not_a_number(&[0])));
        }
        let separator = guess_separator(line.bytes).map_err(at_line)?;
        let fields = separator.split(line.bytes);
        if is_row(&fields, told) {
            let width = width_of(&fields, told);
            if width > MOST_COLUMNS {
                return Err(at_line(format!("{width} columns; {MOST_COLUMNS} are the most")));
            }
            if width < 3 {
                return Err(at_line(format!("{width} columns; a point needs x, y and z")));
            }
            if let Some(told) = told.filter(|told| told.names().len() != width) {
                return Err(at_line(wrong_list(width, told)));
            }
            let names = match (header, told) {
                (_, Some(_)) => None,
                (Some(header), None) => Some(header_names(header, separator, width)?),
                (None, None) => {
                    comment.and_then(|comment| comment_names(comment, separator, width))
                }
            };
            let (rows_start, rows_line) = (line.start, line.number);
            return Ok(TableHead { separator, width, names, rows_start, rows_line });
        }
        if header.is_some() || text.to_ascii_lowercase().starts_with(b"ncols ") {
            return Err(at_line(no_row(&fields)));
        }
        header = Some(line);
    }
    Err((last_line, "no row of numbers".to_string()))
}

/// Names of a header line that has as many fields as the rows.
fn header_names(
    header: Line,
    separator: Separator,
    width: usize,
) -> Result<Vec<String>, (u64, String)> {
    let own = guess_separator(header.bytes).unwrap_or(Separator::Blanks);
    let separators = [separator, own, Separator::Blanks];
    let splits = separators.map(|separator| separator.split(header.bytes));
    let Some(fields) = splits.iter().find(|fields| fields.len() == width) else {
        let count = splits[0].len();
        let reason = format!(
            "the header has {count} names, the rows have {width} columns; --columns sets the names"
        );
        return Err((header.number, reason));
    };
    columns::from_header(fields).map_err(|reason| (header.number, reason))
}

/// Names in a comment above the rows, if it is a header.
fn comment_names(comment: &[u8], separator: Separator, width: usize) -> Option<Vec<String>> {
    let own = guess_separator(comment).ok()?;
    let splits = [separator, own].map(|separator| separator.split(comment));
    let fields = splits.iter().find(|fields| fields.len() == width)?;
    columns::from_header(fields).ok()
}

/// Whether a line is a row rather than a header: its first columns (those that `told` does not
/// skip) are numbers.
fn is_row(fields: &[&[u8]], told: Option<&ColumnList>) -> bool {
    let is_number = |field: &&&[u8]| field.is_empty() || read_token(field).is_some();
    match told {
        None => fields.first().is_some_and(|field| read_token(field).is_some()),
        Some(told) => {
            let used = fields.iter().zip(told.names()).filter(|(_, name)| *name != columns::SKIP);
            used.map(|(field, _)| field).take(3).all(|field| is_number(&field))
        }
    }
}

/// What is wrong with a list of columns of another length than the rows.
pub fn wrong_list(width: usize, told: &ColumnList) -> String {
    format!("{width} columns, but --columns names {}", told.names().len())
}

/// Fields of the first row; empty ones at its end are no columns unless somebody named them.
fn width_of(fields: &[&[u8]], told: Option<&ColumnList>) -> usize {
    if told.is_some_and(|told| told.names().len() == fields.len()) {
        return fields.len();
    }
    fields.iter().rposition(|field| !field.is_empty()).map_or(0, |last| last + 1)
}

fn no_row(fields: &[&[u8]]) -> String {
    let first = fields.first().copied().unwrap_or_default();
    match &first.to_ascii_lowercase()[..] {
        b"ncols" | b"nrows" => "an ESRI grid of heights, not a list of points".to_string(),
        _ => format!("neither a header nor a row: {} is not a number", quote(first)),
    }
}

/// Trimming of bytes at the front.
trait TrimStart {
    fn trim_start_matches_bytes(&self, set: &[u8]) -> &[u8];
}

impl TrimStart for [u8] {
    fn trim_start_matches_bytes(&self, set: &[u8]) -> &[u8] {
        let start = self.iter().position(|byte| !set.contains(byte)).unwrap_or(self.len());
        &self[start..]
    }
}
