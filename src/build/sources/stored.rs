//! A store as the first source of a conversion, to take in what does not fit it in place.
//!
//! Its points come node by node, coarse to fine, which is the order in which they count as
//! inserted. Their records are bytes here: layout and lattice of the result are the store's own.

use std::path::PathBuf;
use std::sync::OnceLock;

use crate::build::BuildError;
use crate::build::sources::onto::sources_onto;
use crate::build::sources::{Source, Sources};
use crate::ids::NodeId;
use crate::input::{
    Column, CoordinateKind, Crs, ForeignFacts, ForeignFault, ForeignReader, ForeignScan,
    MOST_BLOCK_ROWS, Placing, ReadOptions, RowBlock, RowBuffer, Scan, ScanPart,
};
use crate::points::{COORDINATE_BYTES, Scalar, record_coordinates};
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
        let mut scans = sources_onto(paths, options, store.metadata())?;
        let schema = store.metadata().schema.clone();
        let appendix = store.header().appendix;
        let stored = Stored {
            infos: store.metadata().sources.clone(),
            appendix: (appendix.offset, appendix.bytes),
        };
        let (path, bytes) = (store.path().to_path_buf(), store.header().file_bytes);
        let lattice = store.metadata().lattice();
        let mut scan = ForeignScan::new(&path, bytes, Box::new(StoredReader::new(store)))?;
        scan.place(Placing { lattice, residual: None });
        let first = Source {
            scan: Scan::Foreign(Box::new(scan)),
            adapter: None,
            first_source: 0,
            shift: [0; 3],
            own_attributes: None,
            warnings: Vec::new(),
            fault: OnceLock::new(),
            stored: Some(stored),
        };
        scans.insert(0, first);
        Ok(Sources { scans: scans.into(), schema, lattice, sample: None, salvage: options.salvage })
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
        let crs = Crs { epsg: metadata.crs.epsg, wkt: metadata.crs.wkt.clone(), ..Crs::default() };
        let facts = ForeignFacts {
            format: "esker".into(),
            points: metadata.points,
            dropped_points: 0,
            bounds: [bounds.min, bounds.max],
            coordinates: CoordinateKind::Lattice(metadata.lattice()),
            columns: vec![Column {
                name: "record".into(),
                scalar: Scalar::U8,
                components: (metadata.schema.record_bytes as usize - COORDINATE_BYTES) as u16,
            }],
            parts: vec![ScanPart { name: None, pose: None, points: metadata.points }],
            blocks: rows,
            crs,
            skipped: Vec::new(),
            warnings: Vec::new(),
            unread: Vec::new(),
        };
        StoredReader { store, facts, blocks }
    }
}

impl ForeignReader for StoredReader {
    fn facts(&self) -> &ForeignFacts {
        &self.facts
    }

    fn read_block(&self, block: usize, rows: &mut RowBuffer) -> Result<(), ForeignFault> {
        let (node, first, points) = self.blocks[block];
        let read = self.store.read_records(node, &mut rows.scratch);
        read.map_err(|error| ForeignFault::at(format!("node {node}"), error.to_string()))?;
        let record_bytes = self.store.metadata().schema.record_bytes as usize;
        let records = &rows.scratch[first * record_bytes..(first + points) * record_bytes];
        let lattice = self.store.metadata().lattice();
        rows.positions.clear();
        rows.attributes.clear();
        for record in records.chunks_exact(record_bytes) {
            let steps = record_coordinates(record).map(i64::from);
            rows.positions.push(lattice.world(steps.into()));
            rows.attributes.extend_from_slice(&record[COORDINATE_BYTES..]);
        }
        Ok(())
    }
}
