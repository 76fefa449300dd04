//! Protects COPC exports: every field of every point format comes out, and the files are the octrees
//! that they say they are.
//!
//! The oracles are this project's LAS reader, which takes a COPC file as the LAZ file it also is, and
//! a reader of the hierarchy written here from the specification.

#[path = "support/export_case.rs"]
mod export_case;
#[path = "support/las_files.rs"]
mod las_files;

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use esker::input::{LasScan, PointFormat};
use esker::output::Compression;
use esker::points::record_coordinates;
use esker::sampling::records;
use export_case::{Case, all_fields, text};
use las_files::{read_all, template, write};

#[test]
fn copc_holds_every_field_of_every_point_format() {
    for format in 0..=10 {
        let case = Case::noise(6000, format, 5, 12, &[]);
        let (_, source) = case.records();
        let path = case.export("out.copc.laz", &[]);
        let copc = LasScan::open(&path).expect("it reads as LAZ");
        assert_eq!(copc.facts().warnings, Vec::<String>::new(), "format {format}");
        let expected_format = match format {
            2 | 3 | 5 | 7 => 7,
            8 | 10 => 8,
            _ => 6,
        };
        assert_eq!(copc.header().point_format.number(), expected_format, "of format {format}");
        let size = usize::from(PointFormat::new(format).expect("a format").base_bytes()) + 5;
        let expected = all_fields(&source, size, format, true);
        let found = read_all(&copc).expect("it reads");
        let found_size = usize::from(copc.header().record_bytes);
        let found = all_fields(&found, found_size, expected_format, false);
        assert_eq!(expected.len(), found.len());
        for (a, b) in expected.iter().zip(&found) {
            assert_eq!(a, b, "format {format}");
        }
        check_octree(&copc, &path);
    }
}

/// One chunk of a COPC file as its hierarchy tells it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Entry {
    offset: u64,
    bytes: u64,
    points: u64,
}

struct Copc {
    low: [f64; 3],
    edge: f64,
    spacing: f64,
    times: [f64; 2],
    entries: BTreeMap<[u32; 4], Entry>,
}

/// Info record and hierarchy, from copc.io.
fn read_copc(bytes: &[u8]) -> Copc {
    let double = |at: usize| f64::from_le_bytes(bytes[at..at + 8].try_into().expect("8"));
    let long = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().expect("8"));
    let int = |at: usize| i32::from_le_bytes(bytes[at..at + 4].try_into().expect("4"));
    assert_eq!(&bytes[377..381], b"copc", "the first record is COPC's");
    assert_eq!(bytes[375 + 18..375 + 22], [1, 0, 160, 0], "its id and size");
    let info = 375 + 54;
    let half = double(info + 24);
    let mut copc = Copc {
        low: [0, 1, 2].map(|axis| double(info + 8 * axis) - half),
        edge: 2.0 * half,
        spacing: double(info + 32),
        times: [double(info + 56), double(info + 64)],
        entries: BTreeMap::new(),
    };
    assert!(bytes[info + 72..info + 160].iter().all(|&byte| byte == 0), "reserved bytes");
    let mut pages = vec![(long(info + 40) as usize, long(info + 48) as usize)];
    while let Some((start, length)) = pages.pop() {
        for at in (start..start + length).step_by(32) {
            let key = [0, 4, 8, 12].map(|i| int(at + i) as u32);
            let (offset, size, points) = (long(at + 16), int(at + 24), int(at + 28));
            if points < 0 {
                pages.push((offset as usize, size as usize));
                continue;
            }
            let entry = Entry { offset, bytes: size as u64, points: points as u64 };
            assert_eq!(copc.entries.insert(key, entry), None, "{key:?} stands twice");
        }
    }
    copc
}

/// Hierarchy and chunks agree; points lie in the cubes of their chunks.
fn check_octree(scan: &LasScan, path: &Path) -> Copc {
    let bytes = std::fs::read(path).expect("the file reads");
    let copc = read_copc(&bytes);
    let header = scan.header();
    let size = usize::from(header.record_bytes);
    let chunks: Vec<Entry> = {
        let mut chunks: Vec<Entry> =
            copc.entries.values().copied().filter(|entry| entry.points > 0).collect();
        chunks.sort_by_key(|entry| entry.offset);
        chunks
    };
    // Chunks fill the space between the table's place and the table.
    let first = u64::from(header.point_data_offset) + 8;
    let end = chunks.iter().fold(first, |at, entry| {
        assert_eq!(entry.offset, at, "chunks follow one another");
        at + entry.bytes
    });
    let table = header.point_data_offset as usize;
    let table = u64::from_le_bytes(bytes[table..table + 8].try_into().expect("8"));
    assert_eq!(end, table, "the table of chunks follows the last one");
    let counts: Vec<u64> = scan.blocks().iter().map(|block| block.points).collect();
    assert_eq!(counts, chunks.iter().map(|entry| entry.points).collect::<Vec<_>>());

    let mut records = &read_all(scan).expect("it reads")[..];
    let keys: BTreeMap<u64, [u32; 4]> = copc
        .entries
        .iter()
        .filter(|(_, entry)| entry.points > 0)
        .map(|(key, entry)| (entry.offset, *key))
        .collect();
    let mut times = [f64::INFINITY, f64::NEG_INFINITY];
    for entry in &chunks {
        let (chunk, rest) = records.split_at(entry.points as usize * size);
        records = rest;
        let key = keys[&entry.offset];
        let edge = copc.edge / f64::from(1u32 << key[0]);
        for record in chunk.chunks_exact(size) {
            let world = header.lattice.world(record_coordinates(record).map(i64::from).into());
            for axis in 0..3 {
                let low = copc.low[axis] + edge * f64::from(key[axis + 1]);
                let inside = (low..=low + edge).contains(&world[axis]);
                assert!(inside, "{world} is not in {key:?}, axis {axis} from {low} by {edge}");
            }
            let time = f64::from_le_bytes(record[22..30].try_into().expect("8"));
            times = [times[0].min(time), times[1].max(time)];
        }
    }
    assert!(records.is_empty());
    if !chunks.is_empty() {
        assert_eq!(copc.times, times);
    }
    for key in copc.entries.keys().filter(|key| key[0] > 0) {
        let parent = [key[0] - 1, key[1] / 2, key[2] / 2, key[3] / 2];
        assert!(copc.entries.contains_key(&parent), "{key:?} has no parent");
    }
    assert!(copc.entries.contains_key(&[0; 4]), "there is a root");
    copc
}

