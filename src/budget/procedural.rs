//! Made-up objects of triangles, and their true time on a pipeline of two stages: what estimators
//! are compared on, the same on every machine.
//!
//! Three scenes after those of the paper: a city of houses with few, large triangles; a forest of
//! trees whose many triangles differ widely in size; a terrain of many triangles of one size. Only
//! what time depends on is made: how large each triangle is, where it faces, how many vertices it
//! adds. Units: metres, milliseconds.

use glam::DVec3;

use crate::budget::{Sample, Triangle, TwoStagePipeline, ViewAngles, Workload, sphere_footprint};
use crate::geometry::View;
use crate::sampling::Random;

/// Time of the simulated machine per transformed vertex.
pub const VERTEX_MS: f64 = 1.0e-4;
/// Time of the simulated machine per pixel.
pub const PIXEL_MS: f64 = 2.0e-6;
/// Time of the simulated machine per draw.
pub const DRAW_MS: f64 = 2.0e-3;

/// One triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Facet {
    /// Vertices that are transformed for it, 0 to 3.
    pub transformed: f64,
    /// Area, square metres.
    pub area: f64,
    /// Unit direction that it faces.
    pub normal: DVec3,
}

/// One object.
#[derive(Clone, Debug, PartialEq)]
pub struct ProceduralObject {
    /// Middle of its bounding sphere.
    pub center: DVec3,
    /// Radius of its bounding sphere.
    pub radius: f64,
    /// Its triangles in drawing order.
    facets: Vec<Facet>,
    /// Sums over the triangles: vertices and square metres.
    transformed: f64,
    area: f64,
}

/// What is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProceduralScene {
    /// Houses on a square of 600 m.
    City,
    /// Trees on a square of 200 m.
    Forest,
    /// Tiles of one surface, 400 m.
    Terrain,
}

impl ProceduralScene {
    /// All scenes.
    pub const ALL: [ProceduralScene; 3] =
        [ProceduralScene::City, ProceduralScene::Forest, ProceduralScene::Terrain];

    /// The scene in a word.
    pub fn name(self) -> &'static str {
        match self {
            ProceduralScene::City => "city",
            ProceduralScene::Forest => "forest",
            ProceduralScene::Terrain => "terrain",
        }
    }

    /// Edge of the scene's square.
    pub fn side(self) -> f64 {
        match self {
            ProceduralScene::City => 600.0,
            ProceduralScene::Forest => 200.0,
            ProceduralScene::Terrain => 400.0,
        }
    }

    /// Makes `count` objects.
    pub fn objects(self, count: u32, seed: u64) -> Vec<ProceduralObject> {
        (0..count).map(|index| self.object(count, seed, index)).collect()
    }

    fn object(self, count: u32, seed: u64, index: u32) -> ProceduralObject {
        let mut random = Random::new(seed, u64::from(index));
        let side = self.side();
        let place = |random: &mut Random| {
            DVec3::new(random.between(0.0, side), random.between(0.0, side), 0.0)
        };
        match self {
            ProceduralScene::City => {
                let height = random.between(4.0, 20.0);
                let floors = 2 + random.below(40) as u32;
                let center = place(&mut random) + DVec3::Z * (0.5 * height);
                // Walls of a few storeys: large, upright, each with vertices of its own.
                let wall = |i: u32| Facet {
                    transformed: if i.is_multiple_of(2) { 2.2 } else { 1.6 },
                    area: 10.0 * height / f64::from(floors)
                        * (0.8 * Random::new(seed ^ 1, u64::from(index * 97 + i)).bell()).exp(),
                    normal: [DVec3::X, DVec3::Y, DVec3::NEG_X, DVec3::NEG_Y, DVec3::Z]
                        [(i % 5) as usize],
                };
                let facets = (0..5 * floors).map(wall).collect();
                ProceduralObject::new(center, 0.6 * height + 6.0, facets)
            }
            ProceduralScene::Forest => {
                let height = random.between(6.0, 18.0);
                let center = place(&mut random) + DVec3::Z * (0.5 * height);
                let leaves = 400 + random.below(1200) as u32;
                let leaf = |i: u32| {
                    let mut random = Random::new(seed ^ 2, u64::from(index) << 20 | u64::from(i));
                    let normal = DVec3::new(random.bell(), random.bell(), random.bell());
                    Facet {
                        transformed: random.between(1.2, 2.4),
                        // From twigs to the cards of whole branches.
                        area: 0.02 * (1.8 * random.bell()).exp(),
                        normal: normal.try_normalize().unwrap_or(DVec3::Z),
                    }
                };
                let facets = (0..leaves).map(leaf).collect();
                ProceduralObject::new(center, 0.55 * height, facets)
            }
            ProceduralScene::Terrain => {
                let across = f64::from(count).sqrt().ceil().max(1.0);
                let tile = side / across;
                let (row, column) = (f64::from(index) / across, f64::from(index) % across);
                let center = DVec3::new(column.floor() + 0.5, row.floor() + 0.5, 0.0) * tile;
                let area = tile * tile / 2000.0;
                let facet = Facet { transformed: 0.55, area, normal: DVec3::Z };
                ProceduralObject::new(center, 0.75 * tile, vec![facet; 2000])
            }
        }
    }
}

