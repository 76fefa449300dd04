//! Which points stand in which chunk of a COPC file.
//!
//! A node of the octree and a node of COPC are the same thing, a cube with points that show one
//! level more than its parent's, so nearly always one becomes the other. Two rules keep chunks at
//! a size that readers like: where a node holds too many points, its finer levels go down into the
//! octants, to be read with what stands there; a leaf with too few gives them to its parent.
//!
//! Subtrees are worked on in parallel, each as a whole; the order of chunks does not depend on the
//! number of threads. Memory is a few subtrees and the path to them.

use glam::{DVec3, I64Vec3};
use rayon::prelude::*;

use super::error::WriteError;
use super::las_frame::Tally;
use super::laz_coding::LazCoding;
use crate::ids::NodeId;
use crate::input::LasHeader;
use crate::octree::Octree;
use crate::points::{Lattice, Scalar, record_coordinates};

/// Most points of a chunk, as far as cells can be divided.
const MOST_POINTS: usize = 100_000;
/// Fewest points of a leaf's chunk.
const LEAST_POINTS: usize = 500;
/// Subtrees of at most so many points are worked on side by side.
const SUBTREE_POINTS: u64 = 1 << 19;

/// A cube of a COPC octree: depth, then place at that depth.
pub(super) type VoxelKey = [u32; 4];

/// One node's points, compressed.
pub(super) struct Chunk {
    /// Its cube.
    pub key: VoxelKey,
    /// What its points are.
    pub tally: Tally,
    /// Smallest and largest GPS time.
    pub times: [f64; 2],
    /// The chunk; empty without points.
    pub bytes: Vec<u8>,
}

/// The cubes that cells of records lie in.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    kind: GridKind,
    /// Deepest level that still divides cells.
    bits: u32,
    /// World position of the root cube's lowest corner.
    pub min: DVec3,
    /// World edge of the root cube.
    pub edge: f64,
}

#[derive(Clone, Copy, Debug)]
enum GridKind {
    /// Cells of the octree: the lattice is the same along all axes.
    Steps { low: I64Vec3 },
    /// Cubes of the world, which are no cells of the octree.
    World { lattice: Lattice },
}

impl Grid {
    /// The cubes for points of an octree, in the lattice of `lattice` with the root's lowest corner
    /// at `low`.
    ///
    /// The root cube of the file begins half a step before the first coordinate, so that no
    /// rounding in a reader puts a point on the other side of a face.
    pub fn new(octree: &Octree, lattice: Lattice, low: I64Vec3) -> Self {
        let half = DVec3::splat(0.5);
        let bits = octree.root_cube().bits;
        if lattice.scale == DVec3::splat(lattice.scale.x) {
            let min = lattice.offset + lattice.scale * (low.as_dvec3() - half);
            let edge = lattice.scale.x * f64::from(bits).exp2();
            return Grid { kind: GridKind::Steps { low }, bits, min, edge };
        }
        let size = octree.nodes().iter().enumerate().fold(DVec3::ZERO, |size, (i, node)| {
            let cell = octree.cell_min(NodeId(i as u32)) - octree.root_cube().min;
            size.max((cell + node.tight_max.as_i64vec3()).as_dvec3())
        });
        let min = lattice.offset + lattice.scale * (low.as_dvec3() - half);
        let edge = (lattice.scale * (size + 1.0)).max_element();
        Grid { kind: GridKind::World { lattice }, bits: 24, min, edge }
    }

    /// Whether its cubes are the cells of the octree.
    pub fn is_octree(&self) -> bool {
        matches!(self.kind, GridKind::Steps { .. })
    }

    /// The octant of a record within the cube that encloses it at `depth`.
    fn octant(&self, record: &[u8], depth: u32) -> usize {
        let integers = I64Vec3::from_array(record_coordinates(record).map(i64::from));
        let cell = match self.kind {
            GridKind::Steps { low } => integers - low,
            GridKind::World { lattice } => {
                let share = (lattice.world(integers) - self.min) / self.edge;
                let cells = f64::from(self.bits).exp2();
                (share * cells).floor().clamp(DVec3::ZERO, DVec3::splat(cells - 1.0)).as_i64vec3()
            }
        };
        let upper = (cell >> (self.bits - depth - 1)) & 1;
        (upper.x | upper.y << 1 | upper.z << 2) as usize
    }
}

/// Gives the records of a node's points, coarse to fine, and how many there are up to each level.
pub type ReadNode<'a, E> = dyn Fn(NodeId, &mut Vec<u8>) -> Result<Vec<usize>, E> + Sync + 'a;

/// What all cells share.
pub(super) struct Growth<'a, E> {
    pub octree: &'a Octree,
    pub grid: Grid,
    pub header: &'a LasHeader,
    pub coding: &'a LazCoding,
    pub read: &'a ReadNode<'a, E>,
    /// Points of each node and all below it.
    pub subtree_points: Vec<u64>,
    pub path: &'a std::path::Path,
}

