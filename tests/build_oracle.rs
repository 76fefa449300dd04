//! Protects the octree build: it gives what inserting the points one after another gives.
//!
//! Every synthetic point carries its number as GPS time. A cloud goes through a LAS file and
//! `build::convert` into a store; each node of the store is compared with the literal insertion of
//! `support/insertion.rs`: same nodes, same totals, same points in the same order. Clouds are
//! small but of all awkward shapes, and the memory caps small enough that the out-of-core path
//! takes them apart, over-dense grid cells included.

#[path = "support/insertion.rs"]
mod insertion;
#[path = "support/las_file.rs"]
mod las_file;

use std::path::Path;
use std::sync::atomic::AtomicBool;

use esker::build::{ConvertOptions, ConvertReport, Representative, Silent, convert};
use esker::ids::NodeId;
use esker::store::{Store, check};
use insertion::{InputPoint, Parameters, insert_all};
use las_file::{LasPoint, write_las};
use proptest::test_runner::{Config, TestRunner};

fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    *state >> 33
}

/// The generators: each gives a position within `-extent..extent`.
fn cloud(kind: usize, count: usize, seed: u64) -> Vec<LasPoint> {
    let mut state = seed.wrapping_mul(2) + 1;
    let mut unit = |n: u64| (random(&mut state) % n) as i32;
    (0..count)
        .map(|i| {
            let position = match kind {
                0 => [unit(4000) - 2000, unit(4000) - 2000, unit(4000) - 2000],
                1 => [unit(5000), unit(5000), unit(40)],
                2 => [unit(9000), 17, -4],
                3 => [7, 7, 7],
                4 if i % 2 == 0 => [unit(60), unit(60), unit(60)],
                4 => [900_000_000 + unit(60), 5 + unit(60), unit(60)],
                5 => [(i as i32 % 16) * 64, (i as i32 / 16 % 16) * 64, (i as i32 / 256) * 64],
                6 => {
                    let r = 1 << (unit(14) as u32);
                    [unit(r as u64) + 1, -unit(r as u64), unit(r as u64) / 3]
                }
                _ => [unit(300), unit(300), unit(300) + if i % 50 == 0 { 100_000 } else { 0 }],
            };
            let color = [0; 3].map(|_| unit(256) as u16);
            LasPoint { position, color, intensity: unit(1000) as u16 }
        })
        .collect()
}

const KINDS: usize = 8;

fn options(depth: u32, threshold: u32) -> ConvertOptions {
    ConvertOptions { depth, threshold, threads: 2, ..ConvertOptions::default() }
}

fn build(folder: &Path, points: &[LasPoint], options: &ConvertOptions) -> (Store, ConvertReport) {
    let input = folder.join("cloud.las");
    write_las(&input, points);
    let output = folder.join("cloud.esker");
    let options = ConvertOptions { overwrite: true, ..options.clone() };
    let report = convert(&[input], &output, &options, &Silent, &AtomicBool::new(false))
        .expect("the cloud converts");
    let findings = check(&output).expect("the store opens").findings;
    assert_eq!(findings, [], "the store checks");
    (Store::open(&output).expect("the store opens"), report)
}

/// Numbers of a node's points, in stored order.
fn numbers(store: &Store, node: NodeId) -> Vec<usize> {
    let (time, _) = store.metadata().schema.find("gps_time").expect("format 3 has a GPS time");
    let mut bytes = Vec::new();
    store.read_attribute(node, time, &mut bytes).expect("the column reads");
    let number = |b: &[u8]| f64::from_le_bytes(b.try_into().expect("8 bytes")) as usize;
    bytes.chunks_exact(8).map(number).collect()
}

fn compare_with_insertion(store: &Store, points: &[LasPoint], depth: u32, threshold: u32) {
    let min = [0, 1, 2].map(|axis| points.iter().map(|p| p.position[axis]).min().unwrap_or(0));
    let root = store.octree().root_cube();
    assert_eq!(root.min.to_array(), min.map(i64::from), "the root starts at the smallest point");
    let input: Vec<InputPoint> = points
        .iter()
        .map(|p| InputPoint {
            position: [0, 1, 2]
                .map(|axis| (i64::from(p.position[axis]) - i64::from(min[axis])) as u32),
            color: p.color,
        })
        .collect();
    let parameters = Parameters { depth, threshold: threshold as usize, bits: root.bits };
    let expected = insert_all(&input, &parameters);
    assert_eq!(store.octree().nodes().len(), expected.len(), "nodes");
    for (i, expected) in expected.iter().enumerate() {
        let id = NodeId(i as u32);
        let node = store.octree().node(id);
        assert_eq!((node.depth, node.cell.to_array()), (expected.depth, expected.cell), "node {i}");
        assert_eq!(node.levels.totals(), expected.totals, "totals of node {i}");
        assert_eq!(numbers(store, id), expected.points, "points of node {i}");
    }
}

