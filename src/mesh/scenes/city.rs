//! A city: streets in a grid, houses of several storeys with window reveals, trees, lamps, cars.

use glam::DVec3;

use super::{Maker, ModelScene, placed};
use crate::ids::{MaterialId, MeshId};
use crate::mesh::shapes::{Solid, block, sphere_profile};
use crate::sampling::Random;

/// From one street's middle to the next.
const PITCH: f64 = 80.0;
const STREET: f64 = 18.0;
/// Lots along each side of a block.
const LOTS: usize = 3;
const EYE: f64 = 1.7;

struct Stock {
    houses: Vec<MeshId>,
    walls: Vec<MaterialId>,
    ground: MeshId,
    pavement: MaterialId,
    asphalt: MaterialId,
    lamp: MeshId,
    iron: MaterialId,
    tree: MeshId,
    leaves: MaterialId,
    car: MeshId,
    paints: Vec<MaterialId>,
    bench: MeshId,
    wood: MaterialId,
}

/// `size` blocks along each side.
pub(super) fn city(size: u32, seed: u64) -> ModelScene {
    let mut maker = Maker::default();
    let stock = stock(&mut maker, seed);
    for y in 0..size {
        for x in 0..size {
            let mut random = Random::new(seed, u64::from(y) * u64::from(size) + u64::from(x) + 1);
            let corner = DVec3::new(f64::from(x), f64::from(y), 0.0) * PITCH;
            city_block(&mut maker, &stock, corner, &mut random);
        }
    }
    // Along the middle street, then around the corner, as far as the city goes.
    let middle = f64::from(size / 2) * PITCH;
    let length = f64::from(size) * PITCH;
    let at = |x: f64, y: f64| DVec3::new(x, y, EYE);
    let walk = vec![
        at(-0.2 * STREET, middle + 0.1 * STREET),
        at(middle, middle - 0.1 * STREET),
        at(middle + 0.1 * STREET, middle + 0.3 * length),
        at(middle + 0.1 * STREET, length - 0.2 * PITCH),
    ];
    maker.finish(walk)
}

/// A block lies north-east of its crossing; streets run along its west and south sides.
fn city_block(maker: &mut Maker, stock: &Stock, corner: DVec3, random: &mut Random) {
    let tile = |maker: &mut Maker, at: DVec3, size: DVec3, material| {
        maker.place(stock.ground, material, placed(size, 0.0, corner + at + 0.5 * size));
    };
    let inner = PITCH - STREET;
    let half = 0.5 * STREET;
    tile(maker, DVec3::new(-half, -half, -1.0), DVec3::new(PITCH, STREET, 1.0), stock.asphalt);
    tile(maker, DVec3::new(-half, half, -1.0), DVec3::new(STREET, inner, 1.0), stock.asphalt);
    tile(maker, DVec3::new(half, half, -1.0), DVec3::new(inner, inner, 1.15), stock.pavement);
    let lot = inner / LOTS as f64;
    for row in 0..LOTS {
        for column in 0..LOTS {
            let middle = DVec3::new(column as f64 + 0.5, row as f64 + 0.5, 0.0) * lot;
            let at = corner + middle + DVec3::new(half, half, 0.0);
            if row == 1 && column == 1 {
                // The yard inside: trees.
                for _ in 0..6 {
                    let spread = DVec3::new(random.bell(), random.bell(), 0.0) * 2.5;
                    plant(maker, stock, at + spread, random);
                }
                continue;
            }
            let storeys = 2 + random.below(7);
            let house = stock.houses[random.below(stock.houses.len() as u64) as usize];
            let wall = stock.walls[random.below(stock.walls.len() as u64) as usize];
            let size = DVec3::new(lot - 2.2, lot - 2.2, 3.1 * storeys as f64)
                * DVec3::new(random.between(0.9, 1.0), random.between(0.9, 1.0), 1.0);
            maker.place(house, wall, placed(size, 0.0, at - DVec3::Z * 0.5));
        }
    }
    // Along the two streets: lamps, trees, benches, parked cars.
    for side in 0..2 {
        let along = |t: f64, off: f64| {
            let (t, off) = (half + t * inner, half + off);
            corner + if side == 0 { DVec3::new(t, off, 0.0) } else { DVec3::new(off, t, 0.0) }
        };
        let turn = if side == 0 { 0.0 } else { std::f64::consts::FRAC_PI_2 };
        for step in 0..4 {
            let t = (f64::from(step) + 0.5) / 4.0;
            maker.place(stock.lamp, stock.iron, placed(DVec3::ONE, turn, along(t, 0.5)));
            plant(maker, stock, along(t + 0.11, 0.6), random);
            if random.unit() < 0.6 {
                maker.place(
                    stock.bench,
                    stock.wood,
                    placed(DVec3::ONE, turn, along(t - 0.06, 0.7) + DVec3::Z * 0.2),
                );
            }
            if random.unit() < 0.7 {
                let paint = stock.paints[random.below(stock.paints.len() as u64) as usize];
                let at = along(t + 0.02, -1.6 - 0.3 * random.unit()) + DVec3::Z * 0.02;
                maker.place(stock.car, paint, placed(DVec3::ONE, turn, at));
            }
        }
    }
}

fn plant(maker: &mut Maker, stock: &Stock, at: DVec3, random: &mut Random) {
    let size = random.between(0.7, 1.2);
    let place = placed(DVec3::splat(size), random.between(0.0, 6.0), at);
    maker.place(stock.tree, stock.leaves, place);
}

