//! The bounding volume hierarchy over objects.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::geometry::Aabb;
use crate::hierarchy::build::{self, Item, Subtree};
use crate::hierarchy::{BoundingHierarchy, surface_area};
use crate::ids::{ObjectId, TreeNodeId};

const NONE: u32 = u32::MAX;

/// Trees built by this process.
static BUILT: AtomicU64 = AtomicU64::new(0);

#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: Aabb,
    parent: u32,
    /// The first of two neighbouring children; `NONE` in leaves.
    first_child: u32,
    /// The subtree's objects stand side by side in `Bvh::objects`.
    first_object: u32,
    object_count: u32,
    cost: u64,
}

/// A binary tree of boxes over objects, in one array.
///
/// Invariants: the root is node 0; a parent stands before its children, which are neighbours; the
/// objects of a subtree are one range of the order; every object is in exactly one leaf, or, where
/// its box is not finite, in the list of those always drawn. Objects with an empty box draw
/// nothing and are in neither.
#[derive(Clone, Debug, Default)]
pub struct Bvh {
    nodes: Vec<Node>,
    objects: Vec<ObjectId>,
    /// The leaf of each object, or `NONE`.
    leaf_of: Vec<u32>,
    object_bounds: Vec<Aabb>,
    /// A leaf beside the tree for objects without a finite box.
    unbounded: Option<u32>,
    /// Which of the trees built so far it is.
    generation: u64,
}

impl Bvh {
    /// Builds the tree over objects' boxes and costs (triangles), with at most `leaf_objects` in a
    /// leaf.
    ///
    /// # Panics
    /// If the two slices differ in length.
    pub fn build(bounds: &[Aabb], costs: &[u64], leaf_objects: usize) -> Self {
        assert_eq!(bounds.len(), costs.len(), "a box and a cost for each object");
        let finite = |b: &Aabb| b.min.is_finite() && b.max.is_finite();
        let mut items: Vec<Item> = Vec::with_capacity(bounds.len());
        let mut unbounded = Vec::new();
        for (object, (bounds, &cost)) in bounds.iter().zip(costs).enumerate() {
            let object = object as u32;
            if *bounds == Aabb::EMPTY {
                continue;
            } else if finite(bounds) && !bounds.is_empty() {
                items.push(Item { bounds: *bounds, center: bounds.center(), cost, object });
            } else {
                unbounded.push(object);
            }
        }
        let mut bvh = Bvh {
            leaf_of: vec![NONE; bounds.len()],
            object_bounds: bounds.to_vec(),
            generation: BUILT.fetch_add(1, Ordering::Relaxed) + 1,
            ..Bvh::default()
        };
        if !items.is_empty() {
            let tree = build::build(&mut items, leaf_objects, 0);
            bvh.lay_out(tree, costs);
        }
        if !unbounded.is_empty() {
            let leaf = bvh.nodes.len() as u32;
            bvh.nodes.push(bvh.new_node(NONE));
            bvh.fill_leaf(leaf, &unbounded, costs);
            bvh.unbounded = Some(leaf);
        }
        bvh
    }

    fn new_node(&self, parent: u32) -> Node {
        Node {
            bounds: Aabb::EMPTY,
            parent,
            first_child: NONE,
            first_object: self.objects.len() as u32,
            object_count: 0,
            cost: 0,
        }
    }

    /// Lays a finished tree out, parents before children, and sums up from the leaves.
    fn lay_out(&mut self, tree: Subtree, costs: &[u64]) {
        self.nodes.push(self.new_node(NONE));
        let mut open = vec![(0u32, tree)];
        while let Some((at, subtree)) = open.pop() {
            self.nodes[at as usize].first_object = self.objects.len() as u32;
            match subtree {
                Subtree::Leaf(objects) => self.fill_leaf(at, &objects, costs),
                Subtree::Inner(children) => {
                    let first = self.nodes.len() as u32;
                    self.nodes[at as usize].first_child = first;
                    let child = self.new_node(at);
                    self.nodes.extend([child, child]);
                    let [left, right] = *children;
                    open.push((first + 1, right));
                    open.push((first, left));
                }
            }
        }
        for at in (0..self.nodes.len()).rev() {
            let node = self.nodes[at];
            if node.first_child != NONE {
                let [left, right] = self.pair(node.first_child);
                self.nodes[at].object_count = left.object_count + right.object_count;
                self.nodes[at].cost = left.cost + right.cost;
                self.nodes[at].bounds = left.bounds.union(&right.bounds);
            }
        }
    }

