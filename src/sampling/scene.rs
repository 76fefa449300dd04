//! A made-up landscape and the scans of it: hills, houses and trees, seen by terrestrial stations
//! and from the air.
//!
//! A square of one kilometre holds 220 houses, 2,500 trees and 48 stations. Of every 20 points 13
//! come from stations, whose density falls with the square of the distance and which do not see
//! through houses; 7 come evenly from an airborne pass, which gives several returns in trees. Point
//! `i` is a function of the settings and `i`, in the order in which the devices would have measured.
//! It is not a simulation of any device, and vegetation casts no shadow.
//!
//! Units: metres from the scene's corner, z above its datum. Records are those of LAS point format
//! 3, 34 bytes, with 16-bit colours.

use glam::{DVec2, DVec3};

use super::random::Random;

/// Size of a record of the scene.
pub const RECORD_BYTES: usize = 34;
/// LAS point format of the records.
pub const POINT_FORMAT: u8 = 3;
/// Edge of the scene.
pub const SIDE: f64 = 1000.0;

const CELLS: usize = 40;
const CELL: f64 = SIDE / CELLS as f64;
const HOUSES: usize = 220;
const TREES: usize = 2500;
const STATIONS: usize = 48;
const STRIPS: u64 = 16;
const NEAREST: f64 = 2.0;
const FARTHEST: f64 = 150.0;
const EYE_HEIGHT: f64 = 1.8;
/// GPS time of the first point, and points a second; both exact in binary, so that the number of a
/// point comes back from its time.
const FIRST_GPS_TIME: f64 = 300_000_000.0;
const POINTS_PER_SECOND: f64 = 131_072.0;

/// What to make.
#[derive(Clone, Copy, Debug)]
pub struct SceneSettings {
    /// Number of points.
    pub points: u64,
    /// Another seed gives another landscape.
    pub seed: u64,
    /// World position of the scene's corner.
    pub origin: DVec3,
    /// World length of one step of the coordinates, metres.
    pub step: f64,
}

impl SceneSettings {
    /// A scene at coordinates as UTM gives them, measured in millimetres.
    pub fn new(points: u64, seed: u64) -> Self {
        SceneSettings {
            points,
            seed,
            origin: DVec3::new(476_000.0, 5_429_000.0, 300.0),
            step: 0.001,
        }
    }
}

/// A landscape with its stations.
#[derive(Clone, Debug)]
pub struct Scene {
    settings: SceneSettings,
    hills: [Hill; 6],
    cells: Vec<SceneCell>,
    stations: Vec<DVec2>,
}

#[derive(Clone, Copy, Debug)]
struct Hill {
    wave: DVec2,
    phase: f64,
    height: f64,
}

#[derive(Clone, Debug, Default)]
struct SceneCell {
    house: Option<House>,
    trees: Vec<Tree>,
}

#[derive(Clone, Copy, Debug)]
struct House {
    min: DVec2,
    max: DVec2,
    ground: f64,
    height: f64,
    ridge: f64,
    wall_color: [f64; 3],
    roof_color: [f64; 3],
}

#[derive(Clone, Copy, Debug)]
struct Tree {
    place: DVec2,
    radius: f64,
    ground: f64,
    height: f64,
}

/// One measured point, before it becomes a record.
#[derive(Clone, Copy)]
struct Sample {
    position: DVec3,
    color: [f64; 3],
    reflectance: f64,
    class: u8,
    range: f64,
    returns: (u8, u8),
    angle_degrees: f64,
}

mod class {
    pub const GROUND: u8 = 2;
    pub const TREE: u8 = 5;
    pub const HOUSE: u8 = 6;
}

