//! Where the points of a scene come from.

use crate::geometry::Aabb;
use crate::ids::NodeId;
use crate::octree::Octree;
use crate::points::Schema;
use crate::store::{NodeReadError, Store, ValueRange};

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
}
