//! Opening a store. Reading single sections of single nodes is `sections`.
//!
//! Opening reads header, metadata and directory; everything else is read when asked for, by
//! position, from any thread. Nothing is cached here but, if wanted, the coarse nodes that stand
//! beside the directory and come with it in one read.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::octree::Octree;
use crate::store::StoreError;
use crate::store::bytes::StoreBytes;
use crate::store::directory::{self, SectionExtent};
use crate::store::header::{
    FoundHeader, HEADER_BYTES, Header, HeaderError, MAGIC, PartExtent, SLOT_BYTES, VERSION,
};
use crate::store::metadata::Metadata;
use crate::store::places::{check_places, place_in_order, refuse_impossible_counts};

/// An open store.
#[derive(Debug)]
pub struct Store {
    pub(super) path: PathBuf,
    pub(super) bytes: Box<dyn StoreBytes>,
    pub(super) found: FoundHeader,
    pub(super) metadata: Metadata,
    pub(super) octree: Octree,
    pub(super) extents: Vec<SectionExtent>,
    /// Where each node's data starts.
    pub(super) node_offsets: Vec<u64>,
    /// Where the bytes in memory start, and these.
    pub(super) coarse: (u64, Vec<u8>),
    pub(super) bytes_read: AtomicU64,
    pub(super) reads: AtomicU64,
}

/// Whether a file begins as a store does. What cannot be read is for its reader to refuse.
pub fn is_store(path: &Path) -> bool {
    let mut head = [0; MAGIC.len()];
    let begins = File::open(path).and_then(|mut file| file.read_exact(&mut head));
    begins.is_ok() && head == MAGIC
}

impl Store {
    /// Opens a store and checks header, metadata and directory.
    pub fn open(path: &Path) -> Result<Store, StoreError> {
        Store::open_with_coarse(path, 0)
    }

    /// Opens a store and, in the same read as its directory, the coarse nodes beside it, if these
    /// have at most `coarse_bytes`; else, in another read, the first of them, so that directory and
    /// nodes have as many. They stay in memory, so a first picture needs no more reads.
    pub fn open_with_coarse(path: &Path, coarse_bytes: u64) -> Result<Store, StoreError> {
        let io_error =
            |action| move |source| StoreError::Io { action, source, path: path.to_path_buf() };
        let file = File::open(path).map_err(io_error("cannot open"))?;
        if !file.metadata().map_err(io_error("cannot read its size"))?.is_file() {
            let reason = "it is not a file".into();
            return Err(StoreError::NotAStore { reason, path: path.into() });
        }
        Store::open_bytes(Box::new(file), path, coarse_bytes)
    }

    /// Opens a store that is not, or not only, a file; `path` names it in messages.
    pub fn open_bytes(
        bytes: Box<dyn StoreBytes>,
        path: &Path,
        coarse_bytes: u64,
    ) -> Result<Store, StoreError> {
        let io_error =
            |action| move |source| StoreError::Io { action, source, path: path.to_path_buf() };
        let not_a_store =
            |reason: &str| StoreError::NotAStore { reason: reason.into(), path: path.into() };
        let file_bytes = bytes.byte_count().map_err(io_error("cannot read its size"))?;
        if file_bytes < SLOT_BYTES as u64 {
            return Err(not_a_store(&format!("{file_bytes} bytes are too few")));
        }
        let mut head = vec![0; file_bytes.min(HEADER_BYTES as u64) as usize];
        bytes.read_exact_at(&mut head, 0).map_err(io_error("cannot read the header"))?;
        let damaged = |section, part, reason| damaged(section, part, reason, path);
        let whole_header = PartExtent { offset: 0, bytes: head.len() as u64, checksum: 0 };
        let found = Header::find(&head).map_err(|error| match error {
            HeaderError::Magic => not_a_store("it does not begin like one"),
            HeaderError::Version(found) => {
                StoreError::Version { found, supported: VERSION, path: path.into() }
            }
            HeaderError::Damaged(reason) => damaged("header", whole_header, reason),
        })?;
        let header = found.header;
        // Bytes beyond the end are what is left of a change that was not finished. A new store has
        // none, unless a change of it was begun.
        if header.file_bytes > file_bytes || header.version == 1 && header.file_bytes != file_bytes
        {
            let reason = format!("the file has {file_bytes} bytes, it says {}", header.file_bytes);
            return Err(damaged("header", whole_header, reason));
        }
        Store::open_parts(bytes, found, head.len() as u64, path, coarse_bytes)
    }

