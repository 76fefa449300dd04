//! The scans and cameras of the suite `stability`.

use std::io;
use std::path::Path;

use glam::DVec3;

use crate::commands::bench::stability::Case;
use crate::geometry::Camera;
use crate::input::{LasTemplate, NewScan, PointFormat};
use crate::output::{Compression, LasWriter};
use crate::points::Lattice;
use crate::sampling::Random;

/// Lattice steps along the edge of a scan.
const EDGE: i32 = 100_000;
const FOV_Y_DEG: f64 = 60.0;
const RECORD_BYTES: usize = 26;

/// All cases, sweep by sweep.
pub(super) fn cases(quick: bool, size: Option<(u32, u32)>) -> Vec<Case> {
    let plan = Plan {
        size: size.unwrap_or(if quick { (320, 180) } else { (640, 360) }),
        points: if quick { 4_000 } else { 30_000 },
        views: if quick { 3 } else { 8 },
        keep: if quick { 3 } else { 1 },
    };
    let mut cases = plan.offsets();
    cases.extend(plan.extents());
    cases.extend(plan.near_planes());
    cases.extend(plan.fields_of_view());
    cases.extend(plan.sets());
    cases.extend(plan.views());
    cases
}

struct Plan {
    size: (u32, u32),
    points: usize,
    views: u64,
    /// Every so manieth value of a sweep.
    keep: usize,
}

impl Plan {
    /// A bumpy sheet 100 m wide under a case's name.
    fn case(&self, sweep: &'static str, name: String, value: f64) -> Case {
        let lattice = Lattice { scale: DVec3::splat(0.001), offset: DVec3::ZERO };
        Case {
            sweep,
            name,
            value,
            lattice,
            points: sheet(self.points),
            cameras: self.cameras(100.0, FOV_Y_DEG, 1e-4),
            size: self.size,
            budget: u64::MAX,
        }
    }

    /// Cameras around and within a cube of that edge at the origin; their near plane is a share of
    /// it.
    fn cameras(&self, edge: f64, fov_y_deg: f64, near_share: f64) -> Vec<Camera> {
        let fov_y_rad = fov_y_deg.to_radians();
        // As far as the cube fills the picture, whatever the field of view.
        let reach = 0.5 / (0.5 * fov_y_rad).tan();
        (0..self.views)
            .map(|index| {
                let mut random = Random::new(77, index);
                let mut direction = || random.between(-1.0, 1.0);
                let towards = DVec3::new(direction(), direction(), direction().abs() + 0.2);
                let towards = towards.normalize();
                let far = match index % 3 {
                    0 => 0.2,
                    1 => reach + 0.6,
                    _ => reach * 0.5 + 0.3,
                };
                let target = DVec3::new(0.5, 0.5, 0.3) * edge;
                let eye = target + towards * (far * edge);
                Camera::looking_at(eye, target, DVec3::Z, fov_y_rad, near_share * edge)
            })
            .collect()
    }

