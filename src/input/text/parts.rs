//! Where the scans of a text begin, and which lines are their rows.
//!
//! In PTS and PTX a line with a single number begins a scan, and no row has a single number. So
//! such lines are looked for side by side in all pieces of a text, and only they and what follows
//! them are then walked in order.

use std::ops::Range;

use glam::{DAffine3, DMat3, DQuat, DVec3};
use rayon::prelude::*;

use super::columns::ColumnList;
use super::number::read_token;
use super::preamble::{Line, TextKind, guess_separator, is_count, lines, wrong_list};
use super::row::{MOST_COLUMNS, Separator, is_passed_over, next_line, not_a_number};
use super::sinks::Placement;
use crate::input::foreign::Pose;

/// Most scans in one file.
const MOST_SCANS: u64 = 1 << 16;

/// Lines between the two counts of a PTX scan and its rows: the scanner's place and axes, then the
/// matrix.
const PTX_FRAME_LINES: usize = 8;

/// What a scan says of itself before its rows.
#[derive(Clone, Debug, PartialEq)]
pub struct PartHead {
    /// Rows that it claims.
    pub claimed_rows: u64,
    /// What happens to its coordinates.
    pub placement: Placement,
    /// Where the scanner stood.
    pub pose: Option<Pose>,
    /// What is odd about it.
    pub warning: Option<String>,
}

/// A stretch of the text, in order.
#[derive(Clone, Debug, PartialEq)]
pub enum Stretch {
    /// Lines that are no rows.
    Passed(u64),
    /// A scan begins.
    Part(Box<PartHead>),
    /// Rows of the scan that began last.
    Rows {
        /// Their bytes.
        bytes: Range<usize>,
        /// Their separator.
        separator: Separator,
        /// Their number of fields.
        width: usize,
    },
    /// Something is wrong, so many lines after the last stretch.
    Fault {
        /// Lines between.
        lines: u64,
        /// Column, counted from 1.
        column: Option<usize>,
        /// What is wrong.
        reason: String,
    },
}

/// Tells the stretches of a text that comes in pieces of whole lines.
#[derive(Debug)]
pub struct Parts<'a> {
    is_ptx: bool,
    told: Option<&'a ColumnList>,
    scans: u64,
    state: State,
}

#[derive(Debug)]
enum State {
    /// Lines of a scan's head that were met so far.
    Head(Vec<Vec<f64>>),
    /// Rows whose width is not known before the first is met.
    Rows(Option<(Separator, usize)>),
}

