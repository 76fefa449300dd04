//! Text files as an open reader: one pass when opened, blocks afterwards.

use glam::DVec3;
use rayon::prelude::*;

use super::columns::{self, AXES, ColumnList};
use super::layout::{Layout, RowClass, lay_out};
use super::parts::{PartHead, Parts, Stretch};
use super::pieces::{Pieces, SLICE_BYTES};
use super::preamble::{
    HEAD_BYTES, TextKind, detect_text, encoding_fault, mark_bytes, read_table_head,
};
use super::row::{BadRows, RowFault, RowFormat, Separator, Tally, read_rows, too_long};
use super::sinks::{Fill, Placement, Survey};
use crate::input::crs::Crs;
use crate::input::foreign::{
    CoordinateKind, ForeignFacts, ForeignFault, ForeignReader, RowBlock, RowBuffer, ScanPart,
};
use crate::input::positioned_file::PositionedFile;

/// What a user can tell about a text.
#[derive(Clone, Debug)]
pub struct TextOptions {
    /// What the columns are; otherwise a header tells, or the numbers in them.
    pub columns: Option<ColumnList>,
    /// What to do with lines that are no rows. Left out, they are counted in the facts.
    pub bad_rows: BadRows,
}

impl Default for TextOptions {
    fn default() -> Self {
        TextOptions { columns: None, bad_rows: BadRows::Refuse }
    }
}

/// A text of points: PTS, PTX, or rows of numbers such as XYZ and CSV.
#[derive(Debug)]
pub struct TextReader {
    file: PositionedFile,
    facts: ForeignFacts,
    layout: Layout,
    classes: Vec<RowClass>,
    placements: Vec<Placement>,
    places: Vec<BlockPlace>,
    bad_rows: BadRows,
}

/// Where the rows of a block stand.
#[derive(Clone, Copy, Debug)]
struct BlockPlace {
    start: u64,
    bytes: u32,
    class: u32,
    /// Its first line, counted from 0.
    line: u64,
}

impl TextReader {
    /// Opens a text: reads all of it once.
    pub fn open(file: PositionedFile, options: &TextOptions) -> Result<TextReader, ForeignFault> {
        let head_bytes = file.bytes().min(HEAD_BYTES as u64);
        let mut head = file.read_range(0..head_bytes)?;
        if let Some(reason) = encoding_fault(&head) {
            return Err(at_line(0, None, reason));
        }
        if head_bytes < file.bytes() {
            let Some(end) = memchr::memrchr(b'\n', &head) else {
                return Err(at_line(0, None, too_long()));
            };
            head.truncate(end + 1);
        }
        let kind = detect_text(&head).unwrap_or(TextKind::Table);
        let mut opening = Opening::new(kind, options);
        let start = match kind {
            TextKind::Table => opening.read_table_head(&head, options)?,
            _ => mark_bytes(&head) as u64,
        };
        drop(head);
        opening.read_all(&file, start)?;
        opening.finish(file)
    }
}

impl ForeignReader for TextReader {
    fn facts(&self) -> &ForeignFacts {
        &self.facts
    }

    fn read_block(&self, block: usize, rows: &mut RowBuffer) -> Result<(), ForeignFault> {
        let place = self.places[block];
        let RowBuffer { positions, attributes, scratch } = rows;
        scratch.resize(place.bytes as usize, 0);
        self.file.read_exact_at(scratch, place.start)?;
        let class = place.class as usize;
        let row = &self.facts.blocks[block];
        let placement = self.placements[row.part as usize];
        let blank_row = self.layout.blank_row(class);
        let targets = &self.layout.targets[class];
        let mut fill = Fill::new(targets, placement, &blank_row, positions, attributes);
        let outcome = read_rows(scratch, &self.classes[class].format, self.bad_rows, &mut fill);
        fill.finish();
        outcome.map_err(|fault| in_row(place.line, fault, None))?;
        let (found, expected) = (positions.len() as u64, row.points);
        if found != expected {
            let reason = format!(
                "{found} points up to byte {}, {expected} when the file was opened: it has changed",
                place.start + u64::from(place.bytes)
            );
            return Err(at_line(place.line, None, reason));
        }
        Ok(())
    }
}

