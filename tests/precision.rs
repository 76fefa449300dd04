//! Protects where points land on screen: far from the origin as near it.
//!
//! The passes compute in f32 relative to a node and the eye. What they make of each point is
//! compared with an f64 projection of the same scan at the origin, view for view, so that nothing
//! large ever enters the exact side.

#[path = "support/insertion.rs"]
mod insertion;
#[path = "support/scans.rs"]
mod scans;

use esker::geometry::{Camera, View};
use esker::metrics::Displacement;
use esker::passes::splat::{eye_relative, local_cell, screen_of};
use esker::passes::{CloudDraw, DrawTable, NodePlace, Tile};
use esker::points::Lattice;
use esker::select::{AllResident, CutScratch, CutSettings, SplatSettings, select_nodes};
use glam::DVec3;
use insertion::Parameters;
use scans::{Random, Scan, courtyard};

const MILLIMETRE: f64 = 0.001;

fn scan_at(offset: DVec3) -> Scan {
    let parameters = Parameters { depth: 5, threshold: 50, bits: 17 };
    let lattice = Lattice { scale: DVec3::splat(MILLIMETRE), offset };
    Scan::on_lattice(courtyard(20_000, 17, 6), &parameters, lattice)
}

/// Places on screen of all points by the arithmetic of the passes, against f64 at the origin.
fn displacement(scan: &Scan, offset: DVec3, view_at_origin: &View) -> Displacement {
    let mut view = *view_at_origin;
    view.camera.eye += offset;
    let splat = SplatSettings::default();
    let settings = CutSettings { error_px: 0.0, point_budget: u64::MAX, ..CutSettings::default() };
    let scratch = &mut CutScratch::default();
    let cut = select_nodes(&scan.octree, &view, &settings, &AllResident, scratch);
    let place = |_| NodePlace::default();
    let mut table = DrawTable::default();
    table.fill(
        &[CloudDraw { octree: &scan.octree, cut: &cut, place: &place, appeared: None }],
        &view,
        &splat,
    );
    let frame = Tile::whole(&view).gpu_frame(&view, &splat, 0);
    let root = scan.octree.root_cube().min.as_dvec3();
    let mut displacement = Displacement::default();
    for (row, node) in cut.table.iter().zip(&table.nodes) {
        let words = scan.positions(row.node);
        for (i, &point) in scan.nodes[row.node.index()].points.iter().enumerate() {
            let steps = root + DVec3::from_array(scan.points[point].position.map(f64::from));
            let Some((x, y, _)) = view_at_origin.project(steps * MILLIMETRE) else { continue };
            if !(-10.0..1290.0).contains(&x) || !(-10.0..730.0).contains(&y) {
                continue;
            }
            let [xw, yw, w] = screen_of(&frame, eye_relative(node, local_cell(node, words, i)));
            let drawn = [xw / w + frame.center_px[0], yw / w + frame.center_px[1]];
            displacement.add((x, y), (f64::from(drawn[0]), f64::from(drawn[1])));
        }
    }
    displacement
}

#[test]
fn points_land_where_f64_puts_them_whatever_the_offset() {
    let offsets = [DVec3::ZERO, DVec3::new(5e5, 5e6, 500.0), DVec3::new(-2e7, 2e7, 9e3)];
    for offset in offsets {
        let scan = scan_at(offset);
        let mut random = Random::new(41);
        let mut worst: f64 = 0.0;
        let mut count = 0;
        for _ in 0..40 {
            // The scan spans about 131 m from (1, -2, 0.5) on.
            let eye = DVec3::new(1.0, -2.0, 0.5) + random.vector(-30.0, 160.0);
            let target = DVec3::new(66.0, 64.0, 10.0) + random.vector(-40.0, 40.0);
            let fov_y = random.range(0.2, 2.0);
            let camera = Camera::looking_at(eye, target, DVec3::Z, fov_y, 0.1);
            let view = View { camera, width_px: 1280, height_px: 720 };
            let found = displacement(&scan, offset, &view);
            worst = worst.max(found.max_px);
            count += found.count;
        }
        println!("offset {offset}: {count} places, at most {worst:.5} px off");
        assert!(count > 50_000, "only {count} places compared");
        assert!(worst < 0.05, "{worst} px at offset {offset}");
    }
}
