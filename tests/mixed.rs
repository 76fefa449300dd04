//! Files of several formats, layouts and lattices in one store: every point comes back with its
//! values under the names of the union, and tells its source.

#[path = "support/foreign_files.rs"]
mod foreign_files;
#[path = "support/las_files.rs"]
mod las_files;
#[path = "support/shared_data.rs"]
mod shared_data;

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use esker::build::{BuildError, ConvertOptions, ConvertReport, Silent, convert};
use esker::ids::NodeId;
use esker::output::Compression;
use esker::points::Scalar;
use esker::store::{SLOT_BYTES, Store, check};
use foreign_files::{
    E57, E57Scan, Pcd, Ply, Point, e57, open, pcd, ply, points_of, read, samples, write,
};

fn converted(inputs: &[PathBuf], output: &Path) -> Result<ConvertReport, BuildError> {
    let options = ConvertOptions { overwrite: true, ..ConvertOptions::default() };
    convert(inputs, output, &options, &Silent, &AtomicBool::new(false))
}

/// Converts files, checks the store and gives its points in no particular order.
fn mixed(inputs: &[PathBuf], folder: &Path) -> (Store, Vec<Point>) {
    let output = folder.join("mixed.esker");
    converted(inputs, &output).unwrap();
    let report = check(&output).unwrap();
    assert!(report.findings.is_empty(), "{:?}", report.findings);
    let store = Store::open(&output).unwrap();
    let (mut points, mut records) = (Vec::new(), Vec::new());
    for node in 0..store.octree().nodes().len() as u32 {
        store.read_records(NodeId(node), &mut records).unwrap();
        let metadata = store.metadata();
        points.extend(points_of(&records, &metadata.schema, |s| metadata.lattice().world(s)));
    }
    (store, points)
}

/// Points of a source, by x.
fn of_source(points: &[Point], source: usize) -> Vec<Point> {
    let of = |point: &&Point| point.columns["source"] == [source as f64];
    let mut points: Vec<Point> = points.iter().filter(of).cloned().collect();
    points.sort_by(|a, b| a.position[0].total_cmp(&b.position[0]));
    points
}

/// A LAS file of a point format: `count` points along x, one step apart.
fn las(
    folder: &Path,
    name: &str,
    format: u8,
    count: i32,
    fill: impl Fn(i32, &mut [u8]),
) -> PathBuf {
    let template = las_files::template(las_files::least_minor(format), format, 0);
    let record_bytes = las_files::schema(&template).record_bytes as usize;
    let mut records = vec![0; count as usize * record_bytes];
    for (i, record) in (0i32..).zip(records.chunks_exact_mut(record_bytes)) {
        record[..4].copy_from_slice(&i.to_le_bytes());
        fill(i, &mut record[12..]);
    }
    let path = folder.join(name);
    las_files::write(&path, &template, Compression::None, &records);
    path
}

#[test]
fn old_and_new_point_formats_meet_in_the_new_layout() {
    let folder = tempfile::tempdir().unwrap();
    let old = las(folder.path(), "old.las", 3, 100, |i, rest| {
        rest[0] = i as u8;
        // Return 2 of 3, edge of flight line; class 9, withheld; 15 degrees to the left.
        rest[2..5].copy_from_slice(&[0b1001_1010, 0b1000_1001, (-15i8) as u8]);
    });
    let new = las(folder.path(), "new.las", 7, 50, |_, rest| {
        // Return 5 of 10; overlap; class 200; angle 1000.
        rest[2..6].copy_from_slice(&[0xa5, 0x08, 200, 4]);
        rest[6..8].copy_from_slice(&1000i16.to_le_bytes());
    });
    let (store, points) = mixed(&[old, new], folder.path());
    let (old, new) = (of_source(&points, 0), of_source(&points, 1));
    assert_eq!((old.len(), new.len()), (100, 50));
    for (i, point) in old.iter().enumerate() {
        assert_eq!(point.columns["intensity"], [i as f64]);
        assert_eq!(point.columns["returns"], [f64::from(0x32)]);
        assert_eq!(point.columns["flags"], [f64::from(0b1000_0100)]);
        assert_eq!(point.columns["classification"], [9.0]);
        assert_eq!(point.columns["scan_angle"], [-2500.0]);
    }
    for point in &new {
        assert_eq!(point.columns["returns"], [f64::from(0xa5)]);
        assert_eq!(point.columns["flags"], [8.0]);
        assert_eq!(point.columns["classification"], [200.0]);
        assert_eq!(point.columns["scan_angle"], [1000.0]);
    }
    let formats: Vec<_> = store.metadata().sources.iter().map(|s| s.point_format).collect();
    assert_eq!(formats, [Some(3), Some(7)], "the files' own");
}

