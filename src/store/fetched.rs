//! Reading and unpacking a node apart from each other.
//!
//! Whoever waits for a disk or a network need not be who decodes: [`Store::fetch`] only reads, the
//! `unpack` methods only decode. Sections that stand side by side come in one read.

use crate::ids::NodeId;
use crate::store::{NodeReadError, SectionContent, Store};

/// Stored bytes of some sections of one node.
#[derive(Clone, Debug)]
pub struct FetchedNode {
    node: NodeId,
    /// Ranges of the file: where they start, and their bytes.
    ranges: Vec<(u64, Vec<u8>)>,
}

/// Bytes between two wanted sections that are read with them rather than in two reads.
const GAP_BYTES: u64 = 16 << 10;

impl FetchedNode {
    /// The node.
    pub fn node(&self) -> NodeId {
        self.node
    }

    /// Copies bytes of the file, if they are here; whether they are.
    pub(super) fn copy(&self, buffer: &mut [u8], offset: u64) -> bool {
        let bytes = self.ranges.iter().find_map(|(start, bytes)| {
            let at = usize::try_from(offset.checked_sub(*start)?).ok()?;
            bytes.get(at..at.checked_add(buffer.len())?)
        });
        if let Some(bytes) = bytes {
            buffer.copy_from_slice(bytes);
        }
        bytes.is_some()
    }
}

impl Store {
    /// Bytes that [`fetch`](Self::fetch) reads.
    pub fn fetch_bytes(&self, node: NodeId, columns: &[SectionContent]) -> u64 {
        self.fetch_ranges(node, columns).iter().map(|&(start, end)| end - start).sum()
    }

    /// Whether [`fetch`](Self::fetch) finds all in memory and reads nothing.
    pub fn fetches_from_memory(&self, node: NodeId, columns: &[SectionContent]) -> bool {
        self.fetch_ranges(node, columns).iter().all(|&(start, end)| self.is_in_memory(start, end))
    }

    /// Reads the stored bytes of some columns of a node; columns that the store lacks are left out.
    pub fn fetch(
        &self,
        node: NodeId,
        columns: &[SectionContent],
    ) -> Result<FetchedNode, NodeReadError> {
        let mut ranges = Vec::new();
        for (start, end) in self.fetch_ranges(node, columns) {
            // The directory was checked against the file's length.
            let mut bytes = vec![0; (end - start) as usize];
            self.read_at(&mut bytes, start).map_err(|source| NodeReadError::Io {
                node,
                level: self.octree().node(node).depth,
                section: "sections".into(),
                source,
                start,
                end,
            })?;
            ranges.push((start, bytes));
        }
        Ok(FetchedNode { node, ranges })
    }

    /// As [`read_positions`](Self::read_positions), of what was fetched.
    pub fn unpack_positions(
        &self,
        fetched: &FetchedNode,
        words: &mut Vec<u32>,
    ) -> Result<(), NodeReadError> {
        self.read_words(Some(fetched), fetched.node, SectionContent::Positions, u32::MAX, words)
    }

    /// As [`read_colors`](Self::read_colors), of what was fetched.
    pub fn unpack_colors(
        &self,
        fetched: &FetchedNode,
        words: &mut Vec<u32>,
    ) -> Result<(), NodeReadError> {
        self.read_words(Some(fetched), fetched.node, SectionContent::Color, u32::MAX, words)
    }

    /// As [`read_attribute`](Self::read_attribute), of what was fetched.
    pub fn unpack_attribute(
        &self,
        fetched: &FetchedNode,
        attribute: usize,
        bytes: &mut Vec<u8>,
    ) -> Result<(), NodeReadError> {
        self.read_column(Some(fetched), fetched.node, attribute, bytes)
    }

    /// Where the wanted sections are, neighbours joined.
    fn fetch_ranges(&self, node: NodeId, columns: &[SectionContent]) -> Vec<(u64, u64)> {
        let sections = &self.metadata().sections;
        let (mut at, _) = self.node_extent(node);
        let mut ranges: Vec<(u64, u64)> = Vec::new();
        for (index, section) in sections.iter().enumerate() {
            let end = at + self.section_extent(node, index).bytes;
            if columns.iter().any(|column| self.needs(*column, section.content)) {
                match ranges.last_mut() {
                    Some(last) if at - last.1 <= GAP_BYTES => last.1 = end,
                    _ => ranges.push((at, end)),
                }
            }
            at = end;
        }
        ranges
    }

    /// Whether a column is put together from a section.
    fn needs(&self, column: SectionContent, section: SectionContent) -> bool {
        let is_put_together = matches!(column, SectionContent::Attribute(_))
            && self.metadata().find_section(column).is_none();
        let is_color = matches!(section, SectionContent::Color | SectionContent::ColorLow);
        column == section || is_put_together && is_color
    }
}