#[test]
fn builds_in_memory_equal_insertion() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for kind in 0..KINDS {
        for (count, depth, threshold) in
            [(1, 7, 1000), (2, 2, 1), (777, 3, 20), (6000, 3, 15), (6000, 7, 100)]
        {
            let points = cloud(kind, count, 11 + kind as u64);
            let (store, report) = build(folder.path(), &points, &options(depth, threshold));
            assert!(report.in_memory);
            assert_eq!(report.points, count as u64);
            compare_with_insertion(&store, &points, depth, threshold);
        }
    }
}

#[test]
fn builds_out_of_core_equal_insertion() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for kind in 0..KINDS {
        for (count, depth, threshold) in [(6000, 3, 15), (9000, 2, 4)] {
            let points = cloud(kind, count, 5 + kind as u64);
            let small = ConvertOptions { memory_bytes: 400_000, ..options(depth, threshold) };
            let (store, report) = build(folder.path(), &points, &small);
            assert!(!report.in_memory && report.temporary_bytes > 0, "it went through files");
            compare_with_insertion(&store, &points, depth, threshold);
        }
    }
}

#[test]
fn representatives_are_the_asked_for_ones() {
    // One cell of two levels with eight points: the one at the top tells which rule was used.
    let colors = [10u16, 200, 90, 100, 105, 30, 250, 0];
    let points: Vec<LasPoint> = (0..8)
        .map(|i| LasPoint {
            position: [i & 1, i >> 1 & 1, i >> 2]
                .map(|bit| bit * 7 + 2 * (1 - bit) * i32::from(i == 0)),
            color: [colors[i as usize]; 3],
            intensity: 0,
        })
        .collect();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let top = |representative| {
        let options = ConvertOptions { representative, ..options(2, 100) };
        let (store, _) = build(folder.path(), &points, &options);
        numbers(&store, NodeId::ROOT)[0]
    };
    // The mean is 98.125: number 3 with 100 is nearest.
    assert_eq!(top(Representative::Color), 3);
    assert_eq!(top(Representative::First), 0);
    // Number 0 stands nearest to the middle of the cube of 8.
    assert_eq!(top(Representative::Center), 0);
    assert!(top(Representative::Random) < 8);
}

#[test]
fn any_small_cloud_builds_the_same_both_ways() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let strategy = (0..KINDS, 1usize..1500, 2u32..5, 1u32..40, 0u64..1000);
    let mut runner = TestRunner::new(Config { cases: 40, ..Config::default() });
    runner
        .run(&strategy, |(kind, count, depth, threshold, seed)| {
            let points = cloud(kind, count, seed);
            let (store, _) = build(folder.path(), &points, &options(depth, threshold));
            compare_with_insertion(&store, &points, depth, threshold);
            let whole = std::fs::read(store.path()).expect("the store reads");
            // From the least cap up: chunks of a few points, then of many.
            let memory_bytes = 400_000 + seed * seed;
            let small = ConvertOptions { memory_bytes, ..options(depth, threshold) };
            let (store, _) = build(folder.path(), &points, &small);
            let spilled = std::fs::read(store.path()).expect("the store reads");
            proptest::prop_assert!(whole == spilled, "the bytes differ");
            Ok(())
        })
        .expect("every cloud builds the same both ways");
}

#[test]
fn bytes_do_not_depend_on_threads_or_memory() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let points = cloud(6, 30_000, 3);
    let mut first: Option<Vec<u8>> = None;
    for threads in [1, 2, 8] {
        for memory_bytes in [1_200_000, 3_000_000, 1 << 30] {
            let options = ConvertOptions { threads, memory_bytes, ..options(3, 30) };
            let (store, report) = build(folder.path(), &points, &options);
            assert_eq!(report.in_memory, memory_bytes == 1 << 30);
            let bytes = std::fs::read(store.path()).expect("the store reads");
            let first = first.get_or_insert_with(|| bytes.clone());
            assert!(*first == bytes, "{threads} threads, {memory_bytes} bytes");
        }
    }
}

#[test]
fn thresholds_trade_nodes_against_overflow() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let points = cloud(6, 40_000, 9);
    let mut before = (u64::MAX, 0);
    for threshold in [10, 30, 100, 300, 1000, 3000, 10_000] {
        let (store, report) = build(folder.path(), &points, &options(4, threshold));
        let now = (report.nodes, report.overflow_points);
        assert!(now.0 <= before.0 && now.1 >= before.1, "{threshold}: {before:?} -> {now:?}");
        before = now;
        let octree = store.octree();
        for (i, node) in octree.nodes().iter().enumerate().skip(1) {
            let mut below = vec![NodeId(i as u32)];
            let mut points = 0u64;
            while let Some(id) = below.pop() {
                points += u64::from(octree.node(id).point_count());
                below.extend(octree.node(id).children());
            }
            assert!(points >= u64::from(threshold), "node {i} of depth {}", node.depth);
        }
    }
}
