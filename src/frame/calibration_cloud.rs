//! A made-up surface in memory, to measure drawing on: any number of nodes of one size.
//!
//! A square in the plane z = 0, each node a regular grid over its cell; a child's grid is twice as
//! fine. Points of parent and child coincide, which a picture does not mind.

use glam::{DVec3, I64Vec3, UVec3};

use crate::frame::NodeSource;
use crate::geometry::{Aabb, MortonKey};
use crate::ids::NodeId;
use crate::octree::{LevelIndex, Node, Octree, RootCube};
use crate::points::{Attribute, Lattice, Scalar, Schema, names};
use crate::store::{NodeReadError, ValueRange};

/// Bits per axis of the root.
const BITS: u32 = 14;
/// Edge of the square, metres.
pub(super) const EDGE: f64 = 16.384;

/// The surface.
pub(super) struct CalibrationCloud {
    octree: Octree,
    /// Position words of a node, by its depth: all nodes of a depth hold the same local grid.
    positions: Vec<Vec<u32>>,
    colors: Vec<u32>,
    schema: Schema,
    ranges: Vec<ValueRange>,
}

impl CalibrationCloud {
    /// `4^levels` points in each node, nodes down to depth `depth`.
    pub(super) fn new(levels: u32, depth: u32) -> Self {
        let totals: Vec<u32> = (0..=levels).map(|level| 4u32.pow(level)).collect();
        let index = LevelIndex::new(totals).expect("totals rise from 1");
        let mut rows = vec![(0u32, UVec3::ZERO, None)];
        let mut nodes: Vec<Node> = Vec::new();
        while let Some(&(at, cell, parent)) = rows.get(nodes.len()) {
            let id = NodeId(nodes.len() as u32);
            let first_child = NodeId(rows.len() as u32);
            let child_mask = if at < depth { 0b1111 } else { 0 };
            for octant in (0..4u32).filter(|_| at < depth) {
                rows.push((at + 1, cell * 2 + UVec3::new(octant & 1, octant >> 1, 0), Some(id)));
            }
            let edge = 1u32 << (BITS - at);
            let last = edge - (edge >> levels);
            nodes.push(Node {
                depth: at,
                cell,
                parent,
                first_child: if child_mask == 0 { NodeId(0) } else { first_child },
                child_mask,
                levels: index.clone(),
                tight_min: UVec3::ZERO,
                tight_max: UVec3::new(last, last, 0),
            });
        }
        let scale = EDGE * (-f64::from(BITS)).exp2();
        let lattice = Lattice { scale: DVec3::splat(scale), offset: DVec3::ZERO };
        let root = RootCube { min: I64Vec3::ZERO, bits: BITS };
        let octree = Octree::new(lattice, root, levels, nodes).expect("the rows form an octree");
        let positions = (0..=depth).map(|at| grid(levels, BITS - at)).collect();
        let rgb = Attribute {
            name: names::RGB.into(),
            scalar: Scalar::U16,
            components: 3,
            record_offset: 12,
        };
        CalibrationCloud {
            octree,
            positions,
            colors: (0..4u32.pow(levels))
                .map(|i| 0xff00_0000 | i.wrapping_mul(2_654_435_761) >> 8)
                .collect(),
            schema: Schema { record_bytes: 18, attributes: vec![rgb] },
            ranges: vec![ValueRange { min: 0.0, max: 255.0 }; 3],
        }
    }
}

/// A grid of `2^levels` points a side over a cell of `bits` bits, coarse to fine, in Morton order
/// within a level.
fn grid(levels: u32, bits: u32) -> Vec<u32> {
    let mut words = Vec::with_capacity(2 << (2 * levels));
    for level in 0..=levels {
        for code in 0..4u64.pow(level) {
            // Every second bit is x, the others y; even places belong to a coarser level.
            let (mut x, mut y) = (0u32, 0u32);
            for bit in 0..level {
                x |= ((code >> (2 * bit)) as u32 & 1) << bit;
                y |= ((code >> (2 * bit + 1)) as u32 & 1) << bit;
            }
            if level > 0 && x % 2 == 0 && y % 2 == 0 {
                continue;
            }
            let morton = u64::encode([x << (bits - level), y << (bits - level), 0]);
            words.extend([morton as u32, (morton >> 32) as u32]);
        }
    }
    words
}

impl NodeSource for CalibrationCloud {
    fn octree(&self) -> &Octree {
        &self.octree
    }
    fn bounds(&self) -> Aabb {
        Aabb::new(DVec3::ZERO, DVec3::new(EDGE, EDGE, 0.0))
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
        words.clone_from(&self.positions[self.octree.node(node).depth as usize]);
        Ok(())
    }
    fn read_colors(&self, _: NodeId, words: &mut Vec<u32>) -> Result<(), NodeReadError> {
        words.clone_from(&self.colors);
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
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_hold_each_grid_point_once() {
        let cloud = CalibrationCloud::new(3, 2);
        assert_eq!(cloud.octree.nodes().len(), 1 + 4 + 16);
        assert_eq!(cloud.octree.point_count(), 21 * 64);
        for words in &cloud.positions {
            let mut codes: Vec<&[u32]> = words.chunks(2).collect();
            assert_eq!(codes.len(), 64);
            codes.sort();
            codes.dedup();
            assert_eq!(codes.len(), 64);
        }
        assert_eq!(cloud.colors.len(), 64);
    }
}
