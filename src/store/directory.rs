//! The node directory: one row per node, coarse to fine, of equal size within a store.
//!
//! Layout: `FORMAT.md`, "Directory". Parents are not stored: children stand in the rows that their
//! parents count off. In version 1 nor are places in the file: node data follows in row order.

use glam::UVec3;

use crate::ids::NodeId;
use crate::octree::{LevelIndex, Node};

/// Stored size and checksum of one section of one node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SectionExtent {
    /// Bytes in the file.
    pub bytes: u64,
    /// CRC-32C of those bytes.
    pub checksum: u32,
}

/// Bytes before the node's place: depth, child mask, two zero bytes, cell, tight box.
const FIXED_BYTES: usize = 4 + 12 + 24;

/// The shape of a directory's rows.
#[derive(Clone, Copy, Debug)]
pub struct Rows {
    /// Version of the format.
    pub version: u32,
    /// Levels within a node beyond its coarsest.
    pub depth: u32,
    /// Sections of a node.
    pub section_count: usize,
}

/// What stands in one row.
#[derive(Clone, Copy, Debug)]
pub struct Row<'a> {
    /// Depth in the outer octree.
    pub depth: u32,
    /// Cell at that depth.
    pub cell: UVec3,
    /// Which children there are.
    pub child_mask: u8,
    /// Smallest and largest local coordinates.
    pub tight: [UVec3; 2],
    /// Where the node's data starts; not in version 1.
    pub offset: u64,
    /// Points up to each level.
    pub totals: &'a [u32],
    /// One per section.
    pub sections: &'a [SectionExtent],
}

/// All rows.
pub struct Decoded {
    /// The nodes; whether they form an octree is for `Octree::new` to say.
    pub nodes: Vec<Node>,
    /// Where their data starts; empty in version 1.
    pub offsets: Vec<u64>,
    /// Section by section within each node.
    pub extents: Vec<SectionExtent>,
}

impl Rows {
    /// Size of one row.
    pub fn row_bytes(&self) -> usize {
        self.totals_at() + 4 * (self.depth as usize + 1) + 12 * self.section_count
    }

    fn totals_at(&self) -> usize {
        FIXED_BYTES + if self.version == 1 { 0 } else { 8 }
    }

    /// Appends one row.
    pub fn encode(&self, row: Row, out: &mut Vec<u8>) {
        out.extend_from_slice(&[row.depth as u8, row.child_mask, 0, 0]);
        for vector in [row.cell, row.tight[0], row.tight[1]] {
            for value in vector.to_array() {
                out.extend_from_slice(&value.to_le_bytes());
            }
        }
        if self.version > 1 {
            out.extend_from_slice(&row.offset.to_le_bytes());
        }
        for total in row.totals {
            out.extend_from_slice(&total.to_le_bytes());
        }
        for section in row.sections {
            out.extend_from_slice(&section.bytes.to_le_bytes());
            out.extend_from_slice(&section.checksum.to_le_bytes());
        }
    }

    /// All rows of a directory, whose length must be a whole number of rows.
    pub fn decode(&self, bytes: &[u8]) -> Result<Decoded, String> {
        let Rows { depth, section_count, .. } = *self;
        let row = self.row_bytes();
        let totals_at = self.totals_at();
        let count = bytes.len() / row;
        let mut nodes: Vec<Node> = Vec::with_capacity(count);
        let mut offsets = Vec::new();
        let mut extents = Vec::with_capacity(count * section_count);
        let mut next_child = 1u64;
        let mut parents = vec![None; count];
        for (i, row) in bytes.chunks_exact(row).enumerate() {
            let u32_at = |at: usize| {
                u32::from_le_bytes(row[at..at + 4].try_into().expect("the slice has 4 bytes"))
            };
            let u64_at = |at: usize| u64::from(u32_at(at)) | u64::from(u32_at(at + 4)) << 32;
            let vector_at = |at: usize| UVec3::new(u32_at(at), u32_at(at + 4), u32_at(at + 8));
            if row[2] != 0 || row[3] != 0 {
                return Err(format!("row {i}: reserved bytes are not zero"));
            }
            let (node_depth, child_mask) = (u32::from(row[0]), row[1]);
            let totals = (0..=depth as usize).map(|level| u32_at(totals_at + 4 * level)).collect();
            let levels = LevelIndex::new(totals).map_err(|error| format!("row {i}: {error}"))?;
            let first_child = u32::try_from(next_child).map_err(|_| "too many rows".to_string())?;
            for child in next_child..next_child + u64::from(child_mask.count_ones()) {
                match parents.get_mut(child as usize) {
                    Some(parent) => *parent = Some(NodeId(i as u32)),
                    None => return Err(format!("row {i}: it has children beyond the last row")),
                }
            }
            next_child += u64::from(child_mask.count_ones());
            nodes.push(Node {
                depth: node_depth,
                cell: vector_at(4),
                parent: parents[i],
                first_child: NodeId(first_child),
                child_mask,
                levels,
                tight_min: vector_at(16),
                tight_max: vector_at(28),
            });
            if self.version > 1 {
                offsets.push(u64_at(FIXED_BYTES));
            }
            let at = totals_at + 4 * (depth as usize + 1);
            for section in 0..section_count {
                let at = at + 12 * section;
                extents.push(SectionExtent { bytes: u64_at(at), checksum: u32_at(at + 8) });
            }
        }
        Ok(Decoded { nodes, offsets, extents })
    }
}
