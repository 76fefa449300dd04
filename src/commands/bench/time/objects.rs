//! Made-up objects on a simulated pipeline: all estimators beside each other, without a clock.

use std::time::Instant;

use glam::DVec3;
use rayon::prelude::*;

use crate::budget::procedural::{ProceduralObject, ProceduralScene};
use crate::budget::{
    CellTable, CostModel, Heuristic, Lookup, PosTable, Sample, SphereObject, TwoStagePipeline,
    cell_bound,
};
use crate::commands::bench::time::score::Score;
use crate::geometry::{Aabb, Camera, View};
use crate::sampling::Random;

const SIZE: (u32, u32) = (1280, 720);
/// Share of a view cell's half width, in radians, by which directions spread around a table's.
const SPREAD_RAD: f64 = 0.48;

/// What is compared.
struct Study {
    objects: Vec<ProceduralObject>,
    tables: Vec<PosTable>,
    pipeline: TwoStagePipeline,
}

/// All scenes and pipelines.
pub fn run(quick: bool) -> Vec<Score> {
    let mut scores = Vec::new();
    for scene in ProceduralScene::ALL {
        let count = match (scene, quick) {
            (ProceduralScene::City, false) => 1200,
            (ProceduralScene::City, true) => 200,
            (ProceduralScene::Forest, false) => 157,
            (ProceduralScene::Forest, true) => 24,
            (ProceduralScene::Terrain, _) => 64,
        };
        let queues: &[Option<u32>] = if quick { &[Some(4)] } else { &[Some(1), Some(4), None] };
        for &queue in queues {
            let pipeline = TwoStagePipeline { queue };
            let objects = scene.objects(count, 41);
            let focal_px = view(DVec3::ZERO, DVec3::X).focal_px();
            let measure = |object: &ProceduralObject| {
                PosTable::measure(|angles| object.measured_at(&angles, focal_px, pipeline))
            };
            let tables = match scene {
                // All tiles are the same.
                ProceduralScene::Terrain => vec![measure(&objects[0]); objects.len()],
                _ => objects.par_iter().map(measure).collect(),
            };
            let study = Study { objects, tables, pipeline };
            let depth = queue.map_or("any".to_owned(), |depth| depth.to_string());
            let name = format!("{}, queue {depth}", scene.name());
            study.per_view(scene, &name, quick, &mut scores);
            if queue == Some(4) && scene == ProceduralScene::City {
                study.per_cell(scene, &name, quick, &mut scores);
            }
        }
    }
    scores
}

impl Study {
    /// One estimate per frame of a walk; prices are fitted to single objects from random places.
    fn per_view(&self, scene: ProceduralScene, name: &str, quick: bool, scores: &mut Vec<Score>) {
        let frames = if quick { 40 } else { 300 };
        let path: Vec<View> = (0..frames).map(|frame| walk(scene, frame, frames)).collect();
        let measured: Vec<f64> = path.par_iter().map(|view| self.frame_ms(view)).collect();
        let samples = self.training(scene);
        let sum_of = |predict: &(dyn Fn(&View) -> f64 + Sync)| -> (Vec<f64>, f64) {
            let start = Instant::now();
            let predicted: Vec<f64> = path.iter().map(predict).collect();
            (predicted, start.elapsed().as_secs_f64() * 1e6 / path.len() as f64)
        };
        let mut note = |estimator: &str, (predicted, us): (Vec<f64>, f64)| {
            let pairs: Vec<_> =
                predicted.into_iter().zip(measured.iter().copied()).filter(|p| p.1 > 0.0).collect();
            scores.push(Score::of(("objects", name, estimator), &pairs, us));
        };
        for heuristic in Heuristic::ALL {
            let Ok(model) = CostModel::fit(heuristic, &samples) else { continue };
            let estimate = sum_of(&|view: &View| {
                self.objects.iter().map(|object| model.predict(&object.workload(view))).sum()
            });
            note(heuristic.name(), estimate);
        }
        for (lookup, estimator) in
            [(Lookup::Expected, "pos"), (Lookup::Conservative, "pos conservative")]
        {
            note(
                estimator,
                sum_of(&|view: &View| self.spheres().map(|o| o.time_ms(view, lookup)).sum()),
            );
        }
    }