    /// Opens the store that a header speaks of which is not in the file yet.
    pub(super) fn open_at(
        bytes: Box<dyn StoreBytes>,
        header: Header,
        path: &Path,
    ) -> Result<Store, StoreError> {
        let found = FoundHeader { header, other_is_damaged: false };
        Store::open_parts(bytes, found, 0, path, 0)
    }

    fn open_parts(
        bytes: Box<dyn StoreBytes>,
        found: FoundHeader,
        head_bytes: u64,
        path: &Path,
        coarse_bytes: u64,
    ) -> Result<Store, StoreError> {
        let header = found.header;
        let io_error =
            |action| move |source| StoreError::Io { action, source, path: path.to_path_buf() };
        let damaged = |section, part, reason| damaged(section, part, reason, path);
        // One read: directory and metadata are neighbours, and so are the coarse nodes.
        let (first, last) = match header.version {
            1 => (header.metadata.offset, header.directory.offset + header.directory.bytes),
            _ => {
                let coarse = header.metadata.offset - header.data_offset;
                let coarse = if coarse <= coarse_bytes { coarse } else { 0 };
                let end = header.directory.offset + header.directory.bytes;
                (header.metadata.offset - coarse, end)
            }
        };
        // Lengths were checked against the file's, so this allocates no more than is there.
        let mut front = vec![0; (last - first) as usize];
        bytes.read_exact_at(&mut front, first).map_err(io_error("cannot read"))?;
        let part_bytes = |section, part: PartExtent| {
            let start = (part.offset - first) as usize;
            let bytes = &front[start..start + part.bytes as usize];
            let found = crc32c::crc32c(bytes);
            if found != part.checksum {
                let reason = format!("checksum {found:08x}, header says {:08x}", part.checksum);
                return Err(damaged(section, part, reason));
            }
            Ok(bytes)
        };
        let metadata: Metadata =
            serde_json::from_slice(part_bytes("metadata", header.metadata)?)
                .map_err(|error| damaged("metadata", header.metadata, error.to_string()))?;
        metadata.validate().map_err(|reason| damaged("metadata", header.metadata, reason))?;
        let directory_bytes = part_bytes("directory", header.directory)?;
        let of_directory = |reason| damaged("directory", header.directory, reason);
        let rows = directory::Rows {
            version: header.version,
            depth: metadata.depth,
            section_count: metadata.sections.len(),
        };
        let row = rows.row_bytes();
        if directory_bytes.len() as u64 != u64::from(header.node_count) * row as u64 {
            let reason = format!("{} rows of {row} bytes do not fill it", header.node_count);
            return Err(of_directory(reason));
        }
        let directory::Decoded { nodes, offsets, extents } =
            rows.decode(directory_bytes).map_err(of_directory)?;
        let octree = Octree::new(metadata.lattice(), metadata.root_cube(), metadata.depth, nodes)
            .map_err(|source| StoreError::Octree { source, path: path.into() })?;
        let node_offsets = match header.version {
            1 => place_in_order(&header, &extents, metadata.sections.len()),
            _ => check_places(&header, offsets, &extents, metadata.sections.len()),
        };
        let node_offsets = node_offsets.map_err(of_directory)?;
        refuse_impossible_counts(&header, &octree, &metadata, &extents).map_err(of_directory)?;
        if octree.point_count() != header.point_count || metadata.points != header.point_count {
            let reason = format!(
                "{} points in the directory, {} in the metadata, {} in the header",
                octree.point_count(),
                metadata.points,
                header.point_count
            );
            return Err(of_directory(reason));
        }
        let mut read = head_bytes + front.len() as u64;
        let mut reads = 2;
        let coarse = if header.version == 1 { 0 } else { header.metadata.offset - first };
        let mut coarse_first = first;
        let left_bytes = coarse_bytes.saturating_sub(front.len() as u64);
        front.truncate(coarse as usize);
        front.shrink_to_fit();
        if coarse == 0 && header.version != 1 && left_bytes > 0 {
            // Not all of them fit: the first of them, which are the coarsest, in another read.
            let all_bytes = header.metadata.offset - header.data_offset;
            front = vec![0; left_bytes.min(all_bytes) as usize];
            coarse_first = header.data_offset;
            bytes.read_exact_at(&mut front, coarse_first).map_err(io_error("cannot read"))?;
            read += front.len() as u64;
            reads += u64::from(!front.is_empty());
        }
        Ok(Store {
            path: path.into(),
            bytes,
            found,
            metadata,
            octree,
            extents,
            node_offsets,
            coarse: (coarse_first, front),
            bytes_read: AtomicU64::new(read),
            reads: AtomicU64::new(reads),
        })
    }

