//! Two hierarchies under one root, so that each can hide the other.

use crate::geometry::Aabb;
use crate::hierarchy::BoundingHierarchy;
use crate::ids::TreeNodeId;

/// Where a node of a [`Joined`] tree comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The root of both.
    Root,
    /// A node of the first tree, by its own id.
    First(TreeNodeId),
    /// A node of the second tree, by its own id.
    Second(TreeNodeId),
}

/// A root above the roots of two trees; ids of the first follow the root's, then the second's.
#[derive(Clone, Copy, Debug)]
pub struct Joined<A, B> {
    /// The first tree.
    pub first: A,
    /// The second tree.
    pub second: B,
}

impl<A: BoundingHierarchy, B: BoundingHierarchy> Joined<A, B> {
    /// Which tree a node belongs to.
    pub fn side(&self, node: TreeNodeId) -> Side {
        let first = self.first.node_limit() as u32;
        match node.0 {
            0 => Side::Root,
            at if at <= first => Side::First(TreeNodeId(at - 1)),
            at => Side::Second(TreeNodeId(at - 1 - first)),
        }
    }

    /// The joined id of a node of the first tree.
    pub fn of_first(&self, node: TreeNodeId) -> TreeNodeId {
        TreeNodeId(node.0 + 1)
    }

    /// The joined id of a node of the second tree.
    pub fn of_second(&self, node: TreeNodeId) -> TreeNodeId {
        TreeNodeId(node.0 + 1 + self.first.node_limit() as u32)
    }
}

impl<A: BoundingHierarchy, B: BoundingHierarchy> BoundingHierarchy for Joined<A, B> {
    fn root(&self) -> Option<TreeNodeId> {
        (self.first.root().is_some() || self.second.root().is_some()).then_some(TreeNodeId(0))
    }

    fn node_limit(&self) -> usize {
        1 + self.first.node_limit() + self.second.node_limit()
    }

    fn generation(&self) -> u64 {
        // Where the second tree's ids begin depends on the first.
        let of =
            [self.first.generation(), self.first.node_limit() as u64, self.second.generation()];
        of.into_iter().fold(0, |all, one| (all ^ one).wrapping_mul(0x9e37_79b9_7f4a_7c15))
    }

    fn parent(&self, node: TreeNodeId) -> Option<TreeNodeId> {
        Some(match self.side(node) {
            Side::Root => return None,
            Side::First(node) => {
                self.first.parent(node).map_or(TreeNodeId(0), |parent| self.of_first(parent))
            }
            Side::Second(node) => {
                self.second.parent(node).map_or(TreeNodeId(0), |parent| self.of_second(parent))
            }
        })
    }

    fn children(&self, node: TreeNodeId) -> impl Iterator<Item = TreeNodeId> {
        let side = self.side(node);
        let roots = (side == Side::Root).then(|| {
            let first = self.first.root().map(|root| self.of_first(root));
            first.into_iter().chain(self.second.root().map(|root| self.of_second(root)))
        });
        let first = match side {
            Side::First(node) => Some(self.first.children(node).map(|child| self.of_first(child))),
            _ => None,
        };
        let second = match side {
            Side::Second(node) => {
                Some(self.second.children(node).map(|child| self.of_second(child)))
            }
            _ => None,
        };
        roots
            .into_iter()
            .flatten()
            .chain(first.into_iter().flatten())
            .chain(second.into_iter().flatten())
    }

    fn is_leaf(&self, node: TreeNodeId) -> bool {
        match self.side(node) {
            Side::Root => false,
            Side::First(node) => self.first.is_leaf(node),
            Side::Second(node) => self.second.is_leaf(node),
        }
    }

    fn bounds(&self, node: TreeNodeId) -> Aabb {
        match self.side(node) {
            Side::Root => {
                let of = |root: Option<Aabb>| root.unwrap_or(Aabb::EMPTY);
                of(self.first.root().map(|root| self.first.bounds(root)))
                    .union(&of(self.second.root().map(|root| self.second.bounds(root))))
            }
            Side::First(node) => self.first.bounds(node),
            Side::Second(node) => self.second.bounds(node),
        }
    }

    fn cost(&self, node: TreeNodeId) -> u64 {
        match self.side(node) {
            Side::Root => {
                self.first.root().map_or(0, |root| self.first.cost(root))
                    + self.second.root().map_or(0, |root| self.second.cost(root))
            }
            Side::First(node) => self.first.cost(node),
            Side::Second(node) => self.second.cost(node),
        }
    }

    fn overhang_px(&self, node: TreeNodeId) -> f64 {
        match self.side(node) {
            Side::Root => {
                let first = self.first.root().map_or(0.0, |root| self.first.overhang_px(root));
                first.max(self.second.root().map_or(0.0, |root| self.second.overhang_px(root)))
            }
            Side::First(node) => self.first.overhang_px(node),
            Side::Second(node) => self.second.overhang_px(node),
        }
    }

    fn keeps_whole(&self, node: TreeNodeId) -> bool {
        match self.side(node) {
            Side::Root => false,
            Side::First(node) => self.first.keeps_whole(node),
            Side::Second(node) => self.second.keeps_whole(node),
        }
    }

    fn always_drawn(&self) -> impl Iterator<Item = TreeNodeId> {
        self.first
            .always_drawn()
            .map(|node| self.of_first(node))
            .chain(self.second.always_drawn().map(|node| self.of_second(node)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hierarchy::Bvh;
    use glam::DVec3;

    #[test]
    fn both_trees_hang_under_one_root() {
        let at = |x: f64| Aabb::new(DVec3::splat(x), DVec3::splat(x + 1.0));
        let tree = |from: f64| {
            let bounds: Vec<Aabb> = (0..4).map(|i| at(from + f64::from(i))).collect();
            Bvh::build(&bounds, &[1; 4], 1)
        };
        let joined = Joined { first: tree(0.0), second: tree(100.0) };
        let mut open: Vec<TreeNodeId> = joined.root().into_iter().collect();
        let (mut leaves, mut nodes) = (0, 0);
        while let Some(node) = open.pop() {
            nodes += 1;
            leaves += usize::from(joined.is_leaf(node));
            for child in joined.children(node) {
                assert_eq!(joined.parent(child), Some(node));
                let own = joined.bounds(node);
                assert_eq!(own.union(&joined.bounds(child)), own);
                open.push(child);
            }
        }
        assert_eq!((nodes, leaves, joined.node_limit()), (15, 8, 15));
        assert_eq!(joined.cost(TreeNodeId(0)), 8);
        assert_eq!(joined.children(TreeNodeId(0)).count(), 2);
        let one = Joined { first: Bvh::default(), second: tree(0.0) };
        assert_eq!(one.children(TreeNodeId(0)).count(), 1);
        assert_eq!(Joined { first: Bvh::default(), second: Bvh::default() }.root(), None);
    }
}
