//! Opening a store and reading single sections of single nodes.
//!
//! Opening reads header, metadata and directory; everything else is read when asked for, by
//! position, from any thread. Nothing is cached here.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::ids::NodeId;
use crate::octree::Octree;
use crate::store::codec::{self, CodecScratch, ElementShape};
use crate::store::directory::{self, SectionExtent};
use crate::store::header::{HEADER_BYTES, Header, HeaderError, MAGIC, PartExtent, VERSION};
use crate::store::metadata::{Metadata, SectionContent, position_shape};
use crate::store::{NodeReadError, StoreError};

/// An open store.
#[derive(Debug)]
pub struct Store {
    path: PathBuf,
    file: File,
    header: Header,
    metadata: Metadata,
    octree: Octree,
    extents: Vec<SectionExtent>,
    /// Where each node's data starts.
    node_offsets: Vec<u64>,
    bytes_read: AtomicU64,
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
        let io_error =
            |action| move |source| StoreError::Io { action, source, path: path.to_path_buf() };
        let not_a_store =
            |reason: &str| StoreError::NotAStore { reason: reason.into(), path: path.into() };
        let file = File::open(path).map_err(io_error("cannot open"))?;
        let file_info = file.metadata().map_err(io_error("cannot read its size"))?;
        if !file_info.is_file() {
            return Err(not_a_store("it is not a file"));
        }
        let file_bytes = file_info.len();
        if file_bytes < HEADER_BYTES as u64 {
            return Err(not_a_store(&format!("{file_bytes} bytes are too few")));
        }
        let mut head = [0; HEADER_BYTES];
        read_exact_at(&file, &mut head, 0).map_err(io_error("cannot read the header"))?;
        let damaged = |section, part: PartExtent, reason| StoreError::Section {
            section,
            start: part.offset,
            end: part.offset + part.bytes,
            reason,
            path: path.into(),
        };
        let whole_header = PartExtent { offset: 0, bytes: HEADER_BYTES as u64, checksum: 0 };
        let header = Header::decode(&head).map_err(|error| match error {
            HeaderError::Magic => not_a_store("it does not begin like one"),
            HeaderError::Version(found) => {
                StoreError::Version { found, supported: VERSION, path: path.into() }
            }
            HeaderError::Damaged(reason) => damaged("header", whole_header, reason),
        })?;
        if header.file_bytes != file_bytes {
            let reason = format!("the file has {file_bytes} bytes, it says {}", header.file_bytes);
            return Err(damaged("header", whole_header, reason));
        }
        let read_part = |section, part: PartExtent| {
            // Lengths were checked against the file's, so this allocates no more than is there.
            let mut bytes = vec![0; part.bytes as usize];
            read_exact_at(&file, &mut bytes, part.offset).map_err(io_error("cannot read"))?;
            let found = crc32c::crc32c(&bytes);
            if found != part.checksum {
                let reason = format!("checksum {found:08x}, header says {:08x}", part.checksum);
                return Err(damaged(section, part, reason));
            }
            Ok(bytes)
        };
        let metadata_bytes = read_part("metadata", header.metadata)?;
        let metadata: Metadata = serde_json::from_slice(&metadata_bytes)
            .map_err(|error| damaged("metadata", header.metadata, error.to_string()))?;
        metadata.validate().map_err(|reason| damaged("metadata", header.metadata, reason))?;
        let directory_bytes = read_part("directory", header.directory)?;
        let row = directory::row_bytes(metadata.depth, metadata.sections.len());
        if directory_bytes.len() as u64 != u64::from(header.node_count) * row as u64 {
            let reason = format!("{} rows of {row} bytes do not fill it", header.node_count);
            return Err(damaged("directory", header.directory, reason));
        }
        let (nodes, extents) =
            directory::decode(&directory_bytes, metadata.depth, metadata.sections.len())
                .map_err(|reason| damaged("directory", header.directory, reason))?;
        let octree = Octree::new(metadata.lattice(), metadata.root_cube(), metadata.depth, nodes)
            .map_err(|source| StoreError::Octree { source, path: path.into() })?;
        let node_offsets = place_nodes(&header, &extents, metadata.sections.len())
            .map_err(|reason| damaged("directory", header.directory, reason))?;
        refuse_impossible_counts(&octree, &metadata, &extents)
            .map_err(|reason| damaged("directory", header.directory, reason))?;
        if octree.point_count() != header.point_count || metadata.points != header.point_count {
            let reason = format!(
                "{} points in the directory, {} in the metadata, {} in the header",
                octree.point_count(),
                metadata.points,
                header.point_count
            );
            return Err(damaged("directory", header.directory, reason));
        }
        let read = HEADER_BYTES as u64 + header.metadata.bytes + header.directory.bytes;
        Ok(Store {
            path: path.into(),
            file,
            header,
            metadata,
            octree,
            extents,
            node_offsets,
            bytes_read: AtomicU64::new(read),
        })
    }

    /// Where the store is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Where its parts are.
    pub fn header(&self) -> &Header {
        &self.header
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

    /// Stored bytes of one section of one node.
    pub fn section_extent(&self, node: NodeId, section: usize) -> SectionExtent {
        self.extents[node.index() * self.metadata.sections.len() + section]
    }

    /// Replaces `words` by the positions of a node: for local coordinates of at most
    /// [`NARROW_BITS`](crate::store::NARROW_BITS) bits two words a point, the low and high half of
    /// the local Morton code; else three, local x, y, z.
    pub fn read_positions(&self, node: NodeId, words: &mut Vec<u32>) -> Result<(), NodeReadError> {
        self.read_words(node, SectionContent::Positions, words)
    }

    /// Replaces `words` by the colours of a node, RGBA8 with red in the lowest byte.
    pub fn read_colors(&self, node: NodeId, words: &mut Vec<u32>) -> Result<(), NodeReadError> {
        self.read_words(node, SectionContent::Color, words)
    }

    /// Replaces `bytes` by an attribute's little-endian column; `attribute` counts in the schema.
    pub fn read_attribute(
        &self,
        node: NodeId,
        attribute: usize,
        bytes: &mut Vec<u8>,
    ) -> Result<(), NodeReadError> {
        let content = SectionContent::Attribute(attribute as u32);
        if let Some((section, _)) = self.metadata.find_section(content) {
            return self.read_section(node, section, bytes);
        }
        if self.metadata.schema.attributes.get(attribute).is_none() {
            return Err(NodeReadError::NoSuchSection { section: format!("attribute {attribute}") });
        }
        self.read_full_color(node, bytes)
    }

    /// Replaces `bytes` by a section of a node, decoded.
    pub fn read_section(
        &self,
        node: NodeId,
        section: usize,
        bytes: &mut Vec<u8>,
    ) -> Result<(), NodeReadError> {
        bytes.clear();
        bytes.resize(self.raw_bytes(node, section), 0);
        self.read_section_into(node, section, bytes)
    }

    /// Bytes `range` of the appendix; its checksum is not looked at.
    pub fn read_appendix(&self, offset: u64, bytes: u64) -> Result<Vec<u8>, StoreError> {
        let appendix = self.header.appendix;
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
        read_exact_at(&self.file, &mut out, appendix.offset + offset).map_err(|source| {
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
            read_exact_at(&self.file, piece, at)?;
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

    fn read_words(
        &self,
        node: NodeId,
        content: SectionContent,
        words: &mut Vec<u32>,
    ) -> Result<(), NodeReadError> {
        let (section, _) = self.metadata.find_section(content).ok_or_else(|| {
            NodeReadError::NoSuchSection { section: format!("{content:?}").to_lowercase() }
        })?;
        words.clear();
        words.resize(self.raw_bytes(node, section) / 4, 0);
        self.read_section_into(node, section, bytemuck::cast_slice_mut(words))?;
        if cfg!(target_endian = "big") {
            words.iter_mut().for_each(|word| *word = u32::from_le(*word));
        }
        Ok(())
    }

    /// The record's `rgb` attribute, put together from the colour sections.
    fn read_full_color(&self, node: NodeId, bytes: &mut Vec<u8>) -> Result<(), NodeReadError> {
        let mut colors = Vec::new();
        self.read_colors(node, &mut colors)?;
        let mut low = Vec::new();
        if let Some((section, _)) = self.metadata.find_section(SectionContent::ColorLow) {
            self.read_section(node, section, &mut low)?;
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

    fn read_section_into(
        &self,
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
        // Stored sections are never longer than their contents (see `codec`), which bounds this.
        if extent.bytes > raw.len() as u64 {
            let reason = format!("{} bytes are stored for {}", extent.bytes, raw.len());
            return Err(NodeReadError::Decode { node, level, section: name(), reason, start, end });
        }
        let mut stored = vec![0; extent.bytes as usize];
        read_exact_at(&self.file, &mut stored, start).map_err(|source| NodeReadError::Io {
            node,
            level,
            section: name(),
            source,
            start,
            end,
        })?;
        self.bytes_read.fetch_add(extent.bytes, Ordering::Relaxed);
        let found = crc32c::crc32c(&stored);
        if found != extent.checksum {
            let expected = extent.checksum;
            let section = name();
            return Err(NodeReadError::Checksum {
                node,
                level,
                section,
                found,
                expected,
                start,
                end,
            });
        }
        let shape = self.shape(node, section);
        codec::decode(shape, &stored, &mut CodecScratch::default(), raw).map_err(|reason| {
            NodeReadError::Decode { node, level, section: name(), reason, start, end }
        })
    }
}

/// Start of each node's data; an error if the extents do not fill the data part exactly.
fn place_nodes(
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

/// Reads exactly `buffer.len()` bytes at a position, without moving a shared cursor.
fn read_exact_at(file: &File, buffer: &mut [u8], offset: u64) -> io::Result<()> {
    #[cfg(unix)]
    {
        std::os::unix::fs::FileExt::read_exact_at(file, buffer, offset)
    }
    #[cfg(windows)]
    {
        let (mut buffer, mut offset) = (buffer, offset);
        while !buffer.is_empty() {
            match std::os::windows::fs::FileExt::seek_read(file, buffer, offset)? {
                0 => return Err(io::ErrorKind::UnexpectedEof.into()),
                read => {
                    buffer = &mut buffer[read..];
                    offset += read as u64;
                }
            }
        }
        Ok(())
    }
}
