//! Time from anywhere within a box, for directions of view: measured, or bounded by per-object
//! tables.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};

use crate::budget::{Lookup, PosTable, ViewAngles, sphere_footprint, visible_angle};
use crate::geometry::{Aabb, View};

/// The longest measured time per direction of a view cell.
#[derive(Clone, Debug, PartialEq)]
pub struct CellTable {
    times_ms: Vec<f32>,
    draws: u32,
}

/// Views drawn at first per direction.
const FIRST_DRAWS: u32 = 16;
/// Most views drawn per direction.
const MOST_DRAWS: u32 = 16 * FIRST_DRAWS;

impl CellTable {
    /// Directions of the table: to the faces, edges and corners of a cube.
    pub fn directions() -> Vec<DVec3> {
        let steps = || [-1.0, 0.0, 1.0].into_iter();
        let all = steps()
            .flat_map(|x| steps().flat_map(move |y| steps().map(move |z| DVec3::new(x, y, z))));
        all.filter_map(DVec3::try_normalize).collect()
    }

    /// Measures random views: `measure` gets the index of a direction and the number of the draw
    /// and gives the time of a view from a random place in the cell, near that direction. Goes on
    /// until the maximum has not changed for half as many draws as it began with.
    pub fn measure(mut measure: impl FnMut(usize, u32) -> f64) -> CellTable {
        let mut draws = 0;
        let mut row = |direction: usize| {
            let (mut most, mut last_change, mut draw) = (0.0f64, 0, 0);
            while draw < MOST_DRAWS && (draw < FIRST_DRAWS || draw - last_change < FIRST_DRAWS / 2)
            {
                let time_ms = measure(direction, draw);
                draw += 1;
                if time_ms.is_finite() && time_ms > most {
                    (most, last_change) = (time_ms, draw);
                }
            }
            draws += draw;
            most as f32
        };
        let times_ms = (0..Self::directions().len()).map(&mut row).collect();
        CellTable { times_ms, draws }
    }

    /// The time of the direction nearest to `forward`.
    pub fn time_ms(&self, forward: DVec3) -> f64 {
        let directions = Self::directions();
        let near = |d: &DVec3| d.dot(forward);
        let nearest = (0..directions.len())
            .max_by(|&a, &b| near(&directions[a]).total_cmp(&near(&directions[b])));
        nearest.map_or(0.0, |i| f64::from(self.times_ms[i]))
    }

    /// Views that were measured.
    pub fn measured(&self) -> u32 {
        self.draws
    }
}

/// An object with its table.
#[derive(Clone, Copy, Debug)]
pub struct SphereObject<'a> {
    /// Middle of its bounding sphere.
    pub center: DVec3,
    /// Radius of its bounding sphere.
    pub radius: f64,
    /// Its times.
    pub table: &'a PosTable,
}

impl SphereObject<'_> {
    /// Predicted time from one viewpoint, clipped to the picture.
    pub fn time_ms(&self, view: &View, lookup: Lookup) -> f64 {
        let footprint = sphere_footprint(view, self.center, self.radius);
        let angles = ViewAngles::of(view.camera.eye, self.center, self.radius);
        let size_rad = visible_angle(view, &footprint);
        self.table.time_ms(&ViewAngles { size_rad, ..angles }, lookup)
    }
}

/// Time that no view from within `cell` exceeds by its own conservative look-ups, if its direction
/// is within `spread_rad` of that of `view` (whose eye does not matter).
///
/// Safe rather than tight: each object counts from the place where it is nearest, unclipped and
/// from its worst side, unless no eye in the cell can see it.
pub fn cell_bound(objects: &[SphereObject], cell: &Aabb, view: &View, spread_rad: f64) -> f64 {
    let reach = 0.5 * cell.diagonal();
    let camera = &view.camera;
    let half_diagonal =
        0.5 * DVec2::new(f64::from(view.width_px), f64::from(view.height_px)).length();
    let half_angle = (half_diagonal / view.focal_px()).atan() + spread_rad;
    let bound = |object: &SphereObject| {
        let place = object.center - cell.center();
        // Seen from somewhere in the cell only if the cone from its middle comes as near to the
        // object's middle as the radius and half the cell.
        let (distance, slack) = (place.length(), object.radius + reach);
        let off_axis = place.angle_between(camera.forward);
        let off_cone = off_axis - half_angle;
        let gap = match off_cone {
            off if off.is_nan() || off <= 0.0 => 0.0,
            off if off < 0.5 * PI => distance * off.sin(),
            _ => distance,
        };
        if gap > slack {
            return 0.0;
        }
        let nearest = object.center.clamp(cell.min, cell.max);
        object.table.longest_ms(ViewAngles::of(nearest, object.center, object.radius).size_rad)
    };
    objects.iter().map(bound).sum()
}

