//! Protects `esker bench stream`: from a scan to tables, rows of every frame, plots and pictures.

#[path = "support/las_file.rs"]
mod las_file;

use std::path::Path;

use assert_cmd::Command;
use las_file::{LasPoint, write_las};

/// A bumpy strip of 400 m by 50 m in millimetres.
fn write_scan(path: &Path) {
    let point = |i: i32| {
        let (x, y) = (i % 800 * 500, i / 800 * 333);
        let z = ((f64::from(x) * 1e-4).sin() * (f64::from(y) * 1e-4).cos() * 1_500.0) as i32;
        LasPoint { position: [x, y, z], color: [(x / 8) as u16, y as u16, 9], intensity: 0 }
    };
    write_las(path, &(0..120_000).map(point).collect::<Vec<_>>());
}

#[test]
fn a_quick_run_writes_all_rows_plots_and_pictures() {
    let folder = tempfile::tempdir().expect("a folder");
    let scan = folder.path().join("strip.las");
    write_scan(&scan);
    let output = folder.path().join("out");
    let run = Command::new(env!("CARGO_BIN_EXE_esker"))
        .args(["bench", "stream", "--quick", "--size", "96x64", "-o"])
        .arg(&output)
        .arg(&scan)
        .assert()
        .success();
    let table = String::from_utf8(run.get_output().stdout.clone()).expect("text");
    for words in ["strip: 120000 points", "loader, 1 at a time", "Flight: 45 frames", "little kept"]
    {
        assert!(table.contains(words), "{words} is missing in:\n{table}");
    }
    let rows = |name: &str| -> Vec<Vec<String>> {
        let csv = std::fs::read_to_string(output.join(name)).expect("the rows");
        let split = |line: &str| -> Vec<String> {
            // Names in quotes hold commas.
            let mut quoted = false;
            let is_end = move |c: char| {
                quoted ^= c == '"';
                c == ',' && !quoted
            };
            line.split(is_end).map(str::to_owned).collect()
        };
        csv.lines().map(split).collect()
    };
    let starts = rows("stream-start.csv");
    // Two disks, three ways of reading; the quota is the usual one.
    assert_eq!(starts.len(), 1 + 2 * 3);
    let flight = rows("stream-flight.csv");
    assert_eq!(flight.len(), 1 + 3 * 45);
    let column = |name: &str| flight[0].iter().position(|cell| cell == name).expect("a column");
    let number = |row: &[String], name: &str| row[column(name)].parse::<u64>().expect("a count");
    for row in &flight[1..] {
        assert_eq!(row.len(), flight[0].len());
        assert!(number(row, "ram_peak_bytes") <= number(row, "ram_limit_bytes"), "{row:?}");
        assert_eq!(number(row, "nodes_waited_for"), 0, "{row:?}");
    }
    assert!(flight[1..].iter().any(|row| number(row, "points_drawn") > 0));
    let plot = std::fs::read_to_string(output.join("stream-strip.svg")).expect("the plot");
    assert!(plot.starts_with("<svg") && plot.contains("<polyline") && !plot.contains("NaN"));
    let files = std::fs::read_dir(&output).expect("it lists").flatten();
    let pictures = files.filter(|file| file.path().extension().is_some_and(|e| e == "png"));
    assert_eq!(pictures.count(), 2);
}
