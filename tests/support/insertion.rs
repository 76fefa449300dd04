//! Oracle for the octree build: the paper's algorithm taken literally, one point after another.
//!
//! Slow on purpose and independent of `build`: pointer trees, no Morton sorting, no parallelism.
//! It follows sections 6.4.6 and 6.5.2 of the Instant Points chapter: points filter down to
//! leaves of an octree of depth D, occupied leaves split, occupied leaves at depth D reject; what
//! is rejected becomes the input of the child node in that octant, unless it is fewer than the
//! threshold, then it is added to the leaves after all; representatives move up bottom-up.
//!
//! Coordinates are lattice steps from the root's lowest corner.

#![allow(dead_code, reason = "each test binary uses a part")]

use esker::geometry::MortonKey;
use esker::ids::NodeId;
use esker::octree::{LevelIndex, Node, Octree, RootCube};
use esker::points::Lattice;
use glam::{I64Vec3, UVec3};

/// One input point. Its place in the input slice is its input index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputPoint {
    /// Steps from the root's lowest corner, below `2^bits`.
    pub position: [u32; 3],
    /// Red, green, blue as stored, 8 or 16 bits; all equal where there is no colour.
    pub color: [u16; 3],
}

/// What shapes the tree.
#[derive(Clone, Copy, Debug)]
pub struct Parameters {
    /// Levels within a node beyond its coarsest (D).
    pub depth: u32,
    /// Fewest rejected points that get a node of their own (T).
    pub threshold: usize,
    /// The root's edge is `2^bits` steps.
    pub bits: u32,
}

/// One outer node: input indices of its points, coarse to fine, Morton order within a level, input
/// order among equal codes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InsertedNode {
    /// Outer depth.
    pub depth: u32,
    /// Cell coordinates at that depth.
    pub cell: [u32; 3],
    /// Running totals per level 0..=D.
    pub totals: Vec<u32>,
    /// Input indices in stored order.
    pub points: Vec<usize>,
    /// Input indices of all points that ever reached the node, rejected ones included.
    pub entered: Vec<usize>,
}

/// Builds all nodes in directory order (by depth, then Morton order of the cell).
pub fn insert_all(input: &[InputPoint], parameters: &Parameters) -> Vec<InsertedNode> {
    let mut nodes = Vec::new();
    if !input.is_empty() {
        fill_node(input, parameters, 0, [0; 3], (0..input.len()).collect(), &mut nodes);
    }
    nodes.sort_by_key(|node| (node.depth, u128::encode(node.cell)));
    nodes
}

/// Steps 1-7 of section 6.5.2 for one node; recursion stands for "take a rejection file".
fn fill_node(
    input: &[InputPoint],
    parameters: &Parameters,
    depth: u32,
    cell: [u32; 3],
    entered: Vec<usize>,
    nodes: &mut Vec<InsertedNode>,
) {
    let tree = Tree { input, depth: parameters.depth, top_bit: parameters.bits - depth };
    let mut root = Cell::Empty;
    let mut rejected: [Vec<usize>; 8] = Default::default();
    for &point in &entered {
        if !tree.insert(&mut root, 0, point, false) {
            rejected[tree.octant(point, 0)].push(point);
        }
    }
    // A child's finest cells must still be whole steps: at the last depth everything is added.
    let is_last = depth + parameters.depth >= parameters.bits;
    for (octant, file) in rejected.into_iter().enumerate() {
        if file.is_empty() {
            continue;
        }
        if is_last || file.len() < parameters.threshold {
            file.iter().for_each(|&point| assert!(tree.insert(&mut root, 0, point, true)));
        } else {
            let child = [0, 1, 2].map(|axis| cell[axis] * 2 + (octant as u32 >> axis & 1));
            fill_node(input, parameters, depth + 1, child, file, nodes);
        }
    }
    nodes.push(tree.finish(&mut root, depth, cell, entered));
}

/// A cell of the inner octree.
enum Cell {
    Empty,
    /// First arrival first; more than one only at depth D.
    Leaf(Vec<usize>),
    Inner {
        children: Box<[Cell; 8]>,
        representative: Option<usize>,
    },
}

struct Tree<'a> {
    input: &'a [InputPoint],
    depth: u32,
    /// The node's cell spans this many bits.
    top_bit: u32,
}

