//! What a reader of a format outside the LAS family offers to the rest of the room.
//!
//! A reader looks through its file once when it opens it (counts, bounds, columns, how exact the
//! coordinates are) and afterwards hands out blocks of rows, in any order, from any thread. It
//! gives coordinates as f64, poses applied; `input` puts them on a lattice.

use std::fmt::Debug;

use glam::{DQuat, DVec3};

use super::crs::Crs;
use super::error::LasFault;
use crate::points::{Lattice, Scalar};

/// How a file writes coordinates, which decides on what lattice they are exact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CoordinateKind {
    /// IEEE single precision.
    F32,
    /// IEEE double precision.
    F64,
    /// Decimal text with at most so many digits after the point.
    Decimal {
        /// Digits after the point.
        digits: u32,
    },
    /// Integers on a lattice.
    Lattice(Lattice),
    /// Computed by the reader (a pose that is not the identity, spherical coordinates): no file
    /// holds these numbers.
    Computed,
}

/// Where a scanner stood: scan coordinates to world coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Applied first.
    pub rotation: DQuat,
    /// Applied second: the scanner's position, in file units.
    pub translation: DVec3,
}

/// One scan within a file; formats without scans have one.
#[derive(Clone, Debug, PartialEq)]
pub struct ScanPart {
    /// What the file calls it.
    pub name: Option<String>,
    /// Where it was taken from.
    pub pose: Option<Pose>,
    /// Its rows in the file, dropped ones included.
    pub points: u64,
}

/// A column besides the coordinates.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    /// Name; standard ones from `points::names` where the meaning is theirs.
    pub name: String,
    /// Type of each component.
    pub scalar: Scalar,
    /// Components, at least 1.
    pub components: u16,
}

/// A part of the file that can be read on its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RowBlock {
    /// Place of its first row among those of the file, dropped ones not counted.
    pub first_point: u64,
    /// Rows it hands out, at most [`MOST_BLOCK_ROWS`].
    pub points: u64,
    /// Index of its scan.
    pub part: u32,
}

/// What a reader found out when it opened its file.
#[derive(Clone, Debug, PartialEq)]
pub struct ForeignFacts {
    /// Format and variant, such as `ply binary_little_endian`.
    pub format: String,
    /// Rows that blocks hand out, exact.
    pub points: u64,
    /// Rows left out because a coordinate is not a finite number or is marked invalid.
    pub dropped_points: u64,
    /// Box of the rows handed out; any value without rows.
    pub bounds: [DVec3; 2],
    /// How coordinates are written.
    pub coordinates: CoordinateKind,
    /// Columns of `RowBuffer::attributes`, packed in this order.
    pub columns: Vec<Column>,
    /// Scans in the file.
    pub parts: Vec<ScanPart>,
    /// All blocks, in the order of the file.
    pub blocks: Vec<RowBlock>,
    /// Reference system, where the file tells.
    pub crs: Crs,
    /// What was seen and left out (images, faces, unknown elements), each with its count.
    pub skipped: Vec<(String, u64)>,
    /// What is odd about the file but does not keep it from being read.
    pub warnings: Vec<String>,
    /// Rows of damaged parts, if these are left out. They count in `parts`.
    pub unread: Vec<Unread>,
}

/// Points that could not be read.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Unread {
    /// Index of their scan.
    pub part: u32,
    /// What is wrong, and where.
    pub reason: String,
    /// How many.
    pub points: u64,
}

/// Rows of one block; memory is used again.
#[derive(Debug, Default)]
pub struct RowBuffer {
    /// World coordinates.
    pub positions: Vec<DVec3>,
    /// Packed little-endian columns, row after row.
    pub attributes: Vec<u8>,
    /// Memory for the reader's own use.
    pub scratch: Vec<u8>,
}

/// What is wrong, without the file's name.
#[derive(Debug, thiserror::Error)]
#[error("{place}: {reason}")]
pub struct ForeignFault {
    /// Line, byte, element or record, such as `line 17` or `byte 1034`.
    pub place: String,
    /// What is wrong there.
    pub reason: String,
}

impl ForeignFault {
    /// A fault at a byte of the file.
    pub fn at_byte(byte: u64, reason: impl Into<String>) -> Self {
        ForeignFault { place: format!("byte {byte}"), reason: reason.into() }
    }

    /// A fault in a line of the file, counted from 1.
    pub fn at_line(line: u64, reason: impl Into<String>) -> Self {
        ForeignFault { place: format!("line {line}"), reason: reason.into() }
    }

    /// A fault at any other place.
    pub fn at(place: impl Into<String>, reason: impl Into<String>) -> Self {
        ForeignFault { place: place.into(), reason: reason.into() }
    }
}

impl From<LasFault> for ForeignFault {
    /// Faults of reading a file at all, which every format shares.
    fn from(fault: LasFault) -> Self {
        match fault {
            LasFault::Io { action, source } => {
                ForeignFault::at(format!("cannot {action}"), source.to_string())
            }
            LasFault::Shrunk { byte, wanted } => {
                let reason = format!("the file ended while bytes {wanted:?} were read");
                ForeignFault::at_byte(byte, reason)
            }
            other => ForeignFault::at_byte(0, other.to_string()),
        }
    }
}

/// Most rows in a block of any format.
pub const MOST_BLOCK_ROWS: u64 = 65_536;

/// An open file of a foreign format.
pub trait ForeignReader: Debug + Send + Sync {
    /// What opening found.
    fn facts(&self) -> &ForeignFacts;

    /// Whether the coordinates have the poses of their scans applied.
    fn applies_poses(&self) -> bool {
        true
    }

    /// Replaces the contents of `rows` by those of a block.
    fn read_block(&self, block: usize, rows: &mut RowBuffer) -> Result<(), ForeignFault>;
}