/// A cube to be filled: the octree's node there and points from above.
pub(super) struct Cell {
    key: VoxelKey,
    node: Option<NodeId>,
    inherited: Levels,
}

/// Records coarse to fine.
#[derive(Default)]
pub(super) struct Levels {
    pub records: Vec<u8>,
    /// Running totals of records.
    pub ends: Vec<usize>,
}

impl Levels {
    fn count(&self) -> usize {
        self.ends.last().copied().unwrap_or(0)
    }
}

/// The chunks of a subtree, and the records of a leaf that is too small for one.
type Grown = (Vec<Chunk>, Vec<u8>);

/// Takes finished chunks.
pub(super) type Emit<'a, E> = dyn FnMut(Chunk) -> Result<(), E> + 'a;

/// Points of each node and all below it.
pub(super) fn subtree_points(octree: &Octree) -> Vec<u64> {
    let nodes = octree.nodes();
    let mut points: Vec<u64> = nodes.iter().map(|node| u64::from(node.point_count())).collect();
    for (i, node) in nodes.iter().enumerate().rev() {
        if let Some(parent) = node.parent {
            points[parent.index()] += points[i];
        }
    }
    points
}

impl<E: From<WriteError> + Send> Growth<'_, E> {
    /// The root cube over the octree's root.
    pub fn root(&self) -> Cell {
        let node = (!self.octree.nodes().is_empty()).then_some(NodeId(0));
        Cell { key: [0; 4], node, inherited: Levels::default() }
    }

    /// The root cube with all points, where the octree's cells are of no use.
    pub fn root_with_all(&self) -> Result<Cell, E> {
        let nodes = 0..self.octree.nodes().len() as u32;
        let read = |node: u32| {
            let mut records = Vec::new();
            (self.read)(NodeId(node), &mut records).map(|_| records)
        };
        let parts: Result<Vec<Vec<u8>>, E> = nodes.into_par_iter().map(read).collect();
        let mut inherited = Levels::default();
        for records in parts? {
            inherited.records.extend_from_slice(&records);
            inherited.ends.push(inherited.records.len() / self.record_bytes());
        }
        Ok(Cell { key: [0; 4], node: None, inherited })
    }

    /// Emits the chunks of a cell and all below it; returns the records of a leaf that is too small
    /// for a chunk.
    pub fn grow(&self, cell: Cell, emit: &mut Emit<E>) -> Result<Vec<u8>, E> {
        let key = cell.key;
        let node = cell.node;
        let (mut own, passed) = self.divide(key, self.points_of(cell)?);
        let mut large = Vec::new();
        let mut small = Vec::new();
        for (octant, inherited) in passed.into_iter().enumerate() {
            let node = node.and_then(|node| self.child(node, octant));
            if node.is_none() && inherited.count() == 0 {
                continue;
            }
            let octant = octant as u32;
            let [depth, x, y, z] = key;
            let key =
                [depth + 1, 2 * x + (octant & 1), 2 * y + (octant >> 1 & 1), 2 * z + (octant >> 2)];
            let child = Cell { key, node, inherited };
            let below = node.map_or(0, |node| self.subtree_points[node.index()]);
            let points = below + child.inherited.count() as u64;
            if points > SUBTREE_POINTS { large.push(child) } else { small.push(child) }
        }
        let grown: Vec<Result<Grown, E>> = small
            .into_par_iter()
            .map(|child| {
                let mut chunks = Vec::new();
                let left = self.grow(child, &mut |chunk| {
                    chunks.push(chunk);
                    Ok(())
                })?;
                Ok((chunks, left))
            })
            .collect();
        let mut has_descendants = false;
        for subtree in grown {
            let (chunks, left) = subtree?;
            own.extend_from_slice(&left);
            has_descendants |= !chunks.is_empty();
            chunks.into_iter().try_for_each(&mut *emit)?;
        }
        for child in large {
            let mut count = 0;
            let left = self.grow(child, &mut |chunk| {
                count += 1;
                emit(chunk)
            })?;
            own.extend_from_slice(&left);
            has_descendants |= count > 0;
        }
        let is_root = key[0] == 0;
        if !is_root && !has_descendants && own.len() < LEAST_POINTS * self.record_bytes() {
            return Ok(own);
        }
        emit(self.chunk(key, own)?)?;
        Ok(Vec::new())
    }

    fn record_bytes(&self) -> usize {
        usize::from(self.header.record_bytes)
    }

    fn child(&self, node: NodeId, octant: usize) -> Option<NodeId> {
        let node = self.octree.node(node);
        let before = node.child_mask & ((1 << octant) - 1);
        let there = node.child_mask >> octant & 1 == 1;
        there.then(|| NodeId(node.first_child.0 + before.count_ones()))
    }

    /// What came from above, then the node's own.
    fn points_of(&self, cell: Cell) -> Result<Levels, E> {
        let Some(node) = cell.node else {
            return Ok(cell.inherited);
        };
        let mut records = Vec::new();
        let ends = (self.read)(node, &mut records)?;
        if cell.inherited.count() == 0 {
            return Ok(Levels { records, ends });
        }
        let mut levels = cell.inherited;
        let before = levels.count();
        levels.records.extend_from_slice(&records);
        levels.ends.extend(ends.into_iter().map(|end| before + end));
        Ok(levels)
    }

    /// What stays in a cell, and what goes into its octants.
    fn divide(&self, key: VoxelKey, levels: Levels) -> (Vec<u8>, [Levels; 8]) {
        let size = self.record_bytes();
        let mut passed: [Levels; 8] = Default::default();
        if levels.count() <= MOST_POINTS || key[0] >= self.grid.bits {
            return (levels.records, passed);
        }
        let mut own = Vec::new();
        let mut start = 0;
        for &end in &levels.ends {
            let count = end - start;
            // The first level that is too large by itself leaves an even share of it here.
            let share = if end <= MOST_POINTS {
                count
            } else if start == 0 {
                MOST_POINTS
            } else {
                0
            };
            let records = levels.records[start * size..end * size].chunks_exact(size);
            for (i, record) in records.enumerate() {
                if (i + 1) * share / count > i * share / count {
                    own.extend_from_slice(record);
                } else {
                    let octant = self.grid.octant(record, key[0]);
                    passed[octant].records.extend_from_slice(record);
                }
            }
            for octant in &mut passed {
                octant.ends.push(octant.records.len() / size);
            }
            start = end;
        }
        (own, passed)
    }

    fn chunk(&self, key: VoxelKey, records: Vec<u8>) -> Result<Chunk, E> {
        let mut tally = Tally::NONE;
        tally.add(&records, self.header);
        let times = times_of(&records, self.record_bytes());
        let records = in_scan_order(&records, self.record_bytes(), times);
        let bytes = if records.is_empty() {
            Vec::new()
        } else {
            let compressed = self.coding.compress(&records, Vec::new());
            compressed.map_err(|reason| super::las::compress_error(reason, self.path))?
        };
        Ok(Chunk { key, tally, times, bytes })
    }
}

