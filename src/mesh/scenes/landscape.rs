//! Hills with forest.

use glam::DVec3;

use super::city::tree;
use super::{Maker, ModelScene, placed};
use crate::mesh::Mesh;
use crate::sampling::Random;

const PATCH: f64 = 40.0;
/// Squares along a patch.
const SQUARES: u32 = 16;
const TREES: u32 = 14;

/// Height of the ground.
fn height(x: f64, y: f64) -> f64 {
    let wave = |length: f64, turn: f64, high: f64| {
        let (s, c) = turn.sin_cos();
        high * ((x * c + y * s) / length).sin() * ((y * c - x * s) / length + turn).cos()
    };
    wave(60.0, 0.4, 16.0) + wave(24.0, 1.3, 4.0) + wave(7.0, 2.2, 0.5)
}

/// `size` patches along each side.
pub(super) fn terrain(size: u32, seed: u64) -> ModelScene {
    let mut maker = Maker::default();
    let grass = maker.material([112, 128, 74]);
    let leaves = [[56, 92, 44], [74, 104, 50], [90, 96, 40]].map(|color| maker.material(color));
    let tree = maker.mesh(tree().into_mesh());
    for row in 0..size {
        for column in 0..size {
            let corner = DVec3::new(f64::from(column), f64::from(row), 0.0) * PATCH;
            let patch = maker.mesh(patch(corner));
            maker.place(patch, grass, placed(DVec3::ONE, 0.0, corner));
            for number in 0..TREES {
                let index = u64::from((row * size + column) * TREES + number);
                let mut random = Random::new(seed, index + 1);
                let at = corner + DVec3::new(random.unit(), random.unit(), 0.0) * PATCH;
                let at = DVec3::new(at.x, at.y, height(at.x, at.y));
                let scale = DVec3::splat(random.between(0.8, 2.2));
                let turn = random.between(0.0, 6.0);
                let leaves = leaves[random.below(3) as usize];
                maker.place(tree, leaves, placed(scale, turn, at));
            }
        }
    }
    let length = f64::from(size) * PATCH;
    let at = |x: f64, y: f64| {
        let (x, y) = (x * length, y * length);
        DVec3::new(x, y, height(x, y) + 1.7)
    };
    let walk = (0..=12).map(|i| at(0.08 + 0.07 * f64::from(i), 0.3 + 0.03 * f64::from(i)));
    maker.finish(walk.collect())
}

/// One patch, relative to its corner; neighbours share their border.
fn patch(corner: DVec3) -> Mesh {
    let step = PATCH / f64::from(SQUARES);
    let mut mesh = Mesh::default();
    for y in 0..=SQUARES {
        for x in 0..=SQUARES {
            let (x, y) = (f64::from(x) * step, f64::from(y) * step);
            let z = height(corner.x + x, corner.y + y);
            mesh.positions.push([x as f32, y as f32, z as f32]);
        }
    }
    let row = SQUARES + 1;
    for y in 0..SQUARES {
        for x in 0..SQUARES {
            let a = y * row + x;
            mesh.triangles.extend([[a, a + 1, a + row + 1], [a, a + row + 1, a + row]]);
        }
    }
    mesh
}
