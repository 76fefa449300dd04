//! Reading single sections of single nodes of an open store.

use std::cell::RefCell;
use std::io;
use std::sync::atomic::Ordering;

use crate::ids::NodeId;
use crate::store::NodeReadError;
use crate::store::blocks::BlockTable;
use crate::store::codec::{self, CodecScratch, ElementShape};
use crate::store::directory::SectionExtent;
use crate::store::fetched::FetchedNode;
use crate::store::metadata::{SectionContent, position_shape};
use crate::store::reader::Store;

thread_local! {
    /// Stored bytes and decoding memory of this thread, used again by every read.
    static SCRATCH: RefCell<(Vec<u8>, CodecScratch)> = RefCell::default();
}

impl Store {
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
        if extent.bytes == 0 {
            // A column of zeros; where there may be none, the store was not opened.
            raw.fill(0);
            return Ok(());
        }
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
