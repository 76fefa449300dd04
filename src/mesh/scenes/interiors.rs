//! Indoors: stacked rooms with doors, and a plant full of pipes.

use std::f64::consts::FRAC_PI_2;

use glam::{DAffine3, DQuat, DVec3};

use super::{Maker, ModelScene, placed};
use crate::mesh::shapes::{Solid, block, cylinder, sphere};
use crate::sampling::Random;

const ROOM: DVec3 = DVec3::new(6.0, 5.0, 3.0);
const WALL: f64 = 0.2;

/// `size` rooms along each axis; every wall has a door, floors are closed.
pub(super) fn rooms(size: u32, seed: u64) -> ModelScene {
    let mut maker = Maker::default();
    // A wall across x with a door in the middle, and the same across y.
    let wall = |span: f64| {
        let mut solid = Solid::default();
        let (half, door, head) = (0.5 * span - 0.11, 0.5, 2.1);
        let (low, high) = (0.06, ROOM.z - 0.06);
        let thick = 0.5 * WALL;
        solid.block(DVec3::new(-thick, -half, low), DVec3::new(thick, -door, high));
        solid.block(DVec3::new(-thick, door, low), DVec3::new(thick, half, high));
        solid.block(DVec3::new(-thick, -door, head), DVec3::new(thick, door, high));
        solid.into_mesh()
    };
    let across_x = maker.mesh(wall(ROOM.y));
    let across_y = maker.mesh(wall(ROOM.x));
    let floor = maker.mesh(block(DVec3::new(ROOM.x - 0.01, ROOM.y - 0.01, 0.1)));
    let post = maker.mesh(block(DVec3::new(WALL, WALL, ROOM.z - 0.12)));
    let mut table = Solid::default();
    table.block(DVec3::new(-0.8, -0.5, 0.7), DVec3::new(0.8, 0.5, 0.75));
    for (x, y) in [(-0.7, -0.4), (0.7, -0.4), (-0.7, 0.4), (0.7, 0.4)] {
        table.block(DVec3::new(x - 0.04, y - 0.04, 0.06), DVec3::new(x + 0.04, y + 0.04, 0.69));
    }
    let table = maker.mesh(table.into_mesh());
    let shelf = maker.mesh(block(DVec3::new(0.4, 1.4, 1.9)));
    let ball = maker.mesh(sphere(10, 14));
    let [plaster, boards, beech, green] =
        [[214, 208, 196], [128, 98, 70], [172, 128, 84], [70, 130, 110]]
            .map(|color| maker.material(color));
    for z in 0..size {
        for y in 0..size {
            for x in 0..size {
                let cell = DVec3::new(f64::from(x), f64::from(y), f64::from(z)) * ROOM;
                let middle = cell + DVec3::new(0.5, 0.5, 0.0) * ROOM;
                let number = (u64::from(z) * u64::from(size) + u64::from(y)) * u64::from(size);
                let mut random = Random::new(seed, number + u64::from(x) + 1);
                maker.place(floor, boards, placed(DVec3::ONE, 0.0, middle));
                let place = |at: DVec3, turn: f64| placed(DVec3::ONE, turn, at);
                let west = DVec3::new(cell.x, middle.y, cell.z);
                let south = DVec3::new(middle.x, cell.y, cell.z);
                maker.place(across_x, plaster, place(west, 0.0));
                maker.place(across_y, plaster, place(south, FRAC_PI_2));
                maker.place(post, plaster, place(cell + DVec3::Z * 0.5 * ROOM.z, 0.0));
                let mut spot = |spread: f64| {
                    middle + DVec3::new(random.bell() * spread, random.bell() * spread, 0.0)
                };
                let (table_at, shelf_at, ball_at) = (spot(0.4), spot(0.05), spot(0.5));
                maker.place(table, beech, place(table_at, 0.3));
                let corner = DVec3::new(-0.4 * ROOM.x, 0.3 * ROOM.y, 1.02);
                maker.place(shelf, green, place(shelf_at + corner, 0.0));
                let ball_at = ball_at + DVec3::new(1.8, -1.2, 0.4);
                maker.place(ball, green, placed(DVec3::splat(0.3), 0.0, ball_at));
            }
        }
    }
    // The outer walls on the far sides.
    for z in 0..size {
        for i in 0..size {
            let (i, z, n) = (f64::from(i), f64::from(z), f64::from(size));
            let east = DVec3::new(n, i + 0.5, z) * ROOM;
            maker.place(across_x, plaster, placed(DVec3::ONE, 0.0, east));
            let north = DVec3::new(i + 0.5, n, z) * ROOM;
            maker.place(across_y, plaster, placed(DVec3::ONE, FRAC_PI_2, north));
        }
    }
    // Through the doors of the middle storey: along x, then along y.
    let at = |x: f64, y: f64| DVec3::new(x, y, f64::from(size / 2)) * ROOM + DVec3::Z * 1.6;
    let row = f64::from(size / 2) + 0.5;
    let last = f64::from(size) - 0.5;
    maker.finish(vec![at(0.5, row), at(last, row), at(last, last)])
}

