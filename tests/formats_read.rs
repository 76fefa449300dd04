//! What PLY, PCD and E57 files hold comes out of their readers, and of a store, bit by bit.
//!
//! Small files of every variant are written by hand (E57 by the crate's writer) with values that
//! are known; real ones are compared with figures that independent readers give (`tools/
//! reader-matrix` compares them value by value).

#[path = "support/foreign_files.rs"]
mod foreign_files;
#[path = "support/shared_data.rs"]
mod shared_data;

use std::path::Path;
use std::sync::atomic::AtomicBool;

use esker::build::{ConvertOptions, Silent, convert};
use esker::ids::NodeId;
use esker::input::{CoordinateKind, FileKind, Scan, detect};
use esker::sampling::Random;
use esker::store::{Store, check};
use foreign_files::{
    E57, E57Scan, Pcd, Ply, Point, Sample, e57, open, pcd, ply, points_of, read, samples, write,
};
use glam::{DQuat, DVec3};

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

/// Converts a file, checks the store and gives its points in no particular order.
fn through_store(input: &Path) -> (Store, Vec<Point>) {
    let output = input.with_extension("esker");
    let options = ConvertOptions { overwrite: true, ..ConvertOptions::default() };
    let inputs = [input.to_path_buf()];
    convert(&inputs, &output, &options, &Silent, &AtomicBool::new(false)).unwrap();
    let report = check(&output).unwrap();
    assert!(report.findings.is_empty(), "{:?}", report.findings);
    let store = Store::open(&output).unwrap();
    let mut points = Vec::new();
    let mut records = Vec::new();
    for node in 0..store.octree().nodes().len() as u32 {
        store.read_records(NodeId(node), &mut records).unwrap();
        let metadata = store.metadata();
        let world = |steps| metadata.lattice().world(steps);
        points.extend(points_of(&records, &metadata.schema, world));
    }
    (store, points)
}

/// Sorted bits of everything that points hold.
fn bits(points: &[Point]) -> Vec<Vec<u64>> {
    let of = |point: &Point| {
        let columns = point.columns.iter().filter(|(name, _)| *name != "coordinate_residual");
        let values = columns.flat_map(|(_, values)| values.clone());
        point.position.into_iter().chain(values).map(f64::to_bits).collect()
    };
    let mut all: Vec<Vec<u64>> = points.iter().map(of).collect();
    all.sort_unstable();
    all
}

fn assert_samples(scan: &Scan, samples: &[Sample]) {
    let points = read(scan).unwrap();
    assert_eq!(points.len(), samples.len(), "{}", scan.format());
    for (point, sample) in points.iter().zip(samples) {
        let single = point.position.map(|value| value as f32);
        assert_eq!(single, sample.position, "{}", scan.format());
        assert_eq!(point.columns["rgb"], sample.color.map(f64::from), "{}", scan.format());
        assert_eq!(point.columns["label"], [f64::from(sample.label)], "{}", scan.format());
    }
}

#[test]
fn every_variant_of_ply_gives_its_points() {
    let folder = folder();
    let samples = samples(300);
    for (kind, format) in [
        (Ply::Ascii, "ply ascii"),
        (Ply::Little, "ply binary_little_endian"),
        (Ply::Big, "ply binary_big_endian"),
        (Ply::Listed, "ply binary_little_endian"),
    ] {
        let path = write(folder.path(), "no_suffix", &ply(&samples, kind));
        assert_eq!(detect(&path).unwrap(), FileKind::Ply);
        let scan = open(&path).unwrap();
        assert_eq!(scan.format(), format);
        assert_samples(&scan, &samples);
        let skipped = &scan.foreign().unwrap().skipped;
        assert!(skipped.contains(&("face".into(), 1)), "{skipped:?}");
        assert!(skipped.contains(&("camera".into(), 1)), "{skipped:?}");
        let lists = skipped.contains(&("lists rings of vertex".into(), 300));
        assert_eq!(lists, kind == Ply::Listed);
        let (_, stored) = through_store(&path);
        assert_eq!(bits(&stored), bits(&read(&scan).unwrap()), "{kind:?}");
    }
}

