//! Points on a model's surfaces, so that every scene can also stand as a scan.

use glam::{DVec2, DVec3};

use crate::ids::ObjectId;
use crate::mesh::Model;
use crate::sampling::Random;

/// A point on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Where, in the world.
    pub position: DVec3,
    /// Unit normal of the face; zero on a face without area.
    pub normal: DVec3,
    /// Colour of the material, sRGB.
    pub color: [u8; 3],
    /// Whose surface.
    pub object: ObjectId,
}

/// Draws points evenly by area from all triangles of a model.
#[derive(Clone, Debug)]
pub struct SurfaceSampler<'a> {
    model: &'a Model,
    /// First triangle of each object in the running sum, then the number of all.
    first: Vec<usize>,
    /// Running sum of areas; as long as there are triangles.
    areas: Vec<f64>,
    seed: u64,
}

impl<'a> SurfaceSampler<'a> {
    /// Sums up the areas; 8 bytes for each placed triangle.
    pub fn new(model: &'a Model, seed: u64) -> Self {
        let mut first = Vec::with_capacity(model.objects.len() + 1);
        let mut areas = Vec::new();
        let mut sum = 0.0;
        for object in &model.objects {
            first.push(areas.len());
            let mesh = model.mesh(object);
            for triangle in 0..mesh.triangles.len() {
                let [a, b, c] = mesh.corners(triangle);
                let turn = |v: DVec3| object.world_from_mesh.transform_vector3(v);
                sum += 0.5 * turn(b - a).cross(turn(c - a)).length();
                areas.push(sum);
            }
        }
        first.push(areas.len());
        SurfaceSampler { model, first, areas, seed }
    }

    /// Area of all surfaces, square metres.
    pub fn area(&self) -> f64 {
        self.areas.last().copied().unwrap_or(0.0)
    }

    /// Point number `index`; `None` if nothing has an area.
    pub fn point(&self, index: u64) -> Option<SurfacePoint> {
        let area = self.area();
        if !(area.is_finite() && area > 0.0) {
            return None;
        }
        let mut random = Random::new(self.seed, index);
        let at = random.unit() * area;
        let triangle = self.areas.partition_point(|&sum| sum <= at).min(self.areas.len() - 1);
        let object = self.first.partition_point(|&first| first <= triangle) - 1;
        let placed = &self.model.objects[object];
        let corners = self.model.mesh(placed).corners(triangle - self.first[object]);
        let [a, b, c] = corners.map(|corner| placed.world_from_mesh.transform_point3(corner));
        let mut share = DVec2::new(random.unit(), random.unit());
        if share.x + share.y > 1.0 {
            share = DVec2::ONE - share;
        }
        let [red, green, blue, _] = self.model.materials[placed.material.index()].color;
        Some(SurfacePoint {
            position: a + (b - a) * share.x + (c - a) * share.y,
            normal: (b - a).cross(c - a).normalize_or_zero(),
            color: [red, green, blue],
            object: ObjectId(object as u32),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::scenes::SceneKind;

    #[test]
    fn points_lie_on_their_objects_evenly_by_area() {
        let scene = SceneKind::Window.make(3, 1);
        let sampler = SurfaceSampler::new(&scene.model, 9);
        let bounds = scene.model.object_bounds();
        let mut on_wall = 0u32;
        for index in 0..20_000 {
            let point = sampler.point(index).expect("there is area");
            let bounds = &bounds[point.object.index()];
            assert!(bounds.distance(point.position) < 1e-9);
            assert!((point.normal.length() - 1.0).abs() < 1e-9);
            on_wall += u32::from(point.object.0 == 0);
        }
        let wall: f64 = {
            let alone = Model { objects: scene.model.objects[..1].to_vec(), ..scene.model.clone() };
            SurfaceSampler::new(&alone, 0).area()
        };
        let expected = wall / sampler.area();
        let seen = f64::from(on_wall) / 20_000.0;
        assert!((seen - expected).abs() < 0.01, "{seen} of {expected}");
        assert_eq!(SurfaceSampler::new(&Model::default(), 0).point(0), None);
    }
}
