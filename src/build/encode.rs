//! A finished node's points into the sections of the store.

use glam::UVec3;

use crate::build::levels::grow;
use crate::build::node::SortedPoints;
use crate::build::rows::{RowLayout, color_offset, copy_short, read_color};
use crate::geometry::MortonKey;
use crate::octree::LevelIndex;
use crate::points::{Attribute, COORDINATE_BYTES, Scalar, Schema, names};
use crate::store::{
    CodecScratch, ElementShape, EncodedNode, NARROW_BITS, NodeRow, Section, SectionContent,
    ValueRange, encode_section, position_shape,
};

/// What encoding needs to know of the store.
pub struct Encoding<'a> {
    /// Columns of a record.
    pub schema: &'a Schema,
    /// Columns of a node.
    pub sections: &'a [Section],
    /// 8 or 16.
    pub color_bits: Option<u8>,
}

/// A node as it goes to the store, with the value ranges of its attributes.
pub struct FinishedNode {
    /// For the store.
    pub node: EncodedNode,
    /// Per attribute of the schema, per component.
    pub ranges: Vec<Vec<ValueRange>>,
    /// Points beyond one per finest cell.
    pub overflow_points: u64,
}

impl FinishedNode {
    /// Points of the node.
    pub fn points(&self) -> u64 {
        u64::from(self.node.row.levels.point_count())
    }
}

/// Encodes nodes; its memory is used again.
#[derive(Default)]
pub struct Encoder {
    /// Attributes of the node's points, in final order.
    records: Vec<u8>,
    column: Vec<u8>,
    bytes: Vec<u8>,
    scratch: CodecScratch,
}

impl Encoder {
    /// Encodes the points of a node, given by their places in final order (level, then Morton).
    pub fn encode<K: MortonKey>(
        &mut self,
        depth: u32,
        local_bits: u32,
        points: &SortedPoints<K>,
        ordered: &[u32],
        totals: Vec<u32>,
        encoding: &Encoding,
    ) -> FinishedNode {
        let cell = points.keys[ordered[0] as usize].ancestor(local_bits).decode();
        let layout = points.layout;
        let stride = layout.attribute_bytes();
        // Gathered once, so that each column is then a walk over memory in order.
        grow(&mut self.records, ordered.len() * stride);
        let records = &mut self.records[..ordered.len() * stride];
        if stride > 0 {
            for (record, &place) in records.chunks_exact_mut(stride).zip(ordered) {
                copy_short(record, layout.attributes(points.row(place)));
            }
        }
        let records = &*records;
        self.bytes.clear();
        let mut sections = Vec::with_capacity(encoding.sections.len());
        let mut tight = [UVec3::MAX, UVec3::ZERO];
        let attributes = &encoding.schema.attributes;
        let mut ranges: Vec<Vec<ValueRange>> = vec![Vec::new(); attributes.len()];
        if encoding.color_bits.is_some() {
            color_ranges(records, stride, encoding.schema, &mut ranges);
        }
        for section in encoding.sections {
            let mut shape = section.shape;
            if section.content == SectionContent::Positions {
                shape = position_shape(local_bits);
            }
            let bytes = ordered.len() * shape.bytes();
            grow(&mut self.column, bytes);
            let column = &mut self.column[..bytes];
            match section.content {
                SectionContent::Attribute(i) => {
                    let attribute = &attributes[i as usize];
                    take_column(records, stride, attribute, column);
                    ranges[i as usize] = value_ranges(attribute, column);
                }
                SectionContent::Positions => {
                    tight = take_positions(points, ordered, local_bits, column);
                }
                SectionContent::Color => take_colors(records, stride, encoding, column),
                SectionContent::ColorLow => take_low_colors(records, stride, encoding, column),
            }
            sections.push(encode_section(shape, column, &mut self.scratch, &mut self.bytes));
        }
        let levels = LevelIndex::new(totals).expect("level totals of a node rise from 1");
        let bytes = self.bytes.as_slice().into();
        let row = NodeRow { depth, cell: cell.into(), levels, tight };
        let node = EncodedNode { row, sections, bytes };
        FinishedNode { node, ranges, overflow_points: 0 }
    }
}

/// Columns of rows that come block by block.
pub struct BlockEncoder<'a> {
    encoding: &'a Encoding<'a>,
    layout: RowLayout,
    local_bits: u32,
    records: Vec<u8>,
}

impl<'a> BlockEncoder<'a> {
    /// For rows of a node with so many bits of local coordinates.
    pub fn new(encoding: &'a Encoding<'a>, layout: RowLayout, local_bits: u32) -> Self {
        BlockEncoder { encoding, layout, local_bits, records: Vec::new() }
    }

    /// The shape of each section.
    pub fn shapes(&self) -> Vec<ElementShape> {
        let shape = |section: &Section| match section.content {
            SectionContent::Positions => position_shape(self.local_bits),
            _ => section.shape,
        };
        self.encoding.sections.iter().map(shape).collect()
    }