impl<'a> Parts<'a> {
    /// Of a PTS or PTX text.
    pub fn new(kind: TextKind, told: Option<&'a ColumnList>) -> Parts<'a> {
        Parts { is_ptx: kind == TextKind::Ptx, told, scans: 0, state: State::Head(Vec::new()) }
    }

    /// The stretches of the next piece; after a fault no more may be asked for.
    pub fn split(&mut self, text: &[u8], slices: &[Range<usize>]) -> Vec<Stretch> {
        let marks: Vec<Vec<usize>> =
            slices.par_iter().map(|slice| single_fields(text, slice)).collect();
        let mut marks = marks.into_iter().flatten().peekable();
        let mut stretches = Vec::new();
        let mut at = 0;
        while at < text.len() {
            match &mut self.state {
                State::Head(_) => {
                    let end = next_line(text, at);
                    if let Err(fault) = self.take_head_line(&text[at..end], &mut stretches) {
                        stretches.push(fault);
                        return stretches;
                    }
                    stretches.push(Stretch::Passed(1));
                    at = end;
                }
                State::Rows(layout) => {
                    while marks.next_if(|mark| *mark < at).is_some() {}
                    let end = marks.peek().copied().unwrap_or(text.len());
                    if end == at {
                        self.state = State::Head(Vec::new());
                        continue;
                    }
                    match row_layout(&text[at..end], *layout, self.told) {
                        Ok(Some((separator, width))) => {
                            *layout = Some((separator, width));
                            push_rows(&mut stretches, at..end, slices, separator, width);
                        }
                        Ok(None) => stretches.push(Stretch::Passed(count_lines(&text[at..end]))),
                        Err((lines, reason)) => {
                            stretches.push(Stretch::Fault { lines, column: None, reason });
                            return stretches;
                        }
                    }
                    at = end;
                }
            }
        }
        stretches
    }

    /// What is missing at the end of the text.
    pub fn end_fault(&self) -> Option<String> {
        match &self.state {
            State::Head(lines) if !lines.is_empty() => {
                Some(format!("the file ends within the head of scan {}", self.scans + 1))
            }
            State::Head(_) if self.scans == 0 => Some("no scan in this file".to_string()),
            _ => None,
        }
    }

    fn take_head_line(&mut self, line: &[u8], out: &mut Vec<Stretch>) -> Result<(), Stretch> {
        let fault = |column, reason| Stretch::Fault { lines: 0, column, reason };
        let State::Head(taken) = &mut self.state else { return Ok(()) };
        let line = line.trim_ascii();
        if is_passed_over(line) {
            return Ok(());
        }
        let scan = self.scans + 1;
        if scan > MOST_SCANS {
            return Err(fault(None, format!("more than {MOST_SCANS} scans in one file")));
        }
        let counts = if self.is_ptx { 2 } else { 1 };
        let mut numbers = Vec::with_capacity(4);
        if taken.len() < counts {
            if !is_count(line) {
                let what = ["columns", "rows"][taken.len().min(1)];
                let what = if self.is_ptx { what } else { "points" };
                let found = super::row::quote(line);
                let reason = format!("{found} where scan {scan} should tell its count of {what}");
                return Err(fault(None, reason));
            }
            numbers.push(read_token(line).map_or(0.0, |number| number.value));
        } else {
            for (index, field) in Separator::Blanks.split(line).into_iter().enumerate().take(5) {
                let number = read_token(field).filter(|number| number.value.is_finite());
                let number = number.ok_or_else(|| fault(Some(index + 1), not_a_number(field)))?;
                numbers.push(number.value);
            }
            let (expected, what) = match taken.len() - counts {
                0 => (3, "the scanner's position"),
                1..4 => (3, "an axis of the scanner"),
                _ => (4, "a row of the scan's matrix"),
            };
            if numbers.len() != expected {
                let found = numbers.len();
                let reason = format!("{found} numbers, expected {expected}: {what} of scan {scan}");
                return Err(fault(None, reason));
            }
        }
        taken.push(numbers);
        let total = if self.is_ptx { counts + PTX_FRAME_LINES } else { counts };
        if taken.len() == total {
            let taken = std::mem::take(taken);
            self.scans = scan;
            self.state = State::Rows(None);
            let head = if self.is_ptx { ptx_head(&taken) } else { Ok(pts_head(&taken)) };
            out.push(Stretch::Part(Box::new(head.map_err(|reason| fault(None, reason))?)));
        }
        Ok(())
    }
}

fn pts_head(lines: &[Vec<f64>]) -> PartHead {
    let claimed_rows = lines[0][0] as u64;
    PartHead { claimed_rows, placement: Placement::PLAIN, pose: None, warning: None }
}

/// The head of a PTX scan out of its ten lines of numbers.
///
/// Points are row vectors: world = (x y z 1) * matrix, so the rows of the matrix are the images of
/// the axes and, last, the place of the origin.
fn ptx_head(lines: &[Vec<f64>]) -> Result<PartHead, String> {
    let vector = |line: usize| DVec3::new(lines[line][0], lines[line][1], lines[line][2]);
    let [first_frame, first_matrix] = [2, 6];
    let last_column = [6, 7, 8, 9].map(|line| lines[line][3]);
    if last_column != [0.0, 0.0, 0.0, 1.0] {
        return Err(format!(
            "the scan's matrix ends in the column {last_column:?}, expected [0, 0, 0, 1]"
        ));
    }
    let transform = DAffine3::from_cols(
        vector(first_matrix),
        vector(first_matrix + 1),
        vector(first_matrix + 2),
        vector(first_matrix + 3),
    );
    let is_identity = transform == DAffine3::IDENTITY;
    // An identity says that the rows are in the world already; the frame above it then tells where
    // they were taken from.
    let (axes, translation) = if is_identity {
        let axes = [1, 2, 3].map(|line| vector(first_frame + line));
        (DMat3::from_cols(axes[0], axes[1], axes[2]), vector(first_frame))
    } else {
        (transform.matrix3, transform.translation)
    };
    let pose = rotation(axes).map(|rotation| Pose { rotation, translation });
    let warning = pose.is_none().then(|| {
        let what = if is_identity { "scanner's axes are" } else { "matrix is" };
        format!("its {what} no rotation: the points are placed by it, no pose is kept")
    });
    let placement =
        Placement { world_from_scan: (!is_identity).then_some(transform), zero_is_no_return: true };
    let claimed_rows = (lines[0][0] as u64).saturating_mul(lines[1][0] as u64);
    Ok(PartHead { claimed_rows, placement, pose, warning })
}

/// The rotation that a matrix is, up to the digits that files write.
fn rotation(axes: DMat3) -> Option<DQuat> {
    let defect = axes.transpose() * axes - DMat3::IDENTITY;
    let is_rotation = defect.abs_diff_eq(DMat3::ZERO, 1e-3) && axes.determinant() > 0.0;
    is_rotation.then(|| DQuat::from_mat3(&axes).normalize())
}

/// Where lines of a slice begin that hold a whole number and nothing else.
fn single_fields(text: &[u8], slice: &Range<usize>) -> Vec<usize> {
    let mut found = Vec::new();
    let mut at = slice.start;
    while at < slice.end {
        let line = &text[at..slice.end];
        // Most lines are told by their first bytes, before their end is looked for.
        let tells = line.iter().find(|byte| !byte.is_ascii_digit());
        let end = next_line(text, at);
        if tells.is_none_or(u8::is_ascii_whitespace) && is_count(&text[at..end]) {
            found.push(at);
        }
        at = end;
    }
    found
}

/// Separator and width of the first row of some lines, once known those it had; `None` if there is
/// no row. An error comes with its line.
fn row_layout(
    text: &[u8],
    known: Option<(Separator, usize)>,
    told: Option<&ColumnList>,
) -> Result<Option<(Separator, usize)>, (u64, String)> {
    if known.is_some() {
        return Ok(known);
    }
    let Some(row) = first_row(text) else { return Ok(None) };
    let separator = guess_separator(row.bytes).map_err(|reason| (row.number, reason))?;
    let width = separator.split(row.bytes).len();
    match told {
        _ if !(3..=MOST_COLUMNS).contains(&width) => {
            Err((row.number, format!("{width} columns, expected 3 to {MOST_COLUMNS}")))
        }
        Some(told) if told.names().len() != width => Err((row.number, wrong_list(width, told))),
        _ => Ok(Some((separator, width))),
    }
}

fn first_row(text: &[u8]) -> Option<Line<'_>> {
    lines(text).find(|line| !is_passed_over(line.bytes))
}