#[test]
fn every_format_keeps_its_values_beside_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let samples = samples(200);
    let grid: Vec<[f64; 3]> = (0..100).map(|i| [f64::from(i) * 0.25, 3.5, -1.125]).collect();
    let pose = Some(([1.0, 0.0, 0.0, 0.0], [50.0, 0.0, 0.0]));
    let scans = [
        E57Scan { points: &grid, coding: E57::Double, pose: None },
        E57Scan { points: &grid, coding: E57::Double, pose },
    ];
    let inputs = [
        write(folder.path(), "a.ply", &ply(&samples, Ply::Little)),
        write(folder.path(), "b.pcd", &pcd(&samples, Pcd::Compressed)),
        write(folder.path(), "c.e57", &e57(&scans)),
    ];
    let (store, points) = mixed(&inputs, folder.path());
    let metadata = store.metadata();
    let told: Vec<_> = metadata.sources.iter().map(|s| (s.name.as_str(), s.points)).collect();
    assert_eq!(told, [("a.ply", 200), ("b.pcd", 400), ("c.e57", 100), ("c.e57", 100)]);
    assert_eq!(metadata.dropped_points, 200 + 20 + 20);
    assert_eq!(metadata.points, 560);
    for (source, path) in inputs[..2].iter().enumerate() {
        let mut own = read(&open(path).unwrap()).unwrap();
        own.sort_by(|a, b| a.position[0].total_cmp(&b.position[0]));
        let found = of_source(&points, source);
        assert_eq!(found.len(), 200);
        for (found, own) in found.iter().zip(&own) {
            assert_eq!(found.position, own.position, "floats come back bit by bit");
            assert_eq!(found.columns["rgb"], own.columns["rgb"]);
            assert_eq!(found.columns["label"], own.columns["label"]);
            assert_eq!(found.columns["row_index"], [0.0], "it has none of its own");
        }
    }
    let own = metadata.sources[0].attributes.as_deref().expect("it lacks some");
    assert!(own.contains(&"label".into()) && !own.contains(&"row_index".into()), "{own:?}");
    let own = metadata.sources[3].attributes.as_deref().expect("it lacks some");
    assert!(own.contains(&"row_index".into()) && !own.contains(&"label".into()), "{own:?}");
    let moved = of_source(&points, 3);
    assert_eq!(moved.len(), 80);
    assert!(moved.iter().all(|p| p.position[0] >= 50.0 - 1e-6));
    assert_eq!(moved[0].columns["column_index"], [7.0]);
}

#[test]
fn types_are_widened_and_las_coordinates_stay_exact_beside_floats() {
    let folder = tempfile::tempdir().unwrap();
    let scan = las(folder.path(), "a.las", 2, 100, |i, rest| {
        rest[..2].copy_from_slice(&(60_000 + i as u16).to_le_bytes());
    });
    let floats = "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty double y\n\
                  property double z\nproperty float intensity\nend_header\n\
                  476000.123456789 5429001.5 300.25 0.125\n476000.1 5429001.6 300.7 -2.5\n";
    let floats = write(folder.path(), "b.ply", floats.as_bytes());
    let (store, points) = mixed(&[scan.clone(), floats], folder.path());
    let (_, intensity) = store.metadata().schema.find("intensity").unwrap();
    assert_eq!(intensity.scalar, Scalar::F32, "16 bits and fractions fit single precision");
    let las_points = of_source(&points, 0);
    let own = read(&open(&scan).unwrap()).unwrap();
    for (i, (found, own)) in las_points.iter().zip(&own).enumerate() {
        assert_eq!(found.columns["intensity"], [60_000.0 + i as f64]);
        let near = |(a, b): (f64, f64)| (a - b).abs() <= 2.0 * f64::EPSILON * b.abs();
        assert!(found.position.into_iter().zip(own.position).all(near), "{found:?} {own:?}");
    }
    let found = of_source(&points, 1);
    assert_eq!(found[0].position, [476_000.1, 5_429_001.6, 300.7]);
    assert_eq!(found[1].position, [476_000.123456789, 5_429_001.5, 300.25]);
    assert_eq!(
        (&found[0].columns["intensity"][..], &found[1].columns["intensity"][..]),
        (&[-2.5][..], &[0.125][..])
    );
}

#[test]
fn a_single_file_has_no_source_and_its_own_layout() {
    let folder = tempfile::tempdir().unwrap();
    let scan = las(folder.path(), "a.las", 1, 10, |_, _| ());
    let output = folder.path().join("one.esker");
    converted(std::slice::from_ref(&scan), &output).unwrap();
    let store = Store::open(&output).unwrap();
    assert_eq!(&store.metadata().schema, open(&scan).unwrap().schema());
    assert_eq!(store.metadata().sources[0].attributes, None);
}

