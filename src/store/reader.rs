//! Opening a store and reading single sections of single nodes.
//!
//! Opening reads header, metadata and directory; everything else is read when asked for, by
//! position, from any thread. Nothing is cached here but, if wanted, the coarse nodes that stand
//! beside the directory and come with it in one read.

use std::cell::RefCell;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::ids::NodeId;
use crate::octree::Octree;
use crate::store::blocks::BlockTable;
use crate::store::bytes::StoreBytes;
use crate::store::codec::{self, CodecScratch, ElementShape};
use crate::store::directory::{self, SectionExtent};
use crate::store::fetched::FetchedNode;
use crate::store::header::{
    FoundHeader, HEADER_BYTES, Header, HeaderError, MAGIC, PartExtent, SLOT_BYTES, VERSION,
};
use crate::store::metadata::{Metadata, SectionContent, position_shape};
use crate::store::{NodeReadError, StoreError};

/// An open store.
#[derive(Debug)]
pub struct Store {
    path: PathBuf,
    bytes: Box<dyn StoreBytes>,
    found: FoundHeader,
    metadata: Metadata,
    octree: Octree,
    extents: Vec<SectionExtent>,
    /// Where each node's data starts.
    node_offsets: Vec<u64>,
    /// Where the bytes in memory start, and these.
    coarse: (u64, Vec<u8>),
    bytes_read: AtomicU64,
    reads: AtomicU64,
}

/// Whether a file begins as a store does. What cannot be read is for its reader to refuse.
pub fn is_store(path: &Path) -> bool {
    let mut head = [0; MAGIC.len()];
    let begins = File::open(path).and_then(|mut file| file.read_exact(&mut head));
    begins.is_ok() && head == MAGIC
}

thread_local! {
    /// Stored bytes and decoding memory of this thread, used again by every read.
    static SCRATCH: RefCell<(Vec<u8>, CodecScratch)> = RefCell::default();
}

impl Store {
    /// Opens a store and checks header, metadata and directory.
    pub fn open(path: &Path) -> Result<Store, StoreError> {
        Store::open_with_coarse(path, 0)
    }

