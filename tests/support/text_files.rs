//! Texts of points out of strings, and all that a reader says of them.

#![allow(dead_code, reason = "each test binary uses a part")]

use std::path::Path;

use esker::input::{
    BadRows, CoordinateKind, ForeignFault, ForeignReader, PositionedFile, RowBuffer, TextOptions,
    TextReader,
};
use esker::points::Scalar;
use glam::DVec3;

pub fn open(text: impl AsRef<[u8]>) -> Result<TextReader, ForeignFault> {
    open_with(text, &TextOptions::default())
}

pub fn open_with(
    text: impl AsRef<[u8]>,
    options: &TextOptions,
) -> Result<TextReader, ForeignFault> {
    TextReader::open(PositionedFile::in_memory(text.as_ref().to_vec()), options)
}

pub fn open_file(path: &Path) -> TextReader {
    let file = std::fs::File::open(path).expect("the file opens");
    let bytes = file.metadata().expect("it has a length").len();
    let opened = TextReader::open(PositionedFile::new(file, bytes), &TextOptions::default());
    opened.unwrap_or_else(|fault| panic!("{}: {fault}", path.display()))
}

/// The fault of a text that must have one, as it is shown.
pub fn fault(text: impl AsRef<[u8]>) -> String {
    open(text).expect_err("the text is wrong").to_string()
}

pub fn with_columns(columns: &str) -> TextOptions {
    let columns = columns.parse().expect("the list of columns is right");
    TextOptions { columns: Some(columns), ..TextOptions::default() }
}

pub fn leaving_out() -> TextOptions {
    TextOptions { bad_rows: BadRows::LeaveOut, ..TextOptions::default() }
}

/// All rows, attributes as numbers in the order of the columns.
#[derive(Debug, Default, PartialEq)]
pub struct Rows {
    pub positions: Vec<DVec3>,
    pub attributes: Vec<Vec<f64>>,
}

/// Reads all blocks and checks them against the facts.
pub fn read(reader: &TextReader) -> Rows {
    let facts = reader.facts();
    let mut rows = Rows::default();
    let mut buffer = RowBuffer::default();
    let stride: usize =
        facts.columns.iter().map(|c| c.scalar.bytes() * usize::from(c.components)).sum();
    for (index, block) in facts.blocks.iter().enumerate() {
        assert_eq!(block.first_point, rows.positions.len() as u64);
        reader.read_block(index, &mut buffer).unwrap_or_else(|fault| panic!("{fault}"));
        assert_eq!(block.points, buffer.positions.len() as u64);
        assert_eq!(buffer.attributes.len(), stride * buffer.positions.len());
        rows.positions.extend_from_slice(&buffer.positions);
        for point in 0..buffer.positions.len() {
            let mut bytes = &buffer.attributes[point * stride..][..stride];
            let mut row = Vec::new();
            for column in &facts.columns {
                for _ in 0..column.components {
                    row.push(column.scalar.read(bytes));
                    bytes = &bytes[column.scalar.bytes()..];
                }
            }
            rows.attributes.push(row);
        }
    }
    assert_eq!(facts.points, rows.positions.len() as u64);
    if facts.points > 0 {
        let min = rows.positions.iter().copied().reduce(DVec3::min);
        let max = rows.positions.iter().copied().reduce(DVec3::max);
        assert_eq!(Some(facts.bounds[0]), min);
        assert_eq!(Some(facts.bounds[1]), max);
    }
    rows
}

/// Columns in short, such as `rgb:u16x3 intensity:f32`.
pub fn columns(reader: &TextReader) -> String {
    let show = |scalar: Scalar| format!("{scalar:?}").to_lowercase();
    let columns = reader.facts().columns.iter().map(|column| match column.components {
        1 => format!("{}:{}", column.name, show(column.scalar)),
        count => format!("{}:{}x{count}", column.name, show(column.scalar)),
    });
    columns.collect::<Vec<_>>().join(" ")
}

pub fn digits(reader: &TextReader) -> Option<u32> {
    match reader.facts().coordinates {
        CoordinateKind::Decimal { digits } => Some(digits),
        _ => None,
    }
}
