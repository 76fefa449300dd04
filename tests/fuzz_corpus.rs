//! What fuzzing starts from and what it found, on every build: each seed and each finding goes
//! through the function that the fuzz targets run (`fuzz/shared.rs`). A finding stays here with its
//! cause after it is mended.

#[path = "../fuzz/shared.rs"]
mod shared;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use shared::{Outcome, TARGETS};

/// Files under `fuzz/findings`, and why each of them once was more than an error.
const FINDINGS: &[(&str, &str)] = &[
    (
        "laz/gps-times-of-0xff",
        "0xff in a layer of GPS times made the decoder of laz call itself until the stack ended",
    ),
    (
        "pcd/double-under-odd-name",
        "an axis whose name is \"y\" but for odd letters was not seen to be of double precision: \
     coordinates were rounded to single precision, became infinite, and so did the lattice",
    ),
];

/// Seeds are for finding paths, not for holding data.
const MOST_SEED_BYTES: u64 = 300_000;

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz").join(name)
}

/// The files of a folder, if it is there.
fn files(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    let mut files: Vec<PathBuf> =
        entries.map(|entry| entry.expect("an entry reads").path()).collect();
    files.sort();
    files
}

fn run(target: &str, path: &Path) -> Outcome {
    let bytes = fs::read(path).expect("the file reads");
    // A panic names the file, because the test's name does not.
    eprintln!("{target}: {}", path.display());
    shared::run(target, &bytes)
}

#[test]
fn seeds_are_whole_files_of_their_format() {
    let mut total = 0;
    for target in TARGETS {
        let seeds = files(&folder("seeds").join(target));
        assert!(!seeds.is_empty(), "no seeds for {target}");
        for seed in seeds {
            total += fs::metadata(&seed).expect("the file is there").len();
            let outcome = run(target, &seed);
            assert!(
                matches!(outcome, Outcome::Read(points) if points > 0),
                "{}: {outcome:?}",
                seed.display()
            );
        }
    }
    assert!(total <= MOST_SEED_BYTES, "the seeds have {total} bytes");
}

#[test]
fn findings_are_values_now_and_their_causes_are_known() {
    let mut kept = BTreeSet::new();
    for target in TARGETS {
        for path in files(&folder("findings").join(target)) {
            let name = path.file_name().expect("it has a name").to_string_lossy();
            kept.insert(format!("{target}/{name}"));
            run(target, &path);
        }
    }
    let told: BTreeSet<String> = FINDINGS.iter().map(|(file, _)| file.to_string()).collect();
    assert_eq!(kept, told, "every finding has its cause in this file");
}

#[test]
fn damaged_seeds_are_values() {
    for target in TARGETS {
        for seed in files(&folder("seeds").join(target)) {
            let bytes = fs::read(&seed).expect("the file reads");
            for part in 0..8 {
                shared::run(target, &bytes[..bytes.len() * part / 8]);
            }
            for at in (0..bytes.len()).step_by((bytes.len() / 64).max(1)) {
                let mut changed = bytes.clone();
                changed[at] ^= 0x40;
                shared::run(target, &changed);
            }
        }
    }
}
