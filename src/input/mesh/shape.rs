//! Shapes as readers find them, made sound: triangles that cannot be drawn are counted and left
//! out, coordinates brought near an origin, large shapes split.
//!
//! Shapes of one file that touch must still touch when drawn, so all of them share one origin and
//! a vertex gets the same f32 wherever it stands; only files wider than [`MOST_SHARED_EXTENT`]
//! have an origin per group, since f32 would become coarser than a millimetre. Shapes of more than
//! [`MOST_GROUP_TRIANGLES`] triangles are split into groups of at most so many that lie close
//! together.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;

use super::report::ModelReport;
use crate::geometry::Aabb;
use crate::ids::{MaterialId, MeshId, TextureId};
use crate::input::foreign::ForeignFault;
use crate::mesh::{MOST_GROUP_TRIANGLES, Material, Mesh, Model, Object, Texture, compact_groups};

/// Widest extent of shapes that share an origin: f32 keeps a millimetre within.
const MOST_SHARED_EXTENT: f64 = 16_384.0;

/// A shape as it stands in a file.
#[derive(Clone, Debug, Default)]
pub(super) struct RawShape {
    pub positions: Vec<DVec3>,
    /// Empty or one per position.
    pub normals: Vec<[f32; 3]>,
    /// Empty or one per position.
    pub uvs: Vec<[f32; 2]>,
    /// Empty or one per position.
    pub colors: Vec<[u8; 4]>,
    /// May name anything.
    pub triangles: Vec<[u32; 3]>,
}

/// A model in the making.
#[derive(Debug)]
pub(super) struct Assembly {
    model: Model,
    pub report: ModelReport,
    world_from_file: DAffine3,
    cancelled: Arc<AtomicBool>,
}

impl Assembly {
    /// An empty model; reading ends when `cancelled` is set.
    pub fn new(world_from_file: DAffine3, cancelled: Arc<AtomicBool>) -> Self {
        let report = ModelReport::default();
        Assembly { model: Model::default(), report, world_from_file, cancelled }
    }

    /// An error if nobody wants the model any more; asked for every row.
    pub fn go_on(&self) -> Result<(), ForeignFault> {
        match self.cancelled.load(Ordering::Relaxed) {
            true => Err(ForeignFault::at("reading", "cancelled")),
            false => Ok(()),
        }
    }

    /// Adds a material.
    pub fn material(&mut self, material: Material) -> MaterialId {
        self.model.materials.push(material);
        MaterialId(self.model.materials.len() as u32 - 1)
    }

    /// Adds a picture.
    pub fn texture(&mut self, texture: Texture) -> TextureId {
        self.model.textures.push(texture);
        TextureId(self.model.textures.len() as u32 - 1)
    }

    /// Adds a shape that keeps its origin, in parts if it is large.
    pub fn shape(&mut self, mut raw: RawShape) -> Vec<MeshId> {
        clean(&mut raw, &mut self.report);
        self.parts(&raw, Some(DVec3::ZERO)).into_iter().map(|(mesh, _)| mesh).collect()
    }

    /// Places a shape.
    pub fn object(&mut self, mesh: MeshId, material: MaterialId, file_from_mesh: DAffine3) {
        let world_from_mesh = self.world_from_file * file_from_mesh;
        if world_from_mesh.is_finite() {
            self.model.objects.push(Object { mesh, material, world_from_mesh });
        } else {
            self.report.unreadable += 1;
            self.report.note("a placement is not finite".into());
        }
    }

    /// Adds shapes that are given in the file's coordinates, each in its place.
    pub fn placed_shapes(
        &mut self,
        shapes: Vec<(RawShape, MaterialId)>,
    ) -> Result<(), ForeignFault> {
        let mut shapes = shapes;
        let mut bounds = Aabb::EMPTY;
        for (raw, _) in &mut shapes {
            self.go_on()?;
            clean(raw, &mut self.report);
            for triangle in &raw.triangles {
                for &vertex in triangle {
                    bounds = bounds.including(raw.positions[vertex as usize]);
                }
            }
        }
        let shared = shared_origin(&bounds);
        for (raw, material) in shapes {
            self.go_on()?;
            for (mesh, origin) in self.parts(&raw, shared) {
                self.object(mesh, material, DAffine3::from_translation(origin));
            }
        }
        Ok(())
    }

