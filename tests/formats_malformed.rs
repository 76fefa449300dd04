//! PLY, PCD and E57 files that are cut off, lie or were damaged: each is read or refused with a
//! line that names place and reason; none brings a panic or memory that a header merely claims.

#[path = "support/foreign_files.rs"]
mod foreign_files;
#[path = "support/watched_memory.rs"]
mod watched_memory;

use std::sync::atomic::Ordering;

use esker::sampling::Random;
use foreign_files::{
    E57, E57Scan, Pcd, Ply, e57, open, pcd, ply, read, samples, with_checksums, write,
};
use watched_memory::LARGEST;

/// More than any honest need of files below 1 MiB.
const MOST_MEMORY: usize = 16 << 20;

/// Opens and reads a file of those bytes: its number of points, or the message.
fn outcome(suffix: &str, bytes: &[u8]) -> Result<usize, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = write(folder.path(), &format!("file.{suffix}"), bytes);
    let points = open(&path).and_then(|scan| read(&scan));
    let outcome = points.map(|points| points.len()).map_err(|error| error.to_string());
    if let Err(message) = &outcome {
        assert!(message.contains(&format!("file.{suffix}")), "no file: {message}");
        assert!(!message.contains('\n'), "more than a line: {message}");
    }
    let largest = LARGEST.load(Ordering::Relaxed);
    assert!(largest < MOST_MEMORY, "{largest} bytes at once: {outcome:?}");
    outcome
}

/// Says that a file is refused with these words.
fn refuses(suffix: &str, bytes: &[u8], words: &[&str]) {
    let message = outcome(suffix, bytes).expect_err("the file is bad");
    for word in words {
        assert!(message.contains(word), "\"{message}\" lacks \"{word}\"");
    }
}

fn replaced(file: &[u8], from: &str, to: &str) -> Vec<u8> {
    let at = file.windows(from.len()).position(|part| part == from.as_bytes());
    let at = at.unwrap_or_else(|| panic!("no {from}"));
    [&file[..at], to.as_bytes(), &file[at + from.len()..]].concat()
}

fn small_e57() -> Vec<u8> {
    let points: Vec<[f64; 3]> = (0..100).map(|i| [f64::from(i), 1.0, 2.0]).collect();
    e57(&[E57Scan { points: &points, coding: E57::Single, pose: None }])
}

/// One file of each kind.
fn specimens() -> Vec<(&'static str, Vec<u8>)> {
    let samples = samples(40);
    let mut files = vec![("e57", small_e57())];
    for kind in [Ply::Ascii, Ply::Little, Ply::Big, Ply::Listed] {
        files.push(("ply", ply(&samples, kind)));
    }
    for kind in [Pcd::Ascii, Pcd::Binary, Pcd::Compressed] {
        files.push(("pcd", pcd(&samples, kind)));
    }
    files
}

#[test]
fn faults_of_ply_files_are_told() {
    let good = ply(&samples(40), Ply::Little);
    let with = |from: &str, to: &str| replaced(&good, from, to);
    refuses("ply", b"ply\n", &["line 2", "end_header"]);
    refuses("ply", b"ply\nend_header\n", &["line 2", "no format"]);
    refuses(
        "ply",
        &with("binary_little_endian", "binary"),
        &["line 2", "unknown format \"binary\""],
    );
    refuses("ply", &with("element vertex 40", "element vertex many"), &["line 7", "odd count"]);
    refuses("ply", &with("property float x", "property float w"), &["no element", "x, y and z"]);
    refuses("ply", &with("property float x", "property word x"), &["line 8", "unknown type"]);
    refuses("ply", &with("property list uint double", "property list float double"), &["line 5"]);
    refuses("ply", &with("element camera 1", "ellement camera 1"), &["line 4", "unknown line"]);
    refuses("ply", &with("vertex 40", "vertex 41"), &["truncated in row 41 of 41"]);
    let most = with("vertex 40", "vertex 18446744073709551615");
    refuses("ply", &most, &["truncated in row 41 of 18446744073709551615"]);
    refuses("ply", &with("camera 1", "camera 999999999"), &["camera", "of 999999999"]);
    let ascii = ply(&samples(40), Ply::Ascii);
    let with = |from: &str, to: &str| replaced(&ascii, from, to);
    refuses("ply", &with("vertex 40", "vertex 42"), &["the file ends after row 41 of 42"]);
    refuses("ply", &with("vertex 40", "vertex 41"), &["line", "numbers"]);
    refuses("ply", &with("0.1 -0 0 0 0", "0.1 -0 0 0 256"), &["line 19", "256 is not in 0..=255"]);
    refuses("ply", &with("0.1 -0 0 0 0", "zero -0 0 0 0"), &["line 19", "\"zero\" is no number"]);
    let listed = ply(&samples(40), Ply::Listed);
    refuses("ply", &listed[..listed.len() - 60], &["row", "of 40 of \"vertex\""]);
    assert_eq!(outcome("ply", &replaced(&ascii, "vertex 40", "vertex 0")), Ok(0));
}

