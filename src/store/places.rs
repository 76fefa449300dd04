//! Where the nodes of a store stand, checked before anything is read there.

use crate::ids::NodeId;
use crate::octree::Octree;
use crate::store::directory::SectionExtent;
use crate::store::header::{FULL_VERSION, HEADER_BYTES, Header};
use crate::store::metadata::{Metadata, Section, SectionContent, position_shape};

/// Version 1: start of each node's data; an error if the extents do not fill the data part exactly.
pub(super) fn place_in_order(
    header: &Header,
    extents: &[SectionExtent],
    section_count: usize,
) -> Result<Vec<u64>, String> {
    let mut at = header.data_offset;
    let end = header.data_offset + header.data_bytes;
    let mut offsets = Vec::with_capacity(extents.len() / section_count.max(1));
    for (i, node) in extents.chunks_exact(section_count).enumerate() {
        offsets.push(at);
        for extent in node {
            at = at
                .checked_add(extent.bytes)
                .filter(|at| *at <= end)
                .ok_or_else(|| format!("node {i} reaches beyond the node data"))?;
        }
    }
    if at == end { Ok(offsets) } else { Err("the nodes do not fill the node data".into()) }
}

/// The offsets, if no two nodes overlap and all lie within the node data.
pub(super) fn check_places(
    header: &Header,
    offsets: Vec<u64>,
    extents: &[SectionExtent],
    section_count: usize,
) -> Result<Vec<u64>, String> {
    let mut places: Vec<(u64, u64, usize)> = Vec::with_capacity(offsets.len());
    let mut total = 0u64;
    for (i, (&start, node)) in offsets.iter().zip(extents.chunks_exact(section_count)).enumerate() {
        let bytes = node.iter().try_fold(0u64, |sum, extent| sum.checked_add(extent.bytes));
        let end = bytes.and_then(|bytes| start.checked_add(bytes));
        let end = end.filter(|&end| end <= header.metadata.offset && start >= HEADER_BYTES as u64);
        let end = end.ok_or_else(|| format!("node {i} reaches beyond the node data"))?;
        total += end - start;
        places.push((start, end, i));
    }
    places.sort_unstable();
    if let Some(pair) = places.windows(2).find(|pair| pair[0].1 > pair[1].0) {
        return Err(format!("nodes {} and {} overlap", pair[0].2, pair[1].2));
    }
    if total == header.data_bytes { Ok(offsets) } else { Err("the nodes do not add up".into()) }
}

/// Whether a section of no bytes is a column of zeros. Only short elements: as many bytes as their
/// points' positions, which cannot be empty, are no more than memory was taken for anyway.
fn may_be_empty(version: u32, section: &Section) -> bool {
    let is_attribute = matches!(section.content, SectionContent::Attribute(_));
    version > FULL_VERSION && is_attribute && section.shape.bytes() <= MOST_EMPTY_BYTES
}

/// Longest element of a section of no bytes.
const MOST_EMPTY_BYTES: usize = 8;

/// LZ4 expands a byte to at most 255, so a section that claims more than its stored bytes can hold
/// is refused before memory is taken for it.
pub(super) fn refuse_impossible_counts(
    header: &Header,
    octree: &Octree,
    metadata: &Metadata,
    extents: &[SectionExtent],
) -> Result<(), String> {
    for (i, node) in extents.chunks_exact(metadata.sections.len()).enumerate() {
        let id = NodeId(i as u32);
        let points = u64::from(octree.node(id).point_count());
        for (section, extent) in metadata.sections.iter().zip(node) {
            let shape = match section.content {
                SectionContent::Positions => position_shape(octree.local_bits(id)),
                _ => section.shape,
            };
            if extent.bytes | u64::from(extent.checksum) == 0
                && may_be_empty(header.version, section)
            {
                continue;
            }
            if points * shape.bytes() as u64 > extent.bytes.saturating_mul(255) {
                return Err(format!("node {i}: {points} points do not fit {} bytes", extent.bytes));
            }
        }
    }
    Ok(())
}
