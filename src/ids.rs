//! Typed indices, so that a node number is never mistaken for a count.

use std::fmt;

/// Index of a node in an [`Octree`](crate::octree::Octree): its row in the store's directory.
///
/// Rows stand coarse to fine (by depth, then by Morton order of the cell), so the root is 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(pub u32);

impl NodeId {
    /// The root of every non-empty octree.
    pub const ROOT: NodeId = NodeId(0);

    /// The id as an array index.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

impl fmt::Display for NodeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}
