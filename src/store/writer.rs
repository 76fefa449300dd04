//! Putting a store together: nodes in any order into a staging area, then the file in one pass.
//!
//! The final file is written beside its destination under a temporary name and renamed when it is
//! complete and on disk, so a store is either whole or not there. Node data is laid down coarse
//! to fine whatever the order in which it came, so the bytes do not depend on threads or memory.

use std::collections::HashMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use glam::UVec3;
use serde::{Deserialize, Serialize};

use crate::geometry::MortonKey;
use crate::octree::LevelIndex;
use crate::store::StoreError;
use crate::store::directory::{self, SectionExtent};
use crate::store::header::{HEADER_BYTES, Header, PartExtent};
use crate::store::metadata::Metadata;

/// A node ready to be written: its place in the octree and its encoded sections.
#[derive(Debug)]
pub struct EncodedNode {
    /// Depth in the outer octree.
    pub depth: u32,
    /// Cell coordinates at that depth.
    pub cell: UVec3,
    /// Points per level.
    pub levels: LevelIndex,
    /// Smallest and largest local coordinates of its points.
    pub tight: [UVec3; 2],
    /// One per section of the store.
    pub sections: Vec<SectionExtent>,
    /// The sections' bytes, one after the other.
    pub bytes: Vec<u8>,
}

/// Where a node's bytes wait.
enum Place {
    Memory(Vec<u8>),
    File { offset: u64, bytes: u64 },
}

struct StagedNode {
    depth: u32,
    cell: UVec3,
    levels: LevelIndex,
    tight: [UVec3; 2],
    sections: Vec<SectionExtent>,
    place: Place,
}

/// A node in the scratch file, as it can be noted down.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StagedState {
    depth: u32,
    cell: [u32; 3],
    totals: Vec<u32>,
    tight: [[u32; 3]; 2],
    sections: Vec<(u64, u32)>,
    offset: u64,
    bytes: u64,
}

/// Where a writer puts node data that does not fit memory.
pub trait Scratch: Send + Sync {
    /// The file for node data; asked for once.
    fn file(&self) -> io::Result<File>;
    /// Called before every write; an error is the write's.
    fn before_write(&self) -> io::Result<()>;
    /// What to name in messages.
    fn path(&self) -> &Path;
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

/// Collects nodes until the store can be written.
pub struct StoreWriter<'a> {
    nodes: Vec<StagedNode>,
    scratch: &'a dyn Scratch,
    memory_limit: usize,
    memory_used: usize,
    spill: Option<(BufWriter<File>, u64)>,
}

impl<'a> StoreWriter<'a> {
    /// A writer that keeps up to `memory_limit` bytes of node data in memory and the rest in the
    /// scratch file.
    pub fn new(scratch: &'a dyn Scratch, memory_limit: usize) -> Self {
        StoreWriter { nodes: Vec::new(), scratch, memory_limit, memory_used: 0, spill: None }
    }

    /// A writer that goes on where another was when it told its state.
    pub fn resume(
        scratch: &'a dyn Scratch,
        memory_limit: usize,
        staged: Vec<StagedState>,
    ) -> Result<Self, StoreError> {
        let mut writer = StoreWriter::new(scratch, memory_limit);
        let mut end = 0;
        for node in staged {
            end = end.max(node.offset + node.bytes);
            let levels = LevelIndex::new(node.totals).map_err(|error| StoreError::Io {
                action: "cannot go on from what was saved",
                source: io::Error::other(error.to_string()),
                path: scratch.path().into(),
            })?;
            let extent = |(bytes, checksum)| SectionExtent { bytes, checksum };
            writer.nodes.push(StagedNode {
                depth: node.depth,
                cell: node.cell.into(),
                levels,
                tight: node.tight.map(UVec3::from),
                sections: node.sections.into_iter().map(extent).collect(),
                place: Place::File { offset: node.offset, bytes: node.bytes },
            });
        }
        if end > 0 {
            let open = || -> io::Result<File> {
                let mut file = scratch.file()?;
                file.set_len(end)?;
                file.seek(SeekFrom::Start(end))?;
                Ok(file)
            };
            let file = open().map_err(|source| writer.scratch_error(source))?;
            writer.spill = Some((BufWriter::with_capacity(1 << 20, file), end));
        }
        Ok(writer)
    }

