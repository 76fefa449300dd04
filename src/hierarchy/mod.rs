//! Trees of boxes: what culling walks, whether the boxes hold triangles or points.
//!
//! [`BoundingHierarchy`] is all that culling knows of a scene. [`Bvh`] is the tree over objects,
//! built by the surface area heuristic and refitted when objects move; [`Joined`] puts two
//! hierarchies under one root; [`Forest`] is what culling sees of octrees; [`tight_cut`] replaces a box by smaller ones around the same content.
//!
//! Boxes are f64 in the world. Not here: which nodes are visible (`visibility`).

mod build;
mod bvh;
mod forest;
mod joined;
mod tight;

pub use bvh::Bvh;
pub use forest::{ChosenNodes, Forest, ForestTree, SubtreeBoxes};
pub use joined::{Joined, Side};
pub use tight::{TightCut, TightForm, tight_cut};

use crate::geometry::Aabb;
use crate::ids::TreeNodeId;

/// A tree of boxes whose leaves hold what is drawn.
///
/// Ids are stable while the tree is not rebuilt. The box of a node encloses the boxes of its
/// children and all that its subtree draws. Only leaves draw; an inner node that owns something
/// itself, as octree nodes do, shows it as one more leaf below.
pub trait BoundingHierarchy {
    /// The node that everything hangs from; `None` in an empty scene.
    fn root(&self) -> Option<TreeNodeId>;

    /// Ids are below this; arrays of per-node state have this length.
    fn node_limit(&self) -> usize;

    /// The node above; `None` for the root.
    fn parent(&self, node: TreeNodeId) -> Option<TreeNodeId>;

    /// The nodes below; none for a leaf.
    fn children(&self, node: TreeNodeId) -> impl Iterator<Item = TreeNodeId>;

    /// Whether the node has no children and draws something itself.
    fn is_leaf(&self, node: TreeNodeId) -> bool;

    /// The box around all that the subtree draws.
    fn bounds(&self, node: TreeNodeId) -> Aabb;

    /// Work of drawing the subtree: triangles, or points.
    fn cost(&self, node: TreeNodeId) -> u64;

    /// How far, in pixels, something drawn may stick out of its box on screen: half the largest
    /// splat of points, 0 for triangles.
    fn overhang_px(&self, node: TreeNodeId) -> f64 {
        let _ = node;
        0.0
    }

    /// A number that changes when the tree is built anew, after which ids mean other nodes; what was
    /// learned of them is then forgotten.
    fn generation(&self) -> u64 {
        0
    }

    /// Whether the boxes of the children are not to stand for the node's: they are hardly smaller,
    /// or not the same in each frame.
    fn keeps_whole(&self, node: TreeNodeId) -> bool {
        let _ = node;
        false
    }

    /// Leaves outside the tree that are drawn in every frame, because no box is known for them.
    fn always_drawn(&self) -> impl Iterator<Item = TreeNodeId> {
        std::iter::empty()
    }
}

impl<T: BoundingHierarchy> BoundingHierarchy for &T {
    fn root(&self) -> Option<TreeNodeId> {
        (**self).root()
    }

    fn node_limit(&self) -> usize {
        (**self).node_limit()
    }

    fn parent(&self, node: TreeNodeId) -> Option<TreeNodeId> {
        (**self).parent(node)
    }

    fn children(&self, node: TreeNodeId) -> impl Iterator<Item = TreeNodeId> {
        (**self).children(node)
    }

    fn is_leaf(&self, node: TreeNodeId) -> bool {
        (**self).is_leaf(node)
    }

    fn bounds(&self, node: TreeNodeId) -> Aabb {
        (**self).bounds(node)
    }

    fn cost(&self, node: TreeNodeId) -> u64 {
        (**self).cost(node)
    }

    fn overhang_px(&self, node: TreeNodeId) -> f64 {
        (**self).overhang_px(node)
    }

    fn keeps_whole(&self, node: TreeNodeId) -> bool {
        (**self).keeps_whole(node)
    }

    fn always_drawn(&self) -> impl Iterator<Item = TreeNodeId> {
        (**self).always_drawn()
    }
}

/// Surface area of a box, 0 for an empty one.
pub fn surface_area(bounds: &Aabb) -> f64 {
    if bounds.is_empty() {
        return 0.0;
    }
    let size = bounds.size();
    2.0 * (size.x * size.y + size.y * size.z + size.z * size.x)
}
