//! One LAS or LAZ file: what it claims, what it holds, and its points block by block.
//!
//! Coordinates stay the file's integers and records stay its bytes. Blocks are independent: any
//! number of threads may read them at once, in any order, each with a buffer of its own.

use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::crs::{self, Crs};
use super::detect::open_regular;
use super::error::{LasError, LasFault};
use super::foreign::RowBuffer;
use super::foreign::Unread;
use super::header::LasHeader;
use super::las_layout::{Layout, las_layout};
use super::laz_decode::decode_block;
use super::laz_layout::{LazCoding, laz_layout};
use super::point_format::{describes_extra_bytes, extra_bytes};
use super::positioned_file::PositionedFile;
use super::template::{ByteRange, LasTemplate};
use super::vlr::{self, Vlr};
use crate::points::{Lattice, Schema};

/// Largest extended record that is read for what it says (reference system, extra bytes).
const MOST_EVLR_BYTES: u64 = 16 << 20;

/// How the points of a scan file are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ScanFormat {
    /// Plain records.
    Las,
    /// Compressed records.
    Laz,
}

/// What a header says about one variable length record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct VlrFacts {
    /// Who defined it.
    pub user_id: String,
    /// What it is, within that user's.
    pub record_id: u16,
    /// Free text.
    pub description: String,
    /// Size of its data.
    pub data_bytes: u64,
    /// Whether it stands after the points.
    pub extended: bool,
}

/// A box as a header states it; possibly inverted, wrong or not finite.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BoundsFacts {
    /// Smallest coordinates.
    pub min: [f64; 3],
    /// Largest coordinates.
    pub max: [f64; 3],
}

/// What a scan file says about itself, and what was found to be different.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScanFacts {
    /// Plain or compressed.
    pub format: ScanFormat,
    /// Version of the format, as in `1.4`.
    pub version: String,
    /// Point format, 0 to 10.
    pub point_format: u8,
    /// Size of one record when not compressed.
    pub record_bytes: u16,
    /// Length of the file.
    pub file_bytes: u64,
    /// Number of points in the file.
    pub points: u64,
    /// Whether `points` was found out; otherwise it is the header's claim, and reading every block
    /// tells.
    pub points_exact: bool,
    /// Number of points that the header claims.
    pub header_points: u64,
    /// The box that the header claims.
    pub header_bounds: BoundsFacts,
    /// World length of one step of the coordinates, per axis.
    pub scale: [f64; 3],
    /// World position of the coordinates' origin.
    pub offset: [f64; 3],
    /// Who measured, or what was done.
    pub system_identifier: String,
    /// The program that wrote the file.
    pub generating_software: String,
    /// Day of the year of creation, 0 where unknown.
    pub creation_day: u16,
    /// Year of creation, 0 where unknown.
    pub creation_year: u16,
    /// The reference system.
    pub crs: Crs,
    /// All variable length records, those before the points first.
    pub vlrs: Vec<VlrFacts>,
    /// What is wrong with the file but does not keep it from being read.
    pub warnings: Vec<String>,
    /// Points that the header claims and a damaged file does not have, if it is read all the same.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unread: Vec<Unread>,
}

/// A part of a scan that can be read on its own.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Block {
    /// Index in the file of its first point.
    pub first_point: u64,
    /// Number of its points; the header's claim in a LAZ file without a chunk table.
    pub points: u64,
    /// Where it stands in the file; empty in files outside the LAS family.
    pub bytes: Range<u64>,
    /// Which LAZ chunk it is, or which block of a foreign reader; 0 in LAS files.
    pub(super) chunk: u64,
    /// Whether it is everything there is, chunk after chunk without a table.
    pub(super) is_sequence: bool,
    /// How many of a LAZ block's points are wanted, from its first on.
    pub(super) wanted: u64,
}

impl Block {
    pub(super) fn records(first_point: u64, points: u64, bytes: Range<u64>) -> Self {
        Block { first_point, points, bytes, chunk: 0, is_sequence: false, wanted: u64::MAX }
    }