    /// Replaces `column` by the elements of a section; returns the value ranges that it tells.
    pub fn block<K: MortonKey>(
        &mut self,
        section: usize,
        rows: &[u8],
        column: &mut Vec<u8>,
    ) -> Vec<Vec<ValueRange>> {
        let stride = self.layout.attribute_bytes();
        let attributes = &self.encoding.schema.attributes;
        let mut ranges: Vec<Vec<ValueRange>> = attributes
            .iter()
            .map(|attribute| vec![EMPTY_RANGE; usize::from(attribute.components)])
            .collect();
        self.records.clear();
        for row in rows.chunks_exact(self.layout.stride()) {
            self.records.extend_from_slice(self.layout.attributes(row));
        }
        let rows = rows.chunks_exact(self.layout.stride());
        let section = &self.encoding.sections[section];
        let shape = match section.content {
            SectionContent::Positions => position_shape(self.local_bits),
            _ => section.shape,
        };
        column.resize(rows.len() * shape.bytes(), 0);
        match section.content {
            SectionContent::Attribute(i) => {
                let attribute = &attributes[i as usize];
                take_column(&self.records, stride, attribute, column);
                ranges[i as usize] = value_ranges(attribute, column);
            }
            SectionContent::Positions => {
                let keys = rows.map(|row| K::read(row).local(self.local_bits));
                take_local(keys, self.local_bits, column);
            }
            SectionContent::Color => {
                take_colors(&self.records, stride, self.encoding, column);
                color_ranges(&self.records, stride, self.encoding.schema, &mut ranges);
            }
            SectionContent::ColorLow => {
                take_low_colors(&self.records, stride, self.encoding, column)
            }
        }
        ranges
    }
}

fn take_positions<K: MortonKey>(
    points: &SortedPoints<K>,
    ordered: &[u32],
    local_bits: u32,
    column: &mut [u8],
) -> [UVec3; 2] {
    let keys = ordered.iter().map(|&place| points.keys[place as usize].local(local_bits));
    take_local(keys.clone(), local_bits, column);
    K::bounds(keys).map(UVec3::from)
}

/// Fills a column with local codes as they are stored.
fn take_local<K: MortonKey>(keys: impl Iterator<Item = K>, local_bits: u32, column: &mut [u8]) {
    if local_bits <= NARROW_BITS {
        for (bytes, local) in column.chunks_exact_mut(8).zip(keys) {
            bytes.copy_from_slice(&local.low_u64().to_le_bytes());
        }
    } else {
        for (bytes, local) in column.chunks_exact_mut(12).zip(keys) {
            let axes = bytes.chunks_exact_mut(4).zip(local.decode());
            axes.for_each(|(bytes, c)| bytes.copy_from_slice(&c.to_le_bytes()));
        }
    }
}

fn record_colors<'a>(
    records: &'a [u8],
    stride: usize,
    schema: &Schema,
) -> impl Iterator<Item = [u16; 3]> + use<'a> {
    let offset = color_offset(schema).expect("colour sections exist only with colour");
    records.chunks_exact(stride).map(move |record| read_color(&record[offset - COORDINATE_BYTES..]))
}

fn take_colors(records: &[u8], stride: usize, encoding: &Encoding, column: &mut [u8]) {
    let shift = if encoding.color_bits == Some(16) { 8 } else { 0 };
    let colors = record_colors(records, stride, encoding.schema);
    for (to, [r, g, b]) in column.chunks_exact_mut(4).zip(colors) {
        to.copy_from_slice(&[(r >> shift) as u8, (g >> shift) as u8, (b >> shift) as u8, 255]);
    }
}

/// Low bytes come xor-ed with the high ones: zero where 8-bit values were widened by repetition.
fn take_low_colors(records: &[u8], stride: usize, encoding: &Encoding, column: &mut [u8]) {
    let colors = record_colors(records, stride, encoding.schema);
    for (to, color) in column.chunks_exact_mut(3).zip(colors) {
        to.copy_from_slice(&color.map(|channel| (channel ^ channel >> 8) as u8));
    }
}

/// Notes the smallest and the largest value of each channel of the colour.
fn color_ranges(records: &[u8], stride: usize, schema: &Schema, ranges: &mut [Vec<ValueRange>]) {
    let Some((attribute, _)) = schema.find(names::RGB) else { return };
    let (mut low, mut high) = ([u16::MAX; 3], [u16::MIN; 3]);
    for color in record_colors(records, stride, schema) {
        for channel in 0..3 {
            low[channel] = low[channel].min(color[channel]);
            high[channel] = high[channel].max(color[channel]);
        }
    }
    if !records.is_empty() {
        let range = |(min, max)| ValueRange { min: f64::from(min), max: f64::from(max) };
        ranges[attribute] = low.into_iter().zip(high).map(range).collect();
    }
}

