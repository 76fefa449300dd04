//! Octrees of points as culling sees them.
//!
//! Below a root that all octrees share, each outer node is an inner node over its children, with one
//! more leaf for the points it holds itself; a node without children is that leaf. Only what a cut
//! chose hangs in the tree; ids do not depend on the cut, so memory of nodes outlives it.
//!
//! The points of a node spread over its whole cell, so its box is hardly larger than that of its
//! own points: taking it apart gains nothing ([`BoundingHierarchy::keeps_whole`]).

use crate::geometry::Aabb;
use crate::hierarchy::BoundingHierarchy;
use crate::ids::{NodeId, TreeNodeId};
use crate::octree::Octree;

/// Boxes around all points of each node's subtree, of one octree.
#[derive(Clone, Debug)]
pub struct SubtreeBoxes(Vec<Aabb>);

impl SubtreeBoxes {
    /// Joins the boxes of the nodes' own points upwards.
    pub fn new(octree: &Octree) -> Self {
        let ids = (0..octree.nodes().len() as u32).map(NodeId);
        let mut boxes: Vec<Aabb> = ids.map(|id| octree.tight_box(id)).collect();
        // Parents stand before their children.
        for (at, node) in octree.nodes().iter().enumerate().rev() {
            if let Some(parent) = node.parent {
                boxes[parent.index()] = boxes[parent.index()].union(&boxes[at]);
            }
        }
        SubtreeBoxes(boxes)
    }
}

/// What a cut chose of one node and its subtree.
#[derive(Clone, Copy, Debug, Default)]
struct Chosen {
    /// Leading points of the node itself; 0 if it is not in the cut.
    points: u32,
    /// How far its splats stick out of their box, and the subtree's, pixels.
    overhang_px: f32,
    below_px: f32,
    /// Points of the subtree; 0 if nothing of it is in the cut.
    below: u64,
}

/// What a cut chose of one octree.
#[derive(Clone, Debug, Default)]
pub struct ChosenNodes {
    nodes: Vec<Chosen>,
    /// Those that are not empty, parents before children.
    filled: Vec<NodeId>,
}

impl ChosenNodes {
    /// Takes in a cut: nodes with the number of their points, at least 1, and by how many pixels
    /// splats may stick out of the box of their centres.
    pub fn choose(&mut self, octree: &Octree, cut: impl Iterator<Item = (NodeId, u32, f32)>) {
        for node in self.filled.drain(..) {
            self.nodes[node.index()] = Chosen::default();
        }
        self.nodes.resize(octree.nodes().len(), Chosen::default());
        for (node, points, overhang_px) in cut {
            let chosen = &mut self.nodes[node.index()];
            *chosen = Chosen { points, overhang_px, ..*chosen };
            self.fill(octree, node);
        }
        self.filled.sort_unstable();
        self.filled.iter().for_each(|node| self.nodes[node.index()].below = 0);
        for &node in self.filled.iter().rev() {
            let chosen = &mut self.nodes[node.index()];
            chosen.below += u64::from(chosen.points);
            chosen.below_px = chosen.below_px.max(chosen.overhang_px);
            let Chosen { below, below_px, .. } = *chosen;
            if let Some(parent) = octree.node(node).parent {
                let parent = &mut self.nodes[parent.index()];
                parent.below += below;
                parent.below_px = parent.below_px.max(below_px);
            }
        }
    }

    /// Lists a node and those above it, which need not be in the cut themselves.
    fn fill(&mut self, octree: &Octree, node: NodeId) {
        let mut at = Some(node);
        while let Some(node) = at {
            let chosen = &mut self.nodes[node.index()];
            // Until sums are taken, 1 says that the node is listed.
            if std::mem::replace(&mut chosen.below, 1) == 1 {
                break;
            }
            self.filled.push(node);
            at = octree.node(node).parent;
        }
    }

    /// Whether anything of a node's subtree hangs in the tree.
    pub fn holds(&self, node: NodeId) -> bool {
        self.nodes.get(node.index()).is_some_and(|chosen| chosen.below > 0)
    }
}

/// One octree of a [`Forest`].
#[derive(Clone, Copy, Debug)]
pub struct ForestTree<'a> {
    /// The octree.
    pub octree: &'a Octree,
    /// Boxes of its subtrees.
    pub boxes: &'a SubtreeBoxes,
    /// What hangs in the tree now.
    pub chosen: &'a ChosenNodes,
}

/// Octrees under one root.
#[derive(Clone, Debug, Default)]
pub struct Forest<'a> {
    trees: Vec<ForestTree<'a>>,
    /// Id of each tree's root, and the first id that is none.
    first: Vec<u32>,
}

/// What an id stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    Root,
    /// A node with its subtree.
    Subtree(usize, NodeId),
    /// A node's own points.
    Points(usize, NodeId),
}