    /// Opens a store and, in the same read as its directory, the coarse nodes beside it, if these
    /// have at most `coarse_bytes`. They stay in memory, so a first picture needs no more reads.
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
        refuse_impossible_counts(&octree, &metadata, &extents).map_err(of_directory)?;
        if octree.point_count() != header.point_count || metadata.points != header.point_count {
            let reason = format!(
                "{} points in the directory, {} in the metadata, {} in the header",
                octree.point_count(),
                metadata.points,
                header.point_count
            );
            return Err(of_directory(reason));
        }
        let read = head_bytes + front.len() as u64;
        let coarse = if header.version == 1 { 0 } else { header.metadata.offset - first };
        front.truncate(coarse as usize);
        front.shrink_to_fit();
        Ok(Store {
            path: path.into(),
            bytes,
            found,
            metadata,
            octree,
            extents,
            node_offsets,
            coarse: (first, front),
            bytes_read: AtomicU64::new(read),
            reads: AtomicU64::new(2),
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

    /// Where a node's data is: its first byte, and how many there are.
    pub fn node_extent(&self, node: NodeId) -> (u64, u64) {
        let sections = self.metadata.sections.len();
        let extents = &self.extents[node.index() * sections..(node.index() + 1) * sections];
        (self.node_offsets[node.index()], extents.iter().map(|extent| extent.bytes).sum())
    }

    /// Stored bytes of one section of one node.
    pub fn section_extent(&self, node: NodeId, section: usize) -> SectionExtent {
        self.extents[node.index() * self.metadata.sections.len() + section]
    }

    /// Replaces `words` by the positions of a node: for local coordinates of at most
    /// [`NARROW_BITS`](crate::store::NARROW_BITS) bits two words a point, the low and high half of
    /// the local Morton code; else three, local x, y, z.
    pub fn read_positions(&self, node: NodeId, words: &mut Vec<u32>) -> Result<(), NodeReadError> {
        self.read_words(None, node, SectionContent::Positions, u32::MAX, words)
    }

    /// Replaces `words` by the positions of a node's first points, reading only the blocks that
    /// hold them; see [`read_positions`](Self::read_positions).
    pub fn read_first_positions(
        &self,
        node: NodeId,
        points: u32,
        words: &mut Vec<u32>,
    ) -> Result<(), NodeReadError> {
        self.read_words(None, node, SectionContent::Positions, points, words)
    }

    /// Replaces `words` by the colours of a node, RGBA8 with red in the lowest byte.
    pub fn read_colors(&self, node: NodeId, words: &mut Vec<u32>) -> Result<(), NodeReadError> {
        self.read_words(None, node, SectionContent::Color, u32::MAX, words)
    }

    /// Replaces `words` by the colours of a node's first points, reading only the blocks that hold
    /// them.
    pub fn read_first_colors(
        &self,
        node: NodeId,
        points: u32,
        words: &mut Vec<u32>,
    ) -> Result<(), NodeReadError> {
        self.read_words(None, node, SectionContent::Color, points, words)
    }

    /// Replaces `bytes` by an attribute's little-endian column; `attribute` counts in the schema.
    pub fn read_attribute(
        &self,
        node: NodeId,
        attribute: usize,
        bytes: &mut Vec<u8>,
    ) -> Result<(), NodeReadError> {
        self.read_column(None, node, attribute, bytes)
    }

    /// Reads an attribute's column, from what was fetched if anything was.
    pub(super) fn read_column(
        &self,
        fetched: Option<&FetchedNode>,
        node: NodeId,
        attribute: usize,
        bytes: &mut Vec<u8>,
    ) -> Result<(), NodeReadError> {
        let content = SectionContent::Attribute(attribute as u32);
        if let Some((section, _)) = self.metadata.find_section(content) {
            return self.read_whole(fetched, node, section, bytes);
        }
        if self.metadata.schema.attributes.get(attribute).is_none() {
            return Err(NodeReadError::NoSuchSection { section: format!("attribute {attribute}") });
        }
        self.read_full_color(fetched, node, bytes)
    }

    /// Replaces `bytes` by a section of a node, decoded.
    pub fn read_section(
        &self,
        node: NodeId,
        section: usize,
        bytes: &mut Vec<u8>,
    ) -> Result<(), NodeReadError> {
        self.read_whole(None, node, section, bytes)
    }

    fn read_whole(
        &self,
        fetched: Option<&FetchedNode>,
        node: NodeId,
        section: usize,
        bytes: &mut Vec<u8>,
    ) -> Result<(), NodeReadError> {
        bytes.clear();
        bytes.resize(self.raw_bytes(node, section), 0);
        self.read_section_into(fetched, node, section, bytes)
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

    fn shape(&self, node: NodeId, section: usize) -> ElementShape {
        let section = &self.metadata.sections[section];
        match section.content {
            SectionContent::Positions => position_shape(self.octree.local_bits(node)),
            _ => section.shape,
        }
    }

    fn raw_bytes(&self, node: NodeId, section: usize) -> usize {
        self.octree.node(node).point_count() as usize * self.shape(node, section).bytes()
    }

    pub(super) fn read_words(
        &self,
        fetched: Option<&FetchedNode>,
        node: NodeId,
        content: SectionContent,
        points: u32,
        words: &mut Vec<u32>,
    ) -> Result<(), NodeReadError> {
        let (section, _) = self.metadata.find_section(content).ok_or_else(|| {
            NodeReadError::NoSuchSection { section: format!("{content:?}").to_lowercase() }
        })?;
        words.clear();
        let points = points.min(self.octree.node(node).point_count()) as usize;
        words.resize(points * self.shape(node, section).bytes() / 4, 0);
        self.read_section_into(fetched, node, section, bytemuck::cast_slice_mut(words))?;
        if cfg!(target_endian = "big") {
            words.iter_mut().for_each(|word| *word = u32::from_le(*word));
        }
        Ok(())
    }

    /// The record's `rgb` attribute, put together from the colour sections.
    fn read_full_color(
        &self,
        fetched: Option<&FetchedNode>,
        node: NodeId,
        bytes: &mut Vec<u8>,
    ) -> Result<(), NodeReadError> {
        let mut colors = Vec::new();
        self.read_words(fetched, node, SectionContent::Color, u32::MAX, &mut colors)?;
        let mut low = Vec::new();
        if let Some((section, _)) = self.metadata.find_section(SectionContent::ColorLow) {
            self.read_whole(fetched, node, section, &mut low)?;
        }
        bytes.clear();
        bytes.reserve(6 * colors.len());
        for (i, word) in colors.iter().enumerate() {
            let [r, g, b, _] = word.to_le_bytes();
            for (channel, value) in [r, g, b].into_iter().enumerate() {
                let full = match low.get(3 * i + channel) {
                    Some(low) => [low ^ value, value],
                    None => [value, 0],
                };
                bytes.extend_from_slice(&full);
            }
        }
        Ok(())
    }

    /// Reads the first elements of a section, as many as `raw` has room for.
    fn read_section_into(
        &self,
        fetched: Option<&FetchedNode>,
        node: NodeId,
        section: usize,
        raw: &mut [u8],
    ) -> Result<(), NodeReadError> {
        let first = node.index() * self.metadata.sections.len();
        let before: u64 = self.extents[first..first + section].iter().map(|e| e.bytes).sum();
        let extent = self.extents[first + section];
        let start = self.node_offsets[node.index()] + before;
        let end = start + extent.bytes;
        let level = self.octree.node(node).depth;
        let name = || self.metadata.section_name(section);
        let undecodable =
            |reason| NodeReadError::Decode { node, level, section: name(), reason, start, end };
        let shape = self.shape(node, section);
        let elements = self.octree.node(node).point_count() as usize;
        let whole_bytes = elements * shape.bytes();
        let is_divided = self.found.header.version > 1 && shape.block_count(elements) > 1;
        let table_bytes = if is_divided { shape.table_bytes(elements) } else { 0 };
        // Stored blocks are never longer than their contents (see `codec`), which bounds this.
        if extent.bytes > (whole_bytes + table_bytes) as u64 || extent.bytes < table_bytes as u64 {
            return Err(undecodable(format!(
                "{} bytes are stored for {whole_bytes}",
                extent.bytes
            )));
        }
        let read = |stored: &mut Vec<u8>, from: u64, to: u64| {
            stored.resize((to - from) as usize, 0);
            if fetched.is_some_and(|fetched| fetched.copy(stored, start + from)) {
                return Ok(());
            }
            self.read_at(stored, start + from).map_err(|source| NodeReadError::Io {
                node,
                level,
                section: name(),
                source,
                start,
                end,
            })
        };
        let verify = |bytes: &[u8]| {
            let (found, expected) = (crc32c::crc32c(bytes), extent.checksum);
            if found == expected {
                return Ok(());
            }
            let section = name();
            Err(NodeReadError::Checksum { node, level, section, found, expected, start, end })
        };
        SCRATCH.with_borrow_mut(|(stored, scratch)| {
            if !is_divided {
                read(stored, 0, extent.bytes)?;
                verify(stored)?;
                if raw.len() == whole_bytes {
                    return codec::decode(shape, stored, scratch, raw).map_err(undecodable);
                }
                let mut whole = vec![0; whole_bytes];
                codec::decode(shape, stored, scratch, &mut whole).map_err(undecodable)?;
                raw.copy_from_slice(&whole[..raw.len()]);
                return Ok(());
            }
            let blocks = (raw.len() / shape.bytes()).div_ceil(shape.block_elements());
            let is_whole = raw.len() == whole_bytes;
            read(stored, 0, if is_whole { extent.bytes } else { table_bytes as u64 })?;
            verify(&stored[..table_bytes])?;
            let table =
                BlockTable::decode(&stored[..table_bytes], extent.bytes).map_err(undecodable)?;
            if is_whole {
                let blocks = &stored[table_bytes..];
                return table.decode_blocks(shape, blocks, scratch, raw).map_err(undecodable);
            }
            read(stored, table_bytes as u64, table.end(blocks))?;
            let rounded = (blocks * shape.block_elements()).min(elements) * shape.bytes();
            let mut whole = vec![0; rounded];
            table.decode_blocks(shape, stored, scratch, &mut whole).map_err(undecodable)?;
            raw.copy_from_slice(&whole[..raw.len()]);
            Ok(())
        })
    }

    /// Whether a range of the file is in memory.
    pub(super) fn is_in_memory(&self, start: u64, end: u64) -> bool {
        let (first, coarse) = &self.coarse;
        start >= *first && end - first <= coarse.len() as u64
    }

    /// Reads from memory what is there, the rest from the file.
    pub(super) fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let (first, coarse) = &self.coarse;
        if let Some(at) = offset.checked_sub(*first)
            && let Ok(at) = usize::try_from(at)
            && let Some(bytes) = at.checked_add(buffer.len()).and_then(|end| coarse.get(at..end))
        {
            buffer.copy_from_slice(bytes);
            return Ok(());
        }
        self.bytes.read_exact_at(buffer, offset)?;
        self.bytes_read.fetch_add(buffer.len() as u64, Ordering::Relaxed);
        self.reads.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }
}

fn damaged(section: &'static str, part: PartExtent, reason: String, path: &Path) -> StoreError {
    let (start, end) = (part.offset, part.offset + part.bytes);
    StoreError::Section { section, start, end, reason, path: path.into() }
}

/// Version 1: start of each node's data; an error if the extents do not fill the data part exactly.
fn place_in_order(
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
fn check_places(
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

/// LZ4 expands a byte to at most 255, so a section that claims more than its stored bytes can hold
/// is refused before memory is taken for it.
fn refuse_impossible_counts(
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
            if points * shape.bytes() as u64 > extent.bytes.saturating_mul(255) {
                return Err(format!("node {i}: {points} points do not fit {} bytes", extent.bytes));
            }
        }
    }
    Ok(())
}
