//! Protects additions to a store: the octree is the one that converting all points together gives,
//! nothing is lost, and until an addition is complete the store is what it was.

#[path = "support/las_file.rs"]
mod las_file;
#[path = "support/shared_data.rs"]
mod shared_data;

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use esker::build::{AppendReport, BuildError, ConvertOptions, Silent, append, convert};
use esker::ids::NodeId;
use esker::store::{HEADER_BYTES, SLOT_BYTES, Store, check};
use glam::UVec3;
use las_file::{GPS_TIME_OFFSET, LasPoint, RECORD_BYTES, las_bytes, record, write_las};

fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    *state >> 33
}

/// Points of several shapes; the first two span the cube of all.
fn cloud(kind: usize, count: usize, seed: u64) -> Vec<LasPoint> {
    let mut state = seed.wrapping_mul(2) + 1;
    let mut unit = |n: u64| (random(&mut state) % n) as i32;
    let point = |position: [i32; 3], color: [u16; 3]| LasPoint { position, color, intensity: 1 };
    let mut points = vec![point([0; 3], [9; 3]), point([1023; 3], [8; 3])];
    points.extend((2..count).map(|i| {
        let position = match kind {
            0 => [unit(1024), unit(1024), unit(1024)],
            1 => [unit(1024), unit(1024), unit(20)],
            2 => [unit(1024), 17, 4],
            3 => [7, 7, 7],
            4 if i % 3 == 0 => [unit(1024), unit(1024), 3],
            4 => [500 + unit(9), 500 + unit(9), unit(9)],
            // What is added lies where there was little.
            _ if i < count / 2 => [unit(200), unit(200), unit(200)],
            _ => [600 + unit(300), 600 + unit(300), unit(100)],
        };
        point(position, [0; 3].map(|_| unit(256) as u16))
    }));
    points
}

const KINDS: usize = 6;

fn options() -> ConvertOptions {
    with_threshold(20)
}

fn with_threshold(threshold: u32) -> ConvertOptions {
    ConvertOptions { depth: 2, threshold, threads: 2, ..ConvertOptions::default() }
}

fn converted(inputs: &[PathBuf], output: &Path) {
    converted_with(&options(), inputs, output);
}

fn converted_with(options: &ConvertOptions, inputs: &[PathBuf], output: &Path) {
    convert(inputs, output, options, &Silent, &AtomicBool::new(false)).expect("it converts");
}

fn appended(
    store: &Path,
    inputs: &[PathBuf],
    options: &ConvertOptions,
) -> Result<AppendReport, BuildError> {
    append(store, inputs, options, &Silent, &AtomicBool::new(false))
}

fn nodes(store: &Store) -> Vec<(u32, UVec3, Vec<u32>)> {
    let nodes = store.octree().nodes().iter();
    nodes.map(|node| (node.depth, node.cell, node.levels.totals().to_vec())).collect()
}

/// All records as they were in the scans, each with its source, sorted.
fn records_with_sources(store: &Store) -> Vec<(Vec<u8>, u16)> {
    let (mut all, mut records) = (Vec::new(), Vec::new());
    for node in 0..store.octree().nodes().len() as u32 {
        store.read_records(NodeId(node), &mut records).expect("the node reads");
        let record_bytes = store.metadata().schema.record_bytes as usize;
        all.extend(records.chunks_exact(record_bytes).map(|record| {
            let (record, source) = record.split_at(RECORD_BYTES);
            let source = source.try_into().map_or(0, u16::from_le_bytes);
            (record.to_vec(), source)
        }));
    }
    all.sort_unstable();
    all
}

/// All records, sorted.
fn records(store: &Store) -> Vec<Vec<u8>> {
    records_with_sources(store).into_iter().map(|(record, _)| record).collect()
}

/// Points beyond one per finest cell of their node, counted.
fn overflow(store: &Store) -> u64 {
    let mut words = Vec::new();
    let beyond = (0..store.octree().nodes().len() as u32).map(NodeId).map(|node| {
        store.read_positions(node, &mut words).expect("the node reads");
        let shift = 3 * (store.octree().local_bits(node) - store.octree().depth());
        let code = |w: &[u32]| (u64::from(w[0]) | u64::from(w[1]) << 32) >> shift;
        let cells: HashSet<u64> = words.chunks_exact(2).map(code).collect();
        (words.len() / 2 - cells.len()) as u64
    });
    beyond.sum()
}