#[test]
fn every_variant_of_pcd_gives_its_points() {
    let folder = folder();
    let samples = samples(3000);
    for kind in [Pcd::Ascii, Pcd::Binary, Pcd::Compressed] {
        let path = write(folder.path(), "cloud.pcd", &pcd(&samples, kind));
        let scan = open(&path).unwrap();
        assert_samples(&scan, &samples);
        assert_eq!(scan.dropped_points(), 3000, "{kind:?}");
        assert_eq!(scan.parts()[0].points, 6000);
        let pose = scan.parts()[0].pose.unwrap();
        assert_eq!(pose.translation, DVec3::new(1.0, 2.0, 3.0));
        let (store, stored) = through_store(&path);
        assert_eq!(bits(&stored), bits(&read(&scan).unwrap()), "{kind:?}");
        let source = &store.metadata().sources[0];
        assert_eq!((source.points, source.dropped_points()), (6000, 3000));
        assert!(!source.pose.unwrap().applied, "a viewpoint is kept, not applied");
    }
}

/// Coordinates that singles, doubles and the scaled steps of the test files all hold.
fn grid(count: usize) -> Vec<[f64; 3]> {
    let mut random = Random::new(5, 0);
    let mut step = || 10.0 + f64::from(random.bits() as u32 % 4000) * 0.125;
    (0..count).map(|_| [step(), step(), step()]).collect()
}

#[test]
fn every_coding_of_e57_gives_its_points() {
    let folder = folder();
    // More than a block, and far more than a packet.
    let points = grid(70_000);
    for coding in [E57::Single, E57::Double, E57::Scaled] {
        let bytes = e57(&[E57Scan { points: &points, coding, pose: None }]);
        let path = write(folder.path(), "scan.bin", &bytes);
        let scan = open(&path).unwrap();
        let found = read(&scan).unwrap();
        let kept = points.iter().enumerate().filter(|(i, _)| i % 5 != 4);
        assert_eq!(found.len(), 56_000);
        assert_eq!(scan.dropped_points(), 14_000);
        for (point, (i, expected)) in found.iter().zip(kept) {
            let near = |(a, b): (f64, f64)| (a - b).abs() < 1e-12 * b.abs();
            assert!(point.position.into_iter().zip(*expected).all(near), "{coding:?} {i}");
            let columns = &point.columns;
            assert_eq!(columns["rgb"], [i % 256, i % 251, i % 241].map(|v| v as f64), "{i}");
            assert_eq!(columns["row_index"], [(i % 8192) as f64]);
            assert_eq!(columns["column_index"], [7.0]);
            assert_eq!(columns["intensity"], [f64::from(i as f32 * 0.5)]);
        }
        assert_eq!(scan.parts()[0].name.as_deref(), Some("station 0"));
        let (_, stored) = through_store(&path);
        assert_eq!(bits(&stored), bits(&found), "{coding:?}");
    }
}

#[test]
fn poses_and_spherical_coordinates_are_computed_within_a_step() {
    let folder = folder();
    let points = grid(1000);
    let polar: Vec<[f64; 3]> = (0..1000)
        .map(|i| [5.0 + f64::from(i) * 0.01, f64::from(i) * 0.006 - 3.0, f64::from(i) * 0.001])
        .collect();
    let rotation = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7);
    let [x, y, z, w] = rotation.to_array();
    let pose = Some(([w, x, y, z], [1000.0, -500.0, 20.0]));
    let bytes = e57(&[
        E57Scan { points: &points, coding: E57::Double, pose },
        E57Scan { points: &polar, coding: E57::Spherical, pose: None },
    ]);
    let path = write(folder.path(), "scans.e57", &bytes);
    let scan = open(&path).unwrap();
    assert_eq!(scan.foreign().unwrap().coordinates, CoordinateKind::Computed);
    assert!(scan.warnings().iter().any(|w| w.contains("rounded")), "{:?}", scan.warnings());
    let moved = points
        .iter()
        .map(|&point| rotation * DVec3::from(point) + DVec3::new(1000.0, -500.0, 20.0));
    let turned = polar.iter().map(|point| {
        let [range, azimuth, elevation] = point.map(|value| f64::from(value as f32));
        range
            * DVec3::new(
                elevation.cos() * azimuth.cos(),
                elevation.cos() * azimuth.sin(),
                elevation.sin(),
            )
    });
    let kept = |(i, _): &(usize, DVec3)| i % 5 != 4;
    let moved = moved.enumerate().filter(kept);
    let expected: Vec<DVec3> =
        moved.chain(turned.enumerate().filter(kept)).map(|(_, p)| p).collect();
    let found = read(&scan).unwrap();
    assert_eq!(found.len(), expected.len());
    let [low, high] = scan.foreign().unwrap().bounds;
    let most = (high - low).max_element() / 2f64.powi(31);
    for (point, expected) in found.iter().zip(expected) {
        let off = (DVec3::from(point.position) - expected).abs().max_element();
        assert!(off <= most + 1e-12, "{off} is more than {most}");
    }
    let (store, stored) = through_store(&path);
    assert_eq!(stored.len(), 1600);
    let sources = &store.metadata().sources;
    assert_eq!(sources.len(), 2, "each scan is a source");
    assert_eq!(sources[1].scan.as_deref(), Some("station 1"));
    let stored_pose = sources[0].pose.unwrap();
    assert!(stored_pose.applied && stored_pose.translation == [1000.0, -500.0, 20.0]);
    let of = |source: f64| stored.iter().filter(|p| p.columns["source"] == [source]).count();
    assert_eq!((of(0.0), of(1.0)), (800, 800));
}

