//! Small seeded scans for tests of selection and drawing, and views of them.

#![allow(dead_code, reason = "each test binary uses a part")]

use std::convert::Infallible;

use super::insertion::{InputPoint, InsertedNode, Parameters, insert_all, octree_of};
use esker::geometry::{Camera, MortonKey, View};
use esker::ids::NodeId;
use esker::octree::Octree;
use esker::passes::{
    CloudDraw, DrawTable, NodePlace, NodeWords, Picture, PointsCpu, Tile, reference_picture,
};
use esker::points::Lattice;
use esker::select::{Cut, SplatSettings};
use glam::{DVec3, I64Vec3};

const BACKGROUND: u32 = 0xff00_0000;

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
    /// Position and colour words per node.
    words: Vec<(Vec<u32>, Vec<u32>)>,
}

impl Scan {
    /// At coordinates as UTM gives them, in centimetres.
    pub fn new(points: Vec<InputPoint>, parameters: &Parameters) -> Self {
        let offset = DVec3::new(4.0e5, 5.2e6, 100.0);
        Scan::on_lattice(points, parameters, Lattice { scale: DVec3::splat(0.01), offset })
    }

    pub fn on_lattice(points: Vec<InputPoint>, parameters: &Parameters, lattice: Lattice) -> Self {
        let nodes = insert_all(&points, parameters);
        let octree =
            octree_of(&points, &nodes, parameters, lattice, I64Vec3::new(1000, -2000, 500));
        let mut scan = Scan { points, nodes, octree, words: Vec::new() };
        let ids = (0..scan.nodes.len() as u32).map(NodeId);
        scan.words = ids.map(|node| scan.words_of(node)).collect();
        scan
    }

    /// World position of an input point.
    pub fn world(&self, point: usize) -> DVec3 {
        let root = self.octree.root_cube().min;
        let position = self.points[point].position.map(i64::from);
        self.octree.lattice().world(root + I64Vec3::from_array(position))
    }

    /// Position words of a node.
    pub fn positions(&self, node: NodeId) -> &[u32] {
        &self.words[node.index()].0
    }

    fn words_of(&self, node: NodeId) -> (Vec<u32>, Vec<u32>) {
        let bits = self.octree.local_bits(node);
        assert!(bits <= 21, "the test clouds have narrow nodes");
        let points = self.nodes[node.index()].points.iter().map(|&point| self.points[point]);
        let positions = points.clone().flat_map(|point| {
            let code = u64::encode(point.position.map(|c| c & ((1 << bits) - 1)));
            [code as u32, (code >> 32) as u32]
        });
        let colors = points.clone().map(|point| {
            let [r, g, b] = point.color.map(|c| c as u8);
            u32::from_le_bytes([r, g, b, 255])
        });
        (positions.collect(), colors.collect())
    }

    /// What is drawn of a cut.
    pub fn table(&self, cut: &Cut, view: &View, splat: &SplatSettings) -> DrawTable {
        let place = |_| NodePlace::default();
        let mut table = DrawTable::default();
        table.fill(
            &[CloudDraw { octree: &self.octree, cut, place: &place, appeared: None }],
            view,
            splat,
        );
        assert_eq!(table.draws.len(), cut.draw.len(), "one draw per node");
        table
    }

    /// The picture of a cut, drawn by the CPU pass.
    pub fn draw(&self, cut: &Cut, view: &View, splat: &SplatSettings) -> Picture {
        let table = self.table(cut, view, splat);
        let words = cut.table.iter().map(|row| {
            let (positions, colors) = &self.words[row.node.index()];
            NodeWords { positions, colors }
        });
        let words: Vec<NodeWords> = words.collect();
        let frame = Tile::whole(view).gpu_frame(view, splat, BACKGROUND);
        let mut pass = PointsCpu::default();
        pass.draw(&frame, &table, &words);
        pass.resolve(&frame)
    }

    /// The picture of all points, from f64.
    pub fn reference(&self, view: &View) -> Picture {
        let read = |node: NodeId, positions: &mut Vec<u32>, colors: &mut Vec<u32>| {
            positions.clone_from(&self.words[node.index()].0);
            colors.clone_from(&self.words[node.index()].1);
            Ok::<(), Infallible>(())
        };
        reference_picture(&self.octree, view, BACKGROUND, read).expect("reading cannot fail")
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
        let shade = 10.0 * random.unit() + masonry(place);
        points.push(InputPoint {
            position: position.as_uvec3().to_array(),
            color: paint.map(|c| (f64::from(c) + shade) as u16),
        });
    }
    points
}

/// Light and dark blocks of several sizes, so that blur shows in the colours.
fn masonry(place: DVec3) -> f64 {
    let block = |count: f64| {
        let cell = (place * count + 0.5).floor();
        if (cell.element_sum() as i64).rem_euclid(2) == 0 { 0.0 } else { 25.0 }
    };
    block(9.0) + block(37.0) + block(151.0) - 40.0
}
