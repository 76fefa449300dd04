//! Changing a store in place: new nodes behind its end, then a header that speaks of them.
//!
//! Until the new header is on disk the file is the store that it was, for whoever opens it or has
//! it open. What a change that was not finished left is cut off, here and by the next change.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use glam::UVec3;

use crate::geometry::MortonKey;
use crate::ids::NodeId;
use crate::store::bytes::StoreBytes;
use crate::store::directory::SectionExtent;
use crate::store::ending::{EndParts, write_end};
use crate::store::header::{HEADER_BYTES, Header};
use crate::store::metadata::Metadata;
use crate::store::part_file::lock_at_once;
use crate::store::writer::{
    AppendixPart, EncodedNode, NodeRow, PlacedNode, WriteHook, io_error, is_coarse,
};
use crate::store::{Store, StoreError};

/// A change of a store.
pub struct StoreAppender<'a> {
    path: PathBuf,
    file: File,
    before_write: WriteHook<'a>,
    old: Header,
    end: u64,
    /// By depth and code of the cell.
    nodes: BTreeMap<(u32, u128), PlacedNode>,
    is_finished: bool,
}

impl<'a> StoreAppender<'a> {
    /// Begins a change of a store, which no one else may be changing.
    pub fn open(path: &Path, before_write: WriteHook<'a>) -> Result<(Self, Store), StoreError> {
        let open = || -> io::Result<File> {
            let file = OpenOptions::new().read(true).write(true).open(path)?;
            lock_at_once(&file)?;
            Ok(file)
        };
        let mut file = open().map_err(io_error("cannot be changed", path))?;
        let store = Store::open(path)?;
        let old = *store.header();
        if old.version == 1 {
            let source = io::Error::new(
                io::ErrorKind::Unsupported,
                "it has version 1 of the format; convert its scans anew",
            );
            return Err(io_error("cannot be changed", path)(source));
        }
        file.set_len(old.file_bytes)
            .and_then(|()| file.seek(SeekFrom::End(0)))
            .map_err(io_error("cannot be changed", path))?;
        let placed = (0..store.octree().nodes().len() as u32).map(NodeId).map(|id| {
            let node = store.octree().node(id);
            let sections = 0..store.metadata().sections.len();
            let placed = PlacedNode {
                row: NodeRow {
                    depth: node.depth,
                    cell: node.cell,
                    levels: node.levels.clone(),
                    tight: [node.tight_min, node.tight_max],
                },
                sections: sections.map(|section| store.section_extent(id, section)).collect(),
                offset: store.node_extent(id).0,
            };
            (key(node.depth, node.cell), placed)
        });
        let nodes = placed.collect();
        let appender = StoreAppender {
            path: path.into(),
            file,
            before_write,
            old,
            end: old.file_bytes,
            nodes,
            is_finished: false,
        };
        Ok((appender, store))
    }

    /// Gives all nodes that are there so many sections; those that they lack are zeros.
    pub fn widen(&mut self, sections: usize) {
        let empty = SectionExtent { bytes: 0, checksum: 0 };
        self.nodes.values_mut().for_each(|node| node.sections.resize(sections, empty));
    }

    /// Takes a new node, or one in place of the node of that cell.
    pub fn put(&mut self, node: EncodedNode) -> Result<(), StoreError> {
        let EncodedNode { row, sections, bytes } = node;
        let offset = self.end;
        self.append(&bytes)?;
        self.nodes.insert(key(row.depth, row.cell), PlacedNode { row, sections, offset });
        Ok(())
    }

    fn append(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        (self.before_write)()
            .and_then(|()| self.file.write_all(bytes))
            .map_err(io_error("cannot write", &self.path))?;
        self.end += bytes.len() as u64;
        Ok(())
    }

    /// The store as it would be if the change ended here; the file still is what it was.
    pub fn preview(&mut self, metadata: &Metadata) -> Result<Store, StoreError> {
        let header = self.write_parts(metadata, &[])?;
        self.end = header.file_bytes;
        let file = self.file.try_clone().map_err(io_error("cannot be read", &self.path))?;
        Store::open_at(Box::new(file), header, &self.path)
    }

    /// Makes the change; returns the new header.
    pub fn finish(
        mut self,
        metadata: &Metadata,
        appendix: &[AppendixPart],
    ) -> Result<Header, StoreError> {
        let header = self.write_parts(metadata, appendix)?;
        let file = &mut self.file;
        let hook = self.before_write;
        let mut complete = || -> io::Result<()> {
            hook()?;
            file.sync_all()?;
            hook()?;
            file.seek(SeekFrom::Start(header.slot_offset()))?;
            file.write_all(&header.encode())?;
            file.sync_all()
        };
        complete().map_err(io_error("cannot write", &self.path))?;
        self.is_finished = true;
        Ok(header)
    }

    /// Coarse nodes, metadata, directory and appendix at the end.
    fn write_parts(
        &mut self,
        metadata: &Metadata,
        appendix: &[AppendixPart],
    ) -> Result<Header, StoreError> {
        let coarse_start = self.end;
        let coarse: Vec<(u32, u128)> = self
            .nodes
            .iter()
            .filter(|(_, node)| is_coarse(node.row.depth, node.bytes()))
            .map(|(key, _)| *key)
            .collect();
        for key in coarse {
            let node = &self.nodes[&key];
            let mut bytes = vec![0; node.bytes() as usize];
            self.file
                .read_exact_at(&mut bytes, node.offset)
                .map_err(io_error("cannot read back", &self.path))?;
            let offset = self.end;
            self.append(&bytes)?;
            self.nodes.get_mut(&key).expect("it was listed").offset = offset;
        }
        let nodes: Vec<&PlacedNode> = self.nodes.values().collect();
        let parts = EndParts {
            metadata,
            appendix,
            coarse_start,
            data_bytes: nodes.iter().map(|node| node.bytes()).sum(),
            generation: self.old.generation + 1,
        };
        write_end(&self.file, self.end, &nodes, &parts, self.before_write)
            .map_err(io_error("cannot write", &self.path))
    }

    /// The old store's appendix, to be kept.
    pub fn old_appendix(&self) -> AppendixPart {
        let (offset, bytes) = (self.old.appendix.offset, self.old.appendix.bytes);
        AppendixPart::FileRange { path: self.path.clone(), offset, bytes }
    }
}

impl Drop for StoreAppender<'_> {
    fn drop(&mut self) {
        if !self.is_finished {
            // If that fails, the next change does it.
            let _ = self.file.set_len(self.old.file_bytes.max(HEADER_BYTES as u64));
        }
    }
}

fn key(depth: u32, cell: UVec3) -> (u32, u128) {
    (depth, u128::encode(cell.to_array()))
}
