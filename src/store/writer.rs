//! Writing a store: node data in the order in which nodes come, then what tells where it is.
//!
//! The file is written beside its destination under a temporary name and renamed when it is
//! complete and on disk, so a store is either whole or not there. Nodes must come in an order that
//! depends on nothing but the points, and the bytes then do, too. Coarse nodes are held back and
//! written last, beside the directory: one read shows the whole cloud.

use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use glam::UVec3;
use serde::{Deserialize, Serialize};

use crate::geometry::MortonKey;
use crate::octree::LevelIndex;
use crate::store::StoreError;
use crate::store::blocks::SectionWriter;
use crate::store::bytes::StoreBytes;
use crate::store::codec::{CodecScratch, ElementShape};
use crate::store::directory::SectionExtent;
use crate::store::early_sync::EarlySync;
use crate::store::ending::{EndParts, write_end};
use crate::store::header::HEADER_BYTES;
use crate::store::metadata::Metadata;
use crate::store::part_file::{PartFile, part_path};

/// What the directory says of a node, but for where its data is.
#[derive(Clone, Debug)]
pub struct NodeRow {
    /// Depth in the outer octree.
    pub depth: u32,
    /// Cell coordinates at that depth.
    pub cell: UVec3,
    /// Points per level.
    pub levels: LevelIndex,
    /// Smallest and largest local coordinates of its points.
    pub tight: [UVec3; 2],
}

/// A node ready to be written.
#[derive(Debug)]
pub struct EncodedNode {
    /// Its place in the octree and its points per level.
    pub row: NodeRow,
    /// One per section of the store.
    pub sections: Vec<SectionExtent>,
    /// The sections' bytes, one after the other.
    pub bytes: Vec<u8>,
}

/// A node whose place in the file is known, or which is held back.
#[derive(Debug)]
pub(super) struct PlacedNode {
    /// What the directory says of it.
    pub row: NodeRow,
    /// Its sections.
    pub sections: Vec<SectionExtent>,
    /// First byte in the file.
    pub offset: u64,
}

/// A node with its place, as it can be noted down.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PlacedState {
    depth: u32,
    cell: [u32; 3],
    totals: Vec<u32>,
    tight: [[u32; 3]; 2],
    sections: Vec<(u64, u32)>,
    offset: u64,
}

/// How far a writer is.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct WriterState {
    end: u64,
    nodes: Vec<PlacedState>,
    coarse: Vec<PlacedState>,
}

/// Called before every write to disk; its error is the write's.
pub type WriteHook<'a> = &'a (dyn Fn() -> io::Result<()> + Sync);

/// Nodes this deep and no deeper are coarse, if they are small enough to wait in memory.
const COARSE_DEPTH: u32 = 2;
/// Most stored bytes of a coarse node: there are at most 73.
const COARSE_BYTES: u64 = 1 << 18;

/// Whether a node is one of those that stand together at the end.
pub(super) fn is_coarse(depth: u32, bytes: u64) -> bool {
    depth <= COARSE_DEPTH && bytes <= COARSE_BYTES
}

/// Records of a source file that go into the appendix.
#[derive(Debug)]
pub enum AppendixPart {
    /// Bytes at hand.
    Bytes(Vec<u8>),
    /// A range of a file, copied in pieces.
    FileRange {
        /// The file.
        path: PathBuf,
        /// First byte.
        offset: u64,
        /// Length in bytes.
        bytes: u64,
    },
}

/// Writes a store.
pub struct StoreWriter<'a> {
    path: PathBuf,
    part: PartFile,
    before_write: WriteHook<'a>,
    end: u64,
    nodes: Vec<PlacedNode>,
    coarse: Vec<(PlacedNode, Vec<u8>)>,
    early: EarlySync,
}

impl<'a> StoreWriter<'a> {
    /// A writer of the store that is to be `path`.
    pub fn create(path: &Path, before_write: WriteHook<'a>) -> Result<Self, StoreError> {
        let part =
            PartFile::create(path).map_err(io_error("cannot create a file beside it", path))?;
        let (nodes, coarse) = (Vec::new(), Vec::new());
        let (end, early) = (HEADER_BYTES as u64, EarlySync::default());
        Ok(StoreWriter { path: path.into(), part, before_write, end, nodes, coarse, early })
    }

