//! A small octree in memory, built straight from the definition, for tests that draw.
//!
//! Every node takes one point per occupied cell and level, the first in Morton order; what is left
//! goes to the children, however few. Points at one place keep their order. Not the builder under test elsewhere: slow and simple.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

use esker::frame::NodeSource;
use esker::geometry::{Aabb, MortonKey};
use esker::ids::NodeId;
use esker::octree::{LevelIndex, Node, Octree, RootCube};
use esker::points::{Attribute, Lattice, Scalar, Schema, names};
use esker::store::{NodeReadError, ValueRange};
use glam::{I64Vec3, UVec3};

/// Points of an octree, node by node.
pub struct MemoryCloud {
    octree: Octree,
    bounds: Aabb,
    schema: Schema,
    ranges: Vec<ValueRange>,
    positions: Vec<Vec<u32>>,
    colors: Vec<Vec<u32>>,
    bytes_read: AtomicU64,
}

struct Open {
    depth: u32,
    cell: UVec3,
    parent: Option<NodeId>,
    points: Vec<(u128, u32)>,
}

impl MemoryCloud {
    /// An octree over lattice points in a root cube of `bits` bits at the origin; `depth` levels
    /// per node. Each point brings its RGBA8 colour.
    pub fn new(lattice: Lattice, bits: u32, depth: u32, points: &[(UVec3, u32)]) -> Self {
        let mut bounds = Aabb::EMPTY;
        for (cell, _) in points {
            bounds = bounds.including(lattice.world(cell.as_i64vec3()));
        }
        let mut coded: Vec<_> =
            points.iter().map(|&(cell, color)| (u128::encode(cell.to_array()), color)).collect();
        // Stable: points at one place stay in the order they came in, whatever their colours.
        coded.sort_by_key(|&(code, _)| code);
        let mut nodes = Vec::new();
        let (mut positions, mut colors) = (Vec::new(), Vec::new());
        let mut open = Vec::new();
        if !coded.is_empty() {
            open.push(Open { depth: 0, cell: UVec3::ZERO, parent: None, points: coded });
        }
        // Level by level, so that rows stand coarse to fine.
        while !open.is_empty() {
            let mut next: Vec<Open> = Vec::new();
            let first_of_next = (nodes.len() + open.len()) as u32;
            for node in open {
                let id = NodeId(nodes.len() as u32);
                let local_bits = bits - node.depth;
                let (chosen, totals, rest) = choose(node.points, local_bits, depth);
                let first_child = NodeId(first_of_next + next.len() as u32);
                let mut child_mask = 0;
                for (octant, points) in rest {
                    child_mask |= 1 << octant;
                    let upper = UVec3::new(octant & 1, octant >> 1 & 1, octant >> 2);
                    next.push(Open {
                        depth: node.depth + 1,
                        cell: node.cell * 2 + upper,
                        parent: Some(id),
                        points,
                    });
                }
                let cells: Vec<UVec3> =
                    chosen.iter().map(|&(code, _)| UVec3::from(code.decode())).collect();
                positions.push(words_of(&chosen, local_bits));
                colors.push(chosen.iter().map(|&(_, color)| color).collect());
                nodes.push(Node {
                    depth: node.depth,
                    cell: node.cell,
                    parent: node.parent,
                    first_child: if child_mask == 0 { NodeId(0) } else { first_child },
                    child_mask,
                    levels: LevelIndex::new(totals).expect("counted so"),
                    tight_min: cells.iter().copied().reduce(UVec3::min).expect("not empty"),
                    tight_max: cells.iter().copied().reduce(UVec3::max).expect("not empty"),
                });
            }
            open = next;
        }
        let root_cube = RootCube { min: I64Vec3::ZERO, bits };
        let octree = Octree::new(lattice, root_cube, depth, nodes).expect("built so");
        let rgb = Attribute {
            name: names::RGB.into(),
            scalar: Scalar::U16,
            components: 3,
            record_offset: 12,
        };
        MemoryCloud {
            octree,
            bounds,
            schema: Schema { record_bytes: 18, attributes: vec![rgb] },
            ranges: vec![ValueRange { min: 0.0, max: 255.0 }; 3],
            positions,
            colors,
            bytes_read: AtomicU64::new(0),
        }
    }

    fn note_read(&self, words: &[u32]) {
        self.bytes_read.fetch_add(4 * words.len() as u64, Ordering::Relaxed);
    }
}

type Points = Vec<(u128, u32)>;

/// Points of a node coarse to fine, running totals per level, and what its octants get.
fn choose(
    points: Points,
    local_bits: u32,
    depth: u32,
) -> (Points, Vec<u32>, BTreeMap<u32, Points>) {
    let points: Points =
        points.into_iter().map(|(code, color)| (code.local(local_bits), color)).collect();
    let mut taken = vec![false; points.len()];
    let (mut chosen, mut totals) = (Vec::new(), Vec::new());
    let deepest = depth == local_bits;
    for level in 0..=depth {
        let cell_of = |i: usize| points[i].0.ancestor(local_bits - level);
        let mut start = 0;
        while start < points.len() {
            let mut end = start;
            while end < points.len() && cell_of(end) == cell_of(start) {
                end += 1;
            }
            if !(start..end).any(|i| taken[i]) {
                taken[start] = true;
                chosen.push(points[start]);
            }
            start = end;
        }
        totals.push(chosen.len() as u32);
    }
    let mut rest: BTreeMap<u32, Points> = BTreeMap::new();
    for (i, &(code, color)) in points.iter().enumerate() {
        if taken[i] {
            continue;
        }
        if deepest {
            // Points of one lattice place: nothing below could part them.
            chosen.push((code, color));
        } else {
            rest.entry((code >> (3 * (local_bits - 1))) as u32 & 7)
                .or_default()
                .push((code, color));
        }
    }
    *totals.last_mut().expect("at least one level") = chosen.len() as u32;
    (chosen, totals, rest)
}

fn words_of(points: &[(u128, u32)], local_bits: u32) -> Vec<u32> {
    let words = |&(code, _): &(u128, u32)| -> Vec<u32> {
        if local_bits <= 21 {
            vec![code as u32, (code >> 32) as u32]
        } else {
            code.decode().to_vec()
        }
    };
    points.iter().flat_map(words).collect()
}

impl NodeSource for MemoryCloud {
    fn octree(&self) -> &Octree {
        &self.octree
    }
    fn bounds(&self) -> Aabb {
        self.bounds
    }
    fn schema(&self) -> &Schema {
        &self.schema
    }
    fn has_colors(&self) -> bool {
        true
    }
    fn value_ranges(&self, _: usize) -> &[ValueRange] {
        &self.ranges
    }
    fn read_positions(&self, node: NodeId, words: &mut Vec<u32>) -> Result<(), NodeReadError> {
        words.clone_from(&self.positions[node.index()]);
        self.note_read(words);
        Ok(())
    }
    fn read_colors(&self, node: NodeId, words: &mut Vec<u32>) -> Result<(), NodeReadError> {
        words.clone_from(&self.colors[node.index()]);
        self.note_read(words);
        Ok(())
    }
    fn read_attribute(
        &self,
        _: NodeId,
        attribute: usize,
        _: &mut Vec<u8>,
    ) -> Result<(), NodeReadError> {
        Err(NodeReadError::NoSuchSection { section: format!("attribute {attribute}") })
    }
    fn bytes_read(&self) -> u64 {
        self.bytes_read.load(Ordering::Relaxed)
    }
}