#[test]
fn faults_of_pcd_files_are_told() {
    let good = pcd(&samples(40), Pcd::Binary);
    let with = |from: &str, to: &str| replaced(&good, from, to);
    refuses("pcd", b"VERSION 0.7\n", &["line 2", "DATA"]);
    refuses("pcd", &with("DATA binary", "DATA bin"), &["line 11", "unknown encoding"]);
    refuses("pcd", &with("TYPE F F", "TYPE F"), &["6 fields", "5 types"]);
    refuses("pcd", &with("TYPE F F F", "TYPE F F Q"), &["\"z\" has type Q4"]);
    refuses("pcd", &with("POINTS 80", "POINTS 81"), &["truncated in row 81 of 81"]);
    refuses("pcd", &with("POINTS 80", "POINTS -1"), &["odd line \"POINTS -1\""]);
    refuses("pcd", &with("COUNT 1", "COUNT 0"), &["\"x\" has no components"]);
    refuses("pcd", &with("FIELDS x y z", "FIELDS x y h"), &["no field \"z\""]);
    let most = with("POINTS 80", "POINTS 18446744073709551615");
    refuses("pcd", &most, &["truncated in row 81"]);
    let packed = pcd(&samples(40), Pcd::Compressed);
    let wide = replaced(&packed, "POINTS 80", "POINTS 90");
    refuses("pcd", &wide, &["1440 bytes of points, 90 points have 1620"]);
    let at = packed.windows(11).position(|part| part == b"compressed\n").unwrap() + 11;
    let with_word = |place: usize, word: u32| {
        let mut file = packed.clone();
        file[at + place..at + place + 4].copy_from_slice(&word.to_le_bytes());
        file
    };
    refuses("pcd", &with_word(0, u32::MAX), &["4294967295 bytes of compressed points"]);
    refuses("pcd", &with_word(0, 10), &["10 bytes cannot hold 1440"]);
    refuses("pcd", &with_word(0, 100), &["end too early"]);
    let huge = replaced(&with_word(4, 0xffff_fff0), "POINTS 80", "POINTS 238609294");
    refuses("pcd", &huge, &["bytes of points"]);
    let mut backwards = packed.clone();
    backwards[at + 8] = 0xff;
    refuses("pcd", &backwards, &["before the first"]);
}

#[test]
fn faults_of_e57_files_are_told() {
    let good = small_e57();
    let put = |at: usize, bytes: &[u8]| {
        let mut file = good.clone();
        file[at..at + bytes.len()].copy_from_slice(bytes);
        with_checksums(file)
    };
    refuses("e57", &good[..40], &["byte 40"]);
    refuses("e57", &put(8, &[7]), &["version"]);
    refuses("e57", &put(32, &u64::MAX.to_le_bytes()), &["18446744073709551615 bytes of XML"]);
    refuses("e57", &put(24, &u64::MAX.to_le_bytes()), &["XML"]);
    refuses("e57", &put(40, &4096u64.to_le_bytes()), &["pages of 4096 bytes"]);
    refuses("e57", &good[..good.len() - 1024], &["XML"]);
    let mut flipped = good.clone();
    flipped[100] ^= 1;
    refuses("e57", &flipped, &["checksum"]);
    let records = |count: &str| {
        with_checksums(replaced(&good, "recordCount=\"100\"", &format!("recordCount=\"{count}\"")))
    };
    // The same number of digits keeps everything else in place.
    refuses("e57", &records("999"), &["scan 0", "after record 100 of 999"]);
    // The section of the points stands behind the header.
    refuses("e57", &put(48, &[3]), &["scan 0", "section of kind 3"]);
    refuses("e57", &put(64, &u64::MAX.to_le_bytes()), &["scan 0", "outside the pages"]);
    refuses("e57", &put(80, &[9]), &["scan 0", "unknown kind 9"]);
    refuses("e57", &put(82, &[0, 1]), &["streams"]);
    refuses("e57", &put(84, &[5, 0]), &["a packet of 5 streams"]);
    refuses("e57", &put(86, &[0xff, 0xff]), &["scan 0", "streams of"]);
}

#[test]
fn every_truncation_gives_a_value() {
    for (suffix, file) in specimens() {
        let step = (file.len() / 300).max(1);
        for end in (1..file.len()).step_by(step) {
            let _ = outcome(suffix, &file[..end]);
        }
    }
}

#[test]
fn every_damage_gives_a_value() {
    let mut random = Random::new(3, 0);
    for (suffix, file) in specimens() {
        for _ in 0..400 {
            let mut damaged = file.clone();
            for _ in 0..=random.below(4) {
                let at = random.below(file.len() as u64) as usize;
                damaged[at] = random.bits() as u8;
            }
            if suffix == "e57" {
                damaged = with_checksums(damaged);
            }
            let _ = outcome(suffix, &damaged);
        }
    }
}

#[test]
fn coordinates_that_are_no_numbers_are_dropped_not_placed() {
    let mut some = samples(10);
    some[3].position[1] = f32::NAN;
    some[7].position[2] = f32::INFINITY;
    for kind in [Ply::Ascii, Ply::Little] {
        let folder = tempfile::tempdir().unwrap();
        let scan = open(&write(folder.path(), "a.ply", &ply(&some, kind))).unwrap();
        assert_eq!((scan.points(), scan.dropped_points()), (8, 2), "{kind:?}");
        assert_eq!(read(&scan).unwrap().len(), 8);
    }
}
