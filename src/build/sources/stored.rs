//! Points that are records already as sources of a conversion: those of a store, to take in what
//! does not fit it in place, and some of an input, for a first look.
//!
//! The points of a store come node by node, coarse to fine, which is the order in which they count as
//! inserted. Their records are bytes here: layout and lattice of the result are the store's own.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use glam::DVec3;

use crate::build::BuildError;
use crate::build::progress::PointSample;
use crate::build::sources::adapt::{Adapter, Coordinates};
use crate::build::sources::common_lattice::whole_multiple;
use crate::build::sources::layout::Move;
use crate::build::sources::onto::{lattice_with, sources_onto, with_sources};
use crate::build::sources::{Source, Sources, open_scans};
use crate::ids::NodeId;
use crate::input::{
    Column, CoordinateKind, Crs, ForeignFacts, ForeignFault, ForeignReader, ForeignScan,
    MOST_BLOCK_ROWS, Placing, ReadOptions, RowBlock, RowBuffer, Scan, ScanPart,
};
use crate::points::{COORDINATE_BYTES, Lattice, Scalar, record_coordinates};
use crate::store::{AppendixPart, SourceInfo, Store};

/// What a store says of its own sources.
#[derive(Clone, Debug)]
pub struct Stored {
    /// One per source.
    pub infos: Vec<SourceInfo>,
    /// Records of their files.
    pub appendix: (u64, u64),
}

impl Sources {
    /// A store and files whose points are to join it, as the sources of a new store.
    pub fn open_with_store(
        store: Store,
        paths: &[PathBuf],
        options: &ReadOptions,
    ) -> Result<Self, BuildError> {
        let scans = open_scans(paths, options)?;
        let (own, target) = (store.metadata().lattice(), with_sources(store.metadata(), &scans));
        let lattice = lattice_with(store.metadata(), &scans);
        let mut scans = sources_onto(scans, &target, lattice).map_err(|error| match error {
            // No lattice holds all of them.
            BuildError::Outgrown { reason, path } => BuildError::Append { reason, path },
            error => error,
        })?;
        let appendix = store.header().appendix;
        let stored = Stored {
            infos: store.metadata().sources.clone(),
            appendix: (appendix.offset, appendix.bytes),
        };
        let (path, bytes) = (store.path().to_path_buf(), store.header().file_bytes);
        let old_bytes = store.metadata().schema.record_bytes as usize;
        let schema = target.schema;
        let mut scan = ForeignScan::new(&path, bytes, Box::new(StoredReader::new(store)))?;
        scan.place(Placing { lattice: own, residual: None });
        let mut first = source_of(scan, Some(stored));
        if own != lattice || old_bytes != schema.record_bytes as usize {
            let coordinates = match whole_multiple(&lattice, &own) {
                Some((factor, shift)) => Coordinates::Scale { factor, shift },
                None => Coordinates::Keep,
            };
            let bytes = old_bytes - COORDINATE_BYTES;
            first.adapter = Some(Adapter {
                source_bytes: old_bytes,
                store_bytes: schema.record_bytes as usize,
                coordinates,
                moves: vec![Move::Copy { from: COORDINATE_BYTES, to: COORDINATE_BYTES, bytes }],
                source_place: None,
            });
        }
        scans.insert(0, first);
        Ok(Sources { scans: scans.into(), schema, lattice, sample: None, read: options.clone() })
    }
}

impl Sources {
    /// Points at hand, as the source of a store with their layout and lattice.
    pub fn of_points(sample: PointSample) -> Result<Self, BuildError> {
        let PointSample { records, schema, lattice } = sample;
        let record_bytes = schema.record_bytes as usize;
        let mut bounds = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        for record in records.chunks_exact(record_bytes) {
            let position = lattice.world(record_coordinates(record).map(i64::from).into());
            bounds = [bounds[0].min(position), bounds[1].max(position)];
        }
        let points = (records.len() / record_bytes) as u64;
        let block = |first_point| RowBlock {
            first_point,
            points: MOST_BLOCK_ROWS.min(points - first_point),
            part: 0,
        };
        let blocks = (0..points).step_by(MOST_BLOCK_ROWS as usize).map(block).collect();
        let bounds = if points > 0 { bounds } else { [DVec3::ZERO; 2] };
        let facts = facts_of("points", points, bounds, lattice, record_bytes, blocks);
        let bytes = records.len() as u64;
        let reader = MemoryReader { records, record_bytes, lattice, facts };
        let mut scan = ForeignScan::new(Path::new("points"), bytes, Box::new(reader))?;
        scan.place(Placing { lattice, residual: None });
        let source = source_of(scan, None);
        let read = ReadOptions::default();
        Ok(Sources { scans: [source].into(), schema, lattice, sample: None, read })
    }
}