    /// The parts of a clean shape with their origins; each has its own if none is given.
    fn parts(&mut self, raw: &RawShape, origin: Option<DVec3>) -> Vec<(MeshId, DVec3)> {
        let center = |t: &[u32; 3]| t.iter().map(|&v| raw.positions[v as usize]).sum::<DVec3>();
        let groups = if raw.triangles.len() <= MOST_GROUP_TRIANGLES {
            vec![(0..raw.triangles.len() as u32).collect()]
        } else {
            let centers: Vec<DVec3> = raw.triangles.par_iter().map(center).collect();
            compact_groups(&centers, MOST_GROUP_TRIANGLES)
        };
        let groups: Vec<Vec<u32>> = groups.into_iter().filter(|group| !group.is_empty()).collect();
        let meshes: Vec<_> = groups.par_iter().map(|group| part_of(raw, group, origin)).collect();
        let mut placed = Vec::with_capacity(meshes.len());
        for (mesh, origin) in meshes {
            placed.push((MeshId(self.model.meshes.len() as u32), origin));
            self.model.meshes.push(mesh);
        }
        placed
    }

    /// The model and what was left out of it. A model without materials gets the default one.
    pub fn finish(self) -> (Model, ModelReport) {
        (self.model, self.report)
    }
}

/// Where coordinates in a box are counted from, so that f32 suffices.
fn shared_origin(bounds: &Aabb) -> Option<DVec3> {
    let extent = bounds.diagonal();
    if extent > MOST_SHARED_EXTENT {
        return None;
    }
    let center = if bounds.is_empty() { DVec3::ZERO } else { bounds.center() };
    // Near the origin of the file nothing is gained: its coordinates stay as they are.
    Some(if center.length() > extent { center } else { DVec3::ZERO })
}

/// Some triangles of a shape as a shape of their own.
fn part_of(raw: &RawShape, group: &[u32], origin: Option<DVec3>) -> (Mesh, DVec3) {
    let corners = || group.iter().flat_map(|&triangle| raw.triangles[triangle as usize]);
    let origin = origin.unwrap_or_else(|| {
        corners().fold(Aabb::EMPTY, |b, v| b.including(raw.positions[v as usize])).center()
    });
    let mut local = HashMap::with_capacity(group.len());
    let mut mesh = Mesh::default();
    let mut add = |vertex: u32| {
        let at = vertex as usize;
        mesh.positions.push((raw.positions[at] - origin).as_vec3().to_array());
        mesh.normals.extend(raw.normals.get(at));
        mesh.uvs.extend(raw.uvs.get(at));
        mesh.colors.extend(raw.colors.get(at));
        mesh.positions.len() as u32 - 1
    };
    let triangles = group.iter().map(|&triangle| {
        raw.triangles[triangle as usize]
            .map(|vertex| *local.entry(vertex).or_insert_with(|| add(vertex)))
    });
    let triangles = triangles.collect();
    mesh.triangles = triangles;
    mesh.normalize_normals();
    (mesh, origin)
}

/// Leaves out triangles that cannot be drawn, and makes the numbers of the others finite.
fn clean(raw: &mut RawShape, report: &mut ModelReport) {
    let RawShape { positions, normals, uvs, colors, triangles } = raw;
    // Of vertices beyond this range differences, or the squares of them, are not finite.
    let is_sound = |p: &DVec3| p.is_finite() && p.abs().max_element() < 1e18;
    triangles.retain(|triangle| {
        let corners = triangle.map(|vertex| positions.get(vertex as usize));
        let [Some(a), Some(b), Some(c)] = corners else {
            report.out_of_range += 1;
            return false;
        };
        if ![a, b, c].into_iter().all(is_sound) {
            report.not_finite += 1;
            return false;
        }
        let has_area = (b - a).cross(c - a).length_squared() > 0.0;
        report.zero_area += u64::from(!has_area);
        has_area
    });
    leave_out_duplicates(triangles, report);
    for (list, count) in
        [(normals.len(), "normals"), (uvs.len(), "texture coordinates"), (colors.len(), "colours")]
    {
        if list != 0 && list != positions.len() {
            report.note(format!("{list} {count} for {} vertices: not used", positions.len()));
        }
    }
    let count = positions.len();
    let fits = |len: usize| len == count;
    if !fits(normals.len()) || normals.iter().any(|n| !Vec3::from(*n).is_finite()) {
        // Those of the faces are better than some that point nowhere.
        normals.clear();
    }
    if !fits(uvs.len()) {
        uvs.clear();
    }
    if !fits(colors.len()) {
        colors.clear();
    }
    uvs.iter_mut().flatten().filter(|uv| !uv.is_finite()).for_each(|uv| *uv = 0.0);
}

