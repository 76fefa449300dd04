//! Holds the structure against the numbers of the literature: branching of scanned surfaces, cost
//! of a plain sequential point tree for the same cloud, points per node.
//!
//! The cloud is what scanners make: even steps in angle from four stations in a walled court, one
//! centimetre of noise along the ray. (Points scattered at random branch less, 2.4, because pairs
//! of near points make chains of cells.) The octrees come from the literal insertion. The paper
//! measured a branching factor of about 3 (4 in theory), 7731 points per node at depth 7 and 533
//! at depth 5.

#[path = "support/insertion.rs"]
mod insertion;
#[path = "support/scans.rs"]
mod scans;

use std::collections::HashMap;
use std::f64::consts::TAU;

use esker::geometry::MortonKey;
use glam::DVec3;
use insertion::{InputPoint, Parameters, insert_all};
use scans::Random;

/// Steps around and steps up of each scan.
const STEPS: (u32, u32) = (600, 150);
/// Side of the court and height of its walls, metres.
const COURT: (f64, f64) = (60.0, 12.0);
/// 65.536 m in millimetres.
const BITS: u32 = 16;

/// What the scanners measure, in millimetres.
fn scans() -> Vec<InputPoint> {
    let mut random = Random::new(51);
    let stations = [(12.0, 15.0), (41.0, 9.0), (50.0, 44.0), (20.0, 38.0)];
    let mut points = Vec::new();
    for (x, y) in stations {
        let eye = DVec3::new(x, y, 1.8);
        for i in 0..STEPS.0 * STEPS.1 {
            let azimuth = TAU * f64::from(i % STEPS.0) / f64::from(STEPS.0);
            let elevation = -1.0 + 1.5 * f64::from(i / STEPS.0) / f64::from(STEPS.1);
            let (sin, cos) = azimuth.sin_cos();
            let ray = DVec3::new(elevation.cos() * cos, elevation.cos() * sin, elevation.sin());
            let Some(range) = range_of(eye, ray) else { continue };
            let place = eye + ray * (range + random.range(-0.01, 0.01));
            let position = (place * 1000.0 + 1000.0).as_uvec3().to_array();
            points.push(InputPoint { position, color: [0; 3] });
        }
    }
    points
}

/// Where a ray meets ground or walls; `None` above them.
fn range_of(eye: DVec3, ray: DVec3) -> Option<f64> {
    let plane = |from: f64, along: f64, to: f64| {
        let range = (to - from) / along;
        if range > 0.0 { range } else { f64::INFINITY }
    };
    let nearest = [
        plane(eye.z, ray.z, 0.0),
        plane(eye.x, ray.x, 0.0),
        plane(eye.x, ray.x, COURT.0),
        plane(eye.y, ray.y, 0.0),
        plane(eye.y, ray.y, COURT.0),
    ];
    let range = nearest.into_iter().fold(f64::INFINITY, f64::min);
    (eye.z + ray.z * range <= COURT.1).then_some(range)
}

/// Interior nodes and leaves of a sequential point tree: cells split until each holds one place.
fn point_tree_size(points: &[InputPoint], bits: u32) -> (usize, usize) {
    let mut codes: Vec<u128> = points.iter().map(|p| u128::encode(p.position)).collect();
    codes.sort_unstable();
    codes.dedup();
    let mut interior = 0;
    for level in 0..bits {
        let mut cells: HashMap<u128, u32> = HashMap::new();
        codes.iter().for_each(|code| *cells.entry(code.ancestor(bits - level)).or_default() += 1);
        interior += cells.values().filter(|&&count| count > 1).count();
    }
    (interior, codes.len())
}

/// Each point once, against one more per interior cell and 24 bytes instead of 16.
#[test]
fn a_plain_point_tree_costs_what_the_branching_says() {
    let (points, bits) = (scans(), BITS);
    let (interior, leaves) = point_tree_size(&points, bits);
    // Every node but the root is the child of an interior one.
    let branching = (interior + leaves - 1) as f64 / interior as f64;
    let overhead = interior as f64 / leaves as f64;
    let memory_ratio = 24.0 * (interior + leaves) as f64 / (16.0 * leaves as f64);
    println!("branching {branching:.2}, overhead {overhead:.3}, memory ratio {memory_ratio:.2}");
    assert!((2.5..=4.0).contains(&branching), "branching {branching}");
    assert!((overhead - 1.0 / (branching - 1.0)).abs() < 1e-3);
    assert!((memory_ratio - 1.5 * (1.0 + overhead)).abs() < 1e-9);

    let parameters = Parameters { depth: 7, threshold: 1000, bits };
    let stored: usize = insert_all(&points, &parameters).iter().map(|n| n.points.len()).sum();
    assert_eq!(stored, points.len(), "the nested octree stores each point once, and no other");
}

/// Levels grow like the occupied cells of a surface, and nodes hold thousands of points.
#[test]
fn levels_grow_like_surfaces() {
    let (points, bits) = (scans(), BITS);
    for (depth, of_the_paper) in [(5, 533), (7, 7731)] {
        let nodes = insert_all(&points, &Parameters { depth, threshold: 1000, bits });
        let mean = points.len() as f64 / nodes.len() as f64;
        println!(
            "depth {depth}: {} nodes, {mean:.0} points each; the paper's {of_the_paper}",
            nodes.len()
        );
        let totals = &nodes[0].totals;
        for pair in totals[2..].windows(2) {
            let growth = f64::from(pair[1]) / f64::from(pair[0]);
            assert!((2.0..=8.0).contains(&growth), "{totals:?}");
        }
    }
}
