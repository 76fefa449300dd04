//! STL: loose triangles, binary or as text.
//!
//! Equal corners become one vertex, so that surfaces are shaded as such. The normals of the file
//! are those of its faces and are not needed. A file that is shorter than it claims gives the
//! triangles that it has.

use std::collections::HashMap;

use glam::DVec3;

use super::shape::{Assembly, RawShape};
use crate::input::foreign::ForeignFault;
use crate::mesh::Material;

const HEADER_BYTES: usize = 84;
const TRIANGLE_BYTES: usize = 50;

/// Reads a file into one shape.
pub(super) fn read(bytes: &[u8], parts: &mut Assembly) -> Result<(), ForeignFault> {
    let mut welder = Welder::default();
    match is_text(bytes) {
        true => read_text(bytes, &mut welder, parts)?,
        false => read_binary(bytes, &mut welder, parts)?,
    }
    let material = parts.material(Material::default());
    parts.placed_shapes(vec![(welder.shape, material)])
}

/// Both kinds may begin with "solid"; the length that a binary file claims decides.
fn is_text(bytes: &[u8]) -> bool {
    let begins = bytes.trim_ascii_start().starts_with(b"solid");
    let claimed = claimed(bytes).map(|count| HEADER_BYTES as u64 + 50 * u64::from(count));
    let head = &bytes[..bytes.len().min(1024)];
    begins && claimed != Some(bytes.len() as u64) && !head.contains(&0)
}

fn claimed(bytes: &[u8]) -> Option<u32> {
    let count = bytes.get(80..84)?;
    Some(u32::from_le_bytes(count.try_into().ok()?))
}

fn read_binary(
    bytes: &[u8],
    welder: &mut Welder,
    parts: &mut Assembly,
) -> Result<(), ForeignFault> {
    let claimed = claimed(bytes).ok_or_else(|| {
        ForeignFault::at("header", format!("{} bytes, STL needs {HEADER_BYTES}", bytes.len()))
    })?;
    let rows = bytes[HEADER_BYTES..].chunks_exact(TRIANGLE_BYTES);
    if (rows.len() as u64) < u64::from(claimed) {
        let note = format!("the header claims {claimed} triangles, the file has {}", rows.len());
        parts.report.note(note);
    }
    for row in rows.take(claimed as usize) {
        parts.go_on()?;
        let number =
            |at: usize| f32::from_le_bytes([row[at], row[at + 1], row[at + 2], row[at + 3]]);
        let corner = |at: usize| [number(at), number(at + 4), number(at + 8)].map(f64::from);
        welder.triangle([corner(12), corner(24), corner(36)]);
    }
    Ok(())
}

fn read_text(bytes: &[u8], welder: &mut Welder, parts: &mut Assembly) -> Result<(), ForeignFault> {
    let mut corners = Vec::with_capacity(4);
    for line in bytes.split(|&byte| byte == b'\n' || byte == b'\r') {
        parts.go_on()?;
        let mut words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
        match words.next() {
            Some(b"vertex") => {
                let mut next = || {
                    let word = std::str::from_utf8(words.next()?).ok()?;
                    word.parse::<f64>().ok()
                };
                let numbers = [next(), next(), next()];
                if numbers.contains(&None) {
                    parts.report.damaged += 1;
                }
                corners.push(numbers.map(|number| number.unwrap_or(f64::NAN)));
            }
            Some(b"endfacet" | b"endloop") if !corners.is_empty() => {
                match corners[..] {
                    [a, b, c] => welder.triangle([a, b, c]),
                    _ => parts.report.damaged += 1,
                }
                corners.clear();
            }
            _ => {}
        }
    }
    parts.report.damaged += u64::from(!corners.is_empty());
    Ok(())
}

#[derive(Default)]
struct Welder {
    shape: RawShape,
    vertex_of: HashMap<[u64; 3], u32>,
}

impl Welder {
    fn triangle(&mut self, corners: [[f64; 3]; 3]) {
        let vertices = corners.map(|corner| {
            // Both zeros are the same place.
            let corner = corner.map(|number| number + 0.0);
            *self.vertex_of.entry(corner.map(f64::to_bits)).or_insert_with(|| {
                self.shape.positions.push(DVec3::from(corner));
                self.shape.positions.len() as u32 - 1
            })
        });
        self.shape.triangles.push(vertices);
    }
}
