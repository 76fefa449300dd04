//! Points as lines of text.
//!
//! Positions are decimals exactly on the lattice, or the shortest decimals that read back as the
//! scan's floats. `.csv` (commas) and `.txt` (blanks) begin with a line of names and hold every
//! attribute, with LAS's packed bytes taken apart and angles in degrees. `.xyz` and `.pts` (which
//! begins with the number of points) hold what readers of such files expect: position, intensity,
//! colour, as far as there are any.

use super::decimal::append_thousandths;
use super::names::component_names;
use super::ply::append_number;
use super::positions::Positions;
use super::rows::RowFormat;
use crate::points::{Attribute, Scalar, Schema, names};

/// The kinds of text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextKind {
    /// Position, intensity, colour.
    Xyz,
    /// The same after a line with the number of points; colours of 8 bits.
    Pts,
    /// Everything, between blanks, after a line of names.
    Txt,
    /// Everything, between commas, after a line of names.
    Csv,
}

impl TextKind {
    fn has_names(self) -> bool {
        matches!(self, TextKind::Txt | TextKind::Csv)
    }
}

/// Rows of a schema as lines.
#[derive(Clone, Debug)]
pub struct TextFormat {
    kind: TextKind,
    positions: Positions,
    columns: Vec<Column>,
    row_bytes: usize,
    notes: Vec<String>,
}

/// One number of a line.
#[derive(Clone, Debug)]
struct Column {
    name: String,
    /// Place in the row.
    from: usize,
    value: Value,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Value {
    Number(Scalar),
    /// Bits of a byte: first one and how many.
    Bits(u8, u8),
    /// Steps of 0.006 degrees.
    AngleSteps,
}

impl TextFormat {
    /// Lines with these columns. `color_bits` are the significant bits of colours.
    pub fn new(
        kind: TextKind,
        positions: Positions,
        schema: &Schema,
        color_bits: Option<u8>,
    ) -> Self {
        let mut columns = Vec::new();
        let mut left_out = Vec::new();
        let mut notes = Vec::new();
        if kind.has_names() {
            let is_shown = |a: &&Attribute| a.name != names::COORDINATE_RESIDUAL;
            let shown = schema.attributes.iter().filter(is_shown);
            shown.for_each(|attribute| add_columns(attribute, schema, &mut columns));
        } else {
            let expected = [names::INTENSITY, names::RGB];
            for name in expected {
                if let Some((_, attribute)) = schema.find(name) {
                    add_numbers(attribute, &mut columns);
                }
            }
            let is_left =
                |name: &str| !expected.contains(&name) && name != names::COORDINATE_RESIDUAL;
            let all = schema.attributes.iter().map(|attribute| attribute.name.as_str());
            left_out.extend(all.filter(|name| is_left(name)));
        }
        if kind == TextKind::Pts && color_bits.is_some_and(|bits| bits > 8) {
            for column in &mut columns {
                if ["red", "green", "blue"].contains(&column.name.as_str()) {
                    (column.from, column.value) = (column.from + 1, Value::Number(Scalar::U8));
                }
            }
            notes.push("colours of 16 bits are cut to the 8 that PTS has".to_string());
        }
        if !left_out.is_empty() {
            let text = format!("left out (.csv and .txt have them): {}", left_out.join(", "));
            notes.push(text);
        }
        TextFormat { kind, positions, columns, row_bytes: schema.record_bytes as usize, notes }
    }

    fn separator(&self) -> u8 {
        if self.kind == TextKind::Csv { b',' } else { b' ' }
    }
}

impl RowFormat for TextFormat {
    fn opening(&self, points: u64, least_bytes: usize) -> Vec<u8> {
        let mut text = match self.kind {
            TextKind::Xyz => String::new(),
            TextKind::Pts => points.to_string(),
            TextKind::Txt | TextKind::Csv => {
                let separator = char::from(self.separator());
                let is_odd = |c: char| c == separator || c.is_whitespace() || c.is_control();
                let named = self.columns.iter().map(|column| column.name.replace(is_odd, "_"));
                let names: Vec<String> =
                    ["x", "y", "z"].into_iter().map(str::to_string).chain(named).collect();
                names.join(&separator.to_string())
            }
        };
        match self.kind {
            TextKind::Xyz => {}
            TextKind::Pts => {
                let missing = least_bytes.saturating_sub(text.len() + 1);
                text.extend(std::iter::repeat_n(' ', missing));
                text.push('\n');
            }
            TextKind::Txt | TextKind::Csv => text.push('\n'),
        }
        text.into_bytes()
    }

    fn append(&self, rows: &[u8], out: &mut Vec<u8>) {
        let separator = self.separator();
        for row in rows.chunks_exact(self.row_bytes) {
            self.positions.append(row, separator, out);
            for column in &self.columns {
                out.push(separator);
                column.append(row, out);
            }
            out.push(b'\n');
        }
    }

    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }
}

impl Column {
    fn append(&self, row: &[u8], out: &mut Vec<u8>) {
        let bytes = &row[self.from..];
        match self.value {
            Value::Number(scalar) => append_number(scalar, bytes, out),
            Value::Bits(first, count) => {
                let value = bytes[0] >> first & ((1u16 << count) - 1) as u8;
                append_number(Scalar::U8, &[value], out);
            }
            Value::AngleSteps => append_thousandths(Scalar::I16.read(bytes) as i64 * 6, out),
        }
    }
}

/// Columns of one attribute; fields that LAS packs into a byte get one each.
fn add_columns(attribute: &Attribute, schema: &Schema, columns: &mut Vec<Column>) {
    let is_byte = (attribute.scalar, attribute.components) == (Scalar::U8, 1);
    let has = |name| schema.find(name).is_some();
    let is_extended = has(names::FLAGS);
    let fields: &[(&str, u8, u8)] = match attribute.name.as_str() {
        names::RETURNS if is_byte && is_extended => {
            &[("return_number", 0, 4), ("number_of_returns", 4, 4)]
        }
        names::RETURNS if is_byte => &[
            ("return_number", 0, 3),
            ("number_of_returns", 3, 3),
            ("scan_direction_flag", 6, 1),
            ("edge_of_flight_line", 7, 1),
        ],
        names::FLAGS if is_byte => &[
            ("synthetic", 0, 1),
            ("key_point", 1, 1),
            ("withheld", 2, 1),
            ("overlap", 3, 1),
            ("scanner_channel", 4, 2),
            ("scan_direction_flag", 6, 1),
            ("edge_of_flight_line", 7, 1),
        ],
        names::CLASSIFICATION if is_byte && has(names::RETURNS) && !is_extended => &[
            ("classification", 0, 5),
            ("synthetic", 5, 1),
            ("key_point", 6, 1),
            ("withheld", 7, 1),
        ],
        names::SCAN_ANGLE if attribute.scalar == Scalar::I16 && is_extended => {
            let from = attribute.record_offset as usize;
            let (name, value) = (attribute.name.clone(), Value::AngleSteps);
            return columns.push(Column { name, from, value });
        }
        _ => return add_numbers(attribute, columns),
    };
    let from = attribute.record_offset as usize;
    let column = |&(name, first, count): &(&str, u8, u8)| Column {
        name: name.to_string(),
        from,
        value: Value::Bits(first, count),
    };
    columns.extend(fields.iter().map(column));
}

fn add_numbers(attribute: &Attribute, columns: &mut Vec<Column>) {
    for (i, name) in component_names(attribute).into_iter().enumerate() {
        let from = attribute.record_offset as usize + i * attribute.scalar.bytes();
        columns.push(Column { name, from, value: Value::Number(attribute.scalar) });
    }
}