impl Scene {
    /// Lays out the landscape.
    pub fn new(settings: SceneSettings) -> Self {
        let mut random = Random::new(settings.seed, u64::MAX);
        let hills = std::array::from_fn(|i| {
            let length = 700.0 / 1.9f64.powi(i as i32);
            let direction = DVec2::from_angle(random.between(0.0, std::f64::consts::TAU));
            Hill {
                wave: direction * (std::f64::consts::TAU / length),
                phase: random.between(0.0, std::f64::consts::TAU),
                height: 0.018 * length,
            }
        });
        let mut scene = Scene {
            settings,
            hills,
            cells: vec![SceneCell::default(); CELLS * CELLS],
            stations: Vec::new(),
        };
        let mut free: Vec<usize> = (0..CELLS * CELLS).collect();
        for i in (1..free.len()).rev() {
            free.swap(i, random.below(i as u64 + 1) as usize);
        }
        let corner = |cell: usize| CELL * DVec2::new((cell % CELLS) as f64, (cell / CELLS) as f64);
        for &cell in &free[..HOUSES] {
            scene.cells[cell].house = Some(scene.house(corner(cell), &mut random));
        }
        // Who scans a town stands where houses are.
        let near_houses = |&cell: &usize| {
            let near = |a: usize, b: usize| a.abs_diff(b) <= 1;
            let neighbours = free[..HOUSES].iter().filter(|&&house| {
                near(house % CELLS, cell % CELLS) && near(house / CELLS, cell / CELLS)
            });
            neighbours.count()
        };
        let mut others = free[HOUSES..].to_vec();
        others.sort_by_cached_key(|cell| std::cmp::Reverse(near_houses(cell)));
        let places = others[..STATIONS].iter().map(|&cell| corner(cell) + 0.5 * CELL);
        scene.stations = places.collect();
        for _ in 0..TREES {
            let woods = &others[STATIONS..];
            let cell = woods[random.below(woods.len() as u64) as usize];
            let tree = scene.tree(corner(cell), &mut random);
            scene.cells[cell].trees.push(tree);
        }
        scene
    }

    fn house(&self, corner: DVec2, random: &mut Random) -> House {
        let size = DVec2::new(random.between(8.0, 18.0), random.between(8.0, 18.0));
        let room = DVec2::splat(CELL) - size;
        let min = corner + room * DVec2::new(random.unit(), random.unit());
        let gray = random.between(0.5, 0.9);
        House {
            min,
            max: min + size,
            ground: self.ground(min + 0.5 * size),
            height: random.between(3.0, 14.0),
            ridge: random.between(0.0, 4.0),
            wall_color: [gray, gray * 0.96, gray * random.between(0.8, 0.95)],
            roof_color: [random.between(0.4, 0.7), random.between(0.2, 0.35), 0.2],
        }
    }

    fn tree(&self, corner: DVec2, random: &mut Random) -> Tree {
        let radius = random.between(1.5, 4.0);
        let room = CELL - 2.0 * radius;
        let place = corner + radius + room * DVec2::new(random.unit(), random.unit());
        let height = radius * random.between(2.5, 4.5);
        Tree { place, radius, ground: self.ground(place), height }
    }

    /// World length of a step per axis, and world position of the integers' origin.
    pub fn scale_and_offset(&self) -> (DVec3, DVec3) {
        // Integers are around 0 in the middle of the scene, as surveyors choose offsets.
        let middle = DVec3::new(0.5 * SIDE, 0.5 * SIDE, 0.0);
        (DVec3::splat(self.settings.step), self.settings.origin + middle)
    }

    /// Number of points.
    pub fn points(&self) -> u64 {
        self.settings.points
    }

    /// The number of the point that carries a GPS time.
    pub fn point_of_gps_time(gps_time: f64) -> u64 {
        ((gps_time - FIRST_GPS_TIME) * POINTS_PER_SECOND) as u64
    }

    /// Writes the records of the points from `first` on; the slice holds whole records.
    pub fn fill(&self, first: u64, records: &mut [u8]) {
        assert!(records.len().is_multiple_of(RECORD_BYTES), "records are made whole");
        for (index, record) in (first..).zip(records.chunks_exact_mut(RECORD_BYTES)) {
            let (sample, source) = self.sample(index);
            self.put(index, source, &sample, record);
        }
    }