fn stock(maker: &mut Maker, seed: u64) -> Stock {
    let mut random = Random::new(seed, 0);
    let houses = (0..6).map(|kind| house(4 + kind % 3, 3 + kind)).map(|m| maker.mesh(m)).collect();
    let mut wall = || {
        let base = random.between(120.0, 220.0);
        [0, 1, 2].map(|i| (base + random.between(-20.0, 20.0) - 8.0 * f64::from(i)) as u8)
    };
    let walls: Vec<[u8; 3]> = (0..8).map(|_| wall()).collect();
    let mut lamp = Solid::default();
    lamp.revolve(&[(0.12, -0.3), (0.09, 4.5)], 8);
    lamp.block(DVec3::new(-0.1, -0.1, 4.52), DVec3::new(1.3, 0.1, 4.65));
    let mut bench = Solid::default();
    bench.block(DVec3::new(-0.9, -0.2, 0.4), DVec3::new(0.9, 0.2, 0.46));
    bench.block(DVec3::new(-0.9, 0.21, 0.5), DVec3::new(0.9, 0.25, 0.9));
    for x in [-0.7, 0.6] {
        bench.block(DVec3::new(x, -0.18, -0.1), DVec3::new(x + 0.1, 0.18, 0.39));
    }
    let mut car = Solid::default();
    car.block(DVec3::new(-2.1, -0.85, 0.35), DVec3::new(2.1, 0.85, 0.85));
    car.block(DVec3::new(-1.2, -0.75, 0.86), DVec3::new(1.1, 0.75, 1.45));
    for (x, y) in [(-1.4, -0.8), (1.4, -0.8), (-1.4, 0.62), (1.4, 0.62)] {
        car.block(DVec3::new(x - 0.3, y, 0.0), DVec3::new(x + 0.3, y + 0.18, 0.34));
    }
    let paints = [[150, 30, 30], [30, 60, 130], [200, 200, 205], [40, 40, 44]];
    Stock {
        houses,
        walls: walls.into_iter().map(|color| maker.material(color)).collect(),
        ground: maker.mesh(block(DVec3::ONE)),
        pavement: maker.material([150, 148, 142]),
        asphalt: maker.material([82, 82, 86]),
        lamp: maker.mesh(lamp.into_mesh()),
        iron: maker.material([60, 66, 70]),
        tree: maker.mesh(tree().into_mesh()),
        leaves: maker.material([70, 110, 52]),
        car: maker.mesh(car.into_mesh()),
        paints: paints.into_iter().map(|color| maker.material(color)).collect(),
        bench: maker.mesh(bench.into_mesh()),
        wood: maker.material([120, 84, 50]),
    }
}

/// A trunk with three crowns.
pub(super) fn tree() -> Solid {
    let mut tree = Solid::default();
    tree.revolve(&[(0.22, -0.3), (0.15, 2.6)], 8);
    for (x, y, z, radius) in [(0.0, 0.0, 4.2, 1.7), (0.9, 0.4, 3.4, 1.2), (-0.7, -0.6, 3.6, 1.3)] {
        let mut crown = Solid::default();
        let profile: Vec<(f64, f64)> =
            sphere_profile(7).into_iter().map(|(r, h)| (r * radius, h * radius)).collect();
        crown.revolve(&profile, 11);
        tree.add(crown, DVec3::new(x, y, z));
    }
    tree
}

/// A house of unit size about the middle of its floor: walls with recessed windows, a flat roof
/// with a parapet block.
fn house(windows: u32, storeys: u32) -> crate::mesh::Mesh {
    let mut solid = Solid::default();
    let (floor, roof) = (0.0, 0.96);
    let frame = |side: u32| {
        let (s, c) = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)][side as usize];
        // Along the wall and outward.
        (DVec3::new(c, s, 0.0), DVec3::new(s, -c, 0.0))
    };
    for side in 0..4 {
        let (along, out) = frame(side);
        let at =
            |u: f64, z: f64, depth: f64| along * (u - 0.5) + out * (0.5 - depth) + DVec3::Z * z;
        for storey in 0..storeys {
            let z = |t: f64| floor + (roof - floor) * (f64::from(storey) + t) / f64::from(storeys);
            for window in 0..windows {
                let u = |t: f64| (f64::from(window) + t) / f64::from(windows);
                let outer = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
                let inner = [(0.25, 0.3), (0.75, 0.3), (0.75, 0.85), (0.25, 0.85)];
                for i in 0..4 {
                    let j = (i + 1) % 4;
                    let [a, b, c, d] = [outer[i], outer[j], inner[j], inner[i]];
                    let p = |(s, t): (f64, f64), depth| at(u(s), z(t), depth);
                    solid.quad([p(a, 0.0), p(b, 0.0), p(c, 0.0), p(d, 0.0)]);
                    solid.quad([p(d, 0.0), p(c, 0.0), p(c, 0.02), p(d, 0.02)]);
                }
                let pane = inner.map(|(s, t)| at(u(s), z(t), 0.02));
                solid.quad(pane);
            }
        }
    }
    solid.block(DVec3::new(-0.5, -0.5, roof), DVec3::new(0.5, 0.5, 0.985));
    solid.block(DVec3::new(-0.2, -0.15, 0.9851), DVec3::new(0.1, 0.2, 1.0));
    solid.into_mesh()
}