#[test]
fn points_of_a_wrong_source_are_found_by_check() {
    let folder = tempfile::tempdir().unwrap();
    let files = [
        las(folder.path(), "a.las", 1, 30, |_, _| ()),
        las(folder.path(), "b.las", 1, 20, |_, _| ()),
    ];
    let output = folder.path().join("two.esker");
    converted(&files, &output).unwrap();
    let mut bytes = std::fs::read(&output).unwrap();
    // The metadata swaps its counts, and its checksum is made to fit.
    let text = |bytes: &[u8], from: &str| {
        bytes.windows(from.len()).position(|part| part == from.as_bytes()).expect("it is there")
    };
    let (thirty, twenty) = (text(&bytes, "\"points\":30"), text(&bytes, "\"points\":20"));
    bytes[thirty + 9] = b'2';
    bytes[twenty + 9] = b'3';
    let mut header = *Store::open(&output).unwrap().header();
    let metadata =
        header.metadata.offset as usize..(header.metadata.offset + header.metadata.bytes) as usize;
    header.metadata.checksum = crc32c::crc32c(&bytes[metadata]);
    bytes[..SLOT_BYTES].copy_from_slice(&header.encode());
    std::fs::write(&output, bytes).unwrap();
    let report = check(&output).unwrap();
    let messages: Vec<&str> = report.findings.iter().map(|f| f.message.as_str()).collect();
    assert_eq!(
        messages,
        [
            "source 0 (a.las): 20 points came in, 30 are here and 0 were dropped",
            "source 1 (b.las): 30 points came in, 20 are here and 0 were dropped"
        ]
    );
}

#[test]
fn all_shared_files_fit_one_store() {
    let Some(folder) = shared_data::file("pump.xyz") else { return };
    let folder = folder.parent().unwrap();
    let names = [
        "4_6_crop.las",
        "autzen_trim_7.las",
        "extrabytes.las",
        "autzen-color.ptx",
        "bun_zipper.ply",
        "bunnyFloat.e57",
        "pump-tls.e57",
        "pump.xyz",
        "room-rgb.pcd",
        "tiny_spherical.e57",
        "indoor-sample.pts",
        "lone-star.copc.laz",
        "isprs-csite4.pcd",
        "ign-semis-2022-pf8.laz",
    ];
    let inputs: Vec<PathBuf> = names.iter().map(|name| folder.join(name)).collect();
    let temporary = tempfile::tempdir().unwrap();
    let output = temporary.path().join("all.esker");
    let report = converted(&inputs, &output).unwrap();
    let scans: Vec<_> = inputs.iter().map(|path| open(path).unwrap()).collect();
    assert_eq!(report.points, scans.iter().map(|scan| scan.points()).sum::<u64>());
    let found = check(&output).unwrap();
    assert!(found.findings.is_empty(), "{:?}", found.findings);
    let store = Store::open(&output).unwrap();
    let sources = &store.metadata().sources;
    assert_eq!(sources.len(), scans.iter().map(|s| s.parts().len().max(1)).sum::<usize>());
}

/// Beyond some, files are opened for each read: a folder of 10,000 tiles stays within what systems
/// allow.
#[cfg(target_os = "linux")]
#[test]
fn many_files_are_not_open_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let one = las(folder.path(), "0.las", 1, 5, |_, _| ());
    let paths: Vec<PathBuf> = (0..600).map(|i| folder.path().join(format!("{i}.las"))).collect();
    for path in &paths[1..] {
        std::fs::copy(&one, path).unwrap();
    }
    let scans: Vec<_> = paths.iter().map(|path| open(path).unwrap()).collect();
    let open_files = std::fs::read_dir("/proc/self/fd").unwrap().count();
    assert!(open_files < 250, "{open_files} open files");
    assert!(scans.iter().all(|scan| read(scan).unwrap().len() == 5));
    drop(scans);
    let (store, points) = mixed(&paths, folder.path());
    assert_eq!((points.len(), store.metadata().sources.len()), (3000, 600));
}

#[test]
fn the_longer_header_of_version_1_5_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let older = las(folder.path(), "older.las", 7, 20, |i, rest| rest[0] = i as u8);
    let mut bytes = std::fs::read(&older).unwrap();
    // Largest and smallest GPS time and an offset of time stand behind what 1.4 has.
    bytes.splice(375..375, [7; 18]);
    let start = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) + 18;
    bytes[25] = 5;
    bytes[94..96].copy_from_slice(&393u16.to_le_bytes());
    bytes[96..100].copy_from_slice(&start.to_le_bytes());
    let newer = write(folder.path(), "newer.las", &bytes);
    let (a, b) = (open(&older).unwrap(), open(&newer).unwrap());
    assert_eq!((b.format().as_str(), b.schema()), ("las 1.5", a.schema()));
    assert_eq!(read(&a).unwrap(), read(&b).unwrap());
    let (_, points) = mixed(&[older, newer], folder.path());
    assert_eq!(points.len(), 40);
}