#[test]
fn floats_of_all_sizes_come_back_bit_by_bit() {
    let folder = folder();
    let mut random = Random::new(11, 0);
    for case in ["single", "double"] {
        let mut file = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex 5000\n\
             property {0} x\nproperty {0} y\nproperty {0} z\nend_header\n",
            if case == "single" { "float" } else { "double" }
        )
        .into_bytes();
        let mut expected = Vec::new();
        for _ in 0..5000 {
            let mut number = || loop {
                let bits = random.bits();
                // Doubles stay within 2^60, because beyond their squares leave the range.
                let single = f32::from_bits(bits as u32);
                let double = f64::from_bits(bits);
                if case == "single" && single.is_finite() {
                    file.extend(single.to_le_bytes());
                    return f64::from(single);
                } else if case == "double" && double.abs() < 2f64.powi(60) {
                    file.extend(double.to_le_bytes());
                    return double;
                }
            };
            expected.push([number(), number(), number()].map(f64::to_bits));
        }
        expected.sort_unstable();
        let path = write(folder.path(), case, &file);
        let (_, stored) = through_store(&path);
        let mut found: Vec<[u64; 3]> =
            stored.iter().map(|point| point.position.map(f64::to_bits)).collect();
        found.sort_unstable();
        assert!(found == expected, "{case}");
    }
}

#[test]
fn floats_on_a_power_of_two_need_no_residual() {
    let folder = folder();
    let mut file = b"ply\nformat binary_little_endian 1.0\nelement vertex 1000\n\
        property float x\nproperty float y\nproperty float z\nend_header\n"
        .to_vec();
    for i in 0..1000u32 {
        // As coordinates in UTM look in single precision.
        for start in [513_000.0f32, 5_403_000.0, -3.0] {
            file.extend((start + (i as f32) * 0.5).to_le_bytes());
        }
    }
    let scan = open(&write(folder.path(), "utm.ply", &file)).unwrap();
    assert!(scan.schema().attributes.is_empty(), "{:?}", scan.schema());
    assert_eq!(scan.lattice().scale.x, 0.5);
    let points = read(&scan).unwrap();
    assert_eq!(points[999].position, [513_499.5, 5_403_499.5, 496.5]);
}

/// What an independent reader finds in a shared file.
struct Known {
    name: &'static str,
    points: u64,
    dropped: u64,
    sums: [f64; 3],
    low: [f64; 3],
    high: [f64; 3],
    /// Sums of some columns' components.
    columns: &'static [(&'static str, &'static [f64])],
}

