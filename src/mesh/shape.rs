//! One shape: triangles over shared vertices.

use glam::{DVec3, Vec3};

use crate::geometry::Aabb;

/// Triangles over vertices, in the shape's own axes.
///
/// `normals`, `uvs` and `colors` are each empty or as long as `positions`. Readers see to it that
/// positions are finite and that triangles name existing vertices; [`Mesh::check`] proves it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Corners, relative to the shape's origin.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals per vertex; empty where faces are to be shaded flat.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates per vertex, (0, 0) at the texture's upper left corner.
    pub uvs: Vec<[f32; 2]>,
    /// Colour and opacity per vertex, sRGB.
    pub colors: Vec<[u8; 4]>,
    /// Vertex numbers, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// The smallest box around the vertices, in the shape's own axes; empty without vertices.
    pub fn bounds(&self) -> Aabb {
        self.positions.iter().fold(Aabb::EMPTY, |bounds, &position| {
            bounds.including(Vec3::from(position).as_dvec3())
        })
    }

    /// The corners of a triangle, in f64.
    pub fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.triangles[triangle]
            .map(|vertex| Vec3::from(self.positions[vertex as usize]).as_dvec3())
    }

    /// What breaks the type's promises, in words; `None` if nothing does.
    pub fn check(&self) -> Option<String> {
        let vertices = self.positions.len();
        for (name, len) in [
            ("normals", self.normals.len()),
            ("texture coordinates", self.uvs.len()),
            ("colours", self.colors.len()),
        ] {
            if len != 0 && len != vertices {
                return Some(format!("{len} {name} for {vertices} vertices"));
            }
        }
        if let Some(at) = self.positions.iter().position(|p| !Vec3::from(*p).is_finite()) {
            return Some(format!("vertex {at} is not finite"));
        }
        let outside = |triangle: &[u32; 3]| triangle.iter().any(|&v| v as usize >= vertices);
        let at = self.triangles.iter().position(outside)?;
        Some(format!("triangle {at} names a vertex beyond {vertices}"))
    }
}