    /// A writer that goes on where another was when it told its state; `coarse` are the bytes of
    /// the nodes that it held back.
    pub fn resume(
        path: &Path,
        before_write: WriteHook<'a>,
        state: WriterState,
        coarse: Vec<Vec<u8>>,
    ) -> Result<Self, StoreError> {
        let part = PartFile::resume(path, state.end)
            .map_err(io_error("cannot go on with the file beside it", path))?;
        let node = |node: PlacedState| -> Result<PlacedNode, StoreError> {
            let levels = LevelIndex::new(node.totals).map_err(|error| {
                io_error("cannot go on from what was saved", path)(io::Error::other(
                    error.to_string(),
                ))
            })?;
            let extent = |(bytes, checksum)| SectionExtent { bytes, checksum };
            Ok(PlacedNode {
                row: NodeRow {
                    depth: node.depth,
                    cell: node.cell.into(),
                    levels,
                    tight: node.tight.map(UVec3::from),
                },
                sections: node.sections.into_iter().map(extent).collect(),
                offset: node.offset,
            })
        };
        let nodes = state.nodes.into_iter().map(node).collect::<Result<_, _>>()?;
        let held = state.coarse.into_iter().map(node).collect::<Result<Vec<_>, _>>()?;
        let coarse = held.into_iter().zip(coarse).collect();
        let (path, end, early) = (path.into(), state.end, EarlySync::default());
        Ok(StoreWriter { path, part, before_write, end, nodes, coarse, early })
    }

    /// Whether what a killed writer left is still there.
    pub fn can_resume(path: &Path, state: &WriterState) -> bool {
        let facts = part_path(path).and_then(|path| std::fs::metadata(path).ok());
        facts.is_some_and(|facts| facts.len() >= state.end)
    }

    /// How far it is, and the bytes of the nodes that it holds back. Everything else is on disk.
    pub fn state(&mut self) -> Result<(WriterState, Vec<&[u8]>), StoreError> {
        (self.before_write)()
            .and_then(|()| self.early.finish())
            .and_then(|()| self.part.file.sync_data())
            .map_err(io_error("cannot write", &self.path))?;
        let placed = |node: &PlacedNode| PlacedState {
            depth: node.row.depth,
            cell: node.row.cell.to_array(),
            totals: node.row.levels.totals().to_vec(),
            tight: node.row.tight.map(|corner| corner.to_array()),
            sections: node.sections.iter().map(|s| (s.bytes, s.checksum)).collect(),
            offset: node.offset,
        };
        let state = WriterState {
            end: self.end,
            nodes: self.nodes.iter().map(placed).collect(),
            coarse: self.coarse.iter().map(|(node, _)| placed(node)).collect(),
        };
        Ok((state, self.coarse.iter().map(|(_, bytes)| bytes.as_slice()).collect()))
    }

    /// Nodes taken so far.
    pub fn node_count(&self) -> u64 {
        (self.nodes.len() + self.coarse.len()) as u64
    }

    /// Takes the next node.
    pub fn add(&mut self, node: EncodedNode) -> Result<(), StoreError> {
        let EncodedNode { row, sections, bytes } = node;
        let offset = self.end;
        let node = PlacedNode { row, sections, offset };
        if is_coarse(node.row.depth, bytes.len() as u64) {
            self.coarse.push((node, bytes.into_boxed_slice().into_vec()));
            return Ok(());
        }
        self.append(&bytes)?;
        self.nodes.push(node);
        Ok(())
    }

    fn append(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        (self.before_write)()
            .and_then(|()| self.part.file.write_all(bytes))
            .and_then(|()| self.early.wrote(&self.part.file, bytes.len() as u64))
            .map_err(io_error("cannot write", &self.path))?;
        self.end += bytes.len() as u64;
        Ok(())
    }

