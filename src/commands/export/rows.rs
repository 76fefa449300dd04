//! Selected points of single nodes as rows of the store's schema.

use anyhow::Context;
use glam::I64Vec3;

use super::selection::Selection;
use crate::geometry::MortonKey;
use crate::ids::NodeId;
use crate::output::Positions;
use crate::points::Lattice;
use crate::store::{NARROW_BITS, NodeReadError, Store};

/// Reads nodes as rows: three coordinates as i32, then the attributes as the schema says.
///
/// Coordinates count from [`origin`](Self::origin), which is that of the store's lattice unless
/// some point is too far from it for 32 bits.
#[derive(Debug)]
pub struct RowReader<'a> {
    store: &'a Store,
    selection: &'a Selection,
    origin: I64Vec3,
}

impl<'a> RowReader<'a> {
    /// Reads what the selection takes, in coordinates from [`origin_of`] the store.
    pub fn new(store: &'a Store, selection: &'a Selection) -> Self {
        RowReader { store, selection, origin: origin_of(store) }
    }

    /// Coordinates of the store's lattice that are 0 in rows.
    pub fn origin(&self) -> I64Vec3 {
        self.origin
    }

    /// The lattice of the rows' coordinates.
    pub fn lattice(&self) -> Lattice {
        let Lattice { scale, offset } = self.store.metadata().lattice();
        Lattice { scale, offset: offset + scale * self.origin.as_dvec3() }
    }

    /// Points of a node that will be taken, or more.
    pub fn most_points(&self, node: NodeId) -> u64 {
        self.selection.share(node).points() as u64
    }

    /// Points that will be taken of all nodes, where that can be known beforehand.
    pub fn known_points(&self) -> Option<u64> {
        let nodes = (0..self.store.octree().nodes().len() as u32).map(NodeId);
        self.selection.takes_all().then(|| nodes.map(|node| self.most_points(node)).sum())
    }

    /// Replaces `rows` by those of a node's points that the selection takes, coarse to fine;
    /// returns the running totals of points per level.
    pub fn read(&self, node: NodeId, rows: &mut Vec<u8>) -> anyhow::Result<Vec<usize>> {
        let share = self.selection.share(node);
        rows.clear();
        let totals = self.store.octree().node(node).levels.totals();
        let mut ends: Vec<usize> =
            totals.iter().map(|&total| (total as usize).min(share.points())).collect();
        if share.points() == 0 {
            return Ok(ends);
        }
        self.read_all(node, share.points(), rows)
            .with_context(|| self.store.path().display().to_string())?;
        if self.selection.takes_all() {
            return Ok(ends);
        }
        let row_bytes = self.store.metadata().schema.record_bytes as usize;
        let (mut index, mut kept) = (0, 0);
        for end in &mut ends {
            while index < *end {
                let row = &rows[index * row_bytes..(index + 1) * row_bytes];
                if share.takes(index) && self.selection.takes_row(row) {
                    rows.copy_within(index * row_bytes..(index + 1) * row_bytes, kept * row_bytes);
                    kept += 1;
                }
                index += 1;
            }
            *end = kept;
        }
        rows.truncate(kept * row_bytes);
        Ok(ends)
    }

    /// The first points of a node.
    fn read_all(
        &self,
        node: NodeId,
        count: usize,
        rows: &mut Vec<u8>,
    ) -> Result<(), NodeReadError> {
        let (store, octree) = (self.store, self.store.octree());
        let schema = &store.metadata().schema;
        let row_bytes = schema.record_bytes as usize;
        rows.resize(count * row_bytes, 0);
        let mut words = Vec::new();
        store.read_positions(node, &mut words)?;
        let is_narrow = octree.local_bits(node) <= NARROW_BITS;
        let cell_min = octree.cell_min(node) - self.origin;
        let points = words.chunks_exact(if is_narrow { 2 } else { 3 });
        for (row, words) in rows.chunks_exact_mut(row_bytes).zip(points) {
            let local = match *words {
                [low, high] => (u64::from(low) | u64::from(high) << 32).decode(),
                _ => [words[0], words[1], words[2]],
            };
            for axis in 0..3 {
                // Bounds fit, and a damaged node that lies about its place gets a wrong one.
                let steps = (cell_min[axis] + i64::from(local[axis])) as i32;
                row[4 * axis..4 * axis + 4].copy_from_slice(&steps.to_le_bytes());
            }
        }
        let mut column = Vec::new();
        for (i, attribute) in schema.attributes.iter().enumerate() {
            store.read_attribute(node, i, &mut column)?;
            let (start, bytes) = (attribute.record_offset as usize, attribute.bytes());
            let values = column.chunks_exact(bytes);
            for (row, value) in rows.chunks_exact_mut(row_bytes).zip(values) {
                row[start..start + bytes].copy_from_slice(value);
            }
        }
        Ok(())
    }
}

/// Coordinates of a store's lattice that are 0 in rows.
pub fn origin_of(store: &Store) -> I64Vec3 {
    let metadata = store.metadata();
    let [low, high] = [metadata.bounds_min, metadata.bounds_max].map(I64Vec3::from);
    let (least, most) = (i64::from(i32::MIN), i64::from(i32::MAX));
    let fits = low.min_element() >= least && high.max_element() <= most;
    // The root cube has an edge of at most 2^32 steps, so the other half always has room.
    if fits { I64Vec3::ZERO } else { low - I64Vec3::splat(least) }
}

/// World positions of rows of a store.
pub fn positions_of(store: &Store, origin: I64Vec3) -> Positions {
    let metadata = store.metadata();
    let bounds = [metadata.bounds_min, metadata.bounds_max].map(I64Vec3::from);
    Positions::new(metadata.lattice(), origin, &metadata.schema, bounds)
}
