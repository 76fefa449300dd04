//! A model as the passes that draw it read it: rows of objects, materials, texels with their
//! coarser levels. The device and the CPU draw from the same tables.

use bytemuck::{Pod, Zeroable};
use glam::{DAffine3, DMat3, DVec3, UVec2};
use rayon::prelude::*;

use crate::geometry::View;
use crate::gpu::layout::{GpuMaterial, GpuMeshObject};
use crate::mesh::{Material, Mesh, Model, Texture};

/// One vertex of a shape.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct MeshVertex {
    /// Relative to the shape's origin.
    pub position: [f32; 3],
    /// Unit normal in parts of 32,767; the last is unused.
    pub normal: [i16; 4],
    /// Texture coordinates.
    pub uv: [f32; 2],
    /// RGBA.
    pub color: [u8; 4],
}

/// The vertices of a shape, which must have normals.
pub(super) fn vertices_of(mesh: &Mesh) -> Vec<MeshVertex> {
    let vertex = |at: usize| {
        let [x, y, z] =
            mesh.normals[at].map(|lane| (lane.clamp(-1.0, 1.0) * 32_767.0).round() as i16);
        MeshVertex {
            position: mesh.positions[at],
            normal: [x, y, z, 0],
            uv: mesh.uvs.get(at).copied().unwrap_or_default(),
            color: mesh.colors.get(at).copied().unwrap_or([255; 4]),
        }
    };
    (0..mesh.positions.len()).map(vertex).collect()
}

/// Materials and all texels.
#[derive(Debug, Default)]
pub(super) struct MaterialTables {
    pub materials: Vec<GpuMaterial>,
    /// RGBA8 words.
    pub texels: Vec<u32>,
    /// Textures whose finest levels found no room.
    #[cfg_attr(not(feature = "gpu"), allow(dead_code, reason = "only the device has limits"))]
    pub reduced_textures: u32,
}

impl MaterialTables {
    /// Tables of a model with at most so many texels: the finest levels of the largest textures are
    /// left out until the others fit.
    pub fn new(model: &Model, most_texels: u64) -> Self {
        let mut levels: Vec<Vec<Level>> = model.textures.par_iter().map(levels_of).collect();
        let texels = |levels: &[Level]| levels.iter().map(Level::texels).sum::<u64>();
        let mut total: u64 = levels.iter().map(|levels| texels(levels)).sum();
        let mut is_reduced = vec![false; levels.len()];
        while total > most_texels {
            let largest = (0..levels.len()).max_by_key(|&at| levels[at].first().map(Level::texels));
            let Some(at) = largest.filter(|&at| !levels[at].is_empty()) else { break };
            total -= levels[at].remove(0).texels();
            is_reduced[at] = true;
        }
        let reduced_textures = is_reduced.iter().filter(|reduced| **reduced).count() as u32;
        let mut tables = MaterialTables { reduced_textures, ..MaterialTables::default() };
        let mut places = Vec::with_capacity(levels.len());
        for levels in &levels {
            places.push(tables.texels.len() as u32);
            levels.iter().for_each(|level| tables.texels.extend(&level.words));
        }
        let row = |material: &Material| {
            let texture = material.texture.map(|texture| texture.index());
            let kept = texture.map(|at| (places[at], &levels[at]));
            let kept = kept.filter(|(_, levels)| !levels.is_empty());
            GpuMaterial {
                color: u32::from_le_bytes(material.color),
                alpha_cutoff: material.alpha_cutoff.unwrap_or(0.0),
                texture_at: kept.map_or(0, |(at, _)| at),
                texture_width: kept.map_or(0, |(_, levels)| levels[0].size.x),
                texture_height: kept.map_or(0, |(_, levels)| levels[0].size.y),
                texture_levels: kept.map_or(0, |(_, levels)| levels.len() as u32),
                padding_0: 0,
                padding_1: 0,
            }
        };
        tables.materials = model.materials.iter().map(row).collect();
        tables
    }
}

/// One level of a texture.
struct Level {
    size: UVec2,
    words: Vec<u32>,
}

impl Level {
    fn texels(&self) -> u64 {
        self.words.len() as u64
    }
}