    pub(super) fn chunk(chunk: u64, first_point: u64, points: u64, bytes: Range<u64>) -> Self {
        Block { chunk, ..Block::records(first_point, points, bytes) }
    }

    /// A block of a foreign reader.
    pub(super) fn rows(index: u64, first_point: u64, points: u64) -> Self {
        Block { chunk: index, ..Block::records(first_point, points, 0..0) }
    }

    pub(super) fn sequence(points: u64, bytes: Range<u64>) -> Self {
        Block { is_sequence: true, ..Block::records(0, points, bytes) }
    }

    /// The same LAZ block, of which only so many points are read, from the first on.
    pub(super) fn beginning(&self, points: u64) -> Self {
        Block { wanted: points, ..self.clone() }
    }

    /// How many points reading it is expected to hand out.
    pub fn expected_points(&self) -> u64 {
        self.points.min(self.wanted)
    }

    /// Which block of a foreign reader it is.
    pub(super) fn index(&self) -> usize {
        self.chunk as usize
    }

    /// A fault of this LAZ chunk.
    pub(super) fn fault(&self, point: u64, reason: String) -> LasFault {
        LasFault::Chunk { chunk: self.chunk, bytes: self.bytes.clone(), point, reason }
    }
}

/// What takes the records of a block: the index in the file of the first point, and whole records.
pub type RecordSink<'a, E> = dyn FnMut(u64, &[u8]) -> Result<(), E> + 'a;

/// Bytes of plain records that are read at once.
const PIECE_BYTES: usize = 1 << 18;

/// Memory of one reading thread; grows to a few MiB and is used again for every block.
#[derive(Debug, Default)]
pub struct BlockBuffer {
    pub(super) window: Vec<u8>,
    pub(super) records: Vec<u8>,
    pub(super) rows: RowBuffer,
    /// For callers that change records before they hand them on.
    pub adapted: Vec<u8>,
}

/// An open LAS or LAZ file.
#[derive(Debug)]
pub struct LasScan {
    path: PathBuf,
    file: PositionedFile,
    header: LasHeader,
    template: LasTemplate,
    evlrs: Vec<Vlr>,
    schema: Schema,
    facts: ScanFacts,
    coding: Option<LazCoding>,
    blocks: Vec<Block>,
}

impl LasScan {
    /// Opens a file and reads everything except its points.
    pub fn open(path: &Path) -> Result<Self, LasError> {
        let file = open_regular(path).map_err(|fault| LasError::new(path, fault))?;
        Self::of(file, path, false)
    }

    /// The same of what is open already, or in memory; `path` is its name in errors.
    /// With `salvage`, what is left of a damaged file is read.
    pub fn of(file: PositionedFile, path: &Path, salvage: bool) -> Result<Self, LasError> {
        Self::read_head(file, path, salvage).map_err(|fault| LasError::new(path, fault))
    }

