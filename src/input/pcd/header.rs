//! The header of a PCD file.

use glam::{DQuat, DVec3};

use crate::input::foreign::{ForeignFault, Pose};
use crate::input::positioned_file::PositionedFile;
use crate::input::table::Field;
use crate::points::Scalar;

/// Longest header that is accepted.
const MOST_BYTES: u64 = 1 << 20;

/// How values are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// As text.
    Ascii,
    /// Point after point.
    Binary,
    /// Field after field, compressed.
    Compressed,
}

impl Encoding {
    /// Format and variant, as facts name them.
    pub fn name(self) -> &'static str {
        match self {
            Encoding::Ascii => "pcd ascii",
            Encoding::Binary => "pcd binary",
            Encoding::Compressed => "pcd binary_compressed",
        }
    }
}

/// A header.
#[derive(Clone, Debug)]
pub struct Header {
    /// How values are written.
    pub encoding: Encoding,
    /// Fields of a point.
    pub fields: Vec<Field>,
    /// Number of points, as claimed.
    pub points: u64,
    /// The viewpoint, if it is anywhere else than in the origin.
    pub pose: Option<Pose>,
    /// What is odd.
    pub warnings: Vec<String>,
    /// Where it ends.
    pub bytes: u64,
    /// Its lines.
    pub lines: u64,
}

/// Entries as they come.
#[derive(Default)]
struct Entries {
    names: Vec<String>,
    sizes: Vec<usize>,
    types: Vec<char>,
    counts: Vec<u16>,
    width: Option<u64>,
    height: Option<u64>,
    points: Option<u64>,
    pose: Option<Pose>,
}

impl Header {
    /// Reads the lines up to `DATA`.
    pub fn read(file: &PositionedFile) -> Result<Header, ForeignFault> {
        let head = file.read_range(0..file.bytes().min(MOST_BYTES))?;
        let mut entries = Entries::default();
        let mut at = 0;
        for line in 1.. {
            let Some(length) = head[at..].iter().position(|&byte| byte == b'\n') else {
                let reason = "the header has no end: \"DATA\" is missing";
                return Err(ForeignFault::at_line(line, reason));
            };
            let text = String::from_utf8_lossy(&head[at..at + length]).into_owned();
            at += length + 1;
            let fault = |reason: String| ForeignFault::at_line(line, reason);
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            let Some((&key, values)) = words.split_first() else { continue };
            if key == "DATA" {
                let encoding = match values {
                    ["ascii"] => Encoding::Ascii,
                    ["binary"] => Encoding::Binary,
                    ["binary_compressed"] => Encoding::Compressed,
                    _ => return Err(fault(format!("unknown encoding \"{}\"", shown(&text)))),
                };
                return entries.finish(encoding, at as u64, line).map_err(fault);
            }
            entries
                .take(key, values)
                .ok_or_else(|| fault(format!("odd line \"{}\"", shown(&text))))?;
        }
        unreachable!("the lines of a file end");
    }
}

fn shown(text: &str) -> String {
    text.chars().take(40).collect::<String>().escape_debug().to_string()
}

fn all<T: std::str::FromStr>(values: &[&str]) -> Option<Vec<T>> {
    values.iter().map(|value| value.parse().ok()).collect()
}

impl Entries {
    /// Takes a line in; nothing if it makes no sense.
    fn take(&mut self, key: &str, values: &[&str]) -> Option<()> {
        let one = || values.first()?.parse::<u64>().ok();
        match key {
            "FIELDS" | "COLUMNS" => self.names = all(values)?,
            "SIZE" => self.sizes = all(values)?,
            "TYPE" => self.types = all(values)?,
            "COUNT" => self.counts = all(values)?,
            "WIDTH" => self.width = Some(one()?),
            "HEIGHT" => self.height = Some(one()?),
            "POINTS" => self.points = Some(one()?),
            "VIEWPOINT" => self.pose = pose(&all::<f64>(values)?),
            "VERSION" => {}
            _ if key.starts_with('#') => {}
            _ => return None,
        }
        Some(())
    }

    fn finish(self, encoding: Encoding, bytes: u64, lines: u64) -> Result<Header, String> {
        let Entries { names, sizes, types, mut counts, width, height, points, pose } = self;
        if counts.is_empty() {
            counts = vec![1; names.len()];
        }
        let lengths = [sizes.len(), types.len(), counts.len()];
        if names.is_empty() || lengths != [names.len(); 3] {
            return Err(format!(
                "{} fields with {} sizes, {} types and {} counts",
                names.len(),
                sizes.len(),
                types.len(),
                counts.len()
            ));
        }
        let mut fields = Vec::with_capacity(names.len());
        for (((name, size), kind), count) in names.into_iter().zip(sizes).zip(types).zip(counts) {
            let scalar = scalar_of(kind, size)
                .ok_or_else(|| format!("field \"{}\" has type {kind}{size}", shown(&name)))?;
            if count == 0 {
                return Err(format!("field \"{}\" has no components", shown(&name)));
            }
            fields.push(Field { name, scalar, count });
        }
        let grid = width.map(|width| width.saturating_mul(height.unwrap_or(1)));
        let points =
            points.or(grid).ok_or("neither POINTS nor WIDTH tells the number of points")?;
        let mut warnings = Vec::new();
        if let Some(grid) = grid.filter(|&grid| grid != points) {
            warnings.push(format!(
                "WIDTH and HEIGHT give {grid} points, POINTS says {points}, which are read"
            ));
        }
        Ok(Header { encoding, fields, points, pose, warnings, bytes, lines })
    }
}

fn scalar_of(kind: char, size: usize) -> Option<Scalar> {
    Some(match (kind, size) {
        ('I', 1) => Scalar::I8,
        ('I', 2) => Scalar::I16,
        ('I', 4) => Scalar::I32,
        ('I', 8) => Scalar::I64,
        ('U', 1) => Scalar::U8,
        ('U', 2) => Scalar::U16,
        ('U', 4) => Scalar::U32,
        ('U', 8) => Scalar::U64,
        ('F', 4) => Scalar::F32,
        ('F', 8) => Scalar::F64,
        _ => return None,
    })
}

/// Translation, then quaternion w, x, y, z; nothing for the origin and for what is no pose.
fn pose(values: &[f64]) -> Option<Pose> {
    let &[tx, ty, tz, w, x, y, z] = values else { return None };
    let translation = DVec3::new(tx, ty, tz);
    let rotation = DQuat::from_xyzw(x, y, z, w);
    let length = rotation.length();
    let usable = translation.is_finite() && length.is_finite() && length > 0.0;
    let is_identity = translation == DVec3::ZERO && rotation == DQuat::IDENTITY;
    (usable && !is_identity).then(|| Pose { rotation: rotation / length, translation })
}
