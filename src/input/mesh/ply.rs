//! PLY with faces: vertices with colours, normals and texture coordinates, faces of any number of
//! corners. Text and both binary orders.
//!
//! The header is that of scans (`input::ply::header`). A file that is shorter than it claims gives
//! the faces that it has. Not read: colours of faces, triangle strips.

use glam::DVec3;

use super::shape::{Assembly, RawShape};
use crate::input::foreign::ForeignFault;
use crate::input::ply::header::{Element, Encoding, Header, Property};
use crate::input::positioned_file::PositionedFile;
use crate::mesh::Material;
use crate::points::Scalar;

/// Names of the list of a face's corners.
const INDEX_NAMES: [&str; 2] = ["vertex_indices", "vertex_index"];
/// Most corners of a face.
const MOST_CORNERS: f64 = 65_536.0;

/// Whether a file declares faces.
pub(super) fn has_faces(file: &PositionedFile) -> bool {
    Header::read(file).is_ok_and(|header| header.elements.iter().any(is_faces))
}

fn is_faces(element: &Element) -> bool {
    element.count > 0 && element.properties.iter().any(is_corners)
}

fn is_corners(property: &Property) -> bool {
    matches!(property, Property::List { name, .. } if INDEX_NAMES.contains(&name.as_str()))
}

/// Reads a file into one shape.
pub(super) fn read(
    file: &PositionedFile,
    bytes: &[u8],
    parts: &mut Assembly,
) -> Result<(), ForeignFault> {
    let header = Header::read(file)?;
    let rest = bytes.get(header.bytes as usize..).unwrap_or_default();
    let mut values = match header.encoding {
        Encoding::Ascii => Values::Text(rest),
        Encoding::LittleEndian => Values::Binary { rest, swaps: false },
        Encoding::BigEndian => Values::Binary { rest, swaps: true },
    };
    let mut raw = RawShape::default();
    'elements: for element in &header.elements {
        let vertices = (element.name == "vertex").then(|| VertexPlan::of(element));
        let corners = element.properties.iter().position(is_corners);
        if element.properties.is_empty() {
            // However many there are, they take no bytes.
            continue;
        }
        let mut row = Vec::with_capacity(element.properties.len());
        let mut list = Vec::new();
        for index in 0..element.count {
            parts.go_on()?;
            row.clear();
            for (at, property) in element.properties.iter().enumerate() {
                let wanted = (Some(at) == corners).then_some(&mut list);
                let Some(value) = values.property(property, wanted) else {
                    parts.report.note(format!(
                        "the file ends in row {} of {} of \"{}\"",
                        index + 1,
                        element.count,
                        element.name
                    ));
                    break 'elements;
                };
                row.push(value);
            }
            if let Some(plan) = &vertices {
                plan.add(&row, &mut raw);
            } else if corners.is_some() {
                add_face(&list, &mut raw, parts);
            }
        }
    }
    let material = parts.material(Material::default());
    parts.placed_shapes(vec![(raw, material)])
}

fn add_face(list: &[f64], raw: &mut RawShape, parts: &mut Assembly) {
    if list.len() < 3 {
        parts.report.damaged += 1;
        return;
    }
    let vertex = |number: f64| match number {
        number if (0.0..f64::from(u32::MAX)).contains(&number) => number as u32,
        _ => u32::MAX,
    };
    let first = vertex(list[0]);
    let pairs = list[1..].windows(2);
    raw.triangles.extend(pairs.map(|pair| [first, vertex(pair[0]), vertex(pair[1])]));
}

/// Where in a row the values of a vertex stand.
struct VertexPlan {
    place: [usize; 3],
    normal: Option<[usize; 3]>,
    uv: Option<[usize; 2]>,
    color: Option<[usize; 3]>,
    alpha: Option<usize>,
    /// What colours are multiplied with to be bytes.
    color_scale: f64,
}

impl VertexPlan {
    fn of(element: &Element) -> VertexPlan {
        let find = |name: &str| element.properties.iter().position(|p| p.is(name));
        fn all<const N: usize>(
            find: &impl Fn(&str) -> Option<usize>,
            names: [&str; N],
        ) -> Option<[usize; N]> {
            let found = names.map(find);
            found.iter().all(Option::is_some).then(|| found.map(Option::unwrap_or_default))
        }
        let color = all(&find, ["red", "green", "blue"])
            .or_else(|| all(&find, ["diffuse_red", "diffuse_green", "diffuse_blue"]));
        let scalar = color.map(|[red, ..]| match element.properties[red] {
            Property::Number { scalar, .. } => scalar,
            Property::List { count, .. } => count,
        });
        VertexPlan {
            place: all(&find, ["x", "y", "z"]).unwrap_or([usize::MAX; 3]),
            normal: all(&find, ["nx", "ny", "nz"]),
            uv: [["s", "t"], ["u", "v"], ["texture_u", "texture_v"]]
                .into_iter()
                .find_map(|names| all(&find, names)),
            color,
            alpha: find("alpha"),
            color_scale: match scalar {
                Some(Scalar::F32 | Scalar::F64) => 255.0,
                Some(Scalar::U16 | Scalar::I16) => 1.0 / 257.0,
                _ => 1.0,
            },
        }
    }

    fn add(&self, row: &[f64], raw: &mut RawShape) {
        let value = |at: usize| row.get(at).copied().unwrap_or(f64::NAN);
        raw.positions.push(DVec3::from(self.place.map(value)));
        raw.normals.extend(self.normal.map(|at| at.map(|at| value(at) as f32)));
        raw.uvs.extend(self.uv.map(|[u, v]| [value(u) as f32, 1.0 - value(v) as f32]));
        let byte = |at: usize| (value(at) * self.color_scale + 0.5) as u8;
        raw.colors.extend(
            self.color.map(|[r, g, b]| [byte(r), byte(g), byte(b), self.alpha.map_or(255, byte)]),
        );
    }
}

/// The values of a file, one after the other.
enum Values<'a> {
    Text(&'a [u8]),
    Binary { rest: &'a [u8], swaps: bool },
}

impl Values<'_> {
    /// The next value, or the length of the next list, whose items go to `list` if they are
    /// wanted; `None` at the end of the file.
    fn property(&mut self, property: &Property, list: Option<&mut Vec<f64>>) -> Option<f64> {
        match *property {
            Property::Number { scalar, .. } => self.number(scalar),
            Property::List { count, item, .. } => {
                let length = self.number(count)?;
                // A face with more corners is no face; whatever follows it is lost too.
                if !(0.0..=MOST_CORNERS).contains(&length) {
                    return None;
                }
                let mut skipped = Vec::new();
                let list = list.unwrap_or(&mut skipped);
                list.clear();
                for _ in 0..length as usize {
                    list.push(self.number(item)?);
                }
                Some(length)
            }
        }
    }

    fn number(&mut self, scalar: Scalar) -> Option<f64> {
        match self {
            Values::Text(rest) => {
                *rest = rest.trim_ascii_start();
                let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
                let (word, after) = rest.split_at(end);
                *rest = after;
                let text = std::str::from_utf8(word).ok()?;
                // A word that is no number must not shift all that follow.
                (!word.is_empty()).then(|| text.parse().unwrap_or(f64::NAN))
            }
            Values::Binary { rest, swaps } => {
                let (value, after) = rest.split_at_checked(scalar.bytes())?;
                *rest = after;
                let mut bytes = [0; 8];
                bytes[..value.len()].copy_from_slice(value);
                if *swaps {
                    bytes[..value.len()].reverse();
                }
                Some(scalar.read(&bytes))
            }
        }
    }
}