/// Figures of plyfile, pypcd4 and pye57; text was parsed by a script.
const KNOWN: &[Known] = &[
    Known {
        name: "autzen-color.ptx",
        points: 1065,
        dropped: 0,
        sums: [678721022.97, 906580758.49, 462314.2],
        low: [635619.85, 848899.7, 406.59],
        high: [638982.55, 853535.43, 586.38],
        columns: &[("rgb", &[129567.0, 118582.0, 134764.0]), ("intensity", &[19.863535])],
    },
    Known {
        name: "bun_zipper.ply",
        points: 35947,
        dropped: 0,
        sums: [-961.9384846930375, 3422.731701642275, 321.62192779389454],
        low: [-0.09468989819288254, 0.03298740088939667, -0.061873599886894226],
        high: [0.06100910156965256, 0.1873210072517395, 0.05879969894886017],
        columns: &[("confidence", &[20744.26499091834]), ("intensity", &[17314.85397133231])],
    },
    Known {
        name: "bunnyFloat.e57",
        points: 30571,
        dropped: 0,
        sums: [-841.0932977735692, 3151.198741853237, 264.2439720416619],
        low: [-0.09468899667263031, 0.040010999888181686, -0.061873000115156174],
        high: [0.0610090009868145, 0.1873210072517395, 0.05879899859428406],
        columns: &[],
    },
    Known {
        name: "indoor-sample.pts",
        points: 202011,
        dropped: 0,
        sums: [-1445081.41, 594749.98, 775537.51],
        low: [-22.16, -1.95, -7.7],
        high: [5.63, 7.55, 12.17],
        columns: &[("rgb", &[0.0; 3]), ("intensity", &[0.0])],
    },
    Known {
        name: "isprs-csite4.pcd",
        points: 518056,
        dropped: 0,
        sums: [265958317526.1875, 2799296586695.5, 155030690.39656067],
        low: [513119.5, 5403189.5, 188.30999755859375],
        high: [513630.09375, 5403763.0, 356.239990234375],
        columns: &[],
    },
    Known {
        name: "pump-tls.e57",
        points: 155201,
        dropped: 0,
        sums: [-74913.309953, -409112.126518, -147000.510634],
        low: [-2.903763, -5.301102, -1.899704],
        high: [1.721603, -0.792648, 1.843002],
        columns: &[
            ("rgb", &[5023067.0, 5904063.0, 4008525.0]),
            ("row_index", &[59422135.0]),
            ("column_index", &[25596424.0]),
            ("intensity", &[73258.7258]),
        ],
    },
    Known {
        name: "pump.xyz",
        points: 155201,
        dropped: 0,
        sums: [-74913.29549, -409112.08044, -147000.47992],
        low: [-2.90376, -5.3011, -1.8997],
        high: [1.7216, -0.79265, 1.843],
        columns: &[("rgb", &[5023067.0, 5904063.0, 4008525.0])],
    },
    Known {
        name: "room-rgb.pcd",
        points: 259847,
        dropped: 47353,
        sums: [6654.195661828038, -34038.23281252594, 418831.59058469534],
        low: [-1.0720570087432861, -1.5806399583816528, 0.8430001139640808],
        high: [1.8101530075073242, 0.4080914855003357, 3.821000099182129],
        columns: &[("rgb", &[41468041.0, 36508734.0, 34265005.0])],
    },
    Known {
        name: "tiny_spherical.e57",
        points: 180,
        dropped: 180,
        sums: [89.95435666933113, 0.0008690215441082027, 114.6459050783777],
        low: [6.341362302269048e-07, -0.499998573193859, 0.0],
        high: [1.0, 0.49999984146591736, 0.9999996829318346],
        columns: &[],
    },
];

#[test]
fn shared_files_are_what_independent_readers_find() {
    for known in KNOWN {
        let Some(path) = shared_data::file(known.name) else { continue };
        let scan = open(&path).unwrap();
        let points = read(&scan).unwrap();
        let name = known.name;
        assert_eq!((scan.points(), scan.dropped_points()), (known.points, known.dropped), "{name}");
        // Sums of doubles differ in their last digits, computed coordinates by the lattice.
        let near = |a: f64, b: f64| (a - b).abs() <= 1e-8 * b.abs().max(1.0);
        for axis in 0..3 {
            let values = || points.iter().map(|point| point.position[axis]);
            assert!(near(values().sum(), known.sums[axis]), "{name}: sum of {axis}");
            assert!(near(values().fold(f64::MAX, f64::min), known.low[axis]), "{name}: {axis}");
            assert!(near(values().fold(f64::MIN, f64::max), known.high[axis]), "{name}: {axis}");
        }
        for (column, sums) in known.columns {
            for (component, &sum) in sums.iter().enumerate() {
                let values = points.iter().map(|point| point.columns[*column][component]);
                assert!(near(values.sum(), sum), "{name}: {column} {component}");
            }
        }
    }
}
