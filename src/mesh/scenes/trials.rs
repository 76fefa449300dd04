//! Scenes that try a method: random boxes, nested shells, a wall with one window, plates that hide
//! one block each or ten, and boxes that show where nothing in them does.

use glam::DVec3;

use super::{Maker, ModelScene, placed};
use crate::mesh::shapes::{Solid, block, sphere};
use crate::sampling::Random;

/// Random boxes in a cube whose edge grows with their number.
pub(super) fn boxes(size: u32, seed: u64) -> ModelScene {
    let mut maker = Maker::default();
    let shape = maker.mesh(block(DVec3::ONE));
    let colors: Vec<_> =
        (0..8u8).map(|i| maker.material([90 + 20 * i, 230 - 20 * i, 120 + 15 * (i % 5)])).collect();
    let edge = 4.0 * f64::from(size).cbrt();
    for i in 0..u64::from(size) {
        let mut random = Random::new(seed, i + 1);
        let mut unit = || DVec3::new(random.unit(), random.unit(), random.unit());
        let (at, shape_size) = (unit() * edge, unit() * 2.5 + 0.2);
        let turn = random.between(0.0, 3.0);
        let color = colors[(i % 8) as usize];
        maker.place(shape, color, placed(shape_size, turn, at));
    }
    let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z) * edge;
    maker.finish(vec![at(-0.2, 0.4, 0.5), at(0.5, 0.5, 0.45), at(1.1, 0.7, 0.6)])
}

/// Closed spheres inside each other; the walk goes from outside to the middle.
pub(super) fn shells(size: u32) -> ModelScene {
    let mut maker = Maker::default();
    let ball = maker.mesh(sphere(24, 36));
    let colors = [[190, 90, 70], [80, 150, 180]].map(|color| maker.material(color));
    for i in 0..size {
        let radius = 1.0 + f64::from(i);
        let place = placed(DVec3::splat(radius), 0.1 * f64::from(i), DVec3::ZERO);
        maker.place(ball, colors[(i % 2) as usize], place);
    }
    let far = f64::from(size) + 4.0;
    maker.finish(vec![DVec3::new(-far, -0.3, 0.2), DVec3::new(-0.2, -0.1, 0.1)])
}

/// A wall across y = 0 with one window, and boxes behind it.
pub(super) fn window(size: u32, seed: u64) -> ModelScene {
    let mut maker = Maker::default();
    let [stone, red] = [[170, 164, 152], [170, 70, 60]].map(|color| maker.material(color));
    let mut wall = Solid::default();
    let (half, high, side, sill, head) = (60.0, 40.0, 2.0, 1.0, 4.0);
    wall.block(DVec3::new(-half, -0.2, -1.0), DVec3::new(-side, 0.2, high));
    wall.block(DVec3::new(side, -0.2, -1.0), DVec3::new(half, 0.2, high));
    wall.block(DVec3::new(-side, -0.2, -1.0), DVec3::new(side, 0.2, sill));
    wall.block(DVec3::new(-side, -0.2, head), DVec3::new(side, 0.2, high));
    let wall = maker.mesh(wall.into_mesh());
    maker.place(wall, stone, placed(DVec3::ONE, 0.0, DVec3::ZERO));
    let shape = maker.mesh(block(DVec3::ONE));
    for i in 0..u64::from(size) {
        let mut random = Random::new(seed, i + 1);
        let at = DVec3::new(
            random.between(-40.0, 40.0),
            random.between(3.0, 60.0),
            random.between(0.0, 25.0),
        );
        let extent = DVec3::new(random.unit(), random.unit(), random.unit()) + 0.3;
        maker.place(shape, red, placed(extent, random.between(0.0, 3.0), at));
    }
    let at = |x: f64, y: f64| DVec3::new(x, y, 2.2);
    maker.finish(vec![at(-14.0, -9.0), at(0.3, -7.0), at(12.0, -12.0)])
}