    /// Where the store is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Where its parts are.
    pub fn header(&self) -> &Header {
        &self.found.header
    }

    /// What is wrong with the file around the store, if anything: a torn slot of the header, bytes
    /// of a change that was not finished. The store itself is whole.
    pub fn leftovers(&self) -> Vec<String> {
        let mut found = Vec::new();
        if self.found.other_is_damaged {
            found.push("header: the slot that is not in use is damaged".into());
        }
        let end = self.found.header.file_bytes;
        match self.bytes.byte_count() {
            Ok(bytes) if bytes > end => found.push(format!(
                "bytes {end}..{bytes} lie beyond the end: a change of the store was not finished"
            )),
            Ok(_) => {}
            Err(error) => found.push(format!("cannot read its size: {error}")),
        }
        found
    }

    /// Bytes of node data that belong to no node, since a change wrote these nodes anew.
    pub fn unused_bytes(&self) -> u64 {
        let header = &self.found.header;
        match header.version {
            1 => 0,
            _ => header.metadata.offset - HEADER_BYTES as u64 - header.data_bytes,
        }
    }

    /// What it says of itself.
    pub fn metadata(&self) -> &Metadata {
        &self.metadata
    }

    /// Its nodes.
    pub fn octree(&self) -> &Octree {
        &self.octree
    }

    /// Bytes read from the file so far, opening included.
    pub fn bytes_read(&self) -> u64 {
        self.bytes_read.load(Ordering::Relaxed)
    }

    /// Reads from the file so far, opening included.
    pub fn reads(&self) -> u64 {
        self.reads.load(Ordering::Relaxed)
    }

    /// Bytes `range` of the appendix; its checksum is not looked at.
    pub fn read_appendix(&self, offset: u64, bytes: u64) -> Result<Vec<u8>, StoreError> {
        let appendix = self.found.header.appendix;
        if offset.checked_add(bytes).is_none_or(|end| end > appendix.bytes) {
            return Err(StoreError::Section {
                section: "appendix",
                start: appendix.offset,
                end: appendix.offset + appendix.bytes,
                reason: "a source's records reach beyond it".into(),
                path: self.path.clone(),
            });
        }
        let mut out = vec![0; bytes as usize];
        self.bytes.read_exact_at(&mut out, appendix.offset + offset).map_err(|source| {
            StoreError::Io { action: "cannot read", source, path: self.path.clone() }
        })?;
        Ok(out)
    }

    /// Checksum of a byte range of the file, read in pieces.
    pub(crate) fn checksum_of(&self, part: PartExtent) -> io::Result<u32> {
        let mut buffer = vec![0; (part.bytes as usize).min(1 << 20)];
        let (mut at, mut left, mut checksum) = (part.offset, part.bytes, 0);
        while left > 0 {
            let piece = &mut buffer[..(left.min(1 << 20)) as usize];
            self.bytes.read_exact_at(piece, at)?;
            checksum = crc32c::crc32c_append(checksum, piece);
            at += piece.len() as u64;
            left -= piece.len() as u64;
        }
        Ok(checksum)
    }
}

fn damaged(section: &'static str, part: PartExtent, reason: String, path: &Path) -> StoreError {
    let (start, end) = (part.offset, part.offset + part.bytes);
    StoreError::Section { section, start, end, reason, path: path.into() }
}