/// What has been learnt of a file that is being opened.
struct Opening<'a> {
    kind: TextKind,
    columns: Option<&'a ColumnList>,
    bad_rows: BadRows,
    classes: Vec<RowClass>,
    placements: Vec<Placement>,
    parts: Vec<ScanPart>,
    claims: Vec<u64>,
    blocks: Vec<RowBlock>,
    places: Vec<BlockPlace>,
    /// Lines walked so far.
    line: u64,
    /// The last line of the scan that began last, counted from 0.
    part_line: u64,
    points: u64,
    dropped: u64,
    unreadable: u64,
    bounds: [DVec3; 2],
    digits: u8,
    is_decimal: bool,
    /// Whether a header or an option named the columns.
    is_named: bool,
    warnings: Vec<String>,
}

/// Stretches surveyed together. What a survey keeps can be larger than short rows with many
/// columns; this bounds it.
const MOST_STRETCHES: usize = 256;

/// Rows to look through.
struct Segment<'t> {
    text: &'t [u8],
    start: u64,
    class: usize,
    part: usize,
}

impl<'a> Opening<'a> {
    fn new(kind: TextKind, options: &'a TextOptions) -> Opening<'a> {
        Opening {
            kind,
            columns: options.columns.as_ref(),
            bad_rows: options.bad_rows,
            classes: Vec::new(),
            placements: Vec::new(),
            parts: Vec::new(),
            claims: Vec::new(),
            blocks: Vec::new(),
            places: Vec::new(),
            line: 0,
            part_line: 0,
            points: 0,
            dropped: 0,
            unreadable: 0,
            bounds: [DVec3::INFINITY, DVec3::NEG_INFINITY],
            digits: 0,
            is_decimal: true,
            is_named: false,
            warnings: Vec::new(),
        }
    }

    /// Finds the first row of a table; gives its byte.
    fn read_table_head(&mut self, head: &[u8], options: &TextOptions) -> Result<u64, ForeignFault> {
        let found = read_table_head(head, options.columns.as_ref());
        let found = found.map_err(|(line, reason)| at_line(line, None, reason))?;
        self.line = found.rows_line;
        self.is_named = found.names.is_some();
        self.class(found.separator, found.width, found.names);
        self.begin_part(&PartHead {
            claimed_rows: 0,
            placement: Placement::PLAIN,
            pose: None,
            warning: None,
        });
        Ok(found.rows_start as u64)
    }

    /// The class of rows of that shape.
    fn class(&mut self, separator: Separator, width: usize, names: Option<Vec<String>>) -> usize {
        let names = match self.columns {
            Some(list) => Some(list.names().to_vec()),
            None => names,
        };
        let is_same =
            |class: &RowClass| class.format.separator == separator && class.format.width() == width;
        if let Some(known) = self.classes.iter().position(is_same) {
            return known;
        }
        let place = |axis: usize| match &names {
            Some(names) => names.iter().position(|name| name == AXES[axis]).unwrap_or(axis),
            None => axis,
        };
        let is_skipped = match &names {
            Some(names) => names.iter().map(|name| name == columns::SKIP).collect(),
            None => vec![false; width],
        };
        self.classes.push(RowClass {
            format: RowFormat { separator, is_skipped },
            axes: [place(0), place(1), place(2)],
            names,
            stats: vec![super::stats::ColumnStats::EMPTY; width],
            rows: 0,
        });
        self.classes.len() - 1
    }

    fn begin_part(&mut self, head: &PartHead) {
        self.part_line = self.line;
        self.parts.push(ScanPart { name: None, pose: head.pose, points: 0 });
        self.claims.push(head.claimed_rows);
        self.placements.push(head.placement);
        if let Some(warning) = &head.warning {
            self.warn(format!("scan {}: {warning}", self.parts.len()));
        }
    }

    /// Keeps a warning, unless there are many already.
    fn warn(&mut self, warning: String) {
        const MOST_WARNINGS: usize = 20;
        match self.warnings.len() {
            0..MOST_WARNINGS => self.warnings.push(warning),
            MOST_WARNINGS => self.warnings.push("more of the kind is not told".to_string()),
            _ => {}
        }
    }

    fn read_all(&mut self, file: &PositionedFile, start: u64) -> Result<(), ForeignFault> {
        let mut pieces = Pieces::new(file, start);
        let mut splitter = match self.kind {
            TextKind::Table => None,
            kind => Some(Parts::new(kind, self.columns)),
        };
        while let Some(piece) = pieces.next(self.line)? {
            let stretches = match &mut splitter {
                Some(splitter) => splitter.split(piece.text, &piece.slices),
                None => {
                    let format = &self.classes[0].format;
                    let (separator, width) = (format.separator, format.width());
                    let rows = |bytes| Stretch::Rows { bytes, separator, width };
                    piece.slices.into_iter().map(rows).collect()
                }
            };
            for stretches in stretches.chunks(MOST_STRETCHES) {
                self.take_stretches(stretches, piece.text, piece.start)?;
            }
        }
        if let Some(reason) = splitter.and_then(|splitter| splitter.end_fault()) {
            return Err(at_line(self.line.saturating_sub(1), None, reason));
        }
        self.check_claim()
    }

    /// Surveys stretches side by side and takes them in order, so that the first fault of the file
    /// is the one told.
    fn take_stretches(
        &mut self,
        stretches: &[Stretch],
        text: &[u8],
        start: u64,
    ) -> Result<(), ForeignFault> {
        let known = self.placements.len();
        let mut fresh = Vec::new();
        let mut segments = Vec::new();
        for stretch in stretches {
            match stretch {
                Stretch::Part(head) => fresh.push(head.placement),
                Stretch::Rows { bytes, separator, width } => segments.push(Segment {
                    text: &text[bytes.clone()],
                    start: start + bytes.start as u64,
                    class: self.class(*separator, *width, None),
                    part: (known + fresh.len()).saturating_sub(1),
                }),
                Stretch::Passed(_) | Stretch::Fault { .. } => {}
            }
        }
        let survey = |segment: &Segment| {
            let class = &self.classes[segment.class];
            let placement = match segment.part.checked_sub(known) {
                Some(index) => fresh[index],
                None => self.placements[segment.part],
            };
            let mut survey = Survey::new(class.format.width(), class.axes, placement);
            let outcome = read_rows(segment.text, &class.format, self.bad_rows, &mut survey);
            (survey, outcome)
        };
        let surveyed: Vec<(Survey, Result<Tally, RowFault>)> =
            segments.par_iter().map(survey).collect();
        let mut surveyed = segments.iter().zip(surveyed);
        for stretch in stretches {
            match stretch {
                Stretch::Passed(lines) => self.line += lines,
                Stretch::Part(head) => {
                    self.check_claim()?;
                    self.begin_part(head);
                }
                Stretch::Rows { .. } => {
                    if let Some((segment, (survey, outcome))) = surveyed.next() {
                        let names = self.classes[segment.class].names.as_deref();
                        let tally = outcome.map_err(|fault| in_row(self.line, fault, names))?;
                        self.take_survey(segment, &survey, tally);
                    }
                }
                Stretch::Fault { lines, column, reason } => {
                    return Err(at_line(self.line + lines, *column, reason.clone()));
                }
            }
        }
        Ok(())
    }

    fn take_survey(&mut self, segment: &Segment, survey: &Survey, tally: Tally) {
        if survey.points > 0 {
            self.blocks.push(RowBlock {
                first_point: self.points,
                points: survey.points,
                part: segment.part as u32,
            });
            self.places.push(BlockPlace {
                start: segment.start,
                bytes: segment.text.len() as u32,
                class: segment.class as u32,
                line: self.line,
            });
        }
        let rows = survey.points + survey.dropped;
        let class = &mut self.classes[segment.class];
        class.rows += rows;
        for (known, seen) in class.stats.iter_mut().zip(&survey.stats) {
            *known = known.join(seen);
        }
        self.line += tally.lines;
        self.part_line = self.line.saturating_sub(1);
        self.parts[segment.part].points += rows;
        self.points += survey.points;
        self.dropped += survey.dropped;
        self.unreadable += tally.bad_rows;
        self.bounds = [self.bounds[0].min(survey.bounds[0]), self.bounds[1].max(survey.bounds[1])];
        self.digits = self.digits.max(survey.digits);
        self.is_decimal &= survey.is_decimal;
    }

    /// Compares the scan that ends here with what it claimed.
    fn check_claim(&mut self) -> Result<(), ForeignFault> {
        let (Some(claimed), Some(part)) = (self.claims.last(), self.parts.last()) else {
            return Ok(());
        };
        let (claimed, found, scan) = (*claimed, part.points, self.parts.len());
        let told = || format!("scan {scan} counts {claimed} rows and has {found}");
        let is_wrong = match self.kind {
            TextKind::Table => return Ok(()),
            TextKind::Ptx => found != claimed,
            // Writers that do not know the count leave 0 or a guess; less than it is a loss.
            TextKind::Pts => found < claimed,
        };
        if is_wrong && self.bad_rows == BadRows::Refuse {
            return Err(at_line(self.part_line, None, told()));
        }
        if found != claimed {
            self.warn(told());
        }
        Ok(())
    }

    /// Names what is not named yet and puts everything together.
    fn finish(mut self, file: PositionedFile) -> Result<TextReader, ForeignFault> {
        for class in &mut self.classes {
            if class.names.is_some() {
                continue;
            }
            let is_ptx = self.kind == TextKind::Ptx;
            class.names = Some(match class.format.width() {
                4 if is_ptx => ptx_names(&["intensity"]),
                7 if is_ptx => ptx_names(&["intensity", "red", "green", "blue"]),
                _ => columns::guess(&class.stats),
            });
        }
        let is_fraction = self.kind == TextKind::Ptx;
        let layout = lay_out(&self.classes, is_fraction);
        let is_guess = self.kind == TextKind::Table && !self.is_named && self.columns.is_none();
        let names = self.classes.first().and_then(|class| class.names.as_ref());
        if let Some(names) = names.filter(|names| is_guess && names.len() > 3) {
            let names = names.join(",");
            self.warn(format!("columns are guessed to be {names}; --columns sets them"));
        }
        self.warnings.extend(layout.warnings.iter().cloned());
        let facts = ForeignFacts {
            format: self.format(),
            points: self.points,
            dropped_points: self.dropped,
            bounds: if self.points > 0 { self.bounds } else { [DVec3::ZERO; 2] },
            coordinates: self.coordinates(),
            columns: layout.columns.clone(),
            parts: self.parts,
            blocks: self.blocks,
            crs: Crs::default(),
            skipped: match self.unreadable {
                0 => Vec::new(),
                count => vec![("lines that are no rows".to_string(), count)],
            },
            warnings: self.warnings,
            unread: Vec::new(),
        };
        Ok(TextReader {
            file,
            facts,
            layout,
            classes: self.classes,
            placements: self.placements,
            places: self.places,
            bad_rows: self.bad_rows,
        })
    }

    fn format(&self) -> String {
        match self.kind {
            TextKind::Pts => "pts".to_string(),
            TextKind::Ptx => "ptx".to_string(),
            TextKind::Table => {
                let separator = self.classes.first().map(|class| class.format.separator);
                format!("text ({})", separator.unwrap_or(Separator::Blanks).name())
            }
        }
    }

    fn coordinates(&self) -> CoordinateKind {
        if self.placements.iter().any(|placement| placement.world_from_scan.is_some()) {
            return CoordinateKind::Computed;
        }
        // Beyond 2^51 steps f64 may not tell two of them apart.
        let most = self.bounds[0].abs().max(self.bounds[1].abs()).max_element();
        let steps = if self.points > 0 { most * 10f64.powi(i32::from(self.digits)) } else { 0.0 };
        if self.is_decimal && steps < (1u64 << 51) as f64 {
            CoordinateKind::Decimal { digits: u32::from(self.digits) }
        } else {
            CoordinateKind::F64
        }
    }
}

fn ptx_names(others: &[&str]) -> Vec<String> {
    AXES.iter().chain(others).map(|name| (*name).to_string()).collect()
}

/// A fault in a line counted from 0, and a column counted from 1.
fn at_line(line: u64, column: Option<usize>, reason: String) -> ForeignFault {
    match column {
        Some(column) => ForeignFault::at(format!("line {}, column {column}", line + 1), reason),
        None => ForeignFault::at_line(line + 1, reason),
    }
}

/// A fault in a row of lines that begin at a line, with the name of its column if it has one.
fn in_row(first_line: u64, fault: RowFault, names: Option<&[String]>) -> ForeignFault {
    let name = fault.column.and_then(|column| names?.get(column - 1));
    let mut place = at_line(first_line + fault.line, fault.column, fault.reason);
    if let Some(name) = name {
        place.place = format!("{} ({name})", place.place);
    }
    place
}

// A block's length fits 32 bits: a slice ends with the line in which it is full, and lines end
// within a piece.
const _: () = assert!(97 * SLICE_BYTES < u32::MAX as usize);