#[test]
fn the_octree_is_that_of_all_points_converted_together() {
    let sizes = [(400, 300, 1), (2500, 40, 2), (3000, 2900, 3), (3000, 2, 4)];
    let cases = (0..KINDS).flat_map(|kind| sizes.map(|size| (kind, size)));
    for (kind, (count, first, seed)) in cases {
        // Where points wait in a node until there are enough for a child, which of them came first
        // is no longer known when they go: the octree is as good, but not the same.
        for threshold in [1, 20] {
            let folder = tempfile::tempdir().expect("a temporary folder");
            let file = |name: &str| folder.path().join(name);
            let points = cloud(kind, count, seed);
            let half = first + (count - first) / 2;
            let write = |name: &str, range: std::ops::Range<usize>| {
                let first = range.start as u64;
                let offset = [500_000.0, 5_000_000.0, 500.0];
                std::fs::write(file(name), las_bytes(&points[range], first, 0.001, offset))
                    .unwrap();
            };
            write("all.las", 0..count);
            write("a.las", 0..first);
            write("b.las", first..half);
            write("c.las", half..count);
            let (together, store) = (file("together.esker"), file("store.esker"));
            let options = with_threshold(threshold);
            converted_with(&options, &[file("all.las")], &together);
            converted_with(&options, &[file("a.las")], &store);
            // Once in one addition of several batches, once in two additions.
            let rest = [file("b.las"), file("c.las")];
            if seed % 2 == 0 {
                let tight = ConvertOptions { memory_bytes: 1, ..options };
                let report = appended(&store, &rest, &tight).expect("it is added");
                assert_eq!(report.new_points, (count - first) as u64);
            } else {
                appended(&store, &rest[..1], &options).expect("it is added");
                appended(&store, &rest[1..], &options).expect("it is added");
            }
            let case = format!("kind {kind}, {first} of {count} points first");
            assert_eq!(check(&store).expect("it opens").findings, [], "{case}");
            let (together, store) = (Store::open(&together).unwrap(), Store::open(&store).unwrap());
            if threshold == 1 {
                assert_eq!(nodes(&together), nodes(&store), "{case}");
            }
            assert!(records(&together) == records(&store), "{case}: other records");
            let facts = |store: &Store| {
                let m = store.metadata();
                (m.points, m.bounds_min, m.bounds_max, m.attribute_ranges[0][0])
            };
            assert_eq!(facts(&together), facts(&store), "{case}");
            assert_eq!(store.metadata().overflow_points, overflow(&store), "{case}");
            assert_eq!(store.metadata().sources.len(), 3, "{case}");
            // The points of each file are told apart, those of the first by a column of no bytes.
            let source = |i: u64| (i >= first as u64) as u16 + (i >= half as u64) as u16;
            let told = records_with_sources(&store).into_iter().all(|(record, told)| {
                let time = record[GPS_TIME_OFFSET..28].try_into().expect("8 bytes");
                told == source(f64::from_le_bytes(time) as u64)
            });
            assert!(told, "{case}: a point of another source");
            let column = store.metadata().sections.len() - 1;
            let ids = (0..store.octree().nodes().len() as u32).map(NodeId);
            let empty = ids.filter(|&id| store.section_extent(id, column).bytes == 0).count();
            assert_eq!(store.header().version, if empty > 0 { 3 } else { 2 }, "{case}");
        }
    }
}

#[test]
fn real_scans_join_a_store() {
    let Some(scan) = shared_data::file("autzen_trim_7.las") else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let store = folder.path().join("twice.esker");
    let options = ConvertOptions::default();
    converted_with(&options, std::slice::from_ref(&scan), &store);
    let before = Store::open(&store).unwrap();
    let report = appended(&store, &[scan], &options).expect("it is added");
    assert_eq!(report.points, 2 * before.metadata().points);
    assert_eq!(check(&store).expect("it opens").findings, []);
    let mut words = Vec::new();
    for node in 0..before.octree().nodes().len() as u32 {
        before.read_positions(NodeId(node), &mut words).expect("who has it open reads on");
    }
    let coarse = Store::open_with_coarse(&store, 1 << 22).expect("it opens");
    let reads = coarse.reads();
    coarse.read_positions(NodeId(0), &mut words).expect("the root reads");
    assert_eq!(coarse.reads(), reads, "coarse nodes stand beside the directory again");
}

#[test]
fn bytes_do_not_depend_on_threads() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = |name: &str| folder.path().join(name);
    let points = cloud(1, 4000, 9);
    write_las(&file("a.las"), &points[..1500]);
    write_las(&file("b.las"), &points[1500..]);
    converted(&[file("a.las")], &file("a.esker"));
    let with = |threads: usize| {
        std::fs::copy(file("a.esker"), file("b.esker")).unwrap();
        let options = ConvertOptions { threads, ..options() };
        appended(&file("b.esker"), &[file("b.las")], &options).expect("it is added");
        std::fs::read(file("b.esker")).unwrap()
    };
    assert!(with(1) == with(4), "the same bytes");
}