#[test]
fn copc_chunks_are_neither_tiny_nor_huge() {
    // A filled cube on few steps: half of its cells at the depth of single steps, and a heap of
    // coincident points that no cell divides.
    let folder = tempfile::tempdir().expect("a folder");
    let scan = folder.path().join("scan.las");
    let mut all = records::noise(420_000, 0, 0, 3);
    for (i, record) in all.chunks_exact_mut(20).enumerate() {
        let heap = i % 7 < 2;
        for axis in record[..12].chunks_exact_mut(4) {
            let value = i32::from_le_bytes(axis.try_into().expect("4")) & 0xff;
            axis.copy_from_slice(&(if heap { 77 } else { value }).to_le_bytes());
        }
    }
    write(&scan, &template(2, 0, 0), Compression::None, &all);
    let case = Case::of(folder, scan, &["--threshold", "20", "--depth", "8"]);
    let path = case.export("out.copc.laz", &[]);
    let copc = LasScan::open(&path).expect("it reads as LAZ");
    assert_eq!(copc.points(), 420_000);
    let tree = check_octree(&copc, &path);
    assert_eq!(tree.spacing, tree.edge / 256.0);
    let has_children = |key: &[u32; 4]| {
        tree.entries
            .keys()
            .any(|k| k[0] == key[0] + 1 && [0, 1, 2].iter().all(|a| k[a + 1] / 2 == key[a + 1]))
    };
    for (key, entry) in &tree.entries {
        assert!(entry.points <= 110_000, "{key:?}: {} points", entry.points);
        if !has_children(key) {
            assert!(entry.points >= 500, "leaf {key:?}: {} points", entry.points);
        }
    }
    assert!(tree.entries.len() > 8, "large nodes were divided: {}", tree.entries.len());
}

#[test]
fn copc_bytes_do_not_depend_on_threads() {
    let case = Case::noise(150_000, 3, 0, 14, &[]);
    let files: Vec<Vec<u8>> = ["1", "3"]
        .iter()
        .map(|threads| {
            let output = case.folder.path().join("t.copc.laz");
            let done = Command::new(env!("CARGO_BIN_EXE_esker"))
                .args(["export", text(&case.store()), "-o", text(&output), "--overwrite"])
                .env("RAYON_NUM_THREADS", threads)
                .status()
                .expect("the program starts");
            assert!(done.success());
            std::fs::read(&output).expect("it is there")
        })
        .collect();
    assert!(files[0] == files[1]);
}

#[test]
fn copc_takes_no_point_one_point_and_unequal_scales() {
    for count in [0, 1] {
        let case = Case::noise(count, 1, 0, 10, &[]);
        let path = case.export("out.copc.laz", &[]);
        let copc = LasScan::open(&path).expect("it reads as LAZ");
        assert_eq!(copc.points(), count as u64);
        check_octree(&copc, &path);
    }
    // Degrees along x and y, metres along z: cells of the store are no cubes.
    let Some(case) = Case::shared("epsg_4326.las") else { return };
    let path = case.export("out.copc.laz", &[]);
    let copc = LasScan::open(&path).expect("it reads as LAZ");
    check_octree(&copc, &path);
    let (_, source) = case.records();
    let found = read_all(&copc).expect("it reads");
    let found = all_fields(&found, 30, 6, false);
    assert!(found == all_fields(&source, 20, 0, true));
}

#[test]
fn real_scans_come_back_from_copc() {
    for name in ["lion_takanawa.copc.laz", "fullwave-pf10.laz", "extrabytes.las", "4_6_crop.las"] {
        let Some(case) = Case::shared(name) else { continue };
        let (scan, source) = case.records();
        let path = case.export("out.copc.laz", &[]);
        let copc = LasScan::open(&path).expect("it reads as LAZ");
        check_octree(&copc, &path);
        assert_eq!(copc.facts().warnings, Vec::<String>::new(), "{name}");
        let (from, to) = (scan.header().point_format.number(), copc.header().point_format.number());
        let found = read_all(&copc).expect("it reads");
        let found = all_fields(&found, usize::from(copc.header().record_bytes), to, false);
        let expected = all_fields(&source, usize::from(scan.header().record_bytes), from, true);
        assert!(found == expected, "{name}");
        let names = |scan: &LasScan| -> Vec<String> {
            let base = scan.header().point_format;
            let fields = base.schema(base.base_bytes(), &[]).0.attributes.len();
            scan.schema().attributes[fields..].iter().map(|a| a.name.clone()).collect()
        };
        if from < 9 {
            assert_eq!(names(&scan), names(&copc), "{name}");
        } else {
            assert_eq!(names(&copc)[0], "wavepacket_index", "{name}");
        }
        assert_eq!(scan.facts().crs.wkt, copc.facts().crs.wkt, "{name}");
        assert_eq!(scan.facts().crs.geotiff_keys, copc.facts().crs.geotiff_keys, "{name}");
    }
}
