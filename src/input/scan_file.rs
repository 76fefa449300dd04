//! One scan file of any format: what it holds, and its points block by block.

use std::path::Path;

use super::crs::Crs;
use super::detect::{ReadOptions, format_of, las_kind, open_regular, read_head};
use super::error::ScanError;
use super::foreign::{ForeignFacts, ForeignFault, ScanPart};
use super::foreign_scan::ForeignScan;
use super::placing::Placing;
use super::positioned_file::PositionedFile;
use super::scan::{Block, BlockBuffer, LasScan, RecordSink, ScanFormat};
use crate::points::{Lattice, Schema};

/// An open scan file.
#[derive(Debug)]
pub enum Scan {
    /// Of the LAS family.
    Las(Box<LasScan>),
    /// Of another format.
    Foreign(Box<ForeignScan>),
}

impl Scan {
    /// Opens a file of whatever format its first bytes tell.
    pub fn open(path: &Path, options: &ReadOptions) -> Result<Self, ScanError> {
        let file = open_regular(path).map_err(|fault| ScanError::foreign(path, fault.into()))?;
        Self::of(file.until(&options.cancel), path, options)
    }

    /// Reads what is open already, or in memory. `path` is its name in errors, and its suffix.
    pub fn of(file: PositionedFile, path: &Path, options: &ReadOptions) -> Result<Self, ScanError> {
        let foreign = |fault| ScanError::foreign(path, fault);
        let head = read_head(&file).map_err(|fault| foreign(fault.into()))?;
        let suffix = path.extension().map(|suffix| suffix.to_ascii_lowercase());
        let named_las = suffix.is_some_and(|suffix| suffix == "las" || suffix == "laz");
        // What calls itself a LAS file and is none is told so.
        if las_kind(&head).is_some() || named_las {
            return Ok(Scan::Las(Box::new(LasScan::of(file, path, options.salvage)?)));
        }
        let format = format_of(path, &head).ok_or_else(|| {
            let found = head[..head.len().min(8)].escape_ascii();
            let reason = format!("begins with \"{found}\", which is no scan format that is known");
            foreign(ForeignFault::at_byte(0, reason))
        })?;
        let file_bytes = file.bytes();
        let reader = (format.open)(file, options).map_err(foreign)?;
        Ok(Scan::Foreign(Box::new(ForeignScan::new(path, file_bytes, reader)?)))
    }

    /// The file.
    pub fn path(&self) -> &Path {
        match self {
            Scan::Las(scan) => scan.path(),
            Scan::Foreign(scan) => scan.path(),
        }
    }

    /// The scan as one of the LAS family, if it is one.
    pub fn las(&self) -> Option<&LasScan> {
        match self {
            Scan::Las(scan) => Some(scan),
            Scan::Foreign(_) => None,
        }
    }

    /// What a reader outside the LAS family found.
    pub fn foreign(&self) -> Option<&ForeignFacts> {
        match self {
            Scan::Las(_) => None,
            Scan::Foreign(scan) => Some(scan.facts()),
        }
    }

    /// Format and variant, such as `laz 1.4` or `ply ascii`.
    pub fn format(&self) -> String {
        match self {
            Scan::Las(scan) => match scan.facts().format {
                ScanFormat::Las => format!("las {}", scan.facts().version),
                ScanFormat::Laz => format!("laz {}", scan.facts().version),
            },
            Scan::Foreign(scan) => scan.facts().format.clone(),
        }
    }

    /// The columns of its records.
    pub fn schema(&self) -> &Schema {
        match self {
            Scan::Las(scan) => scan.schema(),
            Scan::Foreign(scan) => scan.schema(),
        }
    }

    /// The lattice of its coordinates.
    pub fn lattice(&self) -> Lattice {
        match self {
            Scan::Las(scan) => scan.lattice(),
            Scan::Foreign(scan) => scan.lattice(),
        }
    }

    /// Length of the file.
    pub fn file_bytes(&self) -> u64 {
        match self {
            Scan::Las(scan) => scan.facts().file_bytes,
            Scan::Foreign(scan) => scan.file_bytes(),
        }
    }

    /// Number of points that its blocks hand out; a claim unless `points_exact`.
    pub fn points(&self) -> u64 {
        match self {
            Scan::Las(scan) => scan.points(),
            Scan::Foreign(scan) => scan.facts().points,
        }
    }

    /// Whether `points` was found out.
    pub fn points_exact(&self) -> bool {
        self.las().is_none_or(|scan| scan.facts().points_exact)
    }

    /// Points of the file that its blocks do not hand out.
    pub fn dropped_points(&self) -> u64 {
        self.foreign().map_or(0, |facts| facts.dropped_points)
    }

    /// Whether reading costs much more than fetching the bytes: decompression, parsing.
    pub fn is_compressed(&self) -> bool {
        self.las().is_none_or(|scan| scan.facts().format == ScanFormat::Laz)
    }

    /// The scans within the file; none where the format knows no such thing.
    pub fn parts(&self) -> &[ScanPart] {
        self.foreign().map_or(&[], |facts| &facts.parts)
    }

    /// What the file says about its reference system.
    pub fn crs(&self) -> &Crs {
        match self {
            Scan::Las(scan) => &scan.facts().crs,
            Scan::Foreign(scan) => &scan.facts().crs,
        }
    }

    /// What is wrong with the file but does not keep it from being read.
    pub fn warnings(&self) -> &[String] {
        match self {
            Scan::Las(scan) => &scan.facts().warnings,
            Scan::Foreign(scan) => scan.warnings(),
        }
    }

    /// The parts that can be read independently, in the order of the file.
    pub fn blocks(&self) -> &[Block] {
        match self {
            Scan::Las(scan) => scan.blocks(),
            Scan::Foreign(scan) => scan.blocks(),
        }
    }

    /// Index in [`parts`](Self::parts) of the scan that a block belongs to.
    pub fn part_of(&self, block: &Block) -> usize {
        let index = block.index();
        self.foreign().map_or(0, |facts| facts.blocks[index].part as usize)
    }

    /// Puts a file outside the LAS family on another lattice; one of that family keeps its own.
    pub fn place(&mut self, placing: Placing) {
        if let Scan::Foreign(scan) = self {
            scan.place(placing);
        }
    }

    /// Reads the records of a block of this scan and hands them out in order.
    ///
    /// `sink` gets the index in the file of the first point and at most 65,536 whole records; its
    /// errors end the reading. Returns the number of points, which for a file whose count is not
    /// exact may differ from the block's.
    pub fn read_block<E: From<ScanError>>(
        &self,
        block: &Block,
        buffer: &mut BlockBuffer,
        sink: &mut RecordSink<'_, E>,
    ) -> Result<u64, E> {
        match self {
            Scan::Las(scan) => {
                scan.read_block_as(block, buffer, sink, |error| ScanError::from(error).into())
            }
            Scan::Foreign(scan) => scan.read_block(block, buffer, sink),
        }
    }
}
