//! Protects the reading of plain LAS files once: headers are taken at their word while points are
//! sorted, and the store is the same, byte for byte, as if every point had been looked at before.
//!
//! The oracle is the same conversion without trust. Headers lie in all ways that make a difference:
//! too small, too large, not finite, in one of several files, noticed at the first point or only at
//! the end. The report says whether the claims were borne out.

#[path = "support/las_file.rs"]
mod las_file;

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use esker::build::{ConvertOptions, ConvertReport, Progress, Silent, Stage, convert};
use esker::store::check;
use las_file::{LasPoint, las_bytes};

const POINTS: usize = 3000;

fn point(i: usize) -> LasPoint {
    let mut x = (i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mut next = |n: u64| {
        x ^= x >> 29;
        x = x.wrapping_mul(0xbf58_476d_1ce4_e5b9);
        ((x >> 40) % n) as i32
    };
    let position = match i % 4 {
        0 => [next(7), next(7), next(7)],
        _ => [next(5000) - 900, next(5000), next(200)],
    };
    LasPoint { position, color: [i as u16 % 250, 3, 9], intensity: i as u16 }
}

/// A file of points in which bounds are written over: of an axis the largest or the smallest.
fn file(folder: &Path, name: &str, points: &[LasPoint], lies: &[(usize, bool, f64)]) -> PathBuf {
    let mut bytes = las_bytes(points, 0, 0.01, [1000.0, -20.0, 0.5]);
    for &(axis, is_min, value) in lies {
        let at = 179 + 16 * axis + 8 * usize::from(is_min);
        bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
    }
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("the input is written");
    path
}

fn options(trust_headers: bool) -> ConvertOptions {
    ConvertOptions { depth: 3, threshold: 20, trust_headers, ..ConvertOptions::default() }
}

fn store(inputs: &[PathBuf], options: &ConvertOptions) -> (Vec<u8>, ConvertReport) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let output = folder.path().join("out.esker");
    let report =
        convert(inputs, &output, options, &Silent, &AtomicBool::new(false)).expect("it converts");
    assert_eq!(check(&output).expect("the store opens").findings, []);
    let left = std::fs::read_dir(folder.path()).expect("it lists").count();
    assert_eq!(left, 1, "nothing but the store is left");
    (std::fs::read(&output).expect("the store reads"), report)
}

/// Converts with and without trust; whether the claims were borne out.
fn same_store(inputs: &[PathBuf], more: impl Fn(&mut ConvertOptions)) -> bool {
    let [(trusting, report), (expected, looked)] = [true, false].map(|trust| {
        let mut options = options(trust);
        more(&mut options);
        store(inputs, &options)
    });
    assert!(trusting == expected, "the stores differ");
    assert!(!looked.read_once);
    assert_eq!(
        (report.points, report.nodes, report.overflow_points, &report.sources),
        (looked.points, looked.nodes, looked.overflow_points, &looked.sources)
    );
    report.read_once
}

#[test]
fn true_bounds_save_a_pass() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let points: Vec<LasPoint> = (0..POINTS).map(point).collect();
    let whole = file(folder.path(), "whole.las", &points, &[]);
    assert!(same_store(std::slice::from_ref(&whole), |_| {}));
    // Out of core, too.
    assert!(same_store(&[whole], |options| options.memory_bytes = 400_000));
    let first = file(folder.path(), "first.las", &points[..1000], &[]);
    let second = file(folder.path(), "second.las", &points[1000..], &[]);
    let empty = file(folder.path(), "empty.las", &[], &[]);
    assert!(same_store(&[first, empty, second], |_| {}));
    let single = file(folder.path(), "single.las", &points[..1], &[]);
    assert!(same_store(&[single], |_| {}));
}

#[test]
fn bounds_that_lie_cost_a_pass_and_change_nothing() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let points: Vec<LasPoint> = (0..POINTS).map(point).collect();
    let lies: [&[(usize, bool, f64)]; 8] = [
        // Smaller than the points, at either end.
        &[(0, true, 992.0)],
        &[(1, false, -19.0)],
        // A smallest coordinate that no point has, and one far off.
        &[(2, true, 0.49)],
        &[(0, true, -1e7)],
        // A root of twice the size.
        &[(1, false, 200.0)],
        // No box at all, and one that the lattice does not reach.
        &[(0, true, f64::NAN), (0, false, f64::INFINITY)],
        &[(0, true, 1020.0), (0, false, 1010.0)],
        &[(2, false, 1e300)],
    ];
    for (i, lie) in lies.into_iter().enumerate() {
        let path = file(folder.path(), &format!("lie{i}.las"), &points, lie);
        assert!(!same_store(&[path], |_| {}), "lie {i} was believed");
    }
    // Larger than the points, but the root stays: that is verified and told as it is.
    let larger = file(folder.path(), "larger.las", &points, &[(2, false, 30.0)]);
    assert!(same_store(&[larger], |_| {}));
}

#[test]
fn a_single_point_outside_is_found_wherever_it_stands() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut points: Vec<LasPoint> = (0..POINTS).map(point).collect();
    let honest = las_bytes(&points, 0, 0.01, [1000.0, -20.0, 0.5]);
    // The last record of all, where no sample is taken; below, and far above.
    for (i, position) in [[-901, 7, 7], [7, 7, 1 << 20]].into_iter().enumerate() {
        points[POINTS - 1].position = position;
        let mut bytes = las_bytes(&points, 0, 0.01, [1000.0, -20.0, 0.5]);
        bytes[179..227].copy_from_slice(&honest[179..227]);
        let path = folder.path().join(format!("late{i}.las"));
        std::fs::write(&path, bytes).expect("the input is written");
        assert!(!same_store(std::slice::from_ref(&path), |_| {}));
        assert!(!same_store(&[path], |options| options.memory_bytes = 400_000));
    }
}

#[test]
fn what_is_wanted_of_all_points_is_had_by_looking_at_them() {
    struct Wants(Mutex<u64>);
    impl Progress for Wants {
        fn begin(&self, _: Stage, _: u64) {}
        fn advance(&self, _: u64) {}
        fn wanted_points(&self) -> u64 {
            100
        }
        fn take_points(&self, sample: esker::build::PointSample) {
            let record_bytes = u64::from(sample.schema.record_bytes);
            *self.0.lock().expect("it is whole") += sample.records.len() as u64 / record_bytes;
        }
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let points: Vec<LasPoint> = (0..POINTS).map(point).collect();
    let path = file(folder.path(), "whole.las", &points, &[]);
    let wants = Wants(Mutex::new(0));
    let output = folder.path().join("out.esker");
    let report = convert(&[path], &output, &options(true), &wants, &AtomicBool::new(false))
        .expect("it converts");
    assert!(!report.read_once);
    let taken = *wants.0.lock().expect("it is whole");
    assert!((50..200).contains(&taken), "{taken} points");
}
