//! Putting a store together: nodes in any order into a staging area, then the file in one pass.
//!
//! The final file is written beside its destination under a temporary name and renamed when it is
//! complete and on disk, so a store is either whole or not there. Node data is laid down coarse
//! to fine whatever the order in which it came, so the bytes do not depend on threads or memory.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use glam::UVec3;

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
pub struct StoreWriter {
    nodes: Vec<StagedNode>,
    temp_dir: PathBuf,
    memory_limit: usize,
    memory_used: usize,
    spill: Option<(BufWriter<File>, u64)>,
}

impl StoreWriter {
    /// A writer that keeps up to `memory_limit` bytes of node data in memory and the rest in an
    /// unnamed file in `temp_dir`, which vanishes with the process.
    pub fn new(temp_dir: &Path, memory_limit: usize) -> Self {
        StoreWriter {
            nodes: Vec::new(),
            temp_dir: temp_dir.into(),
            memory_limit,
            memory_used: 0,
            spill: None,
        }
    }

    /// Bytes that went to the temporary file so far.
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
            self.spill(&bytes).map_err(|source| StoreError::Io {
                action: "cannot write temporary node data",
                source,
                path: self.temp_dir.clone(),
            })?
        };
        self.nodes.push(StagedNode { depth, cell, levels, tight, sections, place });
        Ok(())
    }

    fn spill(&mut self, bytes: &[u8]) -> io::Result<Place> {
        let (file, end) = match &mut self.spill {
            Some(spill) => spill,
            empty => empty.insert((
                BufWriter::with_capacity(1 << 20, tempfile::tempfile_in(&self.temp_dir)?),
                0,
            )),
        };
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

        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let io_error =
            |action| move |source| StoreError::Io { action, source, path: path.to_path_buf() };
        let file = tempfile::Builder::new()
            .prefix(".esker-")
            .suffix(".tmp")
            .tempfile_in(folder)
            .map_err(io_error("cannot create a file beside it"))?;
        let mut out = BufWriter::with_capacity(1 << 20, file);
        let mut write = |out: &mut BufWriter<_>| -> io::Result<()> {
            out.write_all(&header.encode())?;
            out.write_all(&metadata_bytes)?;
            out.write_all(&directory)?;
            self.copy_nodes(out)?;
            header.appendix.checksum = copy_appendix(appendix, out)?;
            out.seek(SeekFrom::Start(0))?;
            out.write_all(&header.encode())?;
            out.flush()
        };
        write(&mut out).map_err(io_error("cannot write"))?;
        let file =
            out.into_inner().map_err(|error| io_error("cannot write")(error.into_error()))?;
        file.as_file().sync_all().map_err(io_error("cannot write"))?;
        make_readable(file.as_file());
        let renamed = if overwrite { file.persist(path) } else { file.persist_noclobber(path) };
        renamed.map_err(|error| io_error("cannot give it its name")(error.error))?;
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
                Place::Memory(bytes) => out.write_all(&std::mem::take(bytes))?,
                Place::File { offset, bytes } => {
                    let file = spill.as_mut().expect("spilled nodes have a spill file");
                    buffer.resize(*bytes as usize, 0);
                    file.seek(SeekFrom::Start(*offset))?;
                    file.read_exact(&mut buffer)?;
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

/// Temporary files are private; a finished store is as readable as any new file.
fn make_readable(file: &File) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // If the file system has no permissions there is nothing to loosen.
        let _ = file.set_permissions(std::fs::Permissions::from_mode(0o644));
    }
    #[cfg(not(unix))]
    let _ = file;
}