    /// Takes the next node column by column and block by block, so that none of it has to be in
    /// memory as a whole. `block` fills its last argument with elements of a section, given by its
    /// number, from the element given on, so many.
    pub fn add_in_blocks<E: From<StoreError>>(
        &mut self,
        row: NodeRow,
        shapes: &[ElementShape],
        mut block: impl FnMut(usize, usize, usize, &mut Vec<u8>) -> Result<(), E>,
    ) -> Result<(), E> {
        let points = row.levels.point_count() as usize;
        let offset = self.end;
        let mut sections = Vec::with_capacity(shapes.len());
        let (mut raw, mut stored) = (Vec::new(), Vec::new());
        let mut scratch = CodecScratch::default();
        for (i, &shape) in shapes.iter().enumerate() {
            let mut section = SectionWriter::new(shape, points);
            let table_start = self.end;
            stored.clear();
            stored.resize(section.table_bytes(), 0);
            for first in (0..points).step_by(shape.block_elements()) {
                let count = shape.block_elements().min(points - first);
                block(i, first, count, &mut raw)?;
                section.block(&raw, &mut scratch, &mut stored);
                self.append(&stored)?;
                stored.clear();
            }
            let (table, extent) = section.finish();
            if !table.is_empty() {
                self.put_back(table_start, &table)?;
            }
            sections.push(extent);
        }
        let node = PlacedNode { row, sections, offset };
        if is_coarse(node.row.depth, node.bytes()) {
            self.take_back(node)?;
        } else {
            self.nodes.push(node);
        }
        Ok(())
    }

    /// Holds back a node that was written last.
    fn take_back(&mut self, node: PlacedNode) -> Result<(), StoreError> {
        let mut bytes = vec![0; node.bytes() as usize];
        let mut file = &self.part.file;
        file.read_exact_at(&mut bytes, node.offset)
            .and_then(|()| file.set_len(node.offset))
            .and_then(|()| file.seek(SeekFrom::Start(node.offset)))
            .map_err(io_error("cannot read back", &self.path))?;
        self.end = node.offset;
        self.coarse.push((node, bytes));
        Ok(())
    }

    /// Writes over bytes that are there already.
    fn put_back(&mut self, offset: u64, bytes: &[u8]) -> Result<(), StoreError> {
        let mut file = &self.part.file;
        (self.before_write)()
            .and_then(|()| file.seek(SeekFrom::Start(offset)))
            .and_then(|_| file.write_all(bytes))
            .and_then(|()| file.seek(SeekFrom::Start(self.end)))
            .map_err(io_error("cannot write", &self.path))?;
        Ok(())
    }

    /// Completes the store and gives it its name; an existing file is replaced only if `overwrite`.
    /// Returns its length in bytes.
    pub fn finish(
        mut self,
        metadata: &Metadata,
        appendix: &[AppendixPart],
        overwrite: bool,
    ) -> Result<u64, StoreError> {
        let coarse_start = self.place_coarse()?;
        let data_bytes = self.end - HEADER_BYTES as u64;
        let parts = EndParts { metadata, appendix, coarse_start, data_bytes, generation: 1 };
        let before_write = self.before_write;
        self.nodes.sort_by_cached_key(PlacedNode::order);
        let nodes: Vec<&PlacedNode> = self.nodes.iter().collect();
        let header = write_end(&self.part.file, self.end, &nodes, &parts, before_write)
            .map_err(io_error("cannot write", &self.path))?;
        let mut early = std::mem::take(&mut self.early);
        let mut complete = || -> io::Result<()> {
            before_write()?;
            let mut file = &self.part.file;
            file.seek(SeekFrom::Start(0))?;
            file.write_all(&header.encode())?;
            before_write()?;
            early.finish()?;
            file.sync_all()
        };
        complete().map_err(io_error("cannot write", &self.path))?;
        self.part
            .rename(&self.path, overwrite)
            .map_err(io_error("cannot give it its name", &self.path))?;
        Ok(header.file_bytes)
    }

    /// Writes the nodes that were held back, coarse to fine; returns where they start.
    fn place_coarse(&mut self) -> Result<u64, StoreError> {
        let start = self.end;
        let mut coarse = std::mem::take(&mut self.coarse);
        coarse.sort_by_cached_key(|(node, _)| node.order());
        for (mut node, bytes) in coarse {
            node.offset = self.end;
            self.append(&bytes)?;
            self.nodes.push(node);
        }
        Ok(start)
    }
}

impl PlacedNode {
    /// The order of rows: by depth, then Morton order of the cell.
    fn order(&self) -> (u32, u128) {
        (self.row.depth, u128::encode(self.row.cell.to_array()))
    }

    /// Stored bytes.
    pub fn bytes(&self) -> u64 {
        self.sections.iter().map(|section| section.bytes).sum()
    }
}

pub(super) fn io_error(action: &'static str, path: &Path) -> impl Fn(io::Error) -> StoreError {
    move |source| StoreError::Io { action, source, path: path.to_path_buf() }
}
