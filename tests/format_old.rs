//! Protects people's stores: files of every released version go on opening and mean the same.
//!
//! `sample_data/store-v1.esker` and `store-v2.esker` were written from the 60 seeded points below
//! (depth 2, threshold 8, colour of 16 bits), `store-v3.esker` from the first 52, the others added.

#[path = "support/las_file.rs"]
mod las_file;

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use esker::build::{ConvertOptions, Silent, convert};
use esker::ids::NodeId;
use esker::store::{FULL_VERSION, HEADER_BYTES, Store, VERSION, check};
use las_file::{LasPoint, RECORD_BYTES, record, write_las};

fn points() -> Vec<LasPoint> {
    (0..60)
        .map(|i: i32| LasPoint {
            position: [i * 37 % 101, i * 53 % 97, i % 7],
            color: [i as u16 * 700, 40_000, i as u16],
            intensity: i as u16,
        })
        .collect()
}

fn records_of(store: &Store) -> Vec<Vec<u8>> {
    let mut all = Vec::new();
    let mut records = Vec::new();
    for node in 0..store.octree().nodes().len() as u32 {
        store.read_records(NodeId(node), &mut records).expect("the node reads");
        let record_bytes = store.metadata().schema.record_bytes as usize;
        all.extend(records.chunks_exact(record_bytes).map(|r| r[..RECORD_BYTES].to_vec()));
    }
    all
}

fn sample(version: u32) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("sample_data/store-v{version}.esker"))
}

#[test]
fn every_version_opens_and_holds_its_points() {
    for version in 1..=VERSION {
        let path = sample(version);
        assert_eq!(check(&path).expect("it opens").findings, []);
        let store = Store::open(&path).expect("it opens");
        assert_eq!(store.header().version, version);
        let mut found = records_of(&store);
        found.sort_unstable();
        let mut expected: Vec<Vec<u8>> =
            points().iter().zip(0..).map(|(point, i)| record(point, i).to_vec()).collect();
        expected.sort_unstable();
        assert_eq!(found, expected);
    }
}

#[test]
fn the_layout_has_not_changed_unnoticed() {
    let path = sample(FULL_VERSION);
    let old = Store::open(&path).expect("it opens");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (input, output) = (folder.path().join("small.las"), folder.path().join("small.esker"));
    write_las(&input, &points());
    let options = ConvertOptions { depth: 2, threshold: 8, ..ConvertOptions::default() };
    convert(&[input], &output, &options, &Silent, &AtomicBool::new(false)).expect("it converts");
    // All but the program's version in the metadata must be the same bytes.
    let new = Store::open(&output).expect("it opens");
    let parts = |path: &Path, store: &Store| {
        let bytes = std::fs::read(path).expect("the store reads");
        let header = store.header();
        let nodes = bytes[HEADER_BYTES..header.metadata.offset as usize].to_vec();
        (nodes, bytes[header.directory.offset as usize..].to_vec())
    };
    assert!(parts(&path, &old) == parts(&output, &new), "nodes, directory or appendix differ");
    let without_version = |store: &Store| {
        let mut metadata = store.metadata().clone();
        metadata.generator.clear();
        metadata
    };
    assert_eq!(without_version(&old), without_version(&new));
}
