//! What stands behind the node data: metadata, directory and appendix.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};

use glam::UVec3;

use crate::store::directory::{Row, Rows};
use crate::store::header::{FULL_VERSION, Header, PartExtent, VERSION};
use crate::store::metadata::Metadata;
use crate::store::writer::{AppendixPart, NodeRow, PlacedNode, WriteHook};

/// What stands behind the node data.
pub(super) struct EndParts<'a> {
    /// What the store says of itself.
    pub metadata: &'a Metadata,
    /// Records of the source files.
    pub appendix: &'a [AppendixPart],
    /// Where the coarse nodes start.
    pub coarse_start: u64,
    /// Bytes of all nodes.
    pub data_bytes: u64,
    /// Of the header.
    pub generation: u32,
}

/// Writes metadata, directory and appendix from `start` on, where the file's cursor is; nodes stand
/// in the order of rows. Returns the header that makes them the store's.
pub(super) fn write_end(
    mut file: &File,
    start: u64,
    nodes: &[&PlacedNode],
    parts: &EndParts,
    before_write: WriteHook,
) -> io::Result<Header> {
    let metadata_bytes = serde_json::to_vec(parts.metadata)?;
    // The oldest that says what the store holds, so that the oldest program reads it.
    let has_empty = nodes.iter().any(|node| node.sections.iter().any(|s| s.bytes == 0));
    let version = if has_empty { VERSION } else { FULL_VERSION };
    let directory = directory_bytes(nodes, parts.metadata, version);
    let part = |offset: u64, bytes: &[u8]| PartExtent {
        offset,
        bytes: bytes.len() as u64,
        checksum: crc32c::crc32c(bytes),
    };
    let metadata = part(start, &metadata_bytes);
    let directory_part = part(metadata.offset + metadata.bytes, &directory);
    let appendix_offset = directory_part.offset + directory_part.bytes;
    before_write()?;
    file.write_all(&metadata_bytes)?;
    file.write_all(&directory)?;
    let (appendix_bytes, checksum) = copy_appendix(parts.appendix, &mut file)?;
    Ok(Header {
        version,
        generation: parts.generation,
        file_bytes: appendix_offset + appendix_bytes,
        metadata,
        directory: directory_part,
        node_count: nodes.len() as u32,
        appendix: PartExtent { offset: appendix_offset, bytes: appendix_bytes, checksum },
        data_offset: parts.coarse_start,
        data_bytes: parts.data_bytes,
        point_count: parts.metadata.points,
    })
}

/// All rows; nodes stand in their order.
fn directory_bytes(nodes: &[&PlacedNode], metadata: &Metadata, version: u32) -> Vec<u8> {
    let place = |node: &PlacedNode| (node.row.depth, node.row.cell);
    let index: HashMap<(u32, UVec3), usize> =
        nodes.iter().enumerate().map(|(i, &node)| (place(node), i)).collect();
    let mut masks = vec![0u8; nodes.len()];
    for NodeRow { depth, cell, .. } in nodes.iter().map(|node| &node.row).filter(|r| r.depth > 0) {
        let parent = index.get(&(depth - 1, cell / 2)).expect("a node's parent is written with it");
        masks[*parent] |= 1 << (cell.x & 1 | (cell.y & 1) << 1 | (cell.z & 1) << 2);
    }
    let section_count = metadata.sections.len();
    let shape = Rows { version, depth: metadata.depth, section_count };
    let mut rows = Vec::with_capacity(nodes.len() * shape.row_bytes());
    for (&PlacedNode { row, sections, offset }, child_mask) in nodes.iter().zip(masks) {
        let row = Row {
            depth: row.depth,
            cell: row.cell,
            child_mask,
            tight: row.tight,
            offset: *offset,
            totals: row.levels.totals(),
            sections,
        };
        shape.encode(row, &mut rows);
    }
    rows
}

/// Copies all parts; returns the length and the checksum of what was written.
fn copy_appendix(parts: &[AppendixPart], out: &mut impl Write) -> io::Result<(u64, u32)> {
    let (mut written, mut checksum) = (0, 0);
    let mut put = |bytes: &[u8]| {
        checksum = crc32c::crc32c_append(checksum, bytes);
        written += bytes.len() as u64;
        out.write_all(bytes)
    };
    for part in parts {
        match part {
            AppendixPart::Bytes(bytes) => put(bytes)?,
            AppendixPart::FileRange { path, offset, bytes } => {
                let mut file = File::open(path)?;
                file.seek(SeekFrom::Start(*offset))?;
                let mut left = *bytes;
                let mut buffer = vec![0; left.min(1 << 20) as usize];
                while left > 0 {
                    let piece = &mut buffer[..left.min(1 << 20) as usize];
                    file.read_exact(piece)?;
                    put(piece)?;
                    left -= piece.len() as u64;
                }
            }
        }
    }
    Ok((written, checksum))
}