/// About 160 objects for each unit of `size`: pipes along the axes with bends, tanks, valves,
/// floors.
pub(super) fn pipes(size: u32, seed: u64) -> ModelScene {
    let mut maker = Maker::default();
    let pipe = maker.mesh(cylinder(14));
    let bend = maker.mesh(sphere(8, 12));
    let plate = maker.mesh(block(DVec3::ONE));
    let valve = maker.mesh({
        let mut solid = Solid::default();
        solid.revolve(&[(0.6, -0.3), (0.7, 0.0), (0.6, 0.3)], 12);
        solid.block(DVec3::new(-0.1, -0.1, 0.31), DVec3::new(0.1, 0.1, 1.2));
        solid.into_mesh()
    });
    let metals: Vec<_> = [[150, 152, 156], [120, 80, 60], [90, 110, 130], [170, 150, 70]]
        .into_iter()
        .map(|color| maker.material(color))
        .collect();
    // The hall grows with the number of objects, at a constant density.
    let edge = 9.0 * f64::from(size).cbrt();
    let hall = DVec3::new(1.6 * edge, edge, 0.7 * edge);
    let mut number = 0u64;
    for run in 0..size {
        let mut random = Random::new(seed, u64::from(run) + 1);
        // A run of pipes that turns at right angles.
        let mut unit = || DVec3::new(random.unit(), random.unit(), random.unit());
        let mut at = unit() * hall;
        let metal = metals[(run % metals.len() as u32) as usize];
        let radius = 0.06 + 0.3 * random.unit().powi(3);
        let mut axis = random.below(3) as usize;
        for _ in 0..50 {
            let mut length = random.between(1.5, 9.0);
            if random.unit() < 0.5 {
                length = -length;
            }
            if at[axis] + length < 0.0 || at[axis] + length > hall[axis] {
                length = -length;
            }
            let mut end = at;
            end[axis] += length;
            let turn = [
                DQuat::from_rotation_y(FRAC_PI_2),
                DQuat::from_rotation_x(-FRAC_PI_2),
                DQuat::IDENTITY,
            ][axis];
            let low = at.min(end);
            let size = DVec3::new(radius, radius, length.abs());
            let place = DAffine3::from_scale_rotation_translation(size, turn, low);
            maker.place(pipe, metal, place);
            let wide = DVec3::splat(1.25 * radius);
            maker.place(bend, metal, placed(wide, 0.2, end));
            let middle = 0.5 * (at + end);
            if number % 5 < 4 {
                let scale = DVec3::splat(1.9 * radius);
                maker.place(valve, metal, placed(scale, random.between(0.0, 3.0), middle));
            }
            if number.is_multiple_of(3) {
                let size = DVec3::new(4.0 * radius, 0.1, 1.1);
                maker.place(plate, metal, placed(size, 0.7, middle - DVec3::Z * 0.8));
            }
            number += 1;
            at = end;
            axis = (axis + 1 + random.below(2) as usize) % 3;
        }
        if run.is_multiple_of(4) {
            let at = DVec3::new(random.unit(), random.unit(), random.unit()) * hall;
            let size = DVec3::new(1.5, 1.5, 4.0) * random.between(0.6, 1.4);
            maker.place(pipe, metals[2], placed(size, 0.0, at));
            maker.place(bend, metals[2], placed(DVec3::splat(1.02 * size.x), 0.0, at));
        }
    }
    let storeys = (hall.z / 6.0).ceil() as u32;
    for storey in 0..=storeys {
        for tile in 0..48u32 {
            let (x, y) = (f64::from(tile % 8) + 0.5, f64::from(tile / 8) + 0.5);
            let mut random = Random::new(seed ^ 0xf1, u64::from(storey * 48 + tile));
            if storey > 0 && random.unit() < 0.3 {
                continue;
            }
            let size = DVec3::new(hall.x / 8.0 - 0.05, hall.y / 6.0 - 0.05, 0.12);
            let at = DVec3::new(x * hall.x / 8.0, y * hall.y / 6.0, f64::from(storey) * 6.0 - 0.3);
            maker.place(plate, metals[1], placed(size, 0.0, at));
        }
    }
    let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z) * hall;
    maker.finish(vec![
        at(0.05, 0.4, 0.2),
        at(0.5, 0.52, 0.3),
        at(0.9, 0.6, 0.45),
        at(0.6, 0.2, 0.6),
    ])
}
