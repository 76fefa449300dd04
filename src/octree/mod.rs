//! The outer octree in memory: cells, per-node point prefixes, and the invariants of both.
//!
//! Each outer node is a cube of the lattice and holds one memory-optimized sequential point tree:
//! its points coarse to fine, so that each level of detail is a prefix ([`LevelIndex`]). A child
//! adds exactly one finer level to what its parent shows. Point data itself is not here; the store
//! reads it by node.

mod level_index;
mod tree;

pub use level_index::LevelIndex;
pub use tree::{Node, Octree, OctreeError, RootCube};
