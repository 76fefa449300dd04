//! Protects the estimate of temporary files that is made before work starts: it comes near what is
//! written in the end, because a disk is refused by it.

use std::path::Path;
use std::process::Command;

/// Converts a generated scan under a cap: bytes of temporary files, expected and written.
fn temporary_bytes(name: &str, cap: &str) -> (f64, f64) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (scan, store) = (folder.path().join(name), folder.path().join("scan.esker"));
    let esker = |arguments: &[&str], path: &Path| {
        let run = Command::new(env!("CARGO_BIN_EXE_esker")).args(arguments).arg(path).output();
        let run = run.expect("the program starts");
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        run.stdout
    };
    esker(&["generate", "--points", "2M", "--seed", "5", "-o"], &scan);
    let output = store.to_str().expect("a plain path");
    let told = esker(&["convert", "--json", "--memory", cap, "-o", output], &scan);
    let told: serde_json::Value = serde_json::from_slice(&told).expect("one object");
    let bytes = |name: &str| told[name].as_u64().expect("a number") as f64;
    (bytes("expected_temporary_bytes"), bytes("temporary_bytes"))
}

#[test]
fn temporary_files_are_foreseen() {
    let cases = [("scan.las", "64MB"), ("scan.las", "80MB"), ("scan.laz", "64MB")];
    for (name, cap) in cases {
        let (expected, written) = temporary_bytes(name, cap);
        assert!(written > 20e6, "{name}, {cap}: only {written} bytes were written");
        let share = expected / written;
        assert!((0.75..1.33).contains(&share), "{name}, {cap}: {expected} bytes of {written}");
    }
}

#[test]
fn what_fits_memory_needs_none() {
    assert_eq!(temporary_bytes("scan.las", "4GiB"), (0.0, 0.0));
}
