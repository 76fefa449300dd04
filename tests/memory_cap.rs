//! Protects the promise of `--memory`: the program's peak resident memory stays under the cap, and
//! temporary files are written at most once, for a scan several times the cap.

#[path = "support/las_file.rs"]
mod las_file;

use std::path::Path;
use std::process::Command;

use las_file::{LasPoint, write_las};

#[test]
fn a_scan_of_several_times_the_cap_converts_within_it() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (scan, store) = (folder.path().join("scan.las"), folder.path().join("scan.esker"));
    let points = 12_000_000u64;
    let generate = Command::new(env!("CARGO_BIN_EXE_esker"))
        .args(["generate", "--points", &points.to_string(), "--seed", "3", "-o"])
        .arg(&scan)
        .status()
        .expect("the program starts");
    assert!(generate.success());
    let scan_bytes = scan.metadata().expect("the scan is there").len();

    let cap = 100_000_000u64;
    assert!(scan_bytes > 4 * cap);
    let output = Command::new(env!("CARGO_BIN_EXE_esker"))
        .args(["convert", "--json", "--memory", &cap.to_string(), "-o"])
        .args([&store, &scan])
        .output()
        .expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one object");
    assert_eq!(json["points"], points);
    assert_eq!(json["in_memory"], false);
    // Each point with its index at most once, packed to about half; nodes go to their place at once.
    let once = points * (34 + 8);
    let temporary = json["temporary_bytes"].as_u64().expect("a number");
    assert!((once / 4..=once * 3 / 5).contains(&temporary), "{temporary} bytes, {once} are once");
    // Resident memory is known under Linux.
    if let Some(peak) = json["peak_rss_bytes"].as_u64() {
        assert!(peak <= cap + cap / 10, "{peak} bytes resident under a cap of {cap}");
    }
    let info = Command::new(env!("CARGO_BIN_EXE_esker")).arg("check").arg(&store).status();
    assert!(info.expect("the program starts").success(), "the store checks");
}

/// Converts under a cap and without one; the peak of the first must stay under the cap, and the
/// bytes be the same.
fn holds(scan: &Path, cap: u64) {
    let convert = |name: &str, memory: u64| {
        let store = scan.with_file_name(name);
        let output = Command::new(env!("CARGO_BIN_EXE_esker"))
            .args(["convert", "--json", "--memory", &memory.to_string(), "-o"])
            .arg(&store)
            .arg(scan)
            .output()
            .expect("the program starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one object");
        (std::fs::read(store).expect("the store reads"), json["peak_rss_bytes"].as_u64())
    };
    let (capped, peak) = convert("capped.esker", cap);
    if let Some(peak) = peak {
        assert!(peak <= cap + cap / 10, "{peak} bytes resident under a cap of {cap}");
    }
    assert!(capped == convert("free.esker", 8 << 30).0, "the cap changes the store");
}

#[test]
fn millions_of_coincident_points_convert_within_a_cap() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scan = folder.path().join("coincident.las");
    let point = |i: usize| LasPoint {
        position: [7, 8, i32::from(i.is_multiple_of(50_000))],
        color: [i as u16, 3, 9],
        intensity: i as u16,
    };
    write_las(&scan, &(0..3_000_000).map(point).collect::<Vec<_>>());
    holds(&scan, 90_000_000);
}

#[test]
fn a_filled_volume_converts_within_a_cap() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scan = folder.path().join("cube.las");
    let generate = Command::new(env!("CARGO_BIN_EXE_esker"))
        .args(["generate", "--points", "4M", "--subject", "cube", "-o"])
        .arg(&scan)
        .status();
    assert!(generate.expect("the program starts").success());
    holds(&scan, 90_000_000);
}
