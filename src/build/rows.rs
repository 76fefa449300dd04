//! Points on their way through the build: rows of a Morton code, an input index and attributes.

use crate::geometry::MortonKey;
use crate::points::{Attribute, COORDINATE_BYTES, Scalar, Schema, names};

/// How a point's row is laid out. The attributes are the record's bytes after its coordinates,
/// which the Morton code holds.
#[derive(Clone, Copy, Debug)]
pub struct RowLayout {
    key_bytes: usize,
    index_bytes: usize,
    attribute_bytes: usize,
    /// Where the colour stands among the attributes.
    color: Option<usize>,
}

impl RowLayout {
    /// The layout for records of a schema, for an input of so many points.
    pub fn new<K: MortonKey>(schema: &Schema, points: u64) -> Self {
        RowLayout {
            key_bytes: K::BYTES,
            index_bytes: if points > u64::from(u32::MAX) { 8 } else { 4 },
            attribute_bytes: schema.record_bytes as usize - COORDINATE_BYTES,
            color: color_offset(schema).map(|offset| offset - COORDINATE_BYTES),
        }
    }

    /// Rows of a code and an index of 8 bytes.
    #[cfg(test)]
    pub fn for_tests<K: MortonKey>() -> Self {
        RowLayout { key_bytes: K::BYTES, index_bytes: 8, attribute_bytes: 0, color: None }
    }

    /// Whether input indices fit 32 bits.
    pub fn has_short_indices(&self) -> bool {
        self.index_bytes == 4
    }

    /// Bytes of a row.
    #[inline]
    pub fn stride(&self) -> usize {
        self.key_bytes + self.index_bytes + self.attribute_bytes
    }

    /// Bytes of a row's attributes.
    pub fn attribute_bytes(&self) -> usize {
        self.attribute_bytes
    }

    /// Whether rows have a colour.
    pub fn has_color(&self) -> bool {
        self.color.is_some()
    }

    /// Fills a row. `attributes` are a record's bytes after its coordinates.
    #[inline(always)]
    pub fn write<K: MortonKey>(&self, row: &mut [u8], key: K, index: u64, attributes: &[u8]) {
        key.write(row);
        let rest = &mut row[K::BYTES..];
        if self.index_bytes == 4 {
            rest[..4].copy_from_slice(&(index as u32).to_le_bytes());
            copy_short(&mut rest[4..], attributes);
        } else {
            rest[..8].copy_from_slice(&index.to_le_bytes());
            copy_short(&mut rest[8..], attributes);
        }
    }

    /// Changes a row's index.
    pub fn set_index<K: MortonKey>(&self, row: &mut [u8], index: u64) {
        row[K::BYTES..K::BYTES + self.index_bytes]
            .copy_from_slice(&index.to_le_bytes()[..self.index_bytes]);
    }

    /// Place of a row's point in the whole input.
    #[inline]
    pub fn index(&self, row: &[u8]) -> u64 {
        let bytes = &row[self.key_bytes..];
        if self.index_bytes == 4 {
            u64::from(u32::from_le_bytes(bytes[..4].try_into().expect("4 bytes")))
        } else {
            u64::from_le_bytes(bytes[..8].try_into().expect("8 bytes"))
        }
    }

    /// A row's attributes.
    #[inline]
    pub fn attributes<'a>(&self, row: &'a [u8]) -> &'a [u8] {
        &row[self.key_bytes + self.index_bytes..]
    }

    /// A row's colour; black without one.
    #[inline]
    pub fn color(&self, row: &[u8]) -> [u16; 3] {
        self.color.map_or([0; 3], |offset| read_color(&self.attributes(row)[offset..]))
    }
}

/// Copies a handful of bytes without calling out. The slices have the same length.
#[inline(always)]
pub fn copy_short(to: &mut [u8], from: &[u8]) {
    /// The first and the last `N` bytes, which may overlap. A loop would become a call.
    #[inline]
    fn both_ends<const N: usize>(to: &mut [u8], from: &[u8]) {
        let last = from.len() - N;
        to[..N].copy_from_slice(&from[..N]);
        to[last..].copy_from_slice(&from[last..]);
    }
    let to = &mut to[..from.len()];
    match from.len() {
        8..=16 => both_ends::<8>(to, from),
        17..=32 => both_ends::<16>(to, from),
        33..=64 => both_ends::<32>(to, from),
        _ => to.copy_from_slice(from),
    }
}

/// Rows in pages that each hold the same power of two of rows, except that any may end early.
#[derive(Clone, Copy)]
pub struct RowTable<'a> {
    pages: &'a [&'a [u8]],
    page_shift: u32,
    layout: RowLayout,
}

impl<'a> RowTable<'a> {
    /// A view of pages of at most `1 << page_shift` rows.
    pub fn new(pages: &'a [&'a [u8]], page_shift: u32, layout: RowLayout) -> Self {
        RowTable { pages, page_shift, layout }
    }

    /// How rows are laid out.
    pub fn layout(&self) -> RowLayout {
        self.layout
    }

    /// The row of a slot: page number and place within the page.
    #[inline]
    pub fn row(&self, slot: u32) -> &'a [u8] {
        let stride = self.layout.stride();
        let place = (slot & ((1 << self.page_shift) - 1)) as usize * stride;
        &self.pages[(slot >> self.page_shift) as usize][place..place + stride]
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.pages.iter().map(|page| page.len() / self.layout.stride()).sum()
    }

    /// Bits that hold all slots.
    pub fn slot_bits(&self) -> u32 {
        self.page_shift + (usize::BITS - self.pages.len().saturating_sub(1).leading_zeros())
    }

    /// All slots with their rows, page by page.
    pub fn slots(
        &self,
    ) -> impl Iterator<Item = impl ExactSizeIterator<Item = (u32, &'a [u8])> + Clone> {
        let (shift, stride) = (self.page_shift, self.layout.stride());
        (0u32..).zip(self.pages).map(move |(page, rows)| {
            let rows = rows.chunks_exact(stride).enumerate();
            rows.map(move |(i, row)| (page << shift | i as u32, row))
        })
    }
}

/// Where the colour stands in a record.
pub fn color_offset(schema: &Schema) -> Option<usize> {
    let is_rgb = |a: &Attribute| a.scalar == Scalar::U16 && a.components == 3;
    let (_, attribute) = schema.find(names::RGB)?;
    is_rgb(attribute).then_some(attribute.record_offset as usize)
}

/// Three little-endian 16-bit channels.
#[inline]
pub fn read_color(bytes: &[u8]) -> [u16; 3] {
    let bytes: &[u8; 6] = bytes[..6].try_into().expect("a colour has 6 bytes");
    let &[r, s, g, h, b, c] = bytes;
    [u16::from_le_bytes([r, s]), u16::from_le_bytes([g, h]), u16::from_le_bytes([b, c])]
}