/// Where formats 6 to 8 have the GPS time.
const GPS_TIME: usize = 22;

fn time_of(record: &[u8]) -> f64 {
    Scalar::F64.read(&record[GPS_TIME..])
}

/// Smallest and largest GPS time; the first above the second without any.
fn times_of(records: &[u8], record_bytes: usize) -> [f64; 2] {
    let times = records.chunks_exact(record_bytes).map(time_of);
    times.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], time| {
        [low.min(time), high.max(time)]
    })
}

/// The records in an order like that in which a scanner gave them, which compresses best: by time
/// where there are times, else in strips along y, about as wide as points are apart.
///
/// Readers of COPC take chunks as a whole, so their order within is free.
fn in_scan_order(records: &[u8], record_bytes: usize, times: [f64; 2]) -> Vec<u8> {
    let count = records.len() / record_bytes;
    let record = |i: u32| &records[i as usize * record_bytes..(i as usize + 1) * record_bytes];
    let mut order: Vec<u32> = (0..count as u32).collect();
    if times[0] < times[1] {
        // Bits of a float in the order of floats; ties keep their places.
        let key = |&i: &u32| {
            let bits = time_of(record(i)).to_bits() as i64;
            bits ^ (((bits >> 63) as u64) >> 1) as i64
        };
        order.sort_by_cached_key(key);
    } else {
        let places = records.chunks_exact(record_bytes).map(record_coordinates);
        let (mut low, mut high) = ([i32::MAX; 2], [i32::MIN; 2]);
        for [x, y, _] in places {
            low = [low[0].min(x), low[1].min(y)];
            high = [high[0].max(x), high[1].max(y)];
        }
        let size = [0, 1].map(|axis| f64::from(high[axis]) - f64::from(low[axis]) + 1.0);
        let width = (STRIP_SPACINGS * (size[0] * size[1] / count as f64).sqrt()).max(1.0);
        let key = |&i: &u32| {
            let [x, y, _] = record_coordinates(record(i));
            let strip = ((f64::from(x) - f64::from(low[0])) / width) as u32;
            (strip, y)
        };
        order.sort_by_cached_key(key);
    }
    let mut ordered = Vec::with_capacity(records.len());
    order.into_iter().for_each(|i| ordered.extend_from_slice(record(i)));
    ordered
}

/// Width of a strip in mean distances between points, seen from above.
const STRIP_SPACINGS: f64 = 1.5;
