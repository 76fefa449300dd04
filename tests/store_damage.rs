//! Protects stores against damage that goes unnoticed: `check` must see every flipped byte, name
//! the place, and never panic; reading must never give wrong points silently.

#[path = "support/las_file.rs"]
mod las_file;

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use esker::build::{ConvertOptions, Silent, convert};
use esker::store::{HEADER_BYTES, Store, StoreError, check};
use las_file::{LasPoint, write_las};

fn small_store(folder: &Path) -> PathBuf {
    let points: Vec<LasPoint> = (0..60)
        .map(|i: i32| LasPoint {
            position: [i * 37 % 101, i * 53 % 97, i % 7],
            color: [i as u16 * 700, 40_000, i as u16],
            intensity: i as u16,
        })
        .collect();
    let (input, output) = (folder.join("small.las"), folder.join("small.esker"));
    write_las(&input, &points);
    let options = ConvertOptions { depth: 2, threshold: 8, ..ConvertOptions::default() };
    convert(&[input], &output, &options, &Silent, &AtomicBool::new(false)).expect("it converts");
    output
}

#[test]
fn every_flipped_byte_is_found_and_named() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = small_store(folder.path());
    let sound = std::fs::read(&path).expect("the store reads");
    let store = Store::open(&path).expect("the store opens");
    let header = *store.header();
    assert!(store.octree().nodes().len() > 3, "it has several nodes");
    drop(store);
    let damaged_path = folder.path().join("damaged.esker");
    for at in 0..sound.len() {
        let mut damaged = sound.clone();
        damaged[at] ^= 1 << (at % 8);
        std::fs::write(&damaged_path, &damaged).expect("a file can be written");
        let message = match check(&damaged_path) {
            Err(error) => error.to_string(),
            Ok(report) => {
                assert!(!report.findings.is_empty(), "byte {at} of {} went unnoticed", sound.len());
                report.findings[0].message.clone()
            }
        };
        let within = |offset: u64, bytes: u64| (offset..offset + bytes).contains(&(at as u64));
        let expected = if at < 8 {
            "not an Esker store"
        } else if at < HEADER_BYTES {
            // Byte 8 becomes a version that there is.
            if (9..12).contains(&at) { "version" } else { "header" }
        } else if within(header.metadata.offset, header.metadata.bytes) {
            "metadata"
        } else if within(header.directory.offset, header.directory.bytes) {
            "directory"
        } else if within(HEADER_BYTES as u64, header.data_bytes) {
            "node "
        } else {
            "appendix"
        };
        assert!(message.contains(expected), "byte {at}: '{message}' does not name {expected}");
    }
}

#[test]
fn every_truncation_is_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = small_store(folder.path());
    let sound = std::fs::read(&path).expect("the store reads");
    let cut_path = folder.path().join("cut.esker");
    for length in (0..sound.len()).step_by(7) {
        std::fs::write(&cut_path, &sound[..length]).expect("a file can be written");
        let error = Store::open(&cut_path).expect_err("a cut store does not open");
        assert!(error.to_string().contains("cut.esker"), "it names the file: {error}");
    }
}

#[test]
fn what_an_unfinished_change_left_is_told() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = small_store(folder.path());
    let sound = std::fs::read(&path).expect("the store reads");
    let longer = [&sound[..], b"more"].concat();
    std::fs::write(&path, longer).expect("a file can be written");
    assert!(Store::open(&path).is_ok(), "the store itself is whole");
    let findings = check(&path).expect("it opens").findings;
    assert!(findings[0].message.contains("beyond the end"), "{findings:?}");
}

#[test]
fn files_that_are_no_stores_are_told_apart() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("other.esker");
    for bytes in [&b""[..], b"LASF", &[0xff; 4000]] {
        std::fs::write(&path, bytes).expect("a file can be written");
        assert!(matches!(Store::open(&path), Err(StoreError::NotAStore { .. })));
    }
    let missing = Store::open(&folder.path().join("missing.esker"));
    assert!(matches!(missing, Err(StoreError::Io { .. })));
    assert!(matches!(Store::open(folder.path()), Err(StoreError::NotAStore { .. })));
}

#[test]
fn a_store_that_shrinks_while_open_gives_an_error_value() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = small_store(folder.path());
    let store = Store::open(&path).expect("the store opens");
    let file = std::fs::OpenOptions::new().write(true).open(&path).expect("it opens for writing");
    let last = esker::ids::NodeId(store.octree().nodes().len() as u32 - 1);
    file.set_len(store.node_extent(last).0 + 1).expect("it can be cut");
    let error = store.read_positions(last, &mut Vec::new()).expect_err("the bytes are gone");
    assert!(error.to_string().contains(&format!("node {last}")), "it names the node: {error}");
}