fn count_lines(text: &[u8]) -> u64 {
    let ends = memchr::memchr_iter(b'\n', text).count();
    (ends + usize::from(text.last().is_some_and(|byte| *byte != b'\n'))) as u64
}

/// Cuts rows at the ends of slices.
fn push_rows(
    stretches: &mut Vec<Stretch>,
    rows: Range<usize>,
    slices: &[Range<usize>],
    separator: Separator,
    width: usize,
) {
    let first = slices.partition_point(|slice| slice.end <= rows.start);
    for slice in &slices[first..] {
        let bytes = slice.start.max(rows.start)..slice.end.min(rows.end);
        if bytes.is_empty() {
            break;
        }
        stretches.push(Stretch::Rows { bytes, separator, width });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(bytes: Range<usize>, width: usize) -> Stretch {
        Stretch::Rows { bytes, separator: Separator::Blanks, width }
    }

    #[test]
    fn scans_and_rows_are_found_wherever_slices_end() {
        let text = b"2\n1 2 3\n4 5 6\n# c\n\n1\n7 8 9 10\n";
        let (first, second) = (2..19, 21..30);
        let cuts: Vec<usize> = lines(text).map(|line| line.start).chain([text.len()]).collect();
        for cut in cuts {
            let slices: Vec<Range<usize>> =
                [0..cut, cut..text.len()].into_iter().filter(|slice| !slice.is_empty()).collect();
            let mut parts = Parts::new(TextKind::Pts, None);
            let stretches = parts.split(text, &slices);
            assert_eq!(parts.end_fault(), None);
            let mut covered = [Vec::new(), Vec::new()];
            let mut scan = 0;
            for stretch in stretches {
                match stretch {
                    Stretch::Part(head) => {
                        scan += 1;
                        assert_eq!(head.claimed_rows, [2, 1][scan - 1]);
                    }
                    Stretch::Rows { bytes, width, .. } => {
                        assert_eq!(width, [3, 4][scan - 1]);
                        covered[scan - 1].extend(bytes);
                    }
                    Stretch::Passed(lines) => assert_eq!(lines, 1),
                    Stretch::Fault { reason, .. } => panic!("{reason}"),
                }
            }
            assert_eq!(covered, [first.clone().collect::<Vec<_>>(), second.clone().collect()]);
        }
    }

    #[test]
    fn a_head_may_come_in_two_pieces() {
        let text =
            b"1\n1\n5 6 7\n1 0 0\n0 1 0\n0 0 1\n0 1 0 0\n-1 0 0 0\n0 0 1 0\n5 6 7 1\n1 2 3 0.5\n";
        let cut = 22;
        assert_eq!(text[cut - 1], b'\n');
        let mut parts = Parts::new(TextKind::Ptx, None);
        assert!(parts.end_fault().is_some_and(|fault| fault.contains("no scan")));
        let before = parts.split(&text[..cut], std::slice::from_ref(&(0..cut)));
        assert!(before.iter().all(|stretch| *stretch == Stretch::Passed(1)), "{before:?}");
        assert!(parts.end_fault().is_some_and(|fault| fault.contains("head of scan 1")));
        let rest = &text[cut..];
        let after = parts.split(rest, std::slice::from_ref(&(0..rest.len())));
        let Some(Stretch::Part(head)) =
            after.iter().find(|stretch| matches!(stretch, Stretch::Part(_)))
        else {
            panic!("{after:?}");
        };
        let pose = head.pose.expect("the matrix is a rotation");
        assert_eq!(pose.translation, DVec3::new(5.0, 6.0, 7.0));
        assert!((pose.rotation * DVec3::X).abs_diff_eq(DVec3::Y, 1e-12));
        let transform = head.placement.world_from_scan.expect("it moves points");
        assert_eq!(
            transform.transform_point3(DVec3::new(1.0, 2.0, 3.0)),
            DVec3::new(3.0, 7.0, 10.0)
        );
        assert_eq!(after.last(), Some(&rows(rest.len() - 10..rest.len(), 4)));
    }
}