    fn pair(&self, first: u32) -> [Node; 2] {
        [self.nodes[first as usize], self.nodes[first as usize + 1]]
    }

    fn fill_leaf(&mut self, leaf: u32, objects: &[u32], costs: &[u64]) {
        let node = &mut self.nodes[leaf as usize];
        node.first_object = self.objects.len() as u32;
        node.object_count = objects.len() as u32;
        for &object in objects {
            node.cost += costs[object as usize];
            self.leaf_of[object as usize] = leaf;
            self.objects.push(ObjectId(object));
        }
        self.nodes[leaf as usize].bounds = self.leaf_bounds(leaf);
    }

    fn leaf_bounds(&self, leaf: u32) -> Aabb {
        self.objects_of(TreeNodeId(leaf))
            .iter()
            .fold(Aabb::EMPTY, |all, object| all.union(&self.object_bounds[object.index()]))
    }

    /// The objects of a subtree.
    pub fn objects_of(&self, node: TreeNodeId) -> &[ObjectId] {
        let node = &self.nodes[node.index()];
        &self.objects[node.first_object as usize..][..node.object_count as usize]
    }

    /// The leaf that holds an object; `None` if it draws nothing.
    pub fn leaf_of(&self, object: ObjectId) -> Option<TreeNodeId> {
        let leaf = self.leaf_of[object.index()];
        (leaf != NONE).then_some(TreeNodeId(leaf))
    }

    /// Objects that have no finite box, and are drawn in every frame.
    pub fn unbounded(&self) -> &[ObjectId] {
        self.unbounded.map_or(&[], |leaf| self.objects_of(TreeNodeId(leaf)))
    }

    /// Number of nodes.
    pub fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// Largest number of steps from the root to a leaf.
    pub fn depth(&self) -> u32 {
        let mut depths = vec![0u32; self.nodes.len()];
        for at in 0..self.nodes.len() {
            if self.nodes[at].parent != NONE {
                depths[at] = depths[self.nodes[at].parent as usize] + 1;
            }
        }
        depths.into_iter().max().unwrap_or(0)
    }

    /// Expected work of a random line through the scene: the sum over leaves of area times cost,
    /// plus one step for each inner node's area, relative to the root's area.
    pub fn sah_cost(&self) -> f64 {
        let Some(root) = self.nodes.first() else { return 0.0 };
        let root_area = surface_area(&root.bounds).max(f64::MIN_POSITIVE);
        let tree = self.nodes.iter().filter(|node| !node.bounds.is_empty());
        let of = |node: &Node| {
            let steps = if node.first_child == NONE { node.cost as f64 } else { 1.0 };
            surface_area(&node.bounds) / root_area * steps
        };
        tree.map(of).sum()
    }