    /// Brings all nodes to the scratch file, on disk, and tells where they are.
    pub fn state(&mut self) -> Result<Vec<StagedState>, StoreError> {
        for i in 0..self.nodes.len() {
            if let Place::Memory(bytes) = &mut self.nodes[i].place {
                let bytes = std::mem::take(bytes);
                let place = self.spill(&bytes).map_err(|source| self.scratch_error(source))?;
                self.nodes[i].place = place;
            }
        }
        self.memory_used = 0;
        let scratch = self.scratch;
        if let Some((file, _)) = &mut self.spill {
            let flushed = scratch
                .before_write()
                .and_then(|()| file.flush())
                .and_then(|()| file.get_ref().sync_data());
            flushed.map_err(|source| self.scratch_error(source))?;
        }
        let state = self.nodes.iter().map(|node| {
            let Place::File { offset, bytes } = node.place else {
                unreachable!("all nodes were brought to the file")
            };
            StagedState {
                depth: node.depth,
                cell: node.cell.to_array(),
                totals: node.levels.totals().to_vec(),
                tight: node.tight.map(|corner| corner.to_array()),
                sections: node.sections.iter().map(|s| (s.bytes, s.checksum)).collect(),
                offset,
                bytes,
            }
        });
        Ok(state.collect())
    }

    fn scratch_error(&self, source: io::Error) -> StoreError {
        let path = self.scratch.path().into();
        StoreError::Io { action: "cannot write temporary node data", source, path }
    }

    /// Nodes taken so far.
    pub fn node_count(&self) -> u64 {
        self.nodes.len() as u64
    }

    /// Bytes that went to the scratch file so far.
    pub fn spilled_bytes(&self) -> u64 {
        self.spill.as_ref().map_or(0, |(_, bytes)| *bytes)
    }

    /// Takes a node, in any order.
    pub fn add(&mut self, node: EncodedNode) -> Result<(), StoreError> {
        let EncodedNode { depth, cell, levels, tight, sections, bytes } = node;
        let place = if self.memory_used + bytes.len() <= self.memory_limit {
            self.memory_used += bytes.len();
            Place::Memory(bytes.into_boxed_slice().into_vec())
        } else {
            self.spill(&bytes).map_err(|source| self.scratch_error(source))?
        };
        self.nodes.push(StagedNode { depth, cell, levels, tight, sections, place });
        Ok(())
    }

    fn spill(&mut self, bytes: &[u8]) -> io::Result<Place> {
        let (file, end) = match &mut self.spill {
            Some(spill) => spill,
            empty => {
                let file = self.scratch.file()?;
                file.set_len(0)?;
                empty.insert((BufWriter::with_capacity(1 << 20, file), 0))
            }
        };
        self.scratch.before_write()?;
        file.write_all(bytes)?;
        let place = Place::File { offset: *end, bytes: bytes.len() as u64 };
        *end += bytes.len() as u64;
        Ok(place)
    }

    /// Writes the store under `path`; an existing file is replaced only if `overwrite`.
    /// Returns its length in bytes.
    pub fn finish(
        mut self,
        path: &Path,
        metadata: &Metadata,
        appendix: &[AppendixPart],
        overwrite: bool,
    ) -> Result<u64, StoreError> {
        self.nodes.sort_by_cached_key(|node| (node.depth, u128::encode(node.cell.to_array())));
        let directory = self.directory_bytes();
        let metadata_bytes =
            serde_json::to_vec(metadata).expect("metadata has no maps with foreign keys");
        let data_bytes: u64 =
            self.nodes.iter().flat_map(|node| &node.sections).map(|section| section.bytes).sum();
        let appendix_bytes = appendix
            .iter()
            .map(|part| match part {
                AppendixPart::Bytes(bytes) => bytes.len() as u64,
                AppendixPart::FileRange { bytes, .. } => *bytes,
            })
            .sum::<u64>();
        let part = |offset: u64, bytes: &[u8]| PartExtent {
            offset,
            bytes: bytes.len() as u64,
            checksum: crc32c::crc32c(bytes),
        };
        let metadata_part = part(HEADER_BYTES as u64, &metadata_bytes);
        let directory_part = part(metadata_part.offset + metadata_part.bytes, &directory);
        let data_offset = directory_part.offset + directory_part.bytes;
        let appendix_offset = data_offset + data_bytes;
        let mut header = Header {
            file_bytes: appendix_offset + appendix_bytes,
            metadata: metadata_part,
            directory: directory_part,
            node_count: self.nodes.len() as u32,
            appendix: PartExtent { offset: appendix_offset, bytes: appendix_bytes, checksum: 0 },
            data_offset,
            data_bytes,
            point_count: metadata.points,
        };

        let io_error =
            |action| move |source| StoreError::Io { action, source, path: path.to_path_buf() };
        let part = PartFile::create(path).map_err(io_error("cannot create a file beside it"))?;
        let mut out = BufWriter::with_capacity(1 << 20, &part.file);
        let scratch = self.scratch;
        let mut write = |out: &mut BufWriter<&File>| -> io::Result<()> {
            scratch.before_write()?;
            out.write_all(&header.encode())?;
            out.write_all(&metadata_bytes)?;
            out.write_all(&directory)?;
            self.copy_nodes(out)?;
            header.appendix.checksum = copy_appendix(appendix, out)?;
            scratch.before_write()?;
            out.seek(SeekFrom::Start(0))?;
            out.write_all(&header.encode())?;
            out.flush()?;
            scratch.before_write()?;
            part.file.sync_all()
        };
        write(&mut out).map_err(io_error("cannot write"))?;
        drop(out);
        part.rename(path, overwrite).map_err(io_error("cannot give it its name"))?;
        Ok(header.file_bytes)
    }

