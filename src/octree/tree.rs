//! Nodes, their cells, and the arena that holds them coarse to fine.

use glam::{DVec3, I64Vec3, UVec3};

use crate::geometry::{Aabb, MortonKey};
use crate::ids::NodeId;
use crate::octree::LevelIndex;
use crate::points::Lattice;

/// Why rows do not form an octree.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OctreeError {
    /// The running totals of a node break an invariant of [`LevelIndex`].
    #[error("level totals {totals:?} do not rise from 1")]
    LevelTotals {
        /// What was found.
        totals: Vec<u32>,
    },
    /// A node is not where its parent, depth or order says.
    #[error("node {node}: {what}")]
    Structure {
        /// The node.
        node: NodeId,
        /// What is wrong with it.
        what: String,
    },
}

/// The cube of the lattice that the root covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RootCube {
    /// Lattice coordinates of its lowest corner.
    pub min: I64Vec3,
    /// Its edge is `2^bits` lattice steps; 1..=32.
    pub bits: u32,
}

/// One outer node. Coordinates named local are lattice steps from the cell's lowest corner.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Node {
    /// Depth in the outer octree; the root has 0.
    pub depth: u32,
    /// Cell coordinates at that depth: the cell starts at `cell << (bits - depth)`.
    pub cell: UVec3,
    /// The parent; `None` for the root.
    pub parent: Option<NodeId>,
    /// The first child; the others follow it directly in octant order.
    pub first_child: NodeId,
    /// Bit `o` is set if octant `o` (x + 2 y + 4 z) has a child.
    pub child_mask: u8,
    /// Points per level.
    pub levels: LevelIndex,
    /// Smallest local coordinates of the node's own points.
    pub tight_min: UVec3,
    /// Largest local coordinates of the node's own points.
    pub tight_max: UVec3,
}

impl Node {
    /// Points that the node itself holds.
    pub fn point_count(&self) -> u32 {
        self.levels.point_count()
    }

    /// The children, in octant order.
    pub fn children(&self) -> impl Iterator<Item = NodeId> + use<> {
        let first = self.first_child.0;
        (first..first + self.child_mask.count_ones()).map(NodeId)
    }
}

/// The outer octree: nodes coarse to fine (by depth, then Morton order), parents before children.
#[derive(Clone, Debug)]
pub struct Octree {
    lattice: Lattice,
    root_cube: RootCube,
    depth: u32,
    nodes: Vec<Node>,
    point_count: u64,
}

impl Octree {
    /// Takes nodes in directory order and checks that they form an octree of point trees of
    /// depth `depth` (the paper's D).
    pub fn new(
        lattice: Lattice,
        root_cube: RootCube,
        depth: u32,
        nodes: Vec<Node>,
    ) -> Result<Self, OctreeError> {
        let point_count = nodes.iter().map(|node| u64::from(node.point_count())).sum();
        let octree = Octree { lattice, root_cube, depth, nodes, point_count };
        octree.check_structure()?;
        Ok(octree)
    }

    /// World positions of lattice coordinates.
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// The root's cube.
    pub fn root_cube(&self) -> RootCube {
        self.root_cube
    }

    /// Levels within a node beyond its coarsest (the paper's D).
    pub fn depth(&self) -> u32 {
        self.depth
    }

    /// All nodes in directory order.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// One node.
    pub fn node(&self, id: NodeId) -> &Node {
        &self.nodes[id.index()]
    }

    /// All points.
    pub fn point_count(&self) -> u64 {
        self.point_count
    }

    /// Edge of a node's cell in lattice steps, as bits: local coordinates are below `2^bits`.
    pub fn local_bits(&self, id: NodeId) -> u32 {
        self.root_cube.bits - self.node(id).depth
    }

    /// Lattice coordinates of the lowest corner of a node's cell.
    pub fn cell_min(&self, id: NodeId) -> I64Vec3 {
        let bits = self.local_bits(id);
        self.root_cube.min + (self.node(id).cell.as_i64vec3() << bits)
    }

    /// World edges of a cell at global level `level` (outer depth plus level within the node).
    ///
    /// The three differ only if the lattice's scales do. Levels past single lattice steps give
    /// fractions of a step.
    pub fn cell_size(&self, level: u32) -> DVec3 {
        self.lattice.scale * f64::from(self.root_cube.bits as i32 - level as i32).exp2()
    }

    /// The whole cell of a node in the world. Closed: it contains every point of its subtree.
    pub fn cell_box(&self, id: NodeId) -> Aabb {
        let min = self.cell_min(id);
        let edge = (1i64 << self.local_bits(id)) - 1;
        Aabb::new(self.lattice.world(min), self.lattice.world(min + I64Vec3::splat(edge)))
    }

    /// The box of the node's own points in the world.
    pub fn tight_box(&self, id: NodeId) -> Aabb {
        let (min, node) = (self.cell_min(id), self.node(id));
        Aabb::new(
            self.lattice.world(min + node.tight_min.as_i64vec3()),
            self.lattice.world(min + node.tight_max.as_i64vec3()),
        )
    }

    fn check_structure(&self) -> Result<(), OctreeError> {
        let mut expected_child = 1u32;
        for (i, node) in self.nodes.iter().enumerate() {
            let id = NodeId(i as u32);
            let wrong = |what: &str| Err(OctreeError::Structure { node: id, what: what.into() });
            if i == 0 && (node.depth != 0 || node.cell != UVec3::ZERO || node.parent.is_some()) {
                return wrong("the first row is not a root");
            }
            if node.levels.depth() != self.depth {
                return wrong("it has another number of levels than the store says");
            }
            if self.root_cube.bits < node.depth + self.depth {
                return wrong("it is deeper than the lattice");
            }
            if node.cell.max_element() as u64 >> node.depth != 0 {
                return wrong("its cell lies outside the root");
            }
            let edge = (1u64 << self.local_bits(id)) - 1;
            if node.tight_min.cmpgt(node.tight_max).any()
                || u64::from(node.tight_max.max_element()) > edge
            {
                return wrong("the box of its points lies outside its cell");
            }
            if node.child_mask != 0 && node.first_child.0 != expected_child {
                return wrong("its children are not the next rows");
            }
            expected_child += node.child_mask.count_ones();
            if expected_child as usize > self.nodes.len() {
                return wrong("it has more children than there are rows");
            }
            let octants = (0..8u32).filter(|o| node.child_mask >> o & 1 == 1);
            for (octant, child_id) in octants.zip(node.children()) {
                let child = self.node(child_id);
                let cell = node.cell * 2 + UVec3::new(octant & 1, octant >> 1 & 1, octant >> 2);
                if child.depth != node.depth + 1 || child.cell != cell || child.parent != Some(id) {
                    return wrong(&format!("row {child_id} is not its child in octant {octant}"));
                }
            }
        }
        if !self.nodes.is_empty() && expected_child as usize != self.nodes.len() {
            let node = NodeId(expected_child);
            return Err(OctreeError::Structure { node, what: "no node has it as a child".into() });
        }
        Ok(())
    }

    /// The Morton code of a node's cell, for ordering within a depth.
    pub fn cell_code(&self, id: NodeId) -> u128 {
        u128::encode(self.node(id).cell.to_array())
    }
}