    /// Point `index`, and the station (1..) or strip (1001..) that measured it.
    fn sample(&self, index: u64) -> (Sample, u16) {
        let mut random = Random::new(self.settings.seed, index);
        let from_stations = (u128::from(self.settings.points) * 13 / 20) as u64;
        if index < from_stations {
            let (station, share) = part(index, from_stations, STATIONS as u64);
            (
                self.station_sample(self.stations[station as usize], share, &mut random),
                station as u16 + 1,
            )
        } else {
            let airborne = self.settings.points - from_stations;
            let (strip, share) = part(index - from_stations, airborne, STRIPS);
            (self.air_sample(strip, share, &mut random), strip as u16 + 1001)
        }
    }

    /// A station turns once while it measures: `share` of the turn is done.
    fn station_sample(&self, station: DVec2, share: f64, random: &mut Random) -> Sample {
        let direction = DVec2::from_angle(std::f64::consts::TAU * share);
        let eye = station.extend(self.ground(station) + EYE_HEIGHT);
        // Evenly in the logarithm of the distance: evenly in angle, so 1 / r^2 on the ground. What
        // would lie outside the scene is measured anew.
        let distance = (0..8)
            .map(|_| NEAREST * (FARTHEST / NEAREST).powf(random.unit()))
            .find(|&distance| inside(station + distance * direction))
            .unwrap_or(NEAREST);
        let target = station + distance * direction;
        let mut sample = match self.first_wall(station, target) {
            Some((house, place)) => {
                let z = house.ground + random.between(-0.5, house.height);
                let color = windows(house.wall_color, place, z - house.ground);
                Sample { class: class::HOUSE, reflectance: 0.5, ..at(place.extend(z), color) }
            }
            None => self.standing(target, 0.6, random).unwrap_or_else(|| self.floor(target)),
        };
        let noise = DVec3::new(random.bell(), random.bell(), random.bell());
        sample.position += 0.002 * noise;
        let ray = sample.position - eye;
        sample.range = ray.length();
        sample.angle_degrees = (ray.z / sample.range).clamp(-1.0, 1.0).asin().to_degrees();
        sample
    }

    /// Strips run along y, evenly; `share` of the strip is flown.
    fn air_sample(&self, strip: u64, share: f64, random: &mut Random) -> Sample {
        let across = random.unit();
        let width = SIDE / STRIPS as f64;
        let target = DVec2::new((strip as f64 + across) * width, share * SIDE);
        let house = self.cell(target).house.filter(|house| house.covers(target));
        let mut sample = match house {
            Some(house) => {
                let z = house.ground + house.roof(target);
                Sample {
                    class: class::HOUSE,
                    reflectance: 0.3,
                    ..at(target.extend(z), house.roof_color)
                }
            }
            None => self.standing(target, 0.75, random).unwrap_or_else(|| self.floor(target)),
        };
        if sample.class == class::TREE {
            sample.returns = [(1, 1), (1, 2), (1, 3), (2, 3)][random.below(4) as usize];
        }
        sample.position.z += 0.02 * random.bell();
        sample.range = 800.0;
        sample.angle_degrees = 40.0 * (across - 0.5);
        sample
    }

    /// A point in the tree over `target`, if there is one and the beam is caught.
    fn standing(&self, target: DVec2, caught: f64, random: &mut Random) -> Option<Sample> {
        let tree = self
            .cell(target)
            .trees
            .iter()
            .find(|tree| (tree.place - target).length_squared() < tree.radius * tree.radius)?;
        let hit = random.unit() < caught;
        // Leaves fill the outer half of a crown that is an ellipsoid on a bare trunk.
        let off = (target - tree.place) / tree.radius;
        let shell = random.between(0.5, 1.0).sqrt() * (1.0 - off.length_squared()).sqrt();
        let side = if random.unit() < 0.7 { 1.0 } else { -1.0 };
        let crown = 0.35 * tree.height;
        let z = tree.ground + tree.height - crown + side * shell * crown;
        let shade = 0.6 + 0.4 * random.unit();
        let color = [0.2 * shade, 0.42 * shade, 0.12 * shade];
        let sample = Sample { class: class::TREE, reflectance: 0.4, ..at(target.extend(z), color) };
        hit.then_some(sample)
    }

