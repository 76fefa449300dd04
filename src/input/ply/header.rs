//! The header of a PLY file: what elements it declares, with what properties.

use crate::input::foreign::ForeignFault;
use crate::input::positioned_file::PositionedFile;
use crate::points::Scalar;

/// Longest header that is accepted.
const MOST_BYTES: u64 = 1 << 20;
/// Most properties of an element that are accepted.
const MOST_PROPERTIES: usize = 4096;

/// How values are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// As text.
    Ascii,
    /// Least significant byte first.
    LittleEndian,
    /// Most significant byte first.
    BigEndian,
}

impl Encoding {
    /// Format and variant, as facts name them.
    pub fn name(self) -> &'static str {
        match self {
            Encoding::Ascii => "ply ascii",
            Encoding::LittleEndian => "ply binary_little_endian",
            Encoding::BigEndian => "ply binary_big_endian",
        }
    }
}

/// A property of an element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Property {
    /// One number.
    Number {
        /// Its name.
        name: String,
        /// Its type.
        scalar: Scalar,
    },
    /// A count and as many numbers.
    List {
        /// Its name.
        name: String,
        /// Type of the count.
        count: Scalar,
        /// Type of the numbers.
        item: Scalar,
    },
}

impl Property {
    /// Whether it is the number of that name.
    pub fn is(&self, wanted: &str) -> bool {
        matches!(self, Property::Number { name, .. } if name == wanted)
    }
}

/// A declared element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Element {
    /// Its name.
    pub name: String,
    /// How many there are, as claimed.
    pub count: u64,
    /// What each holds.
    pub properties: Vec<Property>,
}

impl Element {
    /// Whether its rows have different sizes.
    pub fn has_lists(&self) -> bool {
        self.properties.iter().any(|property| matches!(property, Property::List { .. }))
    }
}

/// A header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// How values are written.
    pub encoding: Encoding,
    /// Elements in file order.
    pub elements: Vec<Element>,
    /// Where it ends.
    pub bytes: u64,
    /// Its lines.
    pub lines: u64,
}

impl Header {
    /// Reads the lines up to `end_header`.
    pub fn read(file: &PositionedFile) -> Result<Header, ForeignFault> {
        let head = file.read_range(0..file.bytes().min(MOST_BYTES))?;
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        let mut at = 0;
        for line in 1.. {
            let Some(length) = head[at..].iter().position(|&byte| byte == b'\n') else {
                let reason = "the header has no end: \"end_header\" is missing";
                return Err(ForeignFault::at_line(line, reason));
            };
            let text = String::from_utf8_lossy(&head[at..at + length]).into_owned();
            at += length + 1;
            let fault = |reason: String| ForeignFault::at_line(line, reason);
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            match words[..] {
                ["end_header", ..] => {
                    let reason = || fault("the header names no format".into());
                    let encoding = encoding.ok_or_else(reason)?;
                    return Ok(Header { encoding, elements, bytes: at as u64, lines: line });
                }
                ["format", name, _] => encoding = Some(encoding_of(name).map_err(fault)?),
                ["element", name, count] => {
                    let count = count.parse();
                    let count = count.map_err(|_| fault(format!("odd count in \"{text}\"")))?;
                    let name = name.to_string();
                    elements.push(Element { name, count, properties: Vec::new() });
                }
                ["property", ref rest @ ..] => {
                    let element = elements.last_mut();
                    let element =
                        element.ok_or_else(|| fault("a property before any element".into()))?;
                    element.properties.push(property_of(rest).map_err(fault)?);
                    if element.properties.len() > MOST_PROPERTIES {
                        return Err(fault(format!("more than {MOST_PROPERTIES} properties")));
                    }
                }
                [] | ["ply" | "comment" | "obj_info", ..] => {}
                _ => return Err(fault(format!("unknown line \"{}\"", shortened(&text)))),
            }
        }
        unreachable!("the lines of a file end");
    }
}

fn shortened(text: &str) -> String {
    text.chars().take(40).collect::<String>().escape_debug().to_string()
}

fn encoding_of(name: &str) -> Result<Encoding, String> {
    match name {
        "ascii" => Ok(Encoding::Ascii),
        "binary_little_endian" => Ok(Encoding::LittleEndian),
        "binary_big_endian" => Ok(Encoding::BigEndian),
        other => Err(format!("unknown format \"{}\"", shortened(other))),
    }
}

fn property_of(words: &[&str]) -> Result<Property, String> {
    match *words {
        ["list", count, item, name] => {
            let (count, item) = (scalar_of(count)?, scalar_of(item)?);
            if matches!(count, Scalar::F32 | Scalar::F64) {
                return Err(format!("the length of list \"{name}\" is no whole number"));
            }
            Ok(Property::List { name: name.to_string(), count, item })
        }
        [scalar, name] => {
            Ok(Property::Number { name: name.to_string(), scalar: scalar_of(scalar)? })
        }
        _ => Err(format!("odd property \"{}\"", shortened(&words.join(" ")))),
    }
}

fn scalar_of(name: &str) -> Result<Scalar, String> {
    Ok(match name {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "int64" | "long" => Scalar::I64,
        "uint64" | "ulong" => Scalar::U64,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        other => return Err(format!("unknown type \"{}\"", shortened(other))),
    })
}
