//! Whole records out of a node's columns: the inverse of taking them apart.

use glam::I64Vec3;

use crate::geometry::MortonKey;
use crate::ids::NodeId;
use crate::store::{NARROW_BITS, NodeReadError, Store};

/// Why a node's points cannot be given as records of the input's layout.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordError {
    /// A section could not be read.
    #[error(transparent)]
    Read(#[from] NodeReadError),
    /// Points of several inputs, too far from the first one's origin for 32-bit coordinates.
    #[error("node {node}: coordinate {coordinate} does not fit a 32-bit record")]
    Coordinate {
        /// The node.
        node: NodeId,
        /// The coordinate on the store's lattice.
        coordinate: i64,
    },
}

impl Store {
    /// Replaces `records` by the records of a node's points, in stored order, as they stood in the
    /// input (with coordinates on the lattice of the first input).
    pub fn read_records(&self, node: NodeId, records: &mut Vec<u8>) -> Result<(), RecordError> {
        let schema = &self.metadata().schema;
        let record_bytes = schema.record_bytes as usize;
        let count = self.octree().node(node).point_count() as usize;
        records.clear();
        records.resize(count * record_bytes, 0);

        let mut words = Vec::new();
        self.read_positions(node, &mut words)?;
        let is_narrow = self.octree().local_bits(node) <= NARROW_BITS;
        let cell_min = self.octree().cell_min(node);
        let points = words.chunks_exact(if is_narrow { 2 } else { 3 });
        for (record, words) in records.chunks_exact_mut(record_bytes).zip(points) {
            let local = match *words {
                [low, high] => (u64::from(low) | u64::from(high) << 32).decode(),
                _ => [words[0], words[1], words[2]],
            };
            let position = cell_min + I64Vec3::from_array(local.map(i64::from));
            for (axis, coordinate) in position.to_array().into_iter().enumerate() {
                let coordinate = i32::try_from(coordinate)
                    .map_err(|_| RecordError::Coordinate { node, coordinate })?;
                record[4 * axis..4 * axis + 4].copy_from_slice(&coordinate.to_le_bytes());
            }
        }

        Ok(self.fill_attributes(node, records)?)
    }

    /// Replaces `records` by the records of a node's points, in stored order, without coordinates.
    pub fn read_attribute_records(
        &self,
        node: NodeId,
        records: &mut Vec<u8>,
    ) -> Result<(), NodeReadError> {
        let count = self.octree().node(node).point_count() as usize;
        records.clear();
        records.resize(count * self.metadata().schema.record_bytes as usize, 0);
        self.fill_attributes(node, records)
    }

    fn fill_attributes(&self, node: NodeId, records: &mut [u8]) -> Result<(), NodeReadError> {
        let schema = &self.metadata().schema;
        let record_bytes = schema.record_bytes as usize;
        let mut column = Vec::new();
        for (i, attribute) in schema.attributes.iter().enumerate() {
            self.read_attribute(node, i, &mut column)?;
            let (start, bytes) = (attribute.record_offset as usize, attribute.bytes());
            let values = column.chunks_exact(bytes);
            for (record, value) in records.chunks_exact_mut(record_bytes).zip(values) {
                record[start..start + bytes].copy_from_slice(value);
            }
        }
        Ok(())
    }
}
