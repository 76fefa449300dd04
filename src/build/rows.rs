//! Records of a job in memory, in input order.

use crate::points::{Attribute, Scalar, Schema, names};

/// A view of records, each optionally preceded by its input index (8 bytes, little-endian).
#[derive(Clone, Copy)]
pub struct Rows<'a> {
    bytes: &'a [u8],
    stride: usize,
    record_start: usize,
    /// Where a row's input index stands; without one, rows count on from `first_index`.
    index_start: Option<usize>,
    first_index: u64,
    color_offset: Option<usize>,
}

/// Bytes of the input index before each record of spilled rows.
pub const INDEX_BYTES: usize = 8;

impl<'a> Rows<'a> {
    /// Records one after the other; the first has the given input index.
    pub fn consecutive(bytes: &'a [u8], schema: &Schema, first_index: u64) -> Self {
        Rows {
            bytes,
            stride: schema.record_bytes as usize,
            record_start: 0,
            index_start: None,
            first_index,
            color_offset: color_offset(schema),
        }
    }

    /// Records each preceded by its input index.
    pub fn indexed(bytes: &'a [u8], schema: &Schema) -> Self {
        Rows::with_prefix(bytes, schema, 0, INDEX_BYTES)
    }

    /// Records each preceded by a prefix of `prefix_bytes` that has the input index at
    /// `index_start`.
    pub fn with_prefix(
        bytes: &'a [u8],
        schema: &Schema,
        index_start: usize,
        prefix_bytes: usize,
    ) -> Self {
        Rows {
            bytes,
            stride: prefix_bytes + schema.record_bytes as usize,
            record_start: prefix_bytes,
            index_start: Some(index_start),
            first_index: 0,
            color_offset: color_offset(schema),
        }
    }

    /// Number of records.
    pub fn len(&self) -> usize {
        self.bytes.len() / self.stride
    }

    /// A whole row: the index if there is one, and the record.
    pub fn row(&self, row: u32) -> &'a [u8] {
        let start = row as usize * self.stride;
        &self.bytes[start..start + self.stride]
    }

    /// A record.
    pub fn record(&self, row: u32) -> &'a [u8] {
        &self.row(row)[self.record_start..]
    }

    /// Place of a record in the whole input.
    pub fn input_index(&self, row: u32) -> u64 {
        let Some(start) = self.index_start else {
            return self.first_index + u64::from(row);
        };
        let bytes = &self.row(row)[start..start + INDEX_BYTES];
        u64::from_le_bytes(bytes.try_into().expect("an index has 8 bytes"))
    }

    /// Whether records have a colour.
    pub fn has_color(&self) -> bool {
        self.color_offset.is_some()
    }

    /// Colour of a record; black without one.
    pub fn color(&self, row: u32) -> [u16; 3] {
        self.color_offset.map_or([0; 3], |offset| read_color(&self.record(row)[offset..]))
    }
}

/// Where the colour stands in a record.
pub fn color_offset(schema: &Schema) -> Option<usize> {
    let is_rgb = |a: &Attribute| a.scalar == Scalar::U16 && a.components == 3;
    let (_, attribute) = schema.find(names::RGB)?;
    is_rgb(attribute).then_some(attribute.record_offset as usize)
}

/// Three little-endian 16-bit channels.
pub fn read_color(bytes: &[u8]) -> [u16; 3] {
    [0, 2, 4].map(|at| u16::from_le_bytes([bytes[at], bytes[at + 1]]))
}
