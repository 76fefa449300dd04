//! Time of one cut, in nodes per second: octrees of 16,000 to 260,000 nodes seen from within,
//! the budget at 5 million points, warmed-up scratch memory.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use esker::geometry::{Camera, View};
use esker::ids::NodeId;
use esker::octree::{LevelIndex, Node, Octree, RootCube};
use esker::points::Lattice;
use esker::select::{AllResident, CutScratch, CutSettings, select_nodes};
use glam::{DVec3, I64Vec3, UVec3};

const DEPTH: u32 = 7;
const BITS: u32 = 21;

/// A surface in space: nodes down to `outer_depth` wherever a cell meets a wavy sheet.
fn sheet(outer_depth: u32) -> Octree {
    let levels = || {
        let totals = (0..=DEPTH).map(|level| 3u32.pow(level).min(7000));
        LevelIndex::new(totals.collect()).expect("totals rise from 1")
    };
    let meets = |depth: u32, cell: UVec3| {
        let edge = f64::from(depth).exp2().recip();
        let low = cell.as_dvec3() * edge;
        let middle = low + 0.5 * edge;
        let height = 0.5 + 0.2 * (5.0 * middle.x).sin() * (4.0 * middle.y).cos();
        (low.z - edge..=low.z + 2.0 * edge).contains(&height)
    };
    let mut rows = vec![(0, UVec3::ZERO, None)];
    let mut nodes: Vec<Node> = Vec::new();
    while let Some(&(depth, cell, parent)) = rows.get(nodes.len()) {
        let id = NodeId(nodes.len() as u32);
        let first_child = NodeId(rows.len() as u32);
        let mut child_mask = 0;
        for octant in (0..8u32).filter(|_| depth < outer_depth) {
            let child = cell * 2 + UVec3::new(octant & 1, octant >> 1 & 1, octant >> 2);
            if meets(depth + 1, child) {
                child_mask |= 1 << octant;
                rows.push((depth + 1, child, Some(id)));
            }
        }
        let tight_max = UVec3::splat(((1u64 << (BITS - depth)) - 1) as u32);
        nodes.push(Node {
            depth,
            cell,
            parent,
            first_child,
            child_mask,
            levels: levels(),
            tight_min: UVec3::ZERO,
            tight_max,
        });
    }
    let lattice = Lattice { scale: DVec3::splat(0.001), offset: DVec3::new(5e5, 5e6, 0.0) };
    let root = RootCube { min: I64Vec3::ZERO, bits: BITS };
    Octree::new(lattice, root, DEPTH, nodes).expect("the rows form an octree")
}

fn cuts(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("select_nodes");
    for outer_depth in [6, 7, 8] {
        let octree = sheet(outer_depth);
        let edge = octree.cell_size(0).x;
        let low = octree.lattice().world(I64Vec3::ZERO);
        let eye = low + DVec3::new(0.1, 0.1, 0.75) * edge;
        let target = low + DVec3::new(0.6, 0.5, 0.4) * edge;
        let camera = Camera::looking_at(eye, target, DVec3::Z, 60f64.to_radians(), 0.1);
        let view = View { camera, width_px: 3840, height_px: 2160 };
        let settings = CutSettings { error_px: 0.2, ..CutSettings::default() };
        let mut scratch = CutScratch::default();
        let cut = select_nodes(&octree, &view, &settings, &AllResident, &mut scratch);
        let counters = cut.counters;
        println!("{} nodes: {counters:?}", octree.nodes().len());
        scratch.recycle(cut);
        group.throughput(Throughput::Elements(u64::from(counters.nodes_visited)));
        group.bench_function(BenchmarkId::from_parameter(octree.nodes().len()), |bencher| {
            bencher.iter(|| {
                let cut = select_nodes(&octree, &view, &settings, &AllResident, &mut scratch);
                scratch.recycle(cut);
            });
        });
    }
    group.finish();
}

criterion_group!(benches, cuts);
criterion_main!(benches);
