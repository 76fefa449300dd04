//! What rows are read for: to learn about a file when it is opened, and for their points later.

use glam::{DAffine3, DVec3};

use super::layout::Target;
use super::number::{Form, Number};
use super::row::RowSink;
use super::stats::ColumnStats;

/// What a scan does to its coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// From the numbers of the rows to world coordinates; `None` changes nothing.
    pub world_from_scan: Option<DAffine3>,
    /// Rows at 0 0 0 are rays without a return, not points.
    pub zero_is_no_return: bool,
}

impl Placement {
    /// As they stand in the file.
    pub const PLAIN: Placement = Placement { world_from_scan: None, zero_is_no_return: false };

    /// Where a row's point is, if it is one.
    #[inline(always)]
    fn place(&self, scan: DVec3) -> Option<DVec3> {
        if self.zero_is_no_return && scan == DVec3::ZERO {
            return None;
        }
        let world = match &self.world_from_scan {
            None => scan,
            Some(transform) => transform.transform_point3(scan),
        };
        world.is_finite().then_some(world)
    }
}

/// Learns about rows.
#[derive(Debug)]
pub struct Survey {
    /// Axis of each field, or 3.
    axes: Vec<u8>,
    placement: Placement,
    /// Rows that are points.
    pub points: u64,
    /// Rows that are none.
    pub dropped: u64,
    /// Box of the points.
    pub bounds: [DVec3; 2],
    /// Most digits after the point that matter in a coordinate.
    pub digits: u8,
    /// Whether every coordinate is a decimal number of at most 19 digits.
    pub is_decimal: bool,
    /// What was seen, per field; coordinates are not.
    pub stats: Vec<ColumnStats>,
    row: DVec3,
}

impl Survey {
    /// Of rows with so many fields.
    pub fn new(width: usize, axes: [usize; 3], placement: Placement) -> Survey {
        let axis = |field| axes.iter().position(|axis| *axis == field).unwrap_or(3) as u8;
        Survey {
            axes: (0..width).map(axis).collect(),
            placement,
            points: 0,
            dropped: 0,
            bounds: [DVec3::INFINITY, DVec3::NEG_INFINITY],
            digits: 0,
            is_decimal: true,
            stats: vec![ColumnStats::EMPTY; width],
            row: DVec3::ZERO,
        }
    }
}

impl RowSink for Survey {
    #[inline(always)]
    fn begin(&mut self) {}

    #[inline(always)]
    fn number(&mut self, field: usize, number: &Number) {
        let axis = usize::from(self.axes[field]);
        if axis == 3 {
            self.stats[field].add(number);
            return;
        }
        self.row[axis] = number.value;
        if number.form == Form::Decimal {
            if number.digits > self.digits {
                self.digits = self.digits.max(number.digits_that_matter());
            }
        } else if number.form == Form::Float {
            self.is_decimal = false;
        }
    }

    #[inline(always)]
    fn end(&mut self) {
        match self.placement.place(self.row) {
            Some(world) => {
                self.points += 1;
                self.bounds = [self.bounds[0].min(world), self.bounds[1].max(world)];
            }
            None => self.dropped += 1,
        }
    }
}

/// Puts rows into a buffer.
#[derive(Debug)]
pub struct Fill<'a> {
    targets: &'a [Target],
    placement: Placement,
    /// The row before its values are written.
    blank_row: &'a [u8],
    positions: &'a mut Vec<DVec3>,
    attributes: &'a mut Vec<u8>,
    row: DVec3,
    row_start: usize,
}

impl<'a> Fill<'a> {
    /// Empties the positions and attributes of the buffer and fills them anew.
    pub fn new(
        targets: &'a [Target],
        placement: Placement,
        blank_row: &'a [u8],
        positions: &'a mut Vec<DVec3>,
        attributes: &'a mut Vec<u8>,
    ) -> Fill<'a> {
        positions.clear();
        attributes.clear();
        Fill {
            targets,
            placement,
            blank_row,
            positions,
            attributes,
            row: DVec3::ZERO,
            row_start: 0,
        }
    }

    /// Takes back what an unfinished last row has written.
    pub fn finish(self) {
        self.attributes.truncate(self.row_start);
    }
}

impl RowSink for Fill<'_> {
    #[inline(always)]
    fn begin(&mut self) {
        self.attributes.truncate(self.row_start);
        self.attributes.extend_from_slice(self.blank_row);
    }

    #[inline(always)]
    fn number(&mut self, field: usize, number: &Number) {
        match self.targets[field] {
            Target::Axis(axis) => self.row[usize::from(axis)] = number.value,
            Target::Value(offset, stored) => {
                stored.write(number, &mut self.attributes[self.row_start + offset as usize..]);
            }
            Target::Skip => {}
        }
    }

    #[inline(always)]
    fn end(&mut self) {
        if let Some(world) = self.placement.place(self.row) {
            self.positions.push(world);
            self.row_start = self.attributes.len();
        }
    }
}