    fn read_head(file: PositionedFile, path: &Path, salvage: bool) -> Result<Self, LasFault> {
        let file_bytes = file.bytes();
        // A header's length is a 16-bit field.
        let head = file.read_range(0..file_bytes.min(u64::from(u16::MAX)))?;
        let header = LasHeader::from_bytes(&head, file_bytes)?;
        let header_bytes = u64::from(header.header_bytes);
        let points_start = u64::from(header.point_data_offset);

        let region_bytes = points_start - header_bytes;
        vlr::limit("bytes before the points", header_bytes, region_bytes, vlr::MOST_VLR_BYTES)?;
        let region = file.read_range(header_bytes..points_start)?;
        let vlrs = vlr::vlrs(&region, header.vlr_count, header_bytes)?;
        let mut warnings = header.oddities();
        let evlrs = match find_evlrs(&file, &header) {
            Err(fault) if salvage => {
                warnings.push(format!("extended records are left out: {fault}"));
                Vec::new()
            }
            evlrs => evlrs?,
        };
        let data_of = |vlr: &Vlr| -> Result<Vec<u8>, LasFault> {
            if vlr.extended {
                let bytes = vlr.data.end - vlr.data.start;
                vlr::limit("bytes of an EVLR", vlr.data.start, bytes, MOST_EVLR_BYTES)?;
                file.read_range(vlr.data.clone())
            } else {
                Ok(region[vlr.data.start as usize..vlr.data.end as usize].to_vec())
            }
        };
        let mut crs = Crs::default();
        let mut described = Vec::new();
        for vlr in vlrs.iter().chain(&evlrs) {
            if vlr.user_id == crs::USER_ID {
                crs.add(vlr.record_id, &data_of(vlr)?);
            }
            if describes_extra_bytes(vlr) {
                let (more, odd) = extra_bytes(&data_of(vlr)?);
                described.extend(more);
                warnings.extend(odd);
            }
        }
        crs.find_epsg();
        let (schema, odd) = header.point_format.schema(header.record_bytes, &described);
        warnings.extend(odd);

        let after = evlrs.iter().map(|evlr| evlr.whole().start).min();
        let end = after.unwrap_or(file_bytes);
        let coding = if header.compressed {
            let laszip = vlrs.iter().find(|vlr| vlr.is_laszip()).ok_or(LasFault::Laszip {
                reason: "missing, though the point format says that records are compressed".into(),
            })?;
            Some(LazCoding::from_vlr(&data_of(laszip)?, &header)?)
        } else {
            None
        };
        let layout = match &coding {
            Some(coding) => laz_layout(&file, &header, coding, end, salvage)?,
            None => las_layout(&file, &header, end, after.is_some(), salvage)?,
        };
        let Layout { blocks, points, points_exact, warnings: more, unread } = layout;
        warnings.extend(more);

        let header_part = head[..usize::from(header.header_bytes)].to_vec();
        let ranges = evlrs.iter().map(Vlr::whole);
        let ranges = ranges.map(|range| ByteRange { start: range.start, end: range.end });
        let template = LasTemplate::new(header_part, region, ranges.collect())?;
        let facts = ScanFacts {
            format: if header.compressed { ScanFormat::Laz } else { ScanFormat::Las },
            version: format!("1.{}", header.minor),
            point_format: header.point_format.number(),
            record_bytes: header.record_bytes,
            file_bytes,
            points,
            points_exact,
            header_points: header.claimed_count(),
            header_bounds: BoundsFacts {
                min: header.bounds.min.to_array(),
                max: header.bounds.max.to_array(),
            },
            scale: header.lattice.scale.to_array(),
            offset: header.lattice.offset.to_array(),
            system_identifier: header.system_identifier.clone(),
            generating_software: header.generating_software.clone(),
            creation_day: header.creation.0,
            creation_year: header.creation.1,
            crs,
            vlrs: vlrs.iter().chain(&evlrs).map(vlr_facts).collect(),
            warnings,
            unread,
        };
        let path = path.to_path_buf();
        Ok(LasScan { path, file, header, template, evlrs, schema, facts, coding, blocks })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What the file says about itself.
    pub fn facts(&self) -> &ScanFacts {
        &self.facts
    }

    /// The header.
    pub fn header(&self) -> &LasHeader {
        &self.header
    }

    /// The columns of its records.
    pub fn schema(&self) -> &Schema {
        &self.schema
    }

    /// The lattice of its coordinates.
    pub fn lattice(&self) -> Lattice {
        self.header.lattice
    }

    /// Header and variable length records, byte for byte.
    pub fn template(&self) -> &LasTemplate {
        &self.template
    }

    /// The extended records; [`read_bytes`](Self::read_bytes) gives their bytes.
    pub fn evlrs(&self) -> &[Vlr] {
        &self.evlrs
    }

    /// Number of points; the header's claim if [`ScanFacts::points_exact`] says so.
    pub fn points(&self) -> u64 {
        self.facts.points
    }

    /// The parts that can be read independently, in the order of the file.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    /// Fills `bytes` from a place in the file.
    pub fn read_bytes(&self, start: u64, bytes: &mut [u8]) -> Result<(), LasError> {
        self.file.read_exact_at(bytes, start).map_err(|fault| LasError::new(&self.path, fault))
    }

    /// Reads the records of a block of this scan and hands them out in order.
    ///
    /// `sink` gets the index in the file of the first point and at most 65,536 whole records; its
    /// errors end the reading. Before an error of the file itself, `sink` has been given every
    /// point before the fault. Returns the number of points, which for a file whose count is not
    /// exact may differ from the block's.
    pub fn read_block<E: From<LasError>>(
        &self,
        block: &Block,
        buffer: &mut BlockBuffer,
        sink: &mut RecordSink<'_, E>,
    ) -> Result<u64, E> {
        self.read_block_as(block, buffer, sink, E::from)
    }

    /// The same for callers whose errors are not made from this file's.
    pub(super) fn read_block_as<E>(
        &self,
        block: &Block,
        buffer: &mut BlockBuffer,
        sink: &mut RecordSink<'_, E>,
        error_of: impl Fn(LasError) -> E,
    ) -> Result<u64, E> {
        let mut sink_in = |first: u64, records: &[u8]| sink(first, records).map_err(Stop::Sink);
        let outcome = match &self.coding {
            Some(coding) => decode_block(&self.file, coding, block, buffer, &mut sink_in),
            None => self.read_records(block, buffer, &mut sink_in),
        };
        outcome.map_err(|stop| match stop {
            Stop::Sink(error) => error,
            Stop::Fault(fault) => error_of(LasError::new(&self.path, fault)),
        })
    }

    fn read_records<E>(
        &self,
        block: &Block,
        buffer: &mut BlockBuffer,
        sink: &mut RecordSink<'_, Stop<E>>,
    ) -> Result<u64, Stop<E>> {
        let record_bytes = usize::from(self.header.record_bytes);
        // In pieces that are still in the cache when they are looked at.
        let piece_points = (PIECE_BYTES / record_bytes).max(1);
        let most = (block.points as usize).min(piece_points) * record_bytes;
        if buffer.records.len() < most {
            buffer.records.resize(most, 0);
        }
        let mut done = 0;
        while done < block.points {
            let points = (block.points - done).min(piece_points as u64);
            let records = &mut buffer.records[..points as usize * record_bytes];
            self.file.read_exact_at(records, block.bytes.start + done * record_bytes as u64)?;
            sink(block.first_point + done, records)?;
            done += points;
        }
        Ok(block.points)
    }
}

/// Why the reading of a block ended early.
enum Stop<E> {
    Sink(E),
    Fault(LasFault),
}

impl<E> From<LasFault> for Stop<E> {
    fn from(fault: LasFault) -> Self {
        Stop::Fault(fault)
    }
}

/// Extended records: those that version 1.4 counts, and the waveform record that 1.3 points to.
fn find_evlrs(file: &PositionedFile, header: &LasHeader) -> Result<Vec<Vlr>, LasFault> {
    let mut evlrs = match header.evlrs {
        Some((start, count)) => vlr::evlrs(file, start, count)?,
        None => Vec::new(),
    };
    let counted = |start: &u64| evlrs.iter().any(|evlr| evlr.whole().contains(start));
    if let Some(start) = header.waveform_start.filter(|start| !counted(start)) {
        evlrs.extend(vlr::evlrs(file, start, 1)?);
    }
    let points_start = u64::from(header.point_data_offset);
    if let Some((index, evlr)) =
        (1..).zip(&evlrs).find(|(_, evlr)| evlr.whole().start < points_start)
    {
        return Err(LasFault::Record {
            kind: "EVLR",
            index,
            count: evlrs.len() as u64,
            byte: evlr.whole().start,
            reason: format!("stands before the points, which start at byte {points_start}"),
        });
    }
    Ok(evlrs)
}

fn vlr_facts(vlr: &Vlr) -> VlrFacts {
    VlrFacts {
        user_id: vlr.user_id.clone(),
        record_id: vlr.record_id,
        description: vlr.description.clone(),
        data_bytes: vlr.data.end - vlr.data.start,
        extended: vlr.extended,
    }
}