const ROOT: TreeNodeId = TreeNodeId(0);

impl<'a> Forest<'a> {
    /// Octrees, in the order of the scene.
    pub fn new(trees: Vec<ForestTree<'a>>) -> Self {
        let mut first = vec![1];
        for tree in &trees {
            first.push(first[first.len() - 1] + 2 * tree.octree.nodes().len() as u32);
        }
        Forest { trees, first }
    }

    fn place(&self, id: TreeNodeId) -> Place {
        if id == ROOT {
            return Place::Root;
        }
        let tree = self.first.partition_point(|&first| first <= id.0) - 1;
        let at = id.0 - self.first[tree];
        let node = NodeId(at / 2);
        if at.is_multiple_of(2) { Place::Subtree(tree, node) } else { Place::Points(tree, node) }
    }

    fn subtree(&self, tree: usize, node: NodeId) -> TreeNodeId {
        TreeNodeId(self.first[tree] + 2 * node.0)
    }

    /// Id of the leaf that stands for a node's own points.
    pub fn leaf(&self, tree: usize, node: NodeId) -> TreeNodeId {
        let is_inner = self.trees[tree].octree.node(node).child_mask != 0;
        TreeNodeId(self.subtree(tree, node).0 + u32::from(is_inner))
    }

    /// The octree and node that a leaf draws; `None` for other ids.
    pub fn points_of_leaf(&self, id: TreeNodeId) -> Option<(usize, NodeId)> {
        match self.place(id) {
            Place::Points(tree, node) => Some((tree, node)),
            Place::Subtree(tree, node) => {
                (self.trees[tree].octree.node(node).child_mask == 0).then_some((tree, node))
            }
            Place::Root => None,
        }
    }

    /// Calls `each` with every octree and node whose points hang below an id.
    pub fn for_each_below(&self, id: TreeNodeId, each: &mut impl FnMut(usize, NodeId)) {
        match self.points_of_leaf(id) {
            Some((tree, node)) => each(tree, node),
            None => self.children(id).for_each(|child| self.for_each_below(child, each)),
        }
    }

    fn chosen(&self, tree: usize, node: NodeId) -> Chosen {
        self.trees[tree].chosen.nodes.get(node.index()).copied().unwrap_or_default()
    }

    fn has_nodes(&self) -> bool {
        self.trees.iter().any(|tree| !tree.octree.nodes().is_empty())
    }
}

