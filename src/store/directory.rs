//! The node directory: one row per node, coarse to fine, of equal size within a store.
//!
//! Layout: `FORMAT.md`, "Directory". Parents and places in the file are not stored: children stand
//! in the rows that their parents count off, and node data follows in row order without gaps.

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

/// Bytes before the level totals: depth, child mask, two zero bytes, cell, tight box.
const FIXED_BYTES: usize = 4 + 12 + 24;

/// Size of one row.
pub fn row_bytes(depth: u32, section_count: usize) -> usize {
    FIXED_BYTES + 4 * (depth as usize + 1) + 12 * section_count
}

/// Appends one row.
pub fn encode_row(
    depth: u32,
    cell: UVec3,
    child_mask: u8,
    tight: [UVec3; 2],
    totals: &[u32],
    sections: &[SectionExtent],
    out: &mut Vec<u8>,
) {
    out.extend_from_slice(&[depth as u8, child_mask, 0, 0]);
    for vector in [cell, tight[0], tight[1]] {
        for value in vector.to_array() {
            out.extend_from_slice(&value.to_le_bytes());
        }
    }
    for total in totals {
        out.extend_from_slice(&total.to_le_bytes());
    }
    for section in sections {
        out.extend_from_slice(&section.bytes.to_le_bytes());
        out.extend_from_slice(&section.checksum.to_le_bytes());
    }
}

/// All rows of a directory, whose length must be a whole number of rows.
///
/// Returns the nodes and, section by section within each node, the extents. Whether the nodes
/// form an octree is for `Octree::new` to say.
pub fn decode(
    bytes: &[u8],
    depth: u32,
    section_count: usize,
) -> Result<(Vec<Node>, Vec<SectionExtent>), String> {
    let row = row_bytes(depth, section_count);
    let count = bytes.len() / row;
    let mut nodes: Vec<Node> = Vec::with_capacity(count);
    let mut extents = Vec::with_capacity(count * section_count);
    let mut next_child = 1u64;
    let mut parents = vec![None; count];
    for (i, row) in bytes.chunks_exact(row).enumerate() {
        let u32_at = |at: usize| {
            u32::from_le_bytes(row[at..at + 4].try_into().expect("the slice has 4 bytes"))
        };
        let vector_at = |at: usize| UVec3::new(u32_at(at), u32_at(at + 4), u32_at(at + 8));
        if row[2] != 0 || row[3] != 0 {
            return Err(format!("row {i}: reserved bytes are not zero"));
        }
        let (node_depth, child_mask) = (u32::from(row[0]), row[1]);
        let totals = (0..=depth as usize).map(|level| u32_at(FIXED_BYTES + 4 * level)).collect();
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
        let at = FIXED_BYTES + 4 * (depth as usize + 1);
        for section in 0..section_count {
            let at = at + 12 * section;
            let bytes = u64::from(u32_at(at)) | u64::from(u32_at(at + 4)) << 32;
            extents.push(SectionExtent { bytes, checksum: u32_at(at + 8) });
        }
    }
    Ok((nodes, extents))
}