/// A texture, and itself again and again with half the sides, down to one texel.
fn levels_of(texture: &Texture) -> Vec<Level> {
    let size = UVec2::new(texture.width, texture.height);
    let is_whole = texture.pixels.len() as u64 == u64::from(size.x) * u64::from(size.y);
    if texture.pixels.is_empty() || !is_whole {
        return Vec::new();
    }
    let words = texture.pixels.iter().map(|&pixel| u32::from_le_bytes(pixel)).collect();
    let mut levels = vec![Level { size, words }];
    while let Some(last) = levels.last()
        && last.size.max_element() > 1
    {
        let size = (last.size / 2).max(UVec2::ONE);
        let texel = |at: UVec2| {
            let mut sums = [0u32; 4];
            for step in [UVec2::ZERO, UVec2::X, UVec2::Y, UVec2::ONE] {
                let from = (at * 2 + step).min(last.size - 1);
                let word = last.words[(from.y * last.size.x + from.x) as usize];
                word.to_le_bytes().iter().zip(&mut sums).for_each(|(b, sum)| *sum += u32::from(*b));
            }
            u32::from_le_bytes(sums.map(|sum| ((sum + 2) / 4) as u8))
        };
        let places = (0..size.y).flat_map(|y| (0..size.x).map(move |x| UVec2::new(x, y)));
        levels.push(Level { size, words: places.map(texel).collect() });
    }
    levels
}

/// The row of an object before a camera.
pub(super) fn object_row(place: &DAffine3, material: u32, view: &View) -> GpuMeshObject {
    let camera = &view.camera;
    let focal_px = view.focal_px();
    let screen_from_world =
        DMat3::from_cols(camera.right() * focal_px, camera.up * -focal_px, camera.forward)
            .transpose();
    let screen_from_mesh = screen_from_world * place.matrix3;
    let DMat3 { x_axis: a, y_axis: b, z_axis: c } = place.matrix3;
    let determinant = place.matrix3.determinant();
    let inverse = place.matrix3.inverse();
    let eye = inverse * (camera.eye - place.translation);
    let largest = a.abs().max(b.abs()).max(c.abs()).max_element();
    // Flat placements have no inverse, those nearly so none that helps.
    let is_solid = determinant.abs() > 1e-9 * largest.powi(3) && eye.is_finite();
    let (eye, offset) = match is_solid && eye.abs().max_element() < 1e30 {
        true => (eye, DVec3::ZERO),
        false => (DVec3::ZERO, screen_from_world * (place.translation - camera.eye)),
    };
    let high = eye.as_vec3();
    let column = |axis: usize| {
        let [x, y, z] = screen_from_mesh.col(axis).as_vec3().to_array();
        [x, y, z, offset[axis] as f32]
    };
    let sign = if determinant < 0.0 { -1.0 } else { 1.0 };
    let unit = |normal: DVec3| {
        let scale = if largest > 0.0 { largest.powi(2).recip() } else { 0.0 };
        (normal * (sign * scale)).as_vec3().extend(0.0).to_array()
    };
    GpuMeshObject {
        screen_from_mesh_x: column(0),
        screen_from_mesh_y: column(1),
        screen_from_mesh_z: column(2),
        eye_high: high.to_array(),
        material,
        eye_low: (eye - high.as_dvec3()).as_vec3().to_array(),
        padding_0: 0,
        normal_x: unit(b.cross(c)),
        normal_y: unit(c.cross(a)),
        normal_z: unit(a.cross(b)),
    }
}

/// What decides how the triangles of an object are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Surface {
    /// Backs are left out.
    pub single_sided: bool,
    /// The placement mirrors, so that clockwise triangles face the eye.
    pub mirrored: bool,
    /// Fragments may be left out.
    pub cut_out: bool,
}

impl Surface {
    pub fn of(material: &Material, place: &DAffine3) -> Self {
        Surface {
            single_sided: !material.double_sided,
            mirrored: place.matrix3.determinant() < 0.0,
            cut_out: material.alpha_cutoff.is_some(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::TextureId;

    fn model(sides: &[u32]) -> Model {
        let texture = |&side: &u32| Texture {
            width: side,
            height: side,
            pixels: vec![[10, 20, 30, 40]; (side * side) as usize],
        };
        let material =
            |at: usize| Material { texture: Some(TextureId(at as u32)), ..Material::default() };
        Model {
            textures: sides.iter().map(texture).collect(),
            materials: (0..sides.len()).map(material).collect(),
            ..Model::default()
        }
    }

    #[test]
    fn textures_have_all_levels() {
        let tables = MaterialTables::new(&model(&[5]), u64::MAX);
        assert_eq!(tables.texels.len(), 25 + 4 + 1);
        assert_eq!(tables.materials[0].texture_levels, 3);
        assert!(tables.texels.iter().all(|&word| word.to_le_bytes() == [10, 20, 30, 40]));
    }

    #[test]
    fn without_room_the_largest_textures_lose_their_finest_levels() {
        let tables = MaterialTables::new(&model(&[16, 4]), 120);
        let sides: Vec<_> = tables.materials.iter().map(|m| m.texture_width).collect();
        assert_eq!((sides, tables.reduced_textures), (vec![8, 4], 1));
        let none = MaterialTables::new(&model(&[16, 4]), 0);
        assert_eq!((none.texels.len(), none.materials[0].texture_levels), (0, 0));
    }
}
