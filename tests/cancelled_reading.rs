//! Protects the end of long readings: whoever cancels while a file is being opened, which for texts
//! means reading all of it, waits no longer than for the next piece, and is told that and nothing
//! about the file. Damaged files that are taken as far as they go are no exception.

#[path = "support/las_file.rs"]
mod las_file;

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use esker::build::{BuildError, ConvertOptions, Silent, convert};
use esker::input::{Cancel, ReadOptions, Scan};
use las_file::{LasPoint, write_las};

const ROWS: usize = 5000;

/// One file per way of reading.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut rows = String::new();
    for i in 0..ROWS {
        writeln!(rows, "{}.5 {} {}.25", i % 71, i / 71, i % 7).expect("a string takes all text");
    }
    let pose = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";
    let four: String = rows.lines().map(|line| format!("{line} 0.5\n")).collect();
    let ply = "ply\nformat ascii 1.0\nelement vertex 5000\nproperty float x\nproperty float y\n\
               property float z\nend_header\n";
    let pcd = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 5000\n\
               HEIGHT 1\nPOINTS 5000\nDATA ascii\n";
    let texts = [
        ("rows.xyz", rows.clone()),
        ("rows.ptx", format!("{ROWS}\n1\n{pose}{four}")),
        ("rows.pts", format!("{ROWS}\n{four}")),
        ("rows.ply", format!("{ply}{rows}")),
        ("rows.pcd", format!("{pcd}{rows}")),
    ];
    let mut paths: Vec<PathBuf> = Vec::new();
    for (name, text) in texts {
        paths.push(folder.join(name));
        std::fs::write(folder.join(name), text).expect("the file is written");
    }
    let point = |i: i32| LasPoint { position: [i, i % 40, 3], color: [9, 9, 9], intensity: 1 };
    write_las(&folder.join("rows.las"), &(0..ROWS as i32).map(point).collect::<Vec<_>>());
    paths.push(folder.join("rows.las"));
    paths
}

#[test]
fn opening_ends_when_it_is_cancelled() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let cancelled = Arc::new(AtomicBool::new(false));
    for path in files(folder.path()) {
        cancelled.store(false, Ordering::Relaxed);
        let read = ReadOptions { cancel: Cancel::when(&cancelled), ..ReadOptions::default() };
        let scan = Scan::open(&path, &read);
        assert_eq!(scan.expect("nobody cancelled").points(), ROWS as u64, "{}", path.display());
        cancelled.store(true, Ordering::Relaxed);
        let error = Scan::open(&path, &read).expect_err("it is cancelled");
        assert!(error.to_string().contains("cancelled"), "{error}");
    }
}

#[test]
fn a_conversion_that_is_cancelled_while_it_opens_files_is_interrupted() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let inputs = files(folder.path());
    let output = folder.path().join("out.esker");
    let cancelled = Arc::new(AtomicBool::new(true));
    for salvage in [false, true] {
        for input in &inputs {
            let mut options = ConvertOptions::default();
            options.read.cancel = Cancel::when(&cancelled);
            options.read.salvage = salvage;
            let outcome =
                convert(std::slice::from_ref(input), &output, &options, &Silent, &cancelled);
            assert!(
                matches!(outcome, Err(BuildError::Interrupted)),
                "{}, salvage {salvage}: {outcome:?}",
                input.display()
            );
        }
    }
    let left = std::fs::read_dir(folder.path()).expect("it lists").count();
    assert_eq!(left, inputs.len(), "nothing but the inputs is left");
}