/// `size` by `size` plates across the view, each with a block right behind it.
pub(super) fn plates(size: u32) -> ModelScene {
    let mut maker = Maker::default();
    let plate = maker.mesh(block(DVec3::new(1.0, 0.05, 1.0)));
    let hidden = maker.mesh(block(DVec3::new(0.3, 0.1, 0.3)));
    let [front, back] = [[120, 160, 200], [220, 40, 40]].map(|color| maker.material(color));
    for row in 0..size {
        for column in 0..size {
            let at = DVec3::new(f64::from(column), 0.0, f64::from(row));
            maker.place(plate, front, placed(DVec3::ONE, 0.0, at));
            maker.place(hidden, back, placed(DVec3::ONE, 0.0, at + DVec3::Y * 0.2));
        }
    }
    let middle = 0.5 * (f64::from(size) - 1.0);
    // So far away that no block shows beside its plate.
    let eye = DVec3::new(middle, -1.1 * f64::from(size), middle);
    maker.finish(vec![eye, eye + DVec3::Y * 0.1])
}

/// Plates that fill the view from one place at many depths, each with ten blocks right behind: the
/// hidden blocks of one plate stand nearer to it than to those of the next, so that many hidden
/// nodes are left however the tree is built.
pub(super) fn field(size: u32, seed: u64) -> ModelScene {
    const BLOCKS: u32 = 10;
    let mut maker = Maker::default();
    let plate = maker.mesh(block(DVec3::new(1.0, 0.05, 1.0)));
    let hidden = maker.mesh(block(DVec3::splat(0.1)));
    let [front, back] = [[120, 160, 200], [220, 40, 40]].map(|color| maker.material(color));
    let middle = 0.5 * (f64::from(size) - 1.0);
    let eye = DVec3::new(middle, -1.1 * f64::from(size), middle);
    for row in 0..size {
        for column in 0..size {
            let mut random =
                Random::new(seed, u64::from(row) * u64::from(size) + u64::from(column));
            // Farther away and larger in proportion: the same place in the picture.
            let depth = random.between(1.0, 2.0);
            let at = |x: f64, z: f64, behind: f64| {
                let offset = DVec3::new(f64::from(column) + x, 0.0, f64::from(row) + z) - eye;
                // Behind along the line of sight, so that plates at the edge hide theirs too.
                eye + depth * (1.0 + behind / -eye.y) * offset
            };
            let scale = DVec3::splat(depth);
            maker.place(plate, front, placed(scale, 0.0, at(0.0, 0.0, 0.0)));
            for step in 0..BLOCKS {
                let behind = 0.1 + 0.04 * f64::from(step);
                let (x, z) = (random.between(-0.25, 0.25), random.between(-0.25, 0.25));
                maker.place(hidden, back, placed(scale, 0.0, at(x, z, behind)));
            }
        }
    }
    maker.finish(vec![eye, eye + DVec3::Y * 0.001])
}

/// A wall with a slit in the middle and pairs of cubes behind its halves.
pub(super) fn slit(size: u32) -> ModelScene {
    let mut maker = Maker::default();
    let [stone, red] = [[170, 164, 152], [170, 70, 60]].map(|color| maker.material(color));
    let far = 20.0 + 0.2 * f64::from(size);
    let mut wall = Solid::default();
    for side in [-1.0, 1.0] {
        let (a, b) = (side * 0.5, side * far);
        wall.block(DVec3::new(a.min(b), -0.1, -far), DVec3::new(a.max(b), 0.1, far));
    }
    let wall = maker.mesh(wall.into_mesh());
    maker.place(wall, stone, placed(DVec3::ONE, 0.0, DVec3::ZERO));
    for pair in 0..size {
        let step = f64::from(pair);
        let apart = 3.0 + 0.1 * step;
        let half = DVec3::splat(0.2 + 0.002 * step);
        let mut cubes = Solid::default();
        for side in [-1.0, 1.0] {
            let center = DVec3::new(side * apart, 4.0 + 0.05 * step, 0.0);
            cubes.block(center - half, center + half);
        }
        let cubes = maker.mesh(cubes.into_mesh());
        maker.place(cubes, red, placed(DVec3::ONE, 0.0, DVec3::ZERO));
    }
    maker.finish(vec![DVec3::new(0.0, -14.0, 0.3), DVec3::new(0.0, -12.0, 0.3)])
}
