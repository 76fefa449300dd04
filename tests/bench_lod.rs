//! Protects `esker bench lod`: from a scan to a table, a CSV file with every row and a plot.

#[path = "support/las_file.rs"]
mod las_file;

use std::path::Path;

use assert_cmd::Command;
use las_file::{LasPoint, write_las};

/// A bumpy square of 40 m in centimetres.
fn write_scan(path: &Path) {
    let point = |i: i32| {
        let (x, y) = (i % 200 * 20, i / 200 * 20);
        let z = ((f64::from(x) * 0.01).sin() * (f64::from(y) * 0.013).cos() * 150.0) as i32;
        let color = [(x / 16) as u16, (y / 16) as u16, ((x / 100 + y / 100) % 2 * 120) as u16];
        LasPoint { position: [x, y, z], color, intensity: 0 }
    };
    write_las(path, &(0..40_000).map(point).collect::<Vec<_>>());
}

#[test]
fn a_quick_run_writes_all_rows_and_a_plot() {
    let folder = tempfile::tempdir().expect("a folder");
    let scan = folder.path().join("square.las");
    write_scan(&scan);
    let output = folder.path().join("out/bench");
    let run = Command::new(env!("CARGO_BIN_EXE_esker"))
        .args(["bench", "lod", "--quick", "--size", "96x64", "-o"])
        .arg(&output)
        .arg(&scan)
        .assert()
        .success();
    let table = String::from_utf8(run.get_output().stdout.clone()).expect("text");
    for words in ["square: 40000 points", "parent cell, diagonal", "per-point", "Approach at 1 px"]
    {
        assert!(table.contains(words), "{words} is missing in:\n{table}");
    }
    for words in ["Options at 1 px", "eye-dome", "continuous", "Steps: the camera goes"] {
        assert!(table.contains(words), "{words} is missing in:\n{table}");
    }
    let options = std::fs::read_to_string(output.join("lod-options-square.csv")).expect("rows");
    assert_eq!(options.lines().count(), 1 + 3 * 16, "three views, sixteen options: {options}");
    // Without an adapter the suite says that it measures no paths.
    if !table.contains("not measured") {
        assert!(table.contains("bare loop") && table.contains("compute32"), "{table}");
        let paths = std::fs::read_to_string(output.join("lod-paths-square.csv")).expect("rows");
        assert!(paths.contains("point list") && paths.contains("grown"), "{paths}");
    }
    let csv = std::fs::read_to_string(output.join("lod.csv")).expect("the rows");
    let rows: Vec<&str> = csv.lines().skip(1).collect();
    let of_study = |study: &str| rows.iter().filter(|row| row.contains(study)).count();
    // Four views: four rules at two errors; four policies without a budget (all larger ones bind
    // nothing). Eight distances: four rules.
    assert_eq!(of_study(",rules,"), 4 * 4 * 2, "{csv}");
    assert_eq!(of_study(",sizes,"), 4 * 4, "{csv}");
    assert_eq!(of_study(",approach,"), 8 * 4, "{csv}");
    for row in rows {
        let numbers = row.rsplit(',').take(4);
        assert!(numbers.clone().all(|n| n.parse::<f64>().is_ok_and(f64::is_finite)), "{row}");
    }
    let plot = std::fs::read_to_string(output.join("lod-square.svg")).expect("the plot");
    assert!(plot.starts_with("<svg") && plot.contains("<polyline") && !plot.contains("NaN"));
}

#[test]
fn wrong_usage_and_missing_files_are_told_apart() {
    let esker = || Command::new(env!("CARGO_BIN_EXE_esker"));
    let folder = tempfile::tempdir().expect("a folder");
    esker().args(["bench", "lod"]).assert().code(2);
    let output = folder.path().join("out");
    let run = esker().args(["bench", "lod", "nowhere.las", "-o"]).arg(output).assert().code(1);
    let message = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
    assert!(message.contains("nowhere.las") && message.lines().count() == 1, "{message}");
}