/// A source whose records are those of the store as they are.
fn source_of(scan: ForeignScan, stored: Option<Stored>) -> Source {
    Source {
        scan: Scan::Foreign(Box::new(scan)),
        adapter: None,
        first_source: 0,
        shift: [0; 3],
        own_attributes: None,
        warnings: Vec::new(),
        fault: OnceLock::new(),
        stored,
    }
}

/// Facts of records that are bytes behind their coordinates.
fn facts_of(
    format: &str,
    points: u64,
    bounds: [DVec3; 2],
    lattice: Lattice,
    record_bytes: usize,
    blocks: Vec<RowBlock>,
) -> ForeignFacts {
    let components = (record_bytes - COORDINATE_BYTES) as u16;
    let record = Column { name: "record".into(), scalar: Scalar::U8, components };
    ForeignFacts {
        format: format.into(),
        points,
        dropped_points: 0,
        bounds,
        coordinates: CoordinateKind::Lattice(lattice),
        columns: if components > 0 { vec![record] } else { Vec::new() },
        parts: vec![ScanPart { name: None, pose: None, points }],
        blocks,
        crs: Crs::default(),
        skipped: Vec::new(),
        warnings: Vec::new(),
        unread: Vec::new(),
    }
}

/// Takes records apart into coordinates and the rest.
fn fill(rows: &mut RowBuffer, records: &[u8], record_bytes: usize, lattice: Lattice) {
    rows.positions.clear();
    rows.attributes.clear();
    for record in records.chunks_exact(record_bytes) {
        let steps = record_coordinates(record).map(i64::from);
        rows.positions.push(lattice.world(steps.into()));
        rows.attributes.extend_from_slice(&record[COORDINATE_BYTES..]);
    }
}

/// Records in memory.
#[derive(Debug)]
struct MemoryReader {
    records: Vec<u8>,
    record_bytes: usize,
    lattice: Lattice,
    facts: ForeignFacts,
}

impl ForeignReader for MemoryReader {
    fn facts(&self) -> &ForeignFacts {
        &self.facts
    }

    fn read_block(&self, block: usize, rows: &mut RowBuffer) -> Result<(), ForeignFault> {
        let RowBlock { first_point, points, .. } = self.facts.blocks[block];
        let range = first_point as usize..(first_point + points) as usize;
        let bytes = range.start * self.record_bytes..range.end * self.record_bytes;
        fill(rows, &self.records[bytes], self.record_bytes, self.lattice);
        Ok(())
    }
}

impl Stored {
    /// The records of the sources' files, in the store that is being read.
    pub fn appendix_part(&self, path: PathBuf) -> AppendixPart {
        AppendixPart::FileRange { path, offset: self.appendix.0, bytes: self.appendix.1 }
    }
}

/// Nodes as blocks of rows.
#[derive(Debug)]
struct StoredReader {
    store: Store,
    facts: ForeignFacts,
    /// Node, first point and number of points of each block.
    blocks: Vec<(NodeId, usize, usize)>,
}

impl StoredReader {
    fn new(store: Store) -> Self {
        let metadata = store.metadata();
        let most = MOST_BLOCK_ROWS as usize;
        let (mut blocks, mut rows, mut first_point) = (Vec::new(), Vec::new(), 0);
        for (i, node) in store.octree().nodes().iter().enumerate() {
            let count = node.point_count() as usize;
            for first in (0..count).step_by(most) {
                let points = most.min(count - first);
                blocks.push((NodeId(i as u32), first, points));
                rows.push(RowBlock { first_point, points: points as u64, part: 0 });
                first_point += points as u64;
            }
        }
        let bounds = metadata.bounds();
        let facts = facts_of(
            "esker",
            metadata.points,
            [bounds.min, bounds.max],
            metadata.lattice(),
            metadata.schema.record_bytes as usize,
            rows,
        );
        let (epsg, wkt) = (metadata.crs.epsg, metadata.crs.wkt.clone());
        let facts = ForeignFacts { crs: Crs { epsg, wkt, ..Crs::default() }, ..facts };
        StoredReader { store, facts, blocks }
    }
}

impl ForeignReader for StoredReader {
    fn facts(&self) -> &ForeignFacts {
        &self.facts
    }

    fn read_block(&self, block: usize, rows: &mut RowBuffer) -> Result<(), ForeignFault> {
        let (node, first, points) = self.blocks[block];
        let mut records = std::mem::take(&mut rows.scratch);
        let read = self.store.read_records(node, &mut records);
        read.map_err(|error| ForeignFault::at(format!("node {node}"), error.to_string()))?;
        let record_bytes = self.store.metadata().schema.record_bytes as usize;
        let wanted = first * record_bytes..(first + points) * record_bytes;
        fill(rows, &records[wanted], record_bytes, self.store.metadata().lattice());
        rows.scratch = records;
        Ok(())
    }
}
