//! A node as the loader sees it: its sizes, its states, and where it is read from.

use std::sync::Arc;

use crate::ids::NodeId;
use crate::store::NodeReadError;

/// A node of a scene: which cloud, which node.
pub type SceneNode = (usize, NodeId);

/// Where a node is on its way to the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Residency {
    /// In the store only, and not wanted.
    Absent,
    /// On the list of wishes.
    Queued,
    /// Being read or unpacked.
    Reading,
    /// Its words are in main memory.
    InRam,
    /// On its way to the device; over within the frame that began it.
    Uploading,
    /// Ready to be drawn.
    Resident,
    /// It cannot be read; its parent stands in.
    Failed,
}

/// The words of a node as they are drawn from.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct LoadedNode {
    /// Position words, then one colour word per point.
    pub words: Vec<u32>,
    /// How many of them are positions.
    pub position_words: u32,
}

impl LoadedNode {
    /// Size of the words.
    pub fn bytes(&self) -> u64 {
        4 * self.words.len() as u64
    }
}

/// What is known of a node before it is read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NodeSize {
    /// Bytes to be read for it.
    pub stored_bytes: u64,
    /// Bytes of its words.
    pub word_bytes: u64,
    /// Depth in its octree.
    pub depth: u32,
}

impl NodeSize {
    /// Bytes of main memory that loading it takes at most, while it is under way: what was read,
    /// a column as it is unpacked, and the words.
    pub fn loading_bytes(&self) -> u64 {
        self.stored_bytes.saturating_add(self.word_bytes.saturating_mul(2))
    }
}

/// A node that the frame wants to have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wish {
    /// Which.
    pub node: SceneNode,
    /// Its sizes.
    pub size: NodeSize,
    /// Whether it is wanted for a frame to come, not for this one: it is read when nothing else
    /// is to do and waits in main memory.
    pub ahead: bool,
}

/// Why a node did not come.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// It could not be read or unpacked.
    #[error(transparent)]
    Read(#[from] NodeReadError),
    /// The reader did something that it must not.
    #[error("node {node}: the reader failed: {reason}")]
    Broken {
        /// The node.
        node: NodeId,
        /// What it said.
        reason: String,
    },
}

impl LoadError {
    /// Whether another try may succeed.
    pub fn is_transient(&self) -> bool {
        matches!(self, LoadError::Read(error) if error.is_transient())
    }
}

/// Where nodes are read from. Called from several threads at once.
pub trait NodeReader: Send + Sync {
    /// Reads the stored bytes of a node; may take its time.
    fn fetch(&self, node: SceneNode) -> Result<Box<dyn Fetched>, LoadError>;
}

/// The stored bytes of one node.
pub trait Fetched: Send {
    /// Makes words of them; keeps a core busy and waits for nothing.
    fn unpack(self: Box<Self>) -> Result<LoadedNode, LoadError>;
}

/// Words that are ready need no unpacking.
impl Fetched for LoadedNode {
    fn unpack(self: Box<Self>) -> Result<LoadedNode, LoadError> {
        Ok(*self)
    }
}

impl<R: NodeReader + ?Sized> NodeReader for Arc<R> {
    fn fetch(&self, node: SceneNode) -> Result<Box<dyn Fetched>, LoadError> {
        (**self).fetch(node)
    }
}