    fn directory_bytes(&self) -> Vec<u8> {
        let index: HashMap<(u32, UVec3), usize> =
            self.nodes.iter().enumerate().map(|(i, node)| ((node.depth, node.cell), i)).collect();
        let mut masks = vec![0u8; self.nodes.len()];
        for node in self.nodes.iter().filter(|node| node.depth > 0) {
            let parent = index
                .get(&(node.depth - 1, node.cell / 2))
                .expect("a node's parent is written with it");
            let octant = node.cell.x & 1 | (node.cell.y & 1) << 1 | (node.cell.z & 1) << 2;
            masks[*parent] |= 1 << octant;
        }
        let mut rows = Vec::new();
        for (node, mask) in self.nodes.iter().zip(masks) {
            let totals = node.levels.totals();
            directory::encode_row(
                node.depth,
                node.cell,
                mask,
                node.tight,
                totals,
                &node.sections,
                &mut rows,
            );
        }
        rows
    }

    fn copy_nodes(&mut self, out: &mut impl Write) -> io::Result<()> {
        let mut spill = match self.spill.take() {
            Some((file, _)) => Some(file.into_inner().map_err(|error| error.into_error())?),
            None => None,
        };
        let mut buffer = Vec::new();
        for node in &mut self.nodes {
            match &mut node.place {
                Place::Memory(bytes) => {
                    self.scratch.before_write()?;
                    out.write_all(&std::mem::take(bytes))?;
                }
                Place::File { offset, bytes } => {
                    let file = spill.as_mut().expect("spilled nodes have a spill file");
                    buffer.resize(*bytes as usize, 0);
                    file.seek(SeekFrom::Start(*offset))?;
                    file.read_exact(&mut buffer)?;
                    self.scratch.before_write()?;
                    out.write_all(&buffer)?;
                }
            }
        }
        Ok(())
    }
}

/// Copies all parts and returns the checksum of what was written.
fn copy_appendix(parts: &[AppendixPart], out: &mut impl Write) -> io::Result<u32> {
    let mut checksum = 0;
    let mut put = |bytes: &[u8]| {
        checksum = crc32c::crc32c_append(checksum, bytes);
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
    Ok(checksum)
}

/// Locks a file, or says that another process has it.
pub fn lock_at_once(file: &File) -> io::Result<()> {
    file.try_lock().map_err(|error| match error {
        TryLockError::WouldBlock => {
            io::Error::new(io::ErrorKind::ResourceBusy, "another process is using it")
        }
        TryLockError::Error(error) => error,
    })
}

/// Removes what a killed run may have left beside a destination.
pub fn remove_dead_part(destination: &Path) {
    if let Some(path) = part_path(destination) {
        // If someone is writing it, it is not dead.
        let _ = PartFile::remove_dead(&path);
    }
}

fn part_path(destination: &Path) -> Option<PathBuf> {
    let name = destination.file_name()?.to_string_lossy();
    Some(destination.with_file_name(format!(".{name}.part")))
}

/// A file being written beside its destination. Its name follows from the destination's, so that
/// what a killed run left is found and written over; a lock keeps two runs apart.
struct PartFile {
    file: File,
    path: PathBuf,
}

impl PartFile {
    fn create(destination: &Path) -> io::Result<Self> {
        let path = part_path(destination).ok_or(io::ErrorKind::InvalidInput)?;
        // What a killed run left may be a second name of the destination: never written to.
        PartFile::remove_dead(&path)?;
        let file = OpenOptions::new().create_new(true).read(true).write(true).open(&path)?;
        file.lock()?;
        Ok(PartFile { file, path })
    }

    /// Removes a file that no living process is writing.
    fn remove_dead(path: &Path) -> io::Result<()> {
        let file = match OpenOptions::new().write(true).open(path) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            Err(error) => return Err(error),
        };
        lock_at_once(&file)?;
        std::fs::remove_file(path)
    }

    /// Gives the file its name, which nothing else may have unless `overwrite`.
    fn rename(self, destination: &Path, overwrite: bool) -> io::Result<()> {
        if overwrite {
            return std::fs::rename(&self.path, destination);
        }
        match std::fs::hard_link(&self.path, destination) {
            Ok(()) => Ok(()),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Err(error),
            // Not every file system has links.
            Err(_) if destination.exists() => Err(io::ErrorKind::AlreadyExists.into()),
            Err(_) => std::fs::rename(&self.path, destination),
        }
    }
}

impl Drop for PartFile {
    fn drop(&mut self) {
        // It is gone already if it got its name by renaming.
        let _ = std::fs::remove_file(&self.path);
    }
}
