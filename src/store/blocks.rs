//! Sections in blocks: a column cut into runs of elements that are compressed one by one.
//!
//! A section of one block is that block. A longer one begins with a table, per block its stored
//! bytes and their checksum, two u32, and the directory's checksum is the table's: so the first
//! blocks can be read and verified without the others, and a column can be written that was never
//! in memory as a whole. Layout: `FORMAT.md`, "Sections".

use crate::store::codec::{self, CodecScratch, ElementShape};
use crate::store::directory::SectionExtent;

/// Decoded bytes of a block, unless a single element has more.
const BLOCK_BYTES: usize = 1 << 17;
/// Bytes of a row of the table.
const ENTRY_BYTES: usize = 8;

impl ElementShape {
    /// Elements of every block but the last.
    pub fn block_elements(&self) -> usize {
        1 << (BLOCK_BYTES / self.bytes()).max(1).ilog2()
    }

    /// Blocks of a column of so many elements.
    pub fn block_count(&self, elements: usize) -> usize {
        elements.div_ceil(self.block_elements()).max(1)
    }

    /// Bytes of the table before the blocks of so many elements.
    pub fn table_bytes(&self, elements: usize) -> usize {
        match self.block_count(elements) {
            1 => 0,
            count => count * ENTRY_BYTES,
        }
    }
}

/// A section as its blocks come, in order.
pub struct SectionWriter {
    shape: ElementShape,
    table: Vec<u8>,
    table_bytes: usize,
    block_bytes: u64,
    only: u32,
}

impl SectionWriter {
    /// A section of so many elements.
    pub fn new(shape: ElementShape, elements: usize) -> Self {
        let table_bytes = shape.table_bytes(elements);
        SectionWriter { shape, table: Vec::new(), table_bytes, block_bytes: 0, only: 0 }
    }

    /// Room to leave before the first block.
    pub fn table_bytes(&self) -> usize {
        self.table_bytes
    }

    /// Encodes one block and appends it to `out`.
    pub fn block(&mut self, raw: &[u8], scratch: &mut CodecScratch, out: &mut Vec<u8>) {
        let start = out.len();
        let bytes = codec::encode(self.shape, raw, scratch, out);
        let checksum = crc32c::crc32c(&out[start..]);
        self.only = checksum;
        self.block_bytes += bytes as u64;
        if self.table_bytes > 0 {
            let bytes = u32::try_from(bytes).expect("a block has few bytes or one element");
            self.table.extend_from_slice(&bytes.to_le_bytes());
            self.table.extend_from_slice(&checksum.to_le_bytes());
        }
    }

    /// The table, to go where room was left, and what the directory says of the section.
    pub fn finish(self) -> (Vec<u8>, SectionExtent) {
        assert_eq!(self.table.len(), self.table_bytes, "all blocks were written");
        let checksum = if self.table.is_empty() { self.only } else { crc32c::crc32c(&self.table) };
        let bytes = self.table_bytes as u64 + self.block_bytes;
        (self.table, SectionExtent { bytes, checksum })
    }
}

/// Encodes a whole column and appends it to `out`.
pub fn encode_section(
    shape: ElementShape,
    raw: &[u8],
    scratch: &mut CodecScratch,
    out: &mut Vec<u8>,
) -> SectionExtent {
    let mut section = SectionWriter::new(shape, raw.len() / shape.bytes());
    let start = out.len();
    out.resize(start + section.table_bytes(), 0);
    // An empty column is one empty block.
    let first = &raw[..raw.len().min(shape.block_elements() * shape.bytes())];
    section.block(first, scratch, out);
    for block in raw[first.len()..].chunks(shape.block_elements() * shape.bytes()) {
        section.block(block, scratch, out);
    }
    let (table, extent) = section.finish();
    out[start..start + table.len()].copy_from_slice(&table);
    extent
}

/// Where the blocks of a section are, as its table says.
pub struct BlockTable {
    entries: Vec<(u64, u32)>,
    table_bytes: u64,
}

impl BlockTable {
    /// Reads a table, whose checksum is known to be right. `extent_bytes` has the whole section.
    pub fn decode(table: &[u8], extent_bytes: u64) -> Result<Self, String> {
        let word = |bytes: &[u8]| u32::from_le_bytes(bytes.try_into().expect("it has 4 bytes"));
        let entry = |row: &[u8]| (u64::from(word(&row[..4])), word(&row[4..]));
        let entries: Vec<(u64, u32)> = table.chunks_exact(ENTRY_BYTES).map(entry).collect();
        let sum: u64 = entries.iter().map(|(bytes, _)| bytes).sum();
        let table_bytes = table.len() as u64;
        if sum + table_bytes != extent_bytes {
            return Err(format!("its blocks have {sum} bytes, it has room for {extent_bytes}"));
        }
        Ok(BlockTable { entries, table_bytes })
    }

    /// Bytes of the section up to the end of its first `blocks` blocks.
    pub fn end(&self, blocks: usize) -> u64 {
        self.table_bytes + self.entries[..blocks].iter().map(|(bytes, _)| bytes).sum::<u64>()
    }

    /// Verifies and decodes the first blocks of a section. `stored` are the bytes behind the table,
    /// `raw` takes whole blocks, or all of the section.
    pub fn decode_blocks(
        &self,
        shape: ElementShape,
        mut stored: &[u8],
        scratch: &mut CodecScratch,
        raw: &mut [u8],
    ) -> Result<(), String> {
        let block_bytes = shape.block_elements() * shape.bytes();
        for (i, (raw, &(bytes, expected))) in
            raw.chunks_mut(block_bytes).zip(&self.entries).enumerate()
        {
            let (block, rest) = stored.split_at(bytes as usize);
            stored = rest;
            let found = crc32c::crc32c(block);
            if found != expected {
                return Err(format!(
                    "block {i}: checksum {found:08x}, its table says {expected:08x}"
                ));
            }
            codec::decode(shape, block, scratch, raw).map_err(|e| format!("block {i}: {e}"))?;
        }
        Ok(())
    }
}