#[test]
fn what_does_not_fit_is_refused_and_leaves_the_store_as_it_was() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = |name: &str| folder.path().join(name);
    let points = cloud(0, 300, 5);
    write_las(&file("a.las"), &points);
    converted(&[file("a.las")], &file("a.esker"));
    let before = std::fs::read(file("a.esker")).unwrap();

    std::fs::write(file("text.xyz"), "0.001 2 3\n4 5 6.0005\n").unwrap();
    std::fs::write(file("broken.las"), b"LASF").unwrap();
    for (name, expected) in [
        ("text.xyz", "not all on the store's lattice"),
        ("broken.las", "broken.las"),
        ("missing.las", "missing.las"),
    ] {
        let error = appended(&file("a.esker"), &[file(name)], &options()).expect_err(name);
        let message = error.to_string();
        assert!(message.contains(expected) && message.contains(name), "{name}: {message}");
        assert!(std::fs::read(file("a.esker")).unwrap() == before, "{name} changed the store");
    }
    let old = Path::new(env!("CARGO_MANIFEST_DIR")).join("sample_data/store-v1.esker");
    std::fs::copy(old, file("old.esker")).unwrap();
    let error = appended(&file("old.esker"), &[file("a.las")], &options()).expect_err("version 1");
    assert!(error.to_string().contains("version 1"), "{error}");
}

#[test]
fn a_store_that_is_outgrown_is_written_anew() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = |name: &str| folder.path().join(name);
    write_las(&file("a.las"), &cloud(1, 900, 5));
    let mut outside = cloud(0, 500, 6);
    outside[30].position = [-5000, 0, 0];
    let mut colours = cloud(0, 500, 7);
    colours[20].color = [40_000, 0, 0];
    for (name, points) in [("outside.las", outside), ("colours.las", colours)] {
        write_las(&file(name), &points);
        converted(&[file("a.las")], &file("a.esker"));
        let report = appended(&file("a.esker"), &[file(name)], &options()).expect(name);
        assert!(report.rebuilt, "{name}");
        assert_eq!((report.points, report.new_points), (1400, 500), "{name}");
        assert_eq!(report.sources.len(), 1, "{name}");
        assert_eq!(check(&file("a.esker")).unwrap().findings, [], "{name}");
        let store = Store::open(&file("a.esker")).unwrap();
        let sources = store.metadata().sources.iter().map(|source| source.name.clone());
        assert_eq!(sources.collect::<Vec<_>>(), ["a.las", name]);
        let (mut expected, given) = (Vec::new(), [cloud(1, 900, 5), points]);
        for points in given {
            expected.extend(points.iter().zip(0..).map(|(p, i)| record(p, i).to_vec()));
        }
        expected.sort_unstable();
        assert!(records(&store) == expected, "{name}: other records");
        std::fs::remove_file(file("a.esker")).unwrap();
    }
}

#[test]
fn a_finer_lattice_that_holds_both_is_taken() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = |name: &str| folder.path().join(name);
    let (points, finer) = (cloud(1, 600, 5), cloud(0, 500, 6));
    let offset = [500.0, -3.0, 0.5];
    std::fs::write(file("a.las"), las_bytes(&points, 0, 0.01, offset)).unwrap();
    std::fs::write(file("b.las"), las_bytes(&finer, 600, 0.004, [500.0, -3.0, 0.75])).unwrap();
    converted(&[file("a.las")], &file("a.esker"));
    let report = appended(&file("a.esker"), &[file("b.las")], &options()).expect("it is added");
    assert!(report.rebuilt);
    assert_eq!(check(&file("a.esker")).unwrap().findings, []);
    let store = Store::open(&file("a.esker")).unwrap();
    assert_eq!(store.metadata().scale, [0.002; 3]);
    let mut expected: Vec<(Vec<u8>, u16)> = Vec::new();
    let scaled = |p: &LasPoint, factor: i32, up: i32| LasPoint {
        position: [p.position[0] * factor, p.position[1] * factor, p.position[2] * factor + up],
        ..*p
    };
    expected.extend((0..).zip(&points).map(|(i, p)| (record(&scaled(p, 5, 0), i).to_vec(), 0)));
    let finer = (600..).zip(&finer);
    expected.extend(finer.map(|(i, p)| (record(&scaled(p, 2, 125), i).to_vec(), 1)));
    expected.sort_unstable();
    assert!(records_with_sources(&store) == expected);
    // Back onto steps that are multiples of the store's: in place.
    let again = appended(&file("a.esker"), &[file("a.las")], &options()).expect("it is added");
    assert!(!again.rebuilt);
    assert_eq!(check(&file("a.esker")).unwrap().findings, []);
}