    /// Some of the values of a sweep, the last among them.
    fn kept<'a>(&self, values: &'a [f64]) -> impl Iterator<Item = &'a f64> {
        values.iter().rev().step_by(self.keep)
    }

    fn offsets(&self) -> Vec<Case> {
        let offsets = [0.0, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8];
        let case = |&offset: &f64| {
            let mut case = self.case("offset", format!("{offset:e} m"), offset);
            case.lattice.offset = DVec3::new(offset, -offset, 0.25 * offset);
            case
        };
        self.kept(&offsets).map(case).collect()
    }

    fn extents(&self) -> Vec<Case> {
        let exponents: Vec<i32> = (-6..=8).step_by(self.keep).collect();
        let case = |exponent: &i32| {
            let extent = 10f64.powi(*exponent);
            let mut case = self.case("extent", format!("{extent:e} m"), extent);
            case.lattice.scale = DVec3::splat(extent / f64::from(EDGE));
            case.cameras = self.cameras(extent, FOV_Y_DEG, 1e-4);
            case
        };
        exponents.iter().map(case).collect()
    }

    fn near_planes(&self) -> Vec<Case> {
        let case = |exponent: i32| {
            let share = 10f64.powi(exponent);
            let mut case = self.case("near plane", format!("{share:e} of the extent"), share);
            case.cameras = self.cameras(100.0, FOV_Y_DEG, share);
            case
        };
        (-9..=-1).step_by(self.keep).map(case).collect()
    }

    fn fields_of_view(&self) -> Vec<Case> {
        let degrees = [1.0, 2.0, 5.0, 10.0, 30.0, 60.0, 90.0, 120.0, 150.0, 170.0];
        let case = |&degrees: &f64| {
            let mut case = self.case("field of view", format!("{degrees} degrees"), degrees);
            case.cameras = self.cameras(100.0, degrees, 1e-4);
            case
        };
        self.kept(&degrees).map(case).collect()
    }

    fn sets(&self) -> Vec<Case> {
        let count = self.points as i32;
        let along = |i: i32| (i64::from(i) * i64::from(EDGE) / i64::from(count)) as i32;
        let side = f64::from(count).sqrt() as i32;
        let of = |point: &dyn Fn(i32) -> [i32; 3]| (0..count).map(point).collect::<Vec<_>>();
        let named: Vec<(&str, Vec<[i32; 3]>)> = vec![
            ("one point", vec![[EDGE / 2; 3]]),
            ("two points", vec![[0; 3], [EDGE; 3]]),
            ("coincident", of(&|_| [EDGE / 3; 3])),
            ("a line along x", of(&|i| [along(i), EDGE / 2, EDGE / 3])),
            ("a diagonal", of(&|i| [along(i); 3])),
            ("a plane", of(&|i| [i % side * (EDGE / side), i / side * (EDGE / side), EDGE / 4])),
            (
                "an oblique plane",
                of(&|i| {
                    let (x, y) = (i % side * (EDGE / side), i / side * (EDGE / side));
                    [x, y, (x + y) / 4]
                }),
            ),
            (
                "on the borders of cells",
                of(&|i| [i % 32, i / 32 % 32, i / 1024 % 32].map(|c| c << 11)),
            ),
            (
                "density falling over 4 decades",
                of(&|i| {
                    let mut random = Random::new(3, i as u64);
                    let reach = 10f64.powf(random.between(-4.0, 0.0)) * f64::from(EDGE);
                    let angle = random.between(0.0, std::f64::consts::TAU);
                    let half = f64::from(EDGE / 2);
                    let (sin, cos) = angle.sin_cos();
                    [(half + 0.5 * reach * cos) as i32, (half + 0.5 * reach * sin) as i32, EDGE / 4]
                }),
            ),
            (
                "two clusters 1e6 m apart",
                of(&|i| {
                    let [x, y, z] = sheet_point(i as u64);
                    [x / 100 + i % 2 * 1_000_000_000, y / 100, z / 100]
                }),
            ),
        ];
        let case = |(name, points): (&str, Vec<[i32; 3]>)| {
            let mut case = self.case("set", name.into(), 0.0);
            if name.starts_with("two clusters") {
                case.cameras.push(Camera::looking_at(
                    DVec3::new(-3.0, 0.5, 2.0),
                    DVec3::new(1e6, 0.5, 0.3),
                    DVec3::Z,
                    FOV_Y_DEG.to_radians(),
                    1e-2,
                ));
            }
            case.points = points;
            case
        };
        named.into_iter().map(case).collect()
    }

    /// Cameras, sizes of the picture and budgets that are extreme.
    fn views(&self) -> Vec<Case> {
        let fov_y_rad = FOV_Y_DEG.to_radians();
        let middle = DVec3::new(50.0, 50.0, 30.0);
        let at = |eye: DVec3, near| Camera::looking_at(eye, middle, DVec3::Z, fov_y_rad, near);
        let point = sheet_point(17).map(|step| f64::from(step) * 0.001);
        let corner = DVec3::splat(65.536);
        let mut cases = Vec::new();
        let mut add = |name: &str, change: &dyn Fn(&mut Case)| {
            let mut case = self.case("view", name.into(), 0.0);
            case.cameras.truncate(2);
            change(&mut case);
            cases.push(case);
        };
        add("eye at a point", &|case| case.cameras = vec![at(point.into(), 1e-4)]);
        add("eye on a corner of cells", &|case| case.cameras = vec![at(corner, 1e-4)]);
        add("eye 1e9 m away", &|case| {
            case.cameras = vec![at(DVec3::new(1e9, -1e9, 1e9), 1.0)];
        });
        add("eye 1e9 m away at 1 degree", &|case| {
            let mut camera = at(DVec3::new(1e9, -1e9, 1e9), 1.0);
            camera.fov_y_rad = 1f64.to_radians();
            case.cameras = vec![camera];
        });
        add("looking away", &|case| case.cameras[0].forward *= -1.0);
        add("1x1 pixel", &|case| case.size = (1, 1));
        add("16384x4 pixels", &|case| case.size = (16_384, 4));
        add("1x4000 pixels", &|case| case.size = (1, 4000));
        add("budget 0", &|case| case.budget = 0);
        add("budget 1", &|case| case.budget = 1);
        add("budget 2^40", &|case| case.budget = 1 << 40);
        cases
    }
}

/// A bumpy sheet in the lower part of the cube, and a wall.
fn sheet(count: usize) -> Vec<[i32; 3]> {
    (0..count as u64).map(sheet_point).collect()
}

fn sheet_point(index: u64) -> [i32; 3] {
    let mut random = Random::new(9, index);
    let (a, b) = (random.unit(), random.unit());
    let place = match index % 4 {
        0 => DVec3::new(a, 0.8, 0.6 * b),
        _ => DVec3::new(a, b, 0.2 + 0.06 * (9.0 * a).sin() * (7.0 * b).cos()),
    };
    (place * f64::from(EDGE)).as_ivec3().to_array()
}

/// Writes points to a LAS file; the colour of each says its number.
pub(super) fn write_scan(path: &Path, lattice: Lattice, points: &[[i32; 3]]) -> anyhow::Result<()> {
    let point_format = PointFormat::new(2).expect("the format exists");
    let template = LasTemplate::for_new_scan(&NewScan {
        minor: 2,
        point_format,
        extra_bytes: 0,
        lattice,
        system_identifier: "SYNTHETIC",
        generating_software: "esker bench",
        creation: (0, 0),
    });
    let (schema, _) = point_format.schema(RECORD_BYTES as u16, &[]);
    let mut writer = LasWriter::create(path, &template, &schema, Compression::None)?;
    let mut records = vec![0; points.len() * RECORD_BYTES];
    for (index, (record, point)) in (1u32..).zip(records.chunks_exact_mut(RECORD_BYTES).zip(points))
    {
        for (axis, coordinate) in point.iter().enumerate() {
            record[4 * axis..4 * axis + 4].copy_from_slice(&coordinate.to_le_bytes());
        }
        let [r, g, b, _] = index.wrapping_mul(0x9e_3779).to_le_bytes();
        for (channel, value) in [r, g, b].into_iter().enumerate() {
            let at = 20 + 2 * channel;
            record[at..at + 2].copy_from_slice(&(u16::from(value) * 257).to_le_bytes());
        }
    }
    writer.write(&records)?;
    writer.finish(&mut io::empty())?;
    Ok(())
}
