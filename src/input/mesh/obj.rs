//! Wavefront OBJ: vertices in f64, faces of any number of corners, materials of MTL files.
//!
//! Each object or group with each of its materials is a shape. Faces are cut into triangles around
//! their first corner. A face that makes no sense is counted; the next one is drawn. Not read:
//! curves, free-form surfaces, smoothing groups, points and lines.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::DVec3;

use super::mtl;
use super::shape::{Assembly, RawShape};
use crate::ids::{MaterialId, TextureId};
use crate::input::foreign::ForeignFault;
use crate::mesh::Material;

/// A corner of a face: position, texture coordinate, normal, counted from 0; `NONE` without one.
type Corner = [u32; 3];
const NONE: u32 = u32::MAX;

/// The lists of a file and the shapes of its faces.
struct Reader<'a> {
    folder: &'a Path,
    parts: &'a mut Assembly,
    positions: Vec<DVec3>,
    /// As long as `positions`, or empty as long as no vertex had one.
    colors: Vec<[f32; 3]>,
    uvs: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
    textures: HashMap<PathBuf, Option<TextureId>>,
    materials: HashMap<String, MaterialId>,
    plain: Option<MaterialId>,
    material: Option<MaterialId>,
    group: u32,
    shapes: Vec<(Shape, MaterialId)>,
    shape_of: HashMap<(u32, MaterialId), usize>,
}

/// Faces of one object and material, with vertices of their own.
#[derive(Default)]
struct Shape {
    corners: Vec<Corner>,
    vertex_of: HashMap<Corner, u32>,
    triangles: Vec<[u32; 3]>,
}

/// Reads a file.
pub(super) fn read(bytes: &[u8], folder: &Path, parts: &mut Assembly) -> Result<(), ForeignFault> {
    let mut reader = Reader {
        folder,
        parts,
        positions: Vec::new(),
        colors: Vec::new(),
        uvs: Vec::new(),
        normals: Vec::new(),
        textures: HashMap::new(),
        materials: HashMap::new(),
        plain: None,
        material: None,
        group: 0,
        shapes: Vec::new(),
        shape_of: HashMap::new(),
    };
    let mut joined = String::new();
    for line in bytes.split(|&byte| byte == b'\n') {
        reader.parts.go_on()?;
        let Ok(line) = std::str::from_utf8(line) else {
            // Names may be in any encoding; numbers are not.
            reader.line(&String::from_utf8_lossy(line));
            continue;
        };
        let line = line.trim_end();
        if let Some(start) = line.strip_suffix('\\') {
            joined.push_str(start);
            joined.push(' ');
        } else if joined.is_empty() {
            reader.line(line);
        } else {
            joined.push_str(line);
            reader.line(&joined);
            joined.clear();
        }
    }
    reader.line(&joined);
    reader.finish()
}