#[test]
fn unused_bytes_go_when_they_are_many_or_not_wanted() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = |name: &str| folder.path().join(name);
    let points = cloud(0, 4000, 5);
    std::fs::write(file("a.las"), las_bytes(&points[..2000], 0, 0.001, [0.0; 3])).unwrap();
    converted(&[file("a.las")], &file("a.esker"));
    std::fs::copy(file("a.esker"), file("b.esker")).unwrap();
    let (mut most, mut compactions) = (0, 0);
    for (i, part) in points[2000..].chunks(100).enumerate() {
        let name = file(&format!("part{i}.las"));
        std::fs::write(&name, las_bytes(part, 2000 + 100 * i as u64, 0.001, [0.0; 3])).unwrap();
        let mostly_used = ConvertOptions { compact_above: 0.8, ..options() };
        let report = appended(&file("a.esker"), &[name], &mostly_used).expect("it is added");
        let store = Store::open(&file("a.esker")).unwrap();
        assert_eq!(report.unused_bytes, store.unused_bytes());
        assert_eq!(report.output_bytes, store.header().file_bytes);
        assert!(report.unused_bytes <= report.output_bytes / 5 * 4, "part {i}");
        most = most.max(report.unused_bytes);
        if report.compacted {
            compactions += 1;
            assert_eq!(report.unused_bytes, 0);
            assert_eq!(store.header().generation, 1);
        }
        assert_eq!(check(&file("a.esker")).unwrap().findings, [], "part {i}");
    }
    assert!(most > 0 && (1..15).contains(&compactions), "{compactions} compactions");
    // The same points, wherever they stand, and the same again without any unused byte.
    let parts: Vec<PathBuf> = (0..20).map(|i| file(&format!("part{i}.las"))).collect();
    let tidy = ConvertOptions { compact_above: 0.0, ..options() };
    let report = appended(&file("b.esker"), &parts, &tidy).expect("it is added");
    assert!(report.compacted && report.unused_bytes == 0);
    assert_eq!(check(&file("b.esker")).unwrap().findings, []);
    let (a, b) = (Store::open(&file("a.esker")).unwrap(), Store::open(&file("b.esker")).unwrap());
    assert!(records_with_sources(&a) == records_with_sources(&b));
    assert!(!file(".b.esker.part").exists());
}

#[test]
fn a_failing_disk_at_any_write_leaves_the_store_as_it_was() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = |name: &str| folder.path().join(name);
    let points = cloud(5, 900, 8);
    write_las(&file("a.las"), &points[..500]);
    write_las(&file("b.las"), &points[500..]);
    converted(&[file("a.las")], &file("a.esker"));
    let before = std::fs::read(file("a.esker")).unwrap();
    let mut failures = 0;
    loop {
        let writes = Arc::new(AtomicUsize::new(0));
        let hook = move || match writes.fetch_add(1, Ordering::Relaxed) == failures {
            true => Err(std::io::ErrorKind::StorageFull.into()),
            false => Ok(()),
        };
        let options = ConvertOptions { before_write: Some(Arc::new(hook)), ..options() };
        if appended(&file("a.esker"), &[file("b.las")], &options).is_ok() {
            break;
        }
        assert!(std::fs::read(file("a.esker")).unwrap() == before, "write {failures}");
        failures += 1;
    }
    assert!(failures > 5, "{failures} writes");
    assert_eq!(check(&file("a.esker")).unwrap().findings, []);
}

#[test]
fn a_change_that_was_cut_off_is_none() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = |name: &str| folder.path().join(name);
    let points = cloud(1, 900, 8);
    write_las(&file("a.las"), &points[..500]);
    write_las(&file("b.las"), &points[500..]);
    converted(&[file("a.las")], &file("a.esker"));
    let old = Store::open(&file("a.esker")).unwrap();
    let (old_nodes, old_bytes) = (nodes(&old), old.header().file_bytes);
    let in_place = ConvertOptions { compact_above: 1.0, ..options() };
    appended(&file("a.esker"), &[file("b.las")], &in_place).unwrap();
    let whole = std::fs::read(file("a.esker")).unwrap();
    // As if the power had gone before the header was written, and while it was.
    for torn in [0, 60] {
        let mut bytes = whole.clone();
        bytes[SLOT_BYTES + torn..HEADER_BYTES].fill(0);
        for length in [old_bytes as usize + 10, bytes.len()] {
            std::fs::write(file("cut.esker"), &bytes[..length]).unwrap();
            let cut = Store::open(&file("cut.esker")).expect("the old store opens");
            assert_eq!(nodes(&cut), old_nodes);
            assert!(!check(&file("cut.esker")).unwrap().findings.is_empty(), "leftovers are told");
            appended(&file("cut.esker"), &[file("b.las")], &in_place).unwrap();
            assert!(std::fs::read(file("cut.esker")).unwrap() == whole, "done again, all is well");
        }
    }
}