    /// One estimate per view cell and direction, along a walk through a row of cells.
    fn per_cell(&self, scene: ProceduralScene, name: &str, quick: bool, scores: &mut Vec<Score>) {
        let (cells, frames): (u32, u32) = if quick { (1, 20) } else { (6, 1000) };
        let side = 10.0;
        let middle = 0.5 * scene.side();
        let (mut sampled, mut bound) = (Vec::new(), Vec::new());
        let (mut sampled_us, mut bound_us) = (0.0, 0.0);
        let objects: Vec<SphereObject> = self.spheres().collect();
        for cell in 0..cells {
            let low = DVec3::new(middle + f64::from(cell) * side, middle, 1.5);
            let bounds = Aabb::new(low, low + DVec3::new(side, side, 0.5));
            let table = CellTable::measure(|direction, draw| {
                let axis = CellTable::directions()[direction];
                let mut random =
                    Random::new(44 + u64::from(cell), (direction as u64) << 32 | u64::from(draw));
                self.frame_ms(&within(&bounds, axis, &mut random))
            });
            let directions = CellTable::directions();
            let start = Instant::now();
            let bounds_ms: Vec<f64> = directions
                .iter()
                .map(|&axis| cell_bound(&objects, &bounds, &view(DVec3::ZERO, axis), SPREAD_RAD))
                .collect();
            bound_us +=
                start.elapsed().as_secs_f64() * 1e6 / (directions.len() * cells as usize) as f64;
            for frame in 0..frames / cells {
                let mut random = Random::new(45, u64::from(cell) << 32 | u64::from(frame));
                // Looking level, in any direction: those of the cube that are level.
                let level: Vec<usize> =
                    (0..directions.len()).filter(|&i| directions[i].z == 0.0).collect();
                let direction = level[random.below(level.len() as u64) as usize];
                let seen = within(&bounds, directions[direction], &mut random);
                let measured = self.frame_ms(&seen);
                let start = Instant::now();
                let estimate = table.time_ms(directions[direction]);
                sampled_us += start.elapsed().as_secs_f64() * 1e6 / f64::from(frames);
                sampled.push((estimate, measured));
                bound.push((bounds_ms[direction], measured));
            }
        }
        let scene = format!("{name}, cells");
        for (estimator, pairs, us) in
            [("cell sampled", &mut sampled, sampled_us), ("cell bound", &mut bound, bound_us)]
        {
            pairs.retain(|(_, measured)| *measured > 0.0);
            scores.push(Score::of(("objects", &scene, estimator), pairs, us));
        }
    }

    fn frame_ms(&self, view: &View) -> f64 {
        self.objects.iter().map(|object| object.measured_ms(view, self.pipeline)).sum()
    }

    fn spheres(&self) -> impl Iterator<Item = SphereObject<'_>> {
        self.objects.iter().zip(&self.tables).map(|(object, table)| SphereObject {
            center: object.center,
            radius: object.radius,
            table,
        })
    }

    /// Objects timed one by one from random places.
    fn training(&self, scene: ProceduralScene) -> Vec<Sample> {
        let sample = |index: u64| {
            let mut random = Random::new(42, index);
            let object = &self.objects[random.below(self.objects.len() as u64) as usize];
            let side = scene.side();
            let away = DVec3::new(random.bell(), random.bell(), random.unit());
            let distance = object.radius + random.unit().powi(2) * 0.7 * side;
            let eye = object.center + away.normalize_or(DVec3::X) * distance;
            let view = view(eye, object.center - eye);
            Sample {
                work: object.workload(&view),
                time_ms: object.measured_ms(&view, self.pipeline),
            }
        };
        (0..4000).map(sample).collect()
    }
}

fn view(eye: DVec3, forward: DVec3) -> View {
    let camera = Camera::looking_at(eye, eye + forward, DVec3::Z, 60f64.to_radians(), 0.1);
    View { camera, width_px: SIZE.0, height_px: SIZE.1 }
}

/// A walk across the scene at the height of an eye, looking about.
fn walk(scene: ProceduralScene, frame: u32, frames: u32) -> View {
    let share = f64::from(frame) / f64::from(frames);
    let side = scene.side();
    let height = if scene == ProceduralScene::Terrain { 30.0 } else { 1.7 };
    let eye = DVec3::new(0.15 * side + 0.6 * side * share, side * (0.3 + 0.4 * share), height);
    let turn = 0.6 + 2.5 * (6.0 * share).sin();
    let forward = DVec3::new(turn.cos(), turn.sin(), if height > 10.0 { -0.5 } else { 0.02 });
    view(eye, forward)
}

/// A view from a random place in a box, near a direction.
fn within(bounds: &Aabb, axis: DVec3, random: &mut Random) -> View {
    let share = DVec3::new(random.unit(), random.unit(), random.unit());
    let across = axis.any_orthonormal_vector();
    let around = DVec3::cross(axis, across);
    let (sin, cos) = random.between(0.0, std::f64::consts::TAU).sin_cos();
    let tilt = random.between(0.0, 0.8 * SPREAD_RAD);
    let forward = axis * tilt.cos() + (across * cos + around * sin) * tilt.sin();
    view(bounds.min + share * bounds.size(), forward)
}
