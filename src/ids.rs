//! Typed indices, so that a node number is never mistaken for a count.

use std::fmt;

macro_rules! index_type {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(pub u32);

        impl $name {
            /// The id as an array index.
            pub fn index(self) -> usize {
                self.0 as usize
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{}", self.0)
            }
        }
    };
}

index_type!(
    /// Index of a node in an [`Octree`](crate::octree::Octree): its row in the store's directory.
    ///
    /// Rows stand coarse to fine (by depth, then by Morton order of the cell), so the root is 0.
    NodeId
);
index_type!(
    /// Index of a node of a [`BoundingHierarchy`](crate::hierarchy::BoundingHierarchy), below its
    /// `node_limit`.
    TreeNodeId
);
index_type!(
    /// Index of a shape in a [`Model`](crate::mesh::Model).
    MeshId
);
index_type!(
    /// Index of a material in a [`Model`](crate::mesh::Model).
    MaterialId
);
index_type!(
    /// Index of a picture in a [`Model`](crate::mesh::Model).
    TextureId
);
index_type!(
    /// Index of an object in a [`Model`](crate::mesh::Model).
    ObjectId
);

impl NodeId {
    /// The root of every non-empty octree.
    pub const ROOT: NodeId = NodeId(0);
}