/// Fills a column with an attribute's values. `records` begin after their coordinates.
fn take_column(records: &[u8], stride: usize, attribute: &Attribute, column: &mut [u8]) {
    fn take<const N: usize>(records: &[u8], stride: usize, offset: usize, column: &mut [u8]) {
        for (value, record) in column.chunks_exact_mut(N).zip(records.chunks_exact(stride)) {
            value.copy_from_slice(&record[offset..offset + N]);
        }
    }
    let (offset, bytes) = (attribute.record_offset as usize - COORDINATE_BYTES, attribute.bytes());
    match bytes {
        1 => take::<1>(records, stride, offset, column),
        2 => take::<2>(records, stride, offset, column),
        4 => take::<4>(records, stride, offset, column),
        6 => take::<6>(records, stride, offset, column),
        8 => take::<8>(records, stride, offset, column),
        _ => {
            let values = column.chunks_exact_mut(bytes);
            for (value, record) in values.zip(records.chunks_exact(stride)) {
                value.copy_from_slice(&record[offset..offset + bytes]);
            }
        }
    }
}

/// Smallest and largest value per component; values that are not numbers do not count.
fn value_ranges(attribute: &Attribute, column: &[u8]) -> Vec<ValueRange> {
    /// In the type itself, so that no value is converted but the two that remain.
    fn integers<T: Copy + Ord, const N: usize>(
        column: &[u8],
        components: usize,
        read: impl Fn([u8; N]) -> T,
        widen: impl Fn(T) -> f64,
    ) -> Vec<ValueRange> {
        let value = |bytes: &[u8]| read(bytes.try_into().expect("the slice has N bytes"));
        let Some(first) = column.get(..components * N) else {
            return vec![EMPTY_RANGE; components];
        };
        if components == 1 {
            let (mut min, mut max) = (value(first), value(first));
            for bytes in column.chunks_exact(N) {
                min = min.min(value(bytes));
                max = max.max(value(bytes));
            }
            return vec![ValueRange { min: widen(min), max: widen(max) }];
        }
        // Element by element: there may be thousands of components.
        let mut extremes: Vec<(T, T)> =
            first.chunks_exact(N).map(|bytes| (value(bytes), value(bytes))).collect();
        for element in column.chunks_exact(N * components) {
            for ((min, max), bytes) in extremes.iter_mut().zip(element.chunks_exact(N)) {
                *min = (*min).min(value(bytes));
                *max = (*max).max(value(bytes));
            }
        }
        let range = |(min, max)| ValueRange { min: widen(min), max: widen(max) };
        extremes.into_iter().map(range).collect()
    }
    fn floats<const N: usize>(
        column: &[u8],
        components: usize,
        read: impl Fn([u8; N]) -> f64,
    ) -> Vec<ValueRange> {
        let mut ranges = vec![EMPTY_RANGE; components];
        for element in column.chunks_exact(N * components) {
            for (range, bytes) in ranges.iter_mut().zip(element.chunks_exact(N)) {
                let value = read(bytes.try_into().expect("the slice has N bytes"));
                range.min = range.min.min(value);
                range.max = range.max.max(value);
            }
        }
        ranges
    }
    let n = usize::from(attribute.components);
    match attribute.scalar {
        Scalar::U8 => integers(column, n, u8::from_le_bytes, f64::from),
        Scalar::I8 => integers(column, n, i8::from_le_bytes, f64::from),
        Scalar::U16 => integers(column, n, u16::from_le_bytes, f64::from),
        Scalar::I16 => integers(column, n, i16::from_le_bytes, f64::from),
        Scalar::U32 => integers(column, n, u32::from_le_bytes, f64::from),
        Scalar::I32 => integers(column, n, i32::from_le_bytes, f64::from),
        Scalar::U64 => integers(column, n, u64::from_le_bytes, |v| v as f64),
        Scalar::I64 => integers(column, n, i64::from_le_bytes, |v| v as f64),
        Scalar::F32 => floats(column, n, |bytes| f64::from(f32::from_le_bytes(bytes))),
        Scalar::F64 => floats(column, n, f64::from_le_bytes),
    }
}

/// The range of no values; joins with any other.
pub const EMPTY_RANGE: ValueRange = ValueRange { min: f64::INFINITY, max: f64::NEG_INFINITY };

/// Joins the ranges of one more node into those so far.
pub fn join_ranges(all: &mut Vec<Vec<ValueRange>>, node: &[Vec<ValueRange>]) {
    if all.is_empty() {
        *all = node.to_vec();
        return;
    }
    for (all, node) in all.iter_mut().flatten().zip(node.iter().flatten()) {
        all.min = all.min.min(node.min);
        all.max = all.max.max(node.max);
    }
}