impl Tree<'_> {
    /// Octant of a point within its cell at `level` of this node.
    fn octant(&self, point: usize, level: u32) -> usize {
        let position = self.input[point].position;
        let Some(bit) = self.top_bit.checked_sub(level + 1) else { return 0 };
        (0..3).map(|axis| (position[axis] as usize >> bit & 1) << axis).sum()
    }

    /// Filters a point down to a leaf; whether it was stored.
    fn insert(&self, cell: &mut Cell, level: u32, point: usize, add: bool) -> bool {
        match cell {
            Cell::Empty => {
                *cell = Cell::Leaf(vec![point]);
                true
            }
            Cell::Inner { children, .. } => {
                let octant = self.octant(point, level);
                self.insert(&mut children[octant], level + 1, point, add)
            }
            Cell::Leaf(points) if level == self.depth => {
                if add {
                    points.push(point);
                }
                add
            }
            Cell::Leaf(points) => {
                let old = points[0];
                let mut children: Box<[Cell; 8]> = Box::new([const { Cell::Empty }; 8]);
                let octant = self.octant(old, level);
                children[octant] = Cell::Leaf(vec![old]);
                *cell = Cell::Inner { children, representative: None };
                self.insert(cell, level, point, add)
            }
        }
    }

    /// Chooses the representatives of inner cells bottom-up; the chosen points move up.
    fn choose(&self, cell: &mut Cell) {
        let Cell::Inner { children, representative } = cell else { return };
        children.iter_mut().for_each(|child| self.choose(child));
        let candidates: Vec<usize> = children.iter().filter_map(Cell::shown).collect();
        let color = |point: usize| self.input[point].color.map(i128::from);
        let count = candidates.len() as i128;
        let sum = candidates.iter().fold([0i128; 3], |sum, &point| {
            [0, 1, 2].map(|channel| sum[channel] + color(point)[channel])
        });
        // Distances to the mean, times the count, so that they stay whole numbers.
        let distance = |point: usize| -> i128 {
            (0..3).map(|c| (count * color(point)[c] - sum[c]).pow(2)).sum()
        };
        let best = candidates.into_iter().min_by_key(|&point| (distance(point), point));
        let best = best.expect("an inner cell has points");
        *representative = Some(best);
        let owner = children.iter_mut().find(|child| child.shown() == Some(best));
        owner.expect("the point came from a child").remove_shown();
    }

    /// Sorts what the cells hold by level and Morton code.
    fn finish(
        &self,
        root: &mut Cell,
        depth: u32,
        cell: [u32; 3],
        entered: Vec<usize>,
    ) -> InsertedNode {
        self.choose(root);
        let mut rows = Vec::new();
        collect(root, 0, &mut rows);
        let mask = ((1u64 << self.top_bit) - 1) as u32;
        let code = |point: usize| u128::encode(self.input[point].position.map(|c| c & mask));
        rows.sort_by_key(|&(level, point)| (level, code(point), point));
        let totals = (0..=self.depth)
            .map(|level| rows.iter().filter(|row| row.0 <= level).count() as u32)
            .collect();
        InsertedNode {
            depth,
            cell,
            totals,
            points: rows.iter().map(|row| row.1).collect(),
            entered,
        }
    }
}

impl Cell {
    /// The point through which the cell is seen from above. Moving it up leaves the cell without
    /// one, but its parent has been decided by then.
    fn shown(&self) -> Option<usize> {
        match self {
            Cell::Empty => None,
            Cell::Leaf(points) => points.first().copied(),
            Cell::Inner { representative, .. } => *representative,
        }
    }

    fn remove_shown(&mut self) {
        match self {
            Cell::Empty => {}
            Cell::Leaf(points) => {
                points.remove(0);
            }
            Cell::Inner { representative, .. } => *representative = None,
        }
    }
}

fn collect(cell: &Cell, level: u32, rows: &mut Vec<(u32, usize)>) {
    match cell {
        Cell::Empty => {}
        Cell::Leaf(points) => rows.extend(points.iter().map(|&point| (level, point))),
        Cell::Inner { children, representative } => {
            rows.extend(representative.map(|point| (level, point)));
            children.iter().for_each(|child| collect(child, level + 1, rows));
        }
    }
}

/// The nodes as an octree, its root's lowest corner at `min` of `lattice`.
pub fn octree_of(
    input: &[InputPoint],
    nodes: &[InsertedNode],
    parameters: &Parameters,
    lattice: Lattice,
    min: I64Vec3,
) -> Octree {
    let find = |depth: u32, cell: UVec3| {
        let found = nodes.iter().position(|n| n.depth == depth && n.cell == cell.to_array());
        found.map(|row| NodeId(row as u32))
    };
    let rows = nodes.iter().map(|node| {
        let cell = UVec3::from_array(node.cell);
        let children = (0..8u32).map(|octant| {
            let upper = UVec3::new(octant & 1, octant >> 1 & 1, octant >> 2);
            find(node.depth + 1, cell * 2 + upper)
        });
        let children: Vec<Option<NodeId>> = children.collect();
        let mask = ((1u64 << (parameters.bits - node.depth)) - 1) as u32;
        let local = |point: &usize| UVec3::from_array(input[*point].position.map(|c| c & mask));
        Node {
            depth: node.depth,
            cell,
            parent: (node.depth > 0).then(|| find(node.depth - 1, cell / 2).expect("has a parent")),
            first_child: children.iter().flatten().min().copied().unwrap_or_default(),
            child_mask: (0..8).filter(|&o| children[o].is_some()).map(|o| 1 << o).sum(),
            levels: LevelIndex::new(node.totals.clone()).expect("totals rise from 1"),
            tight_min: node.points.iter().map(local).reduce(UVec3::min).expect("not empty"),
            tight_max: node.points.iter().map(local).reduce(UVec3::max).expect("not empty"),
        }
    });
    let root = RootCube { min, bits: parameters.bits };
    Octree::new(lattice, root, parameters.depth, rows.collect()).expect("the rows form an octree")
}