    /// Takes in new boxes of objects that moved; ids and order stay.
    ///
    /// Costs the moved leaves and their ancestors, not the tree. An object whose new box is not
    /// finite keeps its place but makes its ancestors' boxes infinite, so that it is always tried.
    pub fn refit(&mut self, moved: &[(ObjectId, Aabb)]) {
        let mut stale: Vec<u32> = Vec::with_capacity(moved.len());
        for &(object, bounds) in moved {
            let sound = bounds.min.is_finite() && bounds.max.is_finite() && !bounds.is_empty();
            let everywhere = glam::DVec3::splat(f64::MAX / 4.0);
            self.object_bounds[object.index()] =
                if sound { bounds } else { Aabb::new(-everywhere, everywhere) };
            let leaf = self.leaf_of[object.index()];
            if leaf != NONE && Some(leaf) != self.unbounded {
                stale.push(leaf);
            }
        }
        stale.sort_unstable();
        stale.dedup();
        for &leaf in &stale {
            self.nodes[leaf as usize].bounds = self.leaf_bounds(leaf);
        }
        // Parents stand before children: taking the largest id first sees each parent after both
        // children are current.
        let mut parents: std::collections::BinaryHeap<u32> =
            stale.iter().map(|&leaf| self.nodes[leaf as usize].parent).collect();
        while let Some(at) = parents.pop() {
            if at == NONE || parents.peek() == Some(&at) {
                continue;
            }
            let [left, right] = self.pair(self.nodes[at as usize].first_child);
            let bounds = left.bounds.union(&right.bounds);
            if bounds != self.nodes[at as usize].bounds {
                self.nodes[at as usize].bounds = bounds;
                parents.push(self.nodes[at as usize].parent);
            }
        }
    }
}

impl BoundingHierarchy for Bvh {
    fn root(&self) -> Option<TreeNodeId> {
        // A scene of unbounded objects alone has only the leaf beside the tree.
        (!self.nodes.is_empty() && self.unbounded != Some(0)).then_some(TreeNodeId(0))
    }

    fn generation(&self) -> u64 {
        self.generation
    }

    fn node_limit(&self) -> usize {
        self.nodes.len()
    }

    fn parent(&self, node: TreeNodeId) -> Option<TreeNodeId> {
        let parent = self.nodes[node.index()].parent;
        (parent != NONE).then_some(TreeNodeId(parent))
    }

    fn children(&self, node: TreeNodeId) -> impl Iterator<Item = TreeNodeId> {
        let first = self.nodes[node.index()].first_child;
        let count = if first == NONE { 0 } else { 2 };
        (0..count).map(move |child| TreeNodeId(first + child))
    }

    fn is_leaf(&self, node: TreeNodeId) -> bool {
        self.nodes[node.index()].first_child == NONE
    }

    fn bounds(&self, node: TreeNodeId) -> Aabb {
        self.nodes[node.index()].bounds
    }

    fn cost(&self, node: TreeNodeId) -> u64 {
        self.nodes[node.index()].cost
    }

