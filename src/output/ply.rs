//! PLY files: one element `vertex`, binary little endian or ASCII.
//!
//! Attributes keep their names and types; PLY has no vectors, so colours become `red`, `green`,
//! `blue`, normals `nx`, `ny`, `nz`, others get their component behind the name. Positions are
//! `float` where that tells them exactly, else `double`.
//!
//! Source: Turk, "The PLY Polygon File Format", 1994.

use std::fmt::Write;

use super::decimal::{append_double, append_integer, append_single, append_unsigned};
use super::las_records::AttributeRanges;
use super::names::component_names;
use super::positions::Positions;
use super::rows::{LEAST_FILLING, RowFormat};
use crate::points::{Attribute, Scalar, Schema, names};

/// How numbers are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlyEncoding {
    /// As bytes, lowest first.
    BinaryLittleEndian,
    /// As text.
    Ascii,
}

/// What is told to a PLY file about its points.
#[derive(Clone, Copy, Debug)]
pub struct PlyFacts<'a> {
    /// The rows' columns.
    pub schema: &'a Schema,
    /// Their values.
    pub ranges: &'a AttributeRanges,
    /// Significant bits of colours; 8 or less are written as bytes.
    pub color_bits: Option<u8>,
    /// Lines that stand in the header as comments.
    pub comments: &'a [String],
}

/// Rows of a schema as vertices.
#[derive(Clone, Debug)]
pub struct PlyFormat {
    encoding: PlyEncoding,
    positions: Positions,
    properties: Vec<Property>,
    comments: Vec<String>,
    row_bytes: usize,
}

/// One number of a vertex.
#[derive(Clone, Debug)]
struct Property {
    name: String,
    /// Type in the row; integers of 64 bits become floats of as many.
    scalar: Scalar,
    /// Place in the row.
    from: usize,
}

/// Whole numbers up to this are exact as f64.
const EXACT_AS_FLOAT: f64 = 9_007_199_254_740_992.0;

impl PlyFormat {
    /// Vertices with these properties.
    pub fn new(encoding: PlyEncoding, positions: Positions, facts: &PlyFacts) -> Self {
        let mut properties = Vec::new();
        for (i, attribute) in facts.schema.attributes.iter().enumerate() {
            if attribute.name != names::COORDINATE_RESIDUAL {
                let ranges = facts.ranges.get(i).map_or(&[][..], Vec::as_slice);
                add_properties(attribute, ranges, facts.color_bits, &mut properties);
            }
        }
        let one_line = |text: &String| text.replace(['\n', '\r'], " ");
        PlyFormat {
            encoding,
            positions,
            properties,
            comments: facts.comments.iter().map(one_line).collect(),
            row_bytes: facts.schema.record_bytes as usize,
        }
    }
}

fn add_properties(
    attribute: &Attribute,
    ranges: &[[f64; 2]],
    color_bits: Option<u8>,
    properties: &mut Vec<Property>,
) {
    let scalar = attribute.scalar;
    let is_normal = attribute.name == names::NORMAL && attribute.components == 3;
    let component_names = match is_normal {
        true => ["nx", "ny", "nz"].map(str::to_string).to_vec(),
        false => component_names(attribute),
    };
    let is_byte_color = attribute.name == names::RGB && color_bits.is_some_and(|bits| bits <= 8);
    for (i, name) in component_names.into_iter().enumerate() {
        let from = attribute.record_offset as usize + i * scalar.bytes();
        // PLY words end at blanks.
        let name = name.replace(|c: char| c.is_whitespace() || c.is_control(), "_");
        let exact = ranges
            .get(i)
            .is_none_or(|range| range.iter().all(|value| value.abs() <= EXACT_AS_FLOAT));
        let is_long = matches!(scalar, Scalar::U64 | Scalar::I64);
        if is_long && !exact {
            // No type of PLY takes them, but two do.
            let high = if scalar == Scalar::U64 { Scalar::U32 } else { Scalar::I32 };
            properties.push(Property { name: format!("{name}_low"), scalar: Scalar::U32, from });
            properties.push(Property {
                name: format!("{name}_high"),
                scalar: high,
                from: from + 4,
            });
        } else {
            // The low byte is the value.
            let scalar = if is_byte_color { Scalar::U8 } else { scalar };
            properties.push(Property { name, scalar, from });
        }
    }
}

