//! Where the points of a scene come from.

use crate::geometry::Aabb;
use crate::ids::NodeId;
use crate::octree::Octree;
use crate::points::Schema;
use crate::store::{FetchedNode, NodeReadError, SectionContent, Store, ValueRange};

/// Most bytes of coarse nodes that a store is opened with, for a first picture without another
/// read ([`Store::open_with_coarse`]). Small enough to come in the time of a disk's seek or two.
pub const FIRST_PICTURE_BYTES: u64 = 3 << 20;

/// An octree whose points can be read node by node and column by column, from any thread.
pub trait NodeSource: Send + Sync {
    /// Its nodes.
    fn octree(&self) -> &Octree;
    /// The box of all points; empty without points.
    fn bounds(&self) -> Aabb;
    /// Its columns.
    fn schema(&self) -> &Schema;
    /// Whether [`read_colors`](Self::read_colors) works.
    fn has_colors(&self) -> bool;
    /// Smallest and largest value of each component of an attribute; empty if not known.
    fn value_ranges(&self, attribute: usize) -> &[ValueRange];
    /// Replaces `words` by a node's positions: two words per point (the local Morton code, low
    /// word first) if the node has at most 21 local bits, else local x, y, z.
    fn read_positions(&self, node: NodeId, words: &mut Vec<u32>) -> Result<(), NodeReadError>;
    /// Replaces `words` by a node's colours, RGBA8 with red in the lowest byte.
    fn read_colors(&self, node: NodeId, words: &mut Vec<u32>) -> Result<(), NodeReadError>;
    /// Replaces `bytes` by a node's column of an attribute, little-endian.
    fn read_attribute(
        &self,
        node: NodeId,
        attribute: usize,
        bytes: &mut Vec<u8>,
    ) -> Result<(), NodeReadError>;
    /// Bytes read from disk so far.
    fn bytes_read(&self) -> u64;

    /// Bytes that [`fetch`](Self::fetch) reads; `None` if it reads nothing.
    fn fetch_bytes(&self, _node: NodeId, _columns: &[SectionContent]) -> Option<u64> {
        None
    }
    /// Whether [`fetch`](Self::fetch) finds these columns in memory and waits for no disk.
    fn fetches_from_memory(&self, _node: NodeId, _columns: &[SectionContent]) -> bool {
        false
    }
    /// Reads the stored bytes of some columns of a node, to be unpacked elsewhere; `None` if the
    /// columns can only be read whole.
    fn fetch(
        &self,
        _node: NodeId,
        _columns: &[SectionContent],
    ) -> Result<Option<FetchedNode>, NodeReadError> {
        Ok(None)
    }
    /// As [`read_positions`](Self::read_positions), of what was fetched.
    fn unpack_positions(
        &self,
        fetched: &FetchedNode,
        words: &mut Vec<u32>,
    ) -> Result<(), NodeReadError> {
        self.read_positions(fetched.node(), words)
    }
    /// As [`read_colors`](Self::read_colors), of what was fetched.
    fn unpack_colors(
        &self,
        fetched: &FetchedNode,
        words: &mut Vec<u32>,
    ) -> Result<(), NodeReadError> {
        self.read_colors(fetched.node(), words)
    }
    /// As [`read_attribute`](Self::read_attribute), of what was fetched.
    fn unpack_attribute(
        &self,
        fetched: &FetchedNode,
        attribute: usize,
        bytes: &mut Vec<u8>,
    ) -> Result<(), NodeReadError> {
        self.read_attribute(fetched.node(), attribute, bytes)
    }
}

impl NodeSource for Store {
    fn octree(&self) -> &Octree {
        self.octree()
    }
    fn bounds(&self) -> Aabb {
        self.metadata().bounds()
    }
    fn schema(&self) -> &Schema {
        &self.metadata().schema
    }
    fn has_colors(&self) -> bool {
        self.metadata().color_bits.is_some()
    }
    fn value_ranges(&self, attribute: usize) -> &[ValueRange] {
        self.metadata().attribute_ranges.get(attribute).map_or(&[], Vec::as_slice)
    }
    fn read_positions(&self, node: NodeId, words: &mut Vec<u32>) -> Result<(), NodeReadError> {
        self.read_positions(node, words)
    }
    fn read_colors(&self, node: NodeId, words: &mut Vec<u32>) -> Result<(), NodeReadError> {
        self.read_colors(node, words)
    }
    fn read_attribute(
        &self,
        node: NodeId,
        attribute: usize,
        bytes: &mut Vec<u8>,
    ) -> Result<(), NodeReadError> {
        self.read_attribute(node, attribute, bytes)
    }
    fn bytes_read(&self) -> u64 {
        self.bytes_read()
    }
    fn fetch_bytes(&self, node: NodeId, columns: &[SectionContent]) -> Option<u64> {
        Some(self.fetch_bytes(node, columns))
    }
    fn fetches_from_memory(&self, node: NodeId, columns: &[SectionContent]) -> bool {
        self.fetches_from_memory(node, columns)
    }
    fn fetch(
        &self,
        node: NodeId,
        columns: &[SectionContent],
    ) -> Result<Option<FetchedNode>, NodeReadError> {
        self.fetch(node, columns).map(Some)
    }
    fn unpack_positions(
        &self,
        fetched: &FetchedNode,
        words: &mut Vec<u32>,
    ) -> Result<(), NodeReadError> {
        self.unpack_positions(fetched, words)
    }
    fn unpack_colors(
        &self,
        fetched: &FetchedNode,
        words: &mut Vec<u32>,
    ) -> Result<(), NodeReadError> {
        self.unpack_colors(fetched, words)
    }
    fn unpack_attribute(
        &self,
        fetched: &FetchedNode,
        attribute: usize,
        bytes: &mut Vec<u8>,
    ) -> Result<(), NodeReadError> {
        self.unpack_attribute(fetched, attribute, bytes)
    }
}