    fn always_drawn(&self) -> impl Iterator<Item = TreeNodeId> {
        self.unbounded.into_iter().map(TreeNodeId)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Random;
    use glam::DVec3;

    fn random_boxes(count: usize, seed: u64) -> Vec<Aabb> {
        (0..count)
            .map(|i| {
                let mut random = Random::new(seed, i as u64);
                let mut unit = || DVec3::from_array(std::array::from_fn(|_| random.unit()));
                let low = unit() * 100.0 + DVec3::new(4.5e5, 5.2e6, 0.0);
                Aabb::new(low, low + unit() * 3.0)
            })
            .collect()
    }

    fn check(bvh: &Bvh, bounds: &[Aabb]) {
        let mut seen = vec![0; bounds.len()];
        for at in 0..bvh.node_count() {
            let node = TreeNodeId(at as u32);
            let own = bvh.bounds(node);
            let mut cost = 0;
            for child in bvh.children(node) {
                assert!(child > node, "parents stand first");
                assert_eq!(bvh.parent(child), Some(node));
                assert_eq!(own.union(&bvh.bounds(child)), own);
                cost += bvh.cost(child);
            }
            if bvh.is_leaf(node) {
                bvh.objects_of(node).iter().for_each(|object| seen[object.index()] += 1);
            } else {
                assert_eq!(bvh.cost(node), cost);
            }
            for object in bvh.objects_of(node) {
                assert_eq!(own.union(&bounds[object.index()]), own, "content inside");
            }
        }
        assert!(seen.iter().all(|&count| count == 1), "every object once");
    }

    #[test]
    fn every_object_is_in_one_leaf_inside_all_its_ancestors() {
        for (count, leaf) in [(1, 1), (2, 1), (3, 4), (1000, 1), (5000, 4)] {
            let bounds = random_boxes(count, 7);
            let costs: Vec<u64> = (0..count as u64).collect();
            let bvh = Bvh::build(&bounds, &costs, leaf);
            check(&bvh, &bounds);
            assert_eq!(bvh.cost(TreeNodeId(0)), costs.iter().sum::<u64>());
        }
    }

    #[test]
    fn splits_by_area_beat_the_median() {
        let bounds = random_boxes(4000, 3);
        let costs = vec![1; bounds.len()];
        let cost = Bvh::build(&bounds, &costs, 1).sah_cost();
        // The median along the longest axis, which a depth beyond the limit asks for.
        let mut items: Vec<Item> = bounds
            .iter()
            .enumerate()
            .map(|(i, b)| Item { bounds: *b, center: b.center(), cost: 1, object: i as u32 })
            .collect();
        let tree = build::build(&mut items, 1, 1000);
        let mut median = Bvh {
            leaf_of: vec![NONE; bounds.len()],
            object_bounds: bounds.clone(),
            ..Bvh::default()
        };
        median.lay_out(tree, &costs);
        check(&median, &bounds);
        assert!(cost < 0.95 * median.sah_cost(), "{cost} against {}", median.sah_cost());
    }

    #[test]
    fn coincident_and_chained_boxes_give_a_shallow_tree() {
        let one = Aabb::new(DVec3::ZERO, DVec3::ONE);
        let coincident = vec![one; 100_000];
        let bvh = Bvh::build(&coincident, &vec![1; coincident.len()], 1);
        check(&bvh, &coincident);
        assert_eq!(bvh.depth(), 17);
        let chained: Vec<Aabb> = (0..2000)
            .map(|i| {
                let low = DVec3::splat(1.5f64.powi(i % 1000));
                Aabb::new(low, low)
            })
            .collect();
        let bvh = Bvh::build(&chained, &vec![1; chained.len()], 1);
        check(&bvh, &chained);
        assert!(bvh.depth() <= 48 + 12, "depth {}", bvh.depth());
    }

    #[test]
    fn odd_boxes_are_always_drawn_or_left_out() {
        let one = Aabb::new(DVec3::ZERO, DVec3::ONE);
        let nan = Aabb::new(DVec3::NAN, DVec3::NAN);
        let bounds = [one, nan, Aabb::EMPTY, Aabb::new(DVec3::ZERO, DVec3::INFINITY)];
        let bvh = Bvh::build(&bounds, &[1; 4], 1);
        assert_eq!(bvh.unbounded(), [ObjectId(1), ObjectId(3)]);
        assert_eq!(bvh.root(), Some(TreeNodeId(0)));
        assert_eq!(bvh.leaf_of(ObjectId(2)), None);
        let alone = Bvh::build(&[nan], &[1], 1);
        assert_eq!((alone.root(), alone.unbounded().len()), (None, 1));
        assert_eq!(Bvh::build(&[], &[], 1).root(), None);
    }

    #[test]
    fn refit_gives_the_boxes_of_the_new_places() {
        let mut bounds = random_boxes(3000, 5);
        let mut bvh = Bvh::build(&bounds, &vec![1; bounds.len()], 2);
        let mut random = Random::new(1, 1);
        for _ in 0..5 {
            let moved: Vec<(ObjectId, Aabb)> = (0..300)
                .map(|_| {
                    let object = random.below(3000) as usize;
                    let step = DVec3::new(random.bell(), random.bell(), random.bell()) * 20.0;
                    let bounds = &mut bounds[object];
                    *bounds = Aabb::new(bounds.min + step, bounds.max + step);
                    (ObjectId(object as u32), *bounds)
                })
                .collect();
            bvh.refit(&moved);
            for node in (0..bvh.node_count()).map(|at| TreeNodeId(at as u32)) {
                let content = bvh
                    .objects_of(node)
                    .iter()
                    .fold(Aabb::EMPTY, |all, object| all.union(&bounds[object.index()]));
                assert_eq!(bvh.bounds(node), content);
            }
        }
    }
}
