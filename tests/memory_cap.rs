//! Protects the promise of `--memory`: the program's peak resident memory stays under the cap, and
//! temporary files are written at most once, for a scan several times the cap.

use std::process::Command;

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
    // Each point with its index at most once; nodes go to their place at once.
    let once = points * (34 + 8);
    let temporary = json["temporary_bytes"].as_u64().expect("a number");
    assert!((once / 2..=once).contains(&temporary), "{temporary} bytes, {once} are once");
    // Resident memory is known under Linux.
    if let Some(peak) = json["peak_rss_bytes"].as_u64() {
        assert!(peak <= cap + cap / 10, "{peak} bytes resident under a cap of {cap}");
    }
    let info = Command::new(env!("CARGO_BIN_EXE_esker")).arg("check").arg(&store).status();
    assert!(info.expect("the program starts").success(), "the store checks");
}