impl RowFormat for PlyFormat {
    fn opening(&self, points: u64, least_bytes: usize) -> Vec<u8> {
        let encoding = match self.encoding {
            PlyEncoding::BinaryLittleEndian => "binary_little_endian",
            PlyEncoding::Ascii => "ascii",
        };
        let mut text = format!("ply\nformat {encoding} 1.0\n");
        for comment in &self.comments {
            line(&mut text, format_args!("comment {comment}"));
        }
        line(&mut text, format_args!("element vertex {points}"));
        let coordinate = if self.positions.is_single() { "float" } else { "double" };
        for axis in ["x", "y", "z"] {
            line(&mut text, format_args!("property {coordinate} {axis}"));
        }
        for Property { name, scalar, .. } in &self.properties {
            line(&mut text, format_args!("property {} {name}", type_name(*scalar)));
        }
        let end = "end_header\n";
        let missing = least_bytes.saturating_sub(text.len() + end.len());
        if missing >= LEAST_FILLING {
            text.push_str("comment");
            text.extend(std::iter::repeat_n(' ', missing - LEAST_FILLING));
            text.push('\n');
        }
        text.push_str(end);
        text.into_bytes()
    }

    fn append(&self, rows: &[u8], out: &mut Vec<u8>) {
        for row in rows.chunks_exact(self.row_bytes) {
            match self.encoding {
                PlyEncoding::BinaryLittleEndian => self.append_binary(row, out),
                PlyEncoding::Ascii => self.append_text(row, out),
            }
        }
    }

    fn notes(&self) -> Vec<String> {
        Vec::new()
    }
}

impl PlyFormat {
    fn append_binary(&self, row: &[u8], out: &mut Vec<u8>) {
        for coordinate in self.positions.of(row).to_array() {
            if self.positions.is_single() {
                out.extend_from_slice(&(coordinate as f32).to_le_bytes());
            } else {
                out.extend_from_slice(&coordinate.to_le_bytes());
            }
        }
        for &Property { scalar, from, .. } in &self.properties {
            match scalar {
                Scalar::U64 | Scalar::I64 => {
                    out.extend_from_slice(&scalar.read(&row[from..]).to_le_bytes());
                }
                _ => out.extend_from_slice(&row[from..from + scalar.bytes()]),
            }
        }
    }

    fn append_text(&self, row: &[u8], out: &mut Vec<u8>) {
        self.positions.append(row, b' ', out);
        for &Property { scalar, from, .. } in &self.properties {
            out.push(b' ');
            append_number(scalar, &row[from..], out);
        }
        out.push(b'\n');
    }
}

/// Appends the number that starts at `bytes[0]` as text, exactly.
pub(super) fn append_number(scalar: Scalar, bytes: &[u8], out: &mut Vec<u8>) {
    let eight = |bytes: &[u8]| bytes[..8].try_into().expect("the slice has 8 bytes");
    match scalar {
        Scalar::F32 => append_single(scalar.read(bytes) as f32, out),
        Scalar::F64 => append_double(scalar.read(bytes), out),
        Scalar::U64 => append_unsigned(u64::from_le_bytes(eight(bytes)), out),
        Scalar::I64 => append_integer(i64::from_le_bytes(eight(bytes)), out),
        _ => append_integer(scalar.read(bytes) as i64, out),
    }
}

fn line(text: &mut String, content: std::fmt::Arguments) {
    writeln!(text, "{content}").expect("a string takes all text");
}

/// The type's name in headers.
fn type_name(scalar: Scalar) -> &'static str {
    match scalar {
        Scalar::U8 => "uchar",
        Scalar::I8 => "char",
        Scalar::U16 => "ushort",
        Scalar::I16 => "short",
        Scalar::U32 => "uint",
        Scalar::I32 => "int",
        Scalar::F32 => "float",
        Scalar::F64 | Scalar::U64 | Scalar::I64 => "double",
    }
}