    fn floor(&self, target: DVec2) -> Sample {
        // Lanes between the cells are paved, the rest is grass with patches.
        let lane = (target / CELL).fract_gl();
        let paved = lane.min_element() < 0.08;
        let patch = 0.5 + 0.25 * ((target.x * 0.21).sin() + (target.y * 0.17).cos());
        let color = if paved {
            [0.35, 0.35, 0.37]
        } else {
            [0.25 + 0.2 * patch, 0.4 + 0.1 * patch, 0.15 + 0.05 * patch]
        };
        let reflectance = if paved { 0.15 } else { 0.35 };
        let position = target.extend(self.ground(target));
        Sample { class: class::GROUND, reflectance, ..at(position, color) }
    }

    fn ground(&self, place: DVec2) -> f64 {
        self.hills.iter().map(|hill| hill.height * (hill.wave.dot(place) + hill.phase).sin()).sum()
    }

    fn cell(&self, place: DVec2) -> &SceneCell {
        let [x, y] = cell_index(place);
        &self.cells[y * CELLS + x]
    }

    /// The first house between two places, and where its wall is met. Walks the grid of cells.
    fn first_wall(&self, from: DVec2, to: DVec2) -> Option<(&House, DVec2)> {
        let ray = to - from;
        let [mut x, mut y] = cell_index(from).map(|i| i as isize);
        let step = [ray.x, ray.y].map(|d| if d < 0.0 { -1 } else { 1 });
        let share = |axis: usize, index: isize| {
            let edge = (index + isize::from(step[axis] > 0)) as f64 * CELL;
            let (from, ray) = (from.to_array()[axis], ray.to_array()[axis]);
            if ray == 0.0 { f64::INFINITY } else { (edge - from) / ray }
        };
        // A ray of 150 m crosses fewer than 20 cells of 25 m.
        for _ in 0..20 {
            let cell = &self.cells[y as usize * CELLS + x as usize];
            let met = cell.house.as_ref().and_then(|house| Some((house, house.entry(from, ray)?)));
            if let Some((house, at)) = met {
                return Some((house, from + at * ray));
            }
            let (next_x, next_y) = (share(0, x), share(1, y));
            if next_x.min(next_y) >= 1.0 {
                break;
            }
            if next_x < next_y {
                x += step[0]
            } else {
                y += step[1]
            }
            if !(0..CELLS as isize).contains(&x) || !(0..CELLS as isize).contains(&y) {
                break;
            }
        }
        None
    }

    fn put(&self, index: u64, source: u16, sample: &Sample, record: &mut [u8]) {
        let (scale, _) = self.scale_and_offset();
        let middle = DVec3::new(0.5 * SIDE, 0.5 * SIDE, 0.0);
        // Coordinates beyond the lattice's reach stop at its end, as a saturating cast does.
        let integers = ((sample.position - middle) / scale).round().to_array().map(|i| i as i32);
        let mut put = |at: usize, value: &[u8]| record[at..at + value.len()].copy_from_slice(value);
        for (axis, integer) in integers.into_iter().enumerate() {
            put(4 * axis, &integer.to_le_bytes());
        }
        let strength = sample.reflectance * (1.0 - 0.4 * (sample.range / 1000.0).min(1.0));
        let (number, count) = sample.returns;
        put(12, &((65_535.0 * strength) as u16).to_le_bytes());
        put(14, &[number | count << 3, sample.class]);
        put(16, &[(sample.angle_degrees.round() as i8) as u8, (index % 251) as u8]);
        put(18, &source.to_le_bytes());
        let gps_time = FIRST_GPS_TIME + index as f64 / POINTS_PER_SECOND;
        put(20, &gps_time.to_le_bytes());
        for (channel, value) in sample.color.into_iter().enumerate() {
            put(28 + 2 * channel, &((65_535.0 * value) as u16).to_le_bytes());
        }
    }
}

impl House {
    fn covers(&self, place: DVec2) -> bool {
        place.cmpge(self.min).all() && place.cmple(self.max).all()
    }

    /// Height of the roof above the house's ground: two slopes that meet in the middle of x.
    fn roof(&self, place: DVec2) -> f64 {
        let half = 0.5 * (self.max.x - self.min.x);
        let off = (place.x - self.min.x - half).abs() / half;
        self.height + self.ridge * (1.0 - off)
    }