/// Eyes in a cell from which a sphere may appear largest in the picture: the cell's corners, the
/// places on its faces where a side of the frustum touches the sphere, and (ours; the other two
/// miss it) the place nearest to the sphere.
pub fn paper_candidates(cell: &Aabb, view: &View, center: DVec3, radius: f64) -> Vec<DVec3> {
    let corner = |i: u32| {
        let pick = |axis: usize| if i >> axis & 1 == 1 { cell.max[axis] } else { cell.min[axis] };
        DVec3::new(pick(0), pick(1), pick(2))
    };
    let mut eyes: Vec<DVec3> = (0..8).map(corner).collect();
    eyes.push(center.clamp(cell.min, cell.max));
    let camera = &view.camera;
    let (half_x, half_y) = (0.5 * f64::from(view.width_px), 0.5 * f64::from(view.height_px));
    let focal_px = view.focal_px();
    // Normals of the frustum's sides, inwards.
    let sides = [
        camera.forward * half_x + camera.right() * focal_px,
        camera.forward * half_x - camera.right() * focal_px,
        camera.forward * half_y + camera.up * focal_px,
        camera.forward * half_y - camera.up * focal_px,
    ];
    for (axis, bound) in (0..3).flat_map(|axis| [(axis, cell.min[axis]), (axis, cell.max[axis])]) {
        for side in sides.map(DVec3::normalize) {
            for touch in [radius, -radius] {
                // On the face, eyes with `side . (center - eye) = touch` form a line; the one
                // nearest to the sphere, held within the face.
                let mut eye = center;
                eye[axis] = bound;
                let mut within = side;
                within[axis] = 0.0;
                let length_squared = within.length_squared();
                if length_squared < 1e-12 {
                    continue;
                }
                let off = side.dot(center - eye) - touch;
                eye += within * (off / length_squared);
                eyes.push(eye.clamp(cell.min, cell.max));
            }
        }
    }
    eyes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;
    use crate::sampling::Random;

    fn direction(random: &mut Random) -> DVec3 {
        let axes = DVec3::new(random.bell(), random.bell(), random.bell());
        axes.try_normalize().unwrap_or(DVec3::X)
    }

    fn view(eye: DVec3, forward: DVec3) -> View {
        let camera = Camera::looking_at(eye, eye + forward, DVec3::Z, 1.0, 0.1);
        View { camera, width_px: 320, height_px: 200 }
    }

    /// Random cells, objects and directions; ten thousand eyes each, at bounds and inside.
    #[test]
    fn no_eye_in_a_cell_needs_more_than_its_bound() {
        let table =
            PosTable::measure(|v| 0.1 + 0.3 * v.size_rad.powi(2) * (1.2 + v.azimuth_rad.cos()));
        for case in 0..6 {
            let mut random = Random::new(15, case);
            let size = DVec3::new(random.unit(), random.unit(), random.unit()) * 4.0;
            let cell = Aabb::new(DVec3::ZERO, size);
            let spheres: Vec<(DVec3, f64)> = (0..5)
                .map(|_| {
                    let place = direction(&mut random) * random.between(0.0, 25.0);
                    (place, random.between(0.1, 4.0))
                })
                .collect();
            let objects: Vec<SphereObject> = spheres
                .iter()
                .map(|&(center, radius)| SphereObject { center, radius, table: &table })
                .collect();
            let axis = direction(&mut random);
            let spread_rad = random.between(0.0, 0.5);
            let bound = cell_bound(&objects, &cell, &view(DVec3::ZERO, axis), spread_rad);
            let mut most = 0.0f64;
            for _ in 0..10_000 {
                let mut eye = DVec3::new(random.unit(), random.unit(), random.unit());
                if random.below(2) == 0 {
                    let axis = random.below(3) as usize;
                    eye[axis] = eye[axis].round();
                }
                // A direction within the spread: tilted by at most that angle.
                let across = axis.cross(direction(&mut random)).try_normalize().unwrap_or(DVec3::X);
                let tilt = random.between(0.0, spread_rad);
                let forward = axis * tilt.cos() + across * tilt.sin();
                let view = view(cell.min + eye * size, forward);
                let sum = objects.iter().map(|o| o.time_ms(&view, Lookup::Conservative)).sum();
                most = most.max(sum);
            }
            assert!(bound >= most, "case {case}: {bound} < {most}");
        }
    }

    /// With the frustum's direction fixed, the candidates reach what ten thousand eyes find for
    /// single objects, up to the coarseness of the eyes.
    #[test]
    fn the_candidates_are_the_places_where_an_object_appears_largest() {
        for case in 0..40 {
            let mut random = Random::new(16, case);
            let size = DVec3::new(random.unit(), random.unit(), random.unit()) * 3.0;
            let cell = Aabb::new(DVec3::ZERO, size);
            let forward = direction(&mut random);
            let center = forward * random.between(6.0, 12.0) + direction(&mut random) * 2.0;
            let radius = random.between(0.2, 1.5);
            let visible = |eye: DVec3| {
                let view = view(eye, forward);
                visible_angle(&view, &sphere_footprint(&view, center, radius))
            };
            let reference = view(DVec3::ZERO, forward);
            let eyes = paper_candidates(&cell, &reference, center, radius);
            assert!(
                eyes.iter().all(|eye| cell.min.cmple(*eye).all() && cell.max.cmpge(*eye).all())
            );
            let best = eyes.into_iter().map(visible).fold(0.0, f64::max);
            let mut most = 0.0f64;
            for _ in 0..2000 {
                let eye = DVec3::new(random.unit(), random.unit(), random.unit()) * size;
                most = most.max(visible(eye));
            }
            assert!(best >= 0.97 * most, "case {case}: {best} {most}");
        }
    }

    #[test]
    fn sampling_goes_on_until_the_maximum_rests() {
        let table =
            CellTable::measure(|direction, draw| (direction as f64) + f64::from(draw.min(20)));
        assert_eq!(table.times_ms.len(), 26);
        assert_eq!(table.measured(), 26 * 29, "the 21st draw is the last to change");
        let steady = CellTable::measure(|_, _| 2.0);
        assert_eq!(steady.measured(), 26 * 16);
        assert_eq!(steady.time_ms(DVec3::Z), 2.0);
        let odd = CellTable::measure(|_, _| f64::NAN);
        assert_eq!(odd.time_ms(DVec3::NAN), 0.0);
        let ever = CellTable::measure(|_, draw| f64::from(draw));
        assert_eq!(ever.measured(), 26 * MOST_DRAWS, "it ends anyway");
    }
}