impl Reader<'_> {
    fn line(&mut self, line: &str) {
        let line = line.trim();
        let (key, rest) = line.split_once([' ', '\t']).unwrap_or((line, ""));
        match key {
            "v" => self.vertex(rest),
            "vt" => {
                let [u, v] = first_numbers(rest).map(|number| number as f32);
                self.uvs.push([u, 1.0 - v]);
            }
            "vn" => {
                let normal: [f64; 3] = first_numbers(rest);
                self.normals.push(normal.map(|number| number as f32));
            }
            "f" => self.face(rest),
            "o" | "g" => self.group += 1,
            "usemtl" => {
                let name = rest.trim();
                self.material = self.materials.get(name).copied();
                if self.material.is_none() {
                    self.parts.report.missing_materials += 1;
                    // Once is enough for a name.
                    let plain = self.plain();
                    self.materials.insert(name.to_string(), plain);
                    self.material = Some(plain);
                }
            }
            "mtllib" => self.library(rest.trim()),
            "p" | "l" => self.parts.report.no_triangles += 1,
            _ => {}
        }
    }

    fn vertex(&mut self, rest: &str) {
        let mut numbers = rest.split_ascii_whitespace().map(|word| word.parse::<f64>());
        let mut next = || numbers.next().map(|number| number.unwrap_or(f64::NAN));
        let mut place = || next().unwrap_or(f64::NAN);
        self.positions.push(DVec3::new(place(), place(), place()));
        // Three more are a colour, four more a weight and a colour.
        let more: [Option<f64>; 4] = std::array::from_fn(|_| next());
        let color = match more {
            [Some(r), Some(g), Some(b), None] | [_, Some(r), Some(g), Some(b)] => Some([r, g, b]),
            _ => None,
        };
        if color.is_some() && self.colors.is_empty() {
            self.colors.resize(self.positions.len() - 1, [1.0; 3]);
        }
        if color.is_some() || !self.colors.is_empty() {
            self.colors.push(color.map_or([1.0; 3], |color| color.map(|c| c as f32)));
        }
    }

    fn face(&mut self, rest: &str) {
        let counts = [self.positions.len(), self.uvs.len(), self.normals.len()];
        let mut corners: Vec<Corner> = Vec::with_capacity(4);
        for word in rest.split_ascii_whitespace() {
            match corner_of(word, counts) {
                Some(corner) => corners.push(corner),
                None => {
                    self.parts.report.damaged += 1;
                    return;
                }
            }
        }
        if corners.len() < 3 {
            self.parts.report.damaged += 1;
            return;
        }
        let is_there = |corner: &Corner| (corner[0] as usize) < counts[0];
        if !corners.iter().all(is_there) {
            self.parts.report.out_of_range += corners.len() as u64 - 2;
            return;
        }
        let plain = self.material.unwrap_or_else(|| self.plain());
        let shapes = &mut self.shapes;
        let at = *self.shape_of.entry((self.group, plain)).or_insert_with(|| {
            shapes.push((Shape::default(), plain));
            shapes.len() - 1
        });
        let shape = &mut self.shapes[at].0;
        let vertices: Vec<u32> = corners.into_iter().map(|corner| shape.vertex(corner)).collect();
        let pairs = vertices[1..].windows(2);
        shape.triangles.extend(pairs.map(|pair| [vertices[0], pair[0], pair[1]]));
    }

    fn library(&mut self, names: &str) {
        // One name with spaces, or several names.
        let whole = self.folder.join(names);
        let libraries = match whole.is_file() {
            true => vec![whole],
            false => names.split_ascii_whitespace().map(|name| self.folder.join(name)).collect(),
        };
        for path in libraries {
            mtl::read(&path, self.parts, &mut self.textures, &mut self.materials);
        }
    }

    fn plain(&mut self) -> MaterialId {
        *self.plain.get_or_insert_with(|| self.parts.material(Material::default()))
    }

    fn finish(self) -> Result<(), ForeignFault> {
        let Reader { positions, colors, uvs, normals, shapes, parts, .. } = self;
        // Colours are shares or bytes; nobody says which.
        let is_bytes = colors.iter().flatten().any(|&c| c > 1.0);
        let byte = |c: f32| (if is_bytes { c } else { c * 255.0 } + 0.5) as u8;
        let shapes = shapes.into_iter().map(|(shape, material)| {
            let corners = &shape.corners;
            let has = |which: usize, count: usize| {
                count > 0 && corners.iter().all(|corner| (corner[which] as usize) < count)
            };
            let mut raw = RawShape {
                positions: corners.iter().map(|corner| positions[corner[0] as usize]).collect(),
                triangles: shape.triangles,
                ..RawShape::default()
            };
            if has(1, uvs.len()) {
                raw.uvs = corners.iter().map(|corner| uvs[corner[1] as usize]).collect();
            }
            if has(2, normals.len()) {
                raw.normals = corners.iter().map(|corner| normals[corner[2] as usize]).collect();
            }
            if has(0, colors.len()) {
                let color = |corner: &Corner| {
                    let [r, g, b] = colors[corner[0] as usize].map(byte);
                    [r, g, b, 255]
                };
                raw.colors = corners.iter().map(color).collect();
            }
            (raw, material)
        });
        let shapes = shapes.collect();
        parts.placed_shapes(shapes)
    }
}

impl Shape {
    fn vertex(&mut self, corner: Corner) -> u32 {
        *self.vertex_of.entry(corner).or_insert_with(|| {
            self.corners.push(corner);
            self.corners.len() as u32 - 1
        })
    }
}

/// `7`, `7/1`, `7//2` or `7/1/2`; negative numbers count back from the last one. `None` if that is
/// no corner; a position that is not there becomes [`NONE`].
fn corner_of(word: &str, counts: [usize; 3]) -> Option<Corner> {
    let mut corner = [NONE; 3];
    let mut given = word.split('/');
    for (which, count) in counts.into_iter().enumerate() {
        let text = given.next().unwrap_or("");
        if text.is_empty() && which > 0 {
            continue;
        }
        let number: i64 = text.parse().ok()?;
        let at = if number < 0 { number + count as i64 } else { number - 1 };
        if (0..count as i64).contains(&at) {
            corner[which] = u32::try_from(at).ok()?;
        }
    }
    given.next().is_none().then_some(corner)
}

/// The first numbers of a line; those that are missing are no numbers.
fn first_numbers<const N: usize>(text: &str) -> [f64; N] {
    let mut words = text.split_ascii_whitespace();
    std::array::from_fn(|_| words.next().and_then(|word| word.parse().ok()).unwrap_or(f64::NAN))
}

/// All numbers up to the first word that is none.
pub(super) fn numbers(text: &str) -> Vec<f64> {
    text.split_ascii_whitespace().map_while(|word| word.parse().ok()).collect()
}

/// What follows the first word.
pub(super) fn text_after<'a>(text: &'a str, word: &str) -> &'a str {
    text[word.len()..].trim_start()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_count_from_both_ends() {
        let counts = [8, 4, 2];
        assert_eq!(corner_of("1/2/2", counts), Some([0, 1, 1]));
        assert_eq!(corner_of("-1//-2", counts), Some([7, NONE, 0]));
        assert_eq!(corner_of("3", counts), Some([2, NONE, NONE]));
        assert_eq!(corner_of("9/1", counts), Some([NONE, 0, NONE]));
        assert_eq!(corner_of("0", counts), Some([NONE; 3]));
        for bad in ["", "a", "1/x", "1/1/1/1", "1.5", "99999999999999999999"] {
            assert_eq!(corner_of(bad, counts), None, "{bad}");
        }
    }
}