    /// Share of the ray at which it enters the house's outline; `None` if it does not.
    fn entry(&self, from: DVec2, ray: DVec2) -> Option<f64> {
        let a = (self.min - from) / ray;
        let b = (self.max - from) / ray;
        let enter = a.min(b).max_element();
        let leave = a.max(b).min_element();
        (enter <= leave && enter > 0.0 && enter <= 1.0).then_some(enter)
    }
}

fn at(position: DVec3, color: [f64; 3]) -> Sample {
    Sample {
        position,
        color,
        reflectance: 0.3,
        class: class::GROUND,
        range: 0.0,
        returns: (1, 1),
        angle_degrees: 0.0,
    }
}

/// Walls have rows of dark windows.
fn windows(wall: [f64; 3], place: DVec2, height: f64) -> [f64; 3] {
    let column = ((place.x + place.y) / 2.5).fract();
    let row = (height / 3.0).fract();
    let is_window = (0.3..0.7).contains(&column) && (0.35..0.75).contains(&row);
    if is_window { [0.12, 0.16, 0.22] } else { wall }
}

/// Which of `parts` equal parts of `count` an index lies in, and how far in that part (0..1).
fn part(index: u64, count: u64, parts: u64) -> (u64, f64) {
    let scaled = u128::from(index) * u128::from(parts);
    let part = (scaled / u128::from(count)) as u64;
    (part, (scaled % u128::from(count)) as f64 / count as f64)
}

fn inside(place: DVec2) -> bool {
    place.cmpge(DVec2::ZERO).all() && place.cmplt(DVec2::splat(SIDE)).all()
}

fn cell_index(place: DVec2) -> [usize; 2] {
    (place / CELL).to_array().map(|i| (i as usize).min(CELLS - 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(points: u64) -> Scene {
        Scene::new(SceneSettings::new(points, 11))
    }

    #[test]
    fn any_part_comes_out_the_same() {
        let scene = scene(10_000);
        let mut whole = vec![0; 10_000 * RECORD_BYTES];
        scene.fill(0, &mut whole);
        let mut part = vec![0; 700 * RECORD_BYTES];
        for first in [0, 6_200, 9_300] {
            scene.fill(first, &mut part);
            let from = first as usize * RECORD_BYTES;
            assert!(part == whole[from..from + part.len()]);
        }
        for (index, record) in whole.chunks_exact(RECORD_BYTES).enumerate() {
            let time = f64::from_le_bytes(record[20..28].try_into().expect("8 bytes"));
            assert_eq!(Scene::point_of_gps_time(time), index as u64);
        }
    }

    #[test]
    fn the_landscape_has_its_parts() {
        let scene = scene(40_000);
        let mut counts = [0; 8];
        for index in 0..scene.points() {
            let (sample, _) = scene.sample(index);
            counts[usize::from(sample.class)] += 1;
            let place = sample.position.truncate();
            assert!(place.cmpge(DVec2::splat(-0.1)).all());
            assert!(place.cmple(DVec2::splat(SIDE + 0.1)).all());
        }
        let least = [(class::GROUND, 20_000), (class::HOUSE, 2_000), (class::TREE, 500)];
        for (class, least) in least {
            assert!(counts[usize::from(class)] > least, "{counts:?}");
        }
    }

    /// Rings of equal width in the logarithm hold equally many points of a station: the number per
    /// area falls with the square of the distance.
    #[test]
    fn a_station_s_density_falls_with_the_square_of_the_distance() {
        let scene = scene(480_000);
        let station = 20;
        let mut rings = [0u32; 4];
        for index in 0..scene.points() * 13 / 20 {
            let (sample, source) = scene.sample(index);
            if source == station + 1 && sample.class == class::GROUND {
                let off = sample.position.truncate() - scene.stations[usize::from(station)];
                let ring = (off.length() / 2.0).log2().floor();
                if (0.0..2.0).contains(&ring) {
                    rings[ring as usize] += 1;
                }
            }
        }
        // 2-4 m and 4-8 m: nothing stands that near in a station's own cell but trees.
        let ratio = f64::from(rings[0]) / f64::from(rings[1]);
        assert!((0.9..1.15).contains(&ratio), "{rings:?}");
    }
}
