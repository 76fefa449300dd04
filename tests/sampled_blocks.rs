//! Protects the first look at a scan: a sample of the blocks is what it says and nothing else.
//!
//! The points of a sample are records of the scan, each once and in order; every part of every file
//! has some; a store made of them is whole. Damage ends a block of a sample, not the conversion.

#[path = "support/las_file.rs"]
mod las_file;
#[path = "support/shared_data.rs"]
mod shared_data;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use esker::build::{BuildError, ConvertOptions, Silent, Sources, convert, convert_sources};
use esker::input::{Block, BlockBuffer, ReadOptions};
use esker::store::check;
use las_file::{LasPoint, write_las};

fn open(paths: &[PathBuf]) -> Sources {
    Sources::open(paths, &ReadOptions::default()).expect("the scans open")
}

fn records(sources: &Sources, source: usize, block: &Block) -> Vec<u8> {
    let mut records = Vec::new();
    let mut take = |part: &[u8]| -> Result<(), BuildError> {
        records.extend_from_slice(part);
        Ok(())
    };
    let mut buffer = BlockBuffer::default();
    sources.read_block(source, block, &mut buffer, &mut take).expect("the block reads");
    records
}

fn field(path: &Path, count: i32, at: i32) {
    let point = |i: i32| LasPoint {
        position: [at + i % 1000, i / 1000, i % 7],
        color: [i as u16; 3],
        intensity: i as u16,
    };
    write_las(path, &(0..count).map(point).collect::<Vec<_>>());
}

/// Checks a sample against all records of the scans and returns its number of points.
fn assert_is_sample(paths: &[PathBuf], wanted: u64) -> u64 {
    let all = open(paths);
    let sample = all.sampled(wanted);
    let record_bytes = all.schema().record_bytes as usize;
    let mut whole = vec![Vec::new(); paths.len()];
    for (source, block) in all.blocks() {
        whole[source].extend(records(&all, source, block));
    }
    let (mut points, mut next) = (0, vec![0; paths.len()]);
    for (source, block) in sample.blocks() {
        let found = records(&sample, source, block);
        let first = block.first_point as usize;
        assert!(first >= next[source], "{paths:?}: blocks overlap at {first}");
        assert!(!found.is_empty(), "{paths:?}: a block without points");
        let at = first * record_bytes;
        assert!(
            found == whole[source][at..at + found.len()],
            "{paths:?}: other records at {first}"
        );
        next[source] = first + found.len() / record_bytes;
        points += (found.len() / record_bytes) as u64;
    }
    for (records, next) in whole.iter().zip(next) {
        assert!(records.is_empty() || next > 0, "{paths:?}: a file has no point in the sample");
    }
    assert_eq!(points, sample.expected_points(), "{paths:?}");

    let folder = tempfile::tempdir().expect("a folder");
    let output = folder.path().join("sample.esker");
    let (options, cancelled) = (ConvertOptions::default(), AtomicBool::new(false));
    let report = convert_sources(&sample, &output, &options, &Silent, &cancelled);
    assert_eq!(report.expect("the sample converts").points, points);
    assert_eq!(check(&output).expect("the store opens").findings, []);
    points
}

#[test]
fn a_sample_of_plain_records_is_short_runs_from_everywhere() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("field.las");
    field(&path, 200_000, 0);
    for wanted in [1, 2_000, 20_000, 150_000] {
        let points = assert_is_sample(std::slice::from_ref(&path), wanted);
        assert!(points.abs_diff(wanted) <= 128, "{points} of {wanted}");
    }
    assert_eq!(assert_is_sample(std::slice::from_ref(&path), 200_000), 200_000);
    assert_eq!(assert_is_sample(std::slice::from_ref(&path), 900_000), 200_000);
    let sample = open(&[path]);
    let sample = sample.sampled(20_000);
    let firsts: Vec<_> = sample.blocks().iter().map(|(_, block)| block.first_point).collect();
    let gaps = firsts.windows(2).map(|pair| pair[1] - pair[0]);
    assert!(gaps.max() <= Some(704), "{firsts:?}");
}

#[test]
fn every_file_has_its_share() {
    let folder = tempfile::tempdir().expect("a folder");
    let paths: Vec<_> = (0..30).map(|i| folder.path().join(format!("{i}.las"))).collect();
    for (i, path) in (0..).zip(&paths) {
        field(path, if i == 3 { 0 } else { 1000 * (i + 1) }, 1000 * i);
    }
    let points = assert_is_sample(&paths, 46_000);
    assert!(points.abs_diff(46_000) < 30 * 256, "{points}");
}

#[test]
fn samples_of_real_scans_are_records_of_theirs() {
    for name in [
        "lone-star.laz",
        "indoor.laz",
        "ign-1km-pf6.laz",
        "lion_takanawa.copc.laz",
        "pf0-pointwise.laz",
        "fullwave-pf10.laz",
        "autzen_trim_7.las",
        "pump.xyz",
        "pump-tls.e57",
    ] {
        let Some(path) = shared_data::file(name) else { continue };
        let all = open(std::slice::from_ref(&path));
        let all: u64 = all.blocks().iter().map(|(_, block)| block.points).sum();
        let points = assert_is_sample(std::slice::from_ref(&path), all / 8);
        // Blocks of formats outside the LAS family are taken as they are.
        assert!(points >= all / 9 && (points <= all / 5 || all < 600_000), "{name}: {points}");
    }
}

#[test]
fn damage_ends_a_block_of_a_sample_and_a_conversion() {
    let Some(scan) = shared_data::file("ign-1km-pf6.laz") else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("damaged.laz");
    let mut bytes = fs::read(&scan).expect("reads");
    let sources = open(&[scan]);
    let (_, block) = sources.blocks()[1];
    // Its layers claim to be longer than the file.
    let layers =
        block.bytes.start as usize + usize::try_from(sources.schema().record_bytes).unwrap();
    bytes[layers + 4..layers + 8].fill(0xff);
    fs::write(&path, bytes).expect("writes");
    let output = folder.path().join("damaged.esker");
    let (options, cancelled) = (ConvertOptions::default(), AtomicBool::new(false));
    let whole = convert(std::slice::from_ref(&path), &output, &options, &Silent, &cancelled);
    assert!(matches!(whole, Err(BuildError::Input(_))), "{whole:?}");
    let sample = open(&[path]).sampled(10_000);
    let report = convert_sources(&sample, &output, &options, &Silent, &cancelled);
    let points = report.expect("the sample converts").points;
    assert!(points > 0 && points < sample.expected_points(), "{points}");
    assert_eq!(check(&output).expect("the store opens").findings, []);
}
