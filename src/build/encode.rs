//! A finished node's points into the sections of the store.

use glam::UVec3;

use crate::build::point_tree::{Entry, NodeGrid};
use crate::build::rows::{Rows, color_offset, read_color};
use crate::geometry::MortonKey;
use crate::octree::LevelIndex;
use crate::points::{Attribute, Scalar, Schema};
use crate::store::{
    CodecScratch, EncodedNode, NARROW_BITS, Section, SectionContent, SectionExtent, ValueRange,
    encode_section, position_shape,
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
}

/// Encodes the points of a node, given in final order (level, then Morton).
pub fn encode_node<K: MortonKey>(
    grid: NodeGrid,
    points: &[Entry<K>],
    totals: Vec<u32>,
    rows: &Rows,
    encoding: &Encoding,
) -> FinishedNode {
    let local_bits = grid.root_bits - grid.depth;
    let cell = points[0].key.ancestor(local_bits).decode();
    let record_bytes = encoding.schema.record_bytes as usize;
    // Gathered once, so that each column is then a walk over memory in order.
    let mut records = Vec::with_capacity(points.len() * record_bytes);
    for point in points {
        records.extend_from_slice(rows.record(point.row));
    }
    let mut bytes = Vec::with_capacity(records.len());
    let mut sections = Vec::with_capacity(encoding.sections.len());
    let mut scratch = CodecScratch::default();
    let mut column = Vec::new();
    let mut tight = [UVec3::MAX, UVec3::ZERO];
    let mut ranges = vec![Vec::new(); encoding.schema.attributes.len()];
    for section in encoding.sections {
        column.clear();
        let mut shape = section.shape;
        match section.content {
            SectionContent::Positions => {
                shape = position_shape(local_bits);
                tight = push_positions(points, local_bits, &mut column);
            }
            SectionContent::Color => push_colors(&records, encoding, &mut column),
            SectionContent::ColorLow => push_low_colors(&records, encoding, &mut column),
            SectionContent::Attribute(i) => {
                let attribute = &encoding.schema.attributes[i as usize];
                push_attribute(&records, record_bytes, attribute, &mut column);
                ranges[i as usize] = value_ranges(attribute, &column);
            }
        }
        let start = bytes.len();
        let written = encode_section(shape, &column, &mut scratch, &mut bytes);
        let checksum = crc32c::crc32c(&bytes[start..]);
        sections.push(SectionExtent { bytes: written as u64, checksum });
    }
    if encoding.color_bits.is_some() {
        let (i, attribute) = encoding
            .schema
            .find(crate::points::names::RGB)
            .expect("colour bits are known only with colour");
        column.clear();
        push_attribute(&records, record_bytes, attribute, &mut column);
        ranges[i] = value_ranges(attribute, &column);
    }
    let levels = LevelIndex::new(totals).expect("level totals of a node rise from 1");
    let node = EncodedNode { depth: grid.depth, cell: cell.into(), levels, tight, sections, bytes };
    FinishedNode { node, ranges }
}

fn push_positions<K: MortonKey>(
    points: &[Entry<K>],
    local_bits: u32,
    column: &mut Vec<u8>,
) -> [UVec3; 2] {
    let mut tight = [UVec3::MAX, UVec3::ZERO];
    for point in points {
        let local = point.key.local(local_bits);
        let position = UVec3::from(local.decode());
        tight = [tight[0].min(position), tight[1].max(position)];
        if local_bits <= NARROW_BITS {
            column.extend_from_slice(&local.low_u64().to_le_bytes());
        } else {
            position.to_array().iter().for_each(|c| column.extend_from_slice(&c.to_le_bytes()));
        }
    }
    tight
}

fn record_colors<'a>(
    records: &'a [u8],
    schema: &Schema,
) -> impl Iterator<Item = [u16; 3]> + use<'a> {
    let offset = color_offset(schema).expect("colour sections exist only with colour");
    records
        .chunks_exact(schema.record_bytes as usize)
        .map(move |record| read_color(&record[offset..]))
}

fn push_colors(records: &[u8], encoding: &Encoding, column: &mut Vec<u8>) {
    let shift = if encoding.color_bits == Some(16) { 8 } else { 0 };
    for color in record_colors(records, encoding.schema) {
        let [r, g, b] = color.map(|channel| (channel >> shift) as u8);
        column.extend_from_slice(&[r, g, b, 255]);
    }
}

/// Low bytes come xor-ed with the high ones: zero where 8-bit values were widened by repetition.
fn push_low_colors(records: &[u8], encoding: &Encoding, column: &mut Vec<u8>) {
    for color in record_colors(records, encoding.schema) {
        column.extend_from_slice(&color.map(|channel| (channel ^ channel >> 8) as u8));
    }
}

fn push_attribute(
    records: &[u8],
    record_bytes: usize,
    attribute: &Attribute,
    column: &mut Vec<u8>,
) {
    let (start, bytes) = (attribute.record_offset as usize, attribute.bytes());
    for record in records.chunks_exact(record_bytes) {
        column.extend_from_slice(&record[start..start + bytes]);
    }
}

/// Smallest and largest value per component; values that are not numbers do not count.
fn value_ranges(attribute: &Attribute, column: &[u8]) -> Vec<ValueRange> {
    let components = usize::from(attribute.components);
    let step = attribute.scalar.bytes();
    let mut ranges = vec![EMPTY_RANGE; components];
    // One byte is by far the most common component; its range needs no conversion per value.
    if attribute.scalar == Scalar::U8 {
        for (component, range) in ranges.iter_mut().enumerate() {
            let values = column[component..].iter().step_by(components);
            let (min, max) = values.fold((u8::MAX, u8::MIN), |(a, b), &v| (a.min(v), b.max(v)));
            *range = ValueRange { min: f64::from(min), max: f64::from(max) };
        }
        return ranges;
    }
    for value in column.chunks_exact(step * components) {
        for (range, component) in ranges.iter_mut().zip(value.chunks_exact(step)) {
            let number = attribute.scalar.read(component);
            range.min = range.min.min(number);
            range.max = range.max.max(number);
        }
    }
    ranges
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