impl ProceduralObject {
    /// An object of some triangles.
    pub fn new(center: DVec3, radius: f64, facets: Vec<Facet>) -> Self {
        let transformed = facets.iter().map(|facet| facet.transformed).sum();
        let area = facets.iter().map(|facet| facet.area).sum();
        ProceduralObject { center, radius, facets, transformed, area }
    }

    /// True time seen from a direction, where a square metre facing the eye covers `px_m2` pixels.
    fn time_ms(&self, to_eye: DVec3, px_m2: f64, pipeline: TwoStagePipeline) -> f64 {
        let triangles = self.facets.iter().map(|facet| Triangle {
            vertex_ms: VERTEX_MS * facet.transformed,
            pixel_ms: PIXEL_MS * px_m2 * facet.area * facet.normal.dot(to_eye).max(0.0),
        });
        DRAW_MS + pipeline.time_ms(triangles)
    }

    /// True time in a view; 0 out of sight.
    pub fn measured_ms(&self, view: &View, pipeline: TwoStagePipeline) -> f64 {
        let (to_eye, px_m2) = self.seen(view);
        if px_m2 > 0.0 { self.time_ms(to_eye, px_m2, pipeline) } else { 0.0 }
    }

    /// True time of the whole object at these angles, with pixels of a picture of `focal_px`.
    pub fn measured_at(
        &self,
        angles: &ViewAngles,
        focal_px: f64,
        pipeline: TwoStagePipeline,
    ) -> f64 {
        let distance = self.radius / (0.5 * angles.size_rad).sin().max(1e-9);
        let (sin, cos) = angles.azimuth_rad.sin_cos();
        let level = DVec3::new(cos, sin, 0.0) * angles.elevation_rad.cos();
        let to_eye = level + DVec3::Z * angles.elevation_rad.sin();
        self.time_ms(to_eye, (focal_px / distance).powi(2), pipeline)
    }

    /// Counts as a program knows them before drawing: pixels are the sphere's visible ones times
    /// the object's mean depth complexity.
    pub fn workload(&self, view: &View) -> Workload {
        let visible_px = sphere_footprint(view, self.center, self.radius).visible_px;
        if visible_px <= 0.0 {
            return Workload::default();
        }
        let sphere_area = std::f64::consts::PI * self.radius * self.radius;
        // A facet shows a quarter of its area on the average over all directions.
        self.counts(visible_px * 0.25 * self.area / sphere_area)
    }

    /// A sample with the pixels that are really drawn.
    pub fn exact_sample(&self, to_eye: DVec3, px_m2: f64, pipeline: TwoStagePipeline) -> Sample {
        let area = |facet: &Facet| facet.area * facet.normal.dot(to_eye).max(0.0);
        let pixels = px_m2 * self.facets.iter().map(area).sum::<f64>();
        let time_ms = self.time_ms(to_eye, px_m2, pipeline);
        Sample { work: self.counts(pixels), time_ms }
    }

    fn counts(&self, pixels: f64) -> Workload {
        let triangles = self.facets.len() as f64;
        Workload {
            draws: 1.0,
            triangles,
            polygons: triangles,
            vertices: 3.0 * triangles,
            transformed: self.transformed,
            pixels,
            switches: 0.0,
        }
    }

    /// Direction to the eye, and visible pixels per square metre that faces it.
    fn seen(&self, view: &View) -> (DVec3, f64) {
        let footprint = sphere_footprint(view, self.center, self.radius);
        let to_eye = view.camera.eye - self.center;
        let distance = to_eye.length().max(self.radius);
        let px_m2 = (view.focal_px() / distance).powi(2);
        let share = match footprint.full_px {
            full if full.is_finite() && full > 0.0 => footprint.visible_px / full,
            _ => (footprint.visible_px / (std::f64::consts::PI * self.radius.powi(2) * px_m2))
                .min(1.0),
        };
        (to_eye.try_normalize().unwrap_or(DVec3::Z), px_m2 * share)
    }
}
