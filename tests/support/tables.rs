//! PLY and delimited text, read the slow and plain way.

#![allow(dead_code, reason = "each test binary uses a part")]

/// Columns of numbers by name.
#[derive(Debug, Default)]
pub struct Table {
    /// Names in the file's order.
    pub names: Vec<String>,
    /// Types as the file calls them, empty in text.
    pub types: Vec<String>,
    columns: Vec<Vec<f64>>,
}

impl Table {
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        let place = self.names.iter().position(|n| n == name)?;
        Some(&self.columns[place])
    }

    pub fn type_of(&self, name: &str) -> Option<&str> {
        let place = self.names.iter().position(|n| n == name)?;
        Some(&self.types[place])
    }

    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, Vec::len)
    }
}

/// One element `vertex` of scalar properties, and nothing else.
pub fn read_ply(bytes: &[u8]) -> Table {
    let end = b"end_header\n";
    let at = bytes.windows(end.len()).position(|window| window == end).expect("a header");
    let header = std::str::from_utf8(&bytes[..at]).expect("headers are text");
    let body = &bytes[at + end.len()..];
    let mut lines = header.lines();
    assert_eq!(lines.next(), Some("ply"));
    let format = lines.next().expect("a format").to_string();
    let (mut table, mut count) = (Table::default(), 0);
    for line in lines {
        match line.split(' ').collect::<Vec<_>>()[..] {
            ["comment", ..] => {}
            ["element", "vertex", number] => count = number.parse().expect("a count"),
            ["property", kind, name] => {
                table.names.push(name.into());
                table.types.push(kind.into());
            }
            _ => panic!("header line {line:?}"),
        }
    }
    table.columns = vec![Vec::with_capacity(count); table.names.len()];
    if format == "format ascii 1.0" {
        let text = std::str::from_utf8(body).expect("text");
        for line in text.lines() {
            add_line(&mut table, line, ' ');
        }
    } else {
        assert_eq!(format, "format binary_little_endian 1.0");
        let mut rest = body;
        for _ in 0..count {
            for (kind, column) in table.types.iter().zip(&mut table.columns) {
                let (value, after) = read_binary(kind, rest);
                column.push(value);
                rest = after;
            }
        }
        assert!(rest.is_empty(), "{} bytes after the last vertex", rest.len());
    }
    assert_eq!(table.rows(), count);
    table
}

fn read_binary<'a>(kind: &str, bytes: &'a [u8]) -> (f64, &'a [u8]) {
    fn take<const N: usize>(bytes: &[u8]) -> ([u8; N], &[u8]) {
        let (head, rest) = bytes.split_first_chunk().expect("the vertex is whole");
        (*head, rest)
    }
    macro_rules! number {
        ($kind:ty) => {{
            let (head, rest) = take(bytes);
            (<$kind>::from_le_bytes(head) as f64, rest)
        }};
    }
    match kind {
        "char" => number!(i8),
        "uchar" => number!(u8),
        "short" => number!(i16),
        "ushort" => number!(u16),
        "int" => number!(i32),
        "uint" => number!(u32),
        "float" => number!(f32),
        "double" => number!(f64),
        _ => panic!("type {kind}"),
    }
}

/// A line of names, then lines of numbers.
pub fn read_delimited(text: &str, separator: char) -> Table {
    let mut lines = text.lines();
    let names: Vec<String> =
        lines.next().expect("a line of names").split(separator).map(str::to_string).collect();
    let columns = vec![Vec::new(); names.len()];
    let mut table = Table { types: vec![String::new(); names.len()], names, columns };
    lines.for_each(|line| add_line(&mut table, line, separator));
    table
}

fn add_line(table: &mut Table, line: &str, separator: char) {
    let numbers: Vec<f64> =
        line.split(separator).map(|number| number.parse().expect("a number")).collect();
    assert_eq!(numbers.len(), table.columns.len(), "{line:?}");
    for (number, column) in numbers.into_iter().zip(&mut table.columns) {
        column.push(number);
    }
}
