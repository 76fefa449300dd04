//! A store without the bytes that changes of it left unused.
//!
//! Nodes are copied as they are stored, in the order in which a conversion writes them, into a new
//! file that takes the name of the old one when it is complete.

use std::path::Path;

use crate::geometry::MortonKey;
use crate::ids::NodeId;
use crate::store::metadata::Metadata;
use crate::store::writer::{AppendixPart, EncodedNode, NodeRow, StoreWriter, WriteHook, io_error};
use crate::store::{Store, StoreError};

/// Writes a store anew without its unused bytes. Returns its length.
pub fn compact(path: &Path, before_write: WriteHook) -> Result<u64, StoreError> {
    let store = Store::open(path)?;
    let (octree, metadata): (_, &Metadata) = (store.octree(), store.metadata());
    let mut order: Vec<NodeId> = (0..octree.nodes().len() as u32).map(NodeId).collect();
    order.sort_by_cached_key(|&id| {
        let node = octree.node(id);
        let end =
            (u128::encode(node.cell.to_array()) + 1) << (3 * (metadata.root_bits - node.depth));
        (end, std::cmp::Reverse(node.depth))
    });
    let mut writer = StoreWriter::create(path, before_write)?;
    for id in order {
        let node = octree.node(id);
        let (offset, length) = store.node_extent(id);
        // The directory was checked against the file's length.
        let mut bytes = vec![0; length as usize];
        store.read_at(&mut bytes, offset).map_err(io_error("cannot read", path))?;
        let sections = 0..metadata.sections.len();
        let sections = sections.map(|section| store.section_extent(id, section)).collect();
        let row = NodeRow {
            depth: node.depth,
            cell: node.cell,
            levels: node.levels.clone(),
            tight: [node.tight_min, node.tight_max],
        };
        writer.add(EncodedNode { row, sections, bytes })?;
    }
    let appendix = store.header().appendix;
    let (offset, bytes) = (appendix.offset, appendix.bytes);
    let appendix = [AppendixPart::FileRange { path: path.into(), offset, bytes }];
    writer.finish(metadata, &appendix, true)
}
