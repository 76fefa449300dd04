//! Small seeded scans for tests of selection and drawing, and views of them.

#![allow(dead_code, reason = "each test binary uses a part")]

use super::insertion::{InputPoint, InsertedNode, Parameters, insert_all, octree_of};
use esker::geometry::{Camera, View};
use esker::octree::Octree;
use esker::points::Lattice;
use glam::{DVec3, I64Vec3};

/// A linear congruential generator (Knuth's MMIX constants), so that tests need no crate.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Random(seed.wrapping_mul(2).wrapping_add(1))
    }

    /// Uniform in 0..1.
    pub fn unit(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    pub fn vector(&mut self, low: f64, high: f64) -> DVec3 {
        DVec3::new(self.range(low, high), self.range(low, high), self.range(low, high))
    }
}

/// A scan and the octree of the literal insertion.
pub struct Scan {
    pub points: Vec<InputPoint>,
    pub nodes: Vec<InsertedNode>,
    pub octree: Octree,
}

impl Scan {
    pub fn new(points: Vec<InputPoint>, parameters: &Parameters) -> Self {
        let nodes = insert_all(&points, parameters);
        let lattice =
            Lattice { scale: DVec3::splat(0.01), offset: DVec3::new(4.0e5, 5.2e6, 100.0) };
        let octree =
            octree_of(&points, &nodes, parameters, lattice, I64Vec3::new(1000, -2000, 500));
        Scan { points, nodes, octree }
    }

    /// World position of an input point.
    pub fn world(&self, point: usize) -> DVec3 {
        let root = self.octree.root_cube().min;
        let position = self.points[point].position.map(i64::from);
        self.octree.lattice().world(root + I64Vec3::from_array(position))
    }

    pub fn center(&self) -> DVec3 {
        let steps = (1i64 << self.octree.root_cube().bits) / 2;
        self.octree.lattice().world(self.octree.root_cube().min + steps)
    }

    /// Edge of the root cube in the world.
    pub fn edge(&self) -> f64 {
        self.octree.cell_size(0).x
    }

    /// A view from `offset` root edges off the centre, towards the centre.
    pub fn view_from(&self, offset: DVec3) -> View {
        let eye = self.center() + offset * self.edge();
        let camera = Camera::looking_at(eye, self.center(), DVec3::Z, 60f64.to_radians(), 0.05);
        View { camera, width_px: 320, height_px: 240 }
    }

    /// A view with everything drawn by chance, often from inside.
    pub fn random_view(&self, random: &mut Random) -> View {
        let eye = self.center() + random.vector(-0.9, 0.9) * self.edge();
        let target = self.center() + random.vector(-0.5, 0.5) * self.edge();
        let fov_y = random.range(0.2, 2.2);
        let camera = Camera::looking_at(eye, target, DVec3::Z, fov_y, random.range(1e-4, 1.0));
        View { camera, width_px: 320, height_px: 200 + (100.0 * random.unit()) as u32 }
    }
}

/// Ground, two walls and scattered leaves, seen by two scanners: density falls with the distance
/// from them. Coordinates below `2^bits`.
pub fn courtyard(count: usize, bits: u32, seed: u64) -> Vec<InputPoint> {
    let mut random = Random::new(seed);
    let scanners = [DVec3::new(0.3, 0.35, 0.1), DVec3::new(0.7, 0.6, 0.15)];
    let edge = f64::from(1u32 << bits);
    let mut points = Vec::with_capacity(count);
    while points.len() < count {
        let (a, b) = (random.unit(), random.unit());
        let (place, paint) = match (random.unit() * 10.0) as u32 {
            0..=4 => (DVec3::new(a, b, 0.02 + 0.01 * (9.0 * a).sin()), [90, 140, 70]),
            5..=6 => (DVec3::new(a, 0.85, 0.4 * b), [180, 160, 140]),
            7..=8 => (DVec3::new(0.12, a, 0.3 * b), [150, 90, 80]),
            _ => (
                DVec3::new(0.5 + 0.1 * a, 0.4 + 0.1 * b, 0.2 + 0.15 * random.unit()),
                [60, 110, 50],
            ),
        };
        let nearest = scanners.iter().map(|s| s.distance(place)).fold(f64::INFINITY, f64::min);
        if random.unit() * (nearest * nearest) > 0.01 {
            continue;
        }
        let noise = random.vector(-0.5, 0.5) * 0.002;
        let position = ((place + noise) * edge).clamp(DVec3::ZERO, DVec3::splat(edge - 1.0));
        let shade = (20.0 * random.unit()) as u16;
        points.push(InputPoint {
            position: position.as_uvec3().to_array(),
            color: paint.map(|c| c + shade),
        });
    }
    points
}