impl BoundingHierarchy for Forest<'_> {
    fn root(&self) -> Option<TreeNodeId> {
        self.has_nodes().then_some(ROOT)
    }

    fn node_limit(&self) -> usize {
        if self.has_nodes() { self.first[self.trees.len()] as usize } else { 0 }
    }

    fn parent(&self, id: TreeNodeId) -> Option<TreeNodeId> {
        match self.place(id) {
            Place::Root => None,
            Place::Points(tree, node) => Some(self.subtree(tree, node)),
            Place::Subtree(tree, node) => {
                let parent = self.trees[tree].octree.node(node).parent;
                Some(parent.map_or(ROOT, |parent| self.subtree(tree, parent)))
            }
        }
    }

    fn children(&self, id: TreeNodeId) -> impl Iterator<Item = TreeNodeId> {
        let place = self.place(id);
        let hangs = |tree: usize, node: NodeId| self.chosen(tree, node).below > 0;
        let roots = (place == Place::Root).then(|| {
            let trees = (0..self.trees.len()).filter(move |&tree| hangs(tree, NodeId::ROOT));
            trees.map(|tree| self.subtree(tree, NodeId::ROOT))
        });
        let below = match place {
            Place::Subtree(tree, node) if self.trees[tree].octree.node(node).child_mask != 0 => {
                let children = self.trees[tree].octree.node(node).children();
                let children = children.filter(move |&child| hangs(tree, child));
                let own = (self.chosen(tree, node).points > 0).then(|| self.leaf(tree, node));
                Some(own.into_iter().chain(children.map(move |child| self.subtree(tree, child))))
            }
            _ => None,
        };
        roots.into_iter().flatten().chain(below.into_iter().flatten())
    }

    fn is_leaf(&self, id: TreeNodeId) -> bool {
        self.points_of_leaf(id).is_some()
    }

    fn bounds(&self, id: TreeNodeId) -> Aabb {
        match self.place(id) {
            Place::Root => {
                let boxes = self.trees.iter().filter_map(|tree| tree.boxes.0.first());
                boxes.fold(Aabb::EMPTY, |all, bounds| all.union(bounds))
            }
            Place::Subtree(tree, node) => self.trees[tree].boxes.0[node.index()],
            Place::Points(tree, node) => self.trees[tree].octree.tight_box(node),
        }
    }

    fn cost(&self, id: TreeNodeId) -> u64 {
        match self.place(id) {
            Place::Root => {
                let trees = (0..self.trees.len()).map(|tree| self.chosen(tree, NodeId::ROOT));
                trees.map(|chosen| chosen.below).sum()
            }
            Place::Subtree(tree, node) => self.chosen(tree, node).below,
            Place::Points(tree, node) => u64::from(self.chosen(tree, node).points),
        }
    }

    fn overhang_px(&self, id: TreeNodeId) -> f64 {
        f64::from(match self.place(id) {
            Place::Root => {
                let trees = (0..self.trees.len()).map(|tree| self.chosen(tree, NodeId::ROOT));
                trees.map(|chosen| chosen.below_px).fold(0.0, f32::max)
            }
            Place::Subtree(tree, node) => self.chosen(tree, node).below_px,
            Place::Points(tree, node) => self.chosen(tree, node).overhang_px,
        })
    }

    fn keeps_whole(&self, _: TreeNodeId) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::{LevelIndex, Node, RootCube};
    use crate::points::Lattice;
    use glam::{DVec3, I64Vec3, UVec3};

    /// A root with two children, of which the first has one child.
    fn octree() -> Octree {
        let lattice = Lattice { offset: DVec3::ZERO, scale: DVec3::ONE };
        let root_cube = RootCube { min: I64Vec3::ZERO, bits: 5 };
        let levels = LevelIndex::new(vec![1, 3]).unwrap();
        let node = |depth, cell, parent: Option<u32>, first_child, child_mask| Node {
            depth,
            cell,
            parent: parent.map(NodeId),
            first_child: NodeId(first_child),
            child_mask,
            levels: levels.clone(),
            tight_min: UVec3::ONE,
            tight_max: UVec3::splat(2),
        };
        let nodes = vec![
            node(0, UVec3::ZERO, None, 1, 0b1000_0001),
            node(1, UVec3::ZERO, Some(0), 3, 0b1000_0000),
            node(1, UVec3::ONE, Some(0), 4, 0),
            node(2, UVec3::ONE, Some(1), 4, 0),
        ];
        Octree::new(lattice, root_cube, 1, nodes).unwrap()
    }

    fn leaves(forest: &Forest) -> Vec<(usize, u32)> {
        let mut found = Vec::new();
        forest.for_each_below(ROOT, &mut |tree, node| found.push((tree, node.0)));
        found.sort_unstable();
        found
    }

    #[test]
    fn only_what_was_chosen_hangs_in_the_tree_and_ids_stay() {
        let octree = octree();
        let boxes = SubtreeBoxes::new(&octree);
        let mut chosen = [ChosenNodes::default(), ChosenNodes::default()];
        let all = [(0, 3, 2.0), (1, 2, 3.0), (2, 3, 1.0), (3, 1, 5.0)];
        let cut = |of: &[u32]| {
            all.into_iter()
                .filter(|(node, ..)| of.contains(node))
                .map(|(n, p, o)| (NodeId(n), p, o))
                .collect::<Vec<_>>()
        };
        // Node 3 of the second tree hangs there although node 1 above it cannot be read.
        for (chosen, of) in chosen.iter_mut().zip([&[0, 1, 2, 3][..], &[0, 3][..]]) {
            chosen.choose(&octree, cut(&[2]).into_iter());
            chosen.choose(&octree, cut(of).into_iter());
        }
        let tree = |i: usize| ForestTree { octree: &octree, boxes: &boxes, chosen: &chosen[i] };
        let forest = Forest::new(vec![tree(0), tree(1)]);
        assert_eq!(leaves(&forest), [(0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (1, 3)]);
        assert_eq!((forest.node_limit(), forest.cost(ROOT)), (17, 9 + 4));
        assert_eq!(forest.overhang_px(ROOT), 5.0);
        assert_eq!(forest.overhang_px(forest.subtree(0, NodeId(1))), 5.0);
        assert_eq!(forest.overhang_px(forest.leaf(0, NodeId(1))), 3.0);
        let mut open = vec![ROOT];
        while let Some(id) = open.pop() {
            assert_eq!(forest.is_leaf(id), forest.children(id).count() == 0, "{id:?}");
            for child in forest.children(id) {
                assert_eq!(forest.parent(child), Some(id));
                let bounds = forest.bounds(id);
                assert_eq!(bounds.union(&forest.bounds(child)), bounds);
                open.push(child);
            }
        }
        let leaf = forest.leaf(1, NodeId(3));
        assert_eq!(forest.points_of_leaf(leaf), Some((1, NodeId(3))));
        // Node 1 is there for what is below it alone.
        assert_eq!([1, 3].map(|node| forest.cost(forest.leaf(1, NodeId(node)))), [0, 1]);
        assert!(chosen[1].holds(NodeId(1)) && !chosen[1].holds(NodeId(2)));
        assert_eq!(Forest::new(Vec::new()).root(), None);
    }
}