/// Leaves out triangles with the corners of an earlier one, in the same direction.
fn leave_out_duplicates(triangles: &mut Vec<[u32; 3]>, report: &mut ModelReport) {
    let key = |&[a, b, c]: &[u32; 3]| match a.min(b).min(c) {
        first if first == a => [a, b, c],
        first if first == b => [b, c, a],
        _ => [c, a, b],
    };
    let mut keys: Vec<_> = triangles.par_iter().map(key).zip(0u32..u32::MAX).collect();
    keys.par_sort_unstable();
    let mut repeats: Vec<u32> =
        keys.windows(2).filter(|pair| pair[0].0 == pair[1].0).map(|pair| pair[1].1).collect();
    report.duplicate += repeats.len() as u64;
    repeats.sort_unstable();
    let (mut at, mut repeats) = (0, repeats.into_iter().peekable());
    if repeats.peek().is_some() {
        triangles.retain(|_| {
            at += 1;
            repeats.next_if_eq(&(at - 1)).is_none()
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corner_of(model: &Model, object: usize, triangle: usize) -> [DVec3; 3] {
        let object = &model.objects[object];
        model.mesh(object).corners(triangle).map(|p| object.world_from_mesh.transform_point3(p))
    }

    /// A sheet of `n` by `n` squares of 1 m, its corner at `at`.
    fn sheet(n: u32, at: DVec3) -> RawShape {
        let mut raw = RawShape::default();
        for y in 0..=n {
            for x in 0..=n {
                raw.positions.push(at + DVec3::new(f64::from(x), f64::from(y), 0.0));
            }
        }
        for y in 0..n {
            for x in 0..n {
                let v = y * (n + 1) + x;
                raw.triangles.push([v, v + 1, v + n + 2]);
                raw.triangles.push([v, v + n + 2, v + n + 1]);
            }
        }
        raw
    }

    #[test]
    fn faults_are_counted_and_the_rest_stays() {
        let mut raw = sheet(2, DVec3::ZERO);
        raw.positions.push(DVec3::new(f64::NAN, 0.0, 0.0));
        raw.triangles.extend([[0, 1, 9], [0, 1, 10], [0, 0, 1], [0, 1, 2], [4, 0, 1]]);
        let mut parts = Assembly::new(DAffine3::IDENTITY, Arc::default());
        let material = parts.material(Material::default());
        parts.placed_shapes(vec![(raw, material)]).expect("not cancelled");
        let (model, report) = parts.finish();
        assert_eq!(model.triangle_count(), 8);
        let counts = (report.not_finite, report.out_of_range, report.zero_area, report.duplicate);
        assert_eq!(counts, (1, 1, 2, 1));
        assert_eq!(report.lines().len(), 4);
    }

    #[test]
    fn large_shapes_are_split_and_keep_their_corners() {
        let at = DVec3::new(4.5e5, 5.2e6, 310.0);
        let mut parts = Assembly::new(DAffine3::IDENTITY, Arc::default());
        let material = parts.material(Material::default());
        parts.placed_shapes(vec![(sheet(70, at), material)]).expect("not cancelled");
        let (model, _) = parts.finish();
        assert_eq!(model.objects.len(), 3);
        assert_eq!(model.triangle_count(), 9800);
        for object in 0..3 {
            let triangles = model.mesh(&model.objects[object]).triangles.len();
            assert!(triangles <= MOST_GROUP_TRIANGLES);
            for triangle in 0..triangles {
                for corner in corner_of(&model, object, triangle) {
                    let off = (corner - at) - (corner - at).round();
                    assert!(off.length() < 1e-5, "{corner}");
                }
            }
        }
        let origins: Vec<_> = model.objects.iter().map(|o| o.world_from_mesh.translation).collect();
        assert!(origins.iter().all(|origin| *origin == origins[0]), "parts still touch");
    }
}
