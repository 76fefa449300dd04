//! Protects `esker bench convert`: the steps and stages are measured, add up and are written down.

use std::process::Command;

fn esker() -> Command {
    Command::new(env!("CARGO_BIN_EXE_esker"))
}

#[test]
fn a_quick_run_tells_steps_stages_and_the_distance_to_the_limit() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = folder.path().join("bench");
    let run = esker()
        .args(["bench", "convert", "--quick", "-o"])
        .arg(&output)
        .output()
        .expect("the program starts");
    let message = String::from_utf8_lossy(&run.stderr).into_owned();
    assert_eq!(run.status.code(), Some(0), "{message}");
    let table = String::from_utf8(run.stdout).expect("text");
    for words in
        ["generated.laz: 300000 points", "x the limit", "bytes a point", "decode", "reading: "]
    {
        assert!(table.contains(words), "{words} is missing in:\n{table}");
    }
    let csv = std::fs::read_to_string(output.join("convert.csv")).expect("the rows");
    let mut lines = csv.lines();
    let header = lines.next().expect("a header");
    assert_eq!(header, "scan,points,kind,step,ns_per_point,points_per_second");
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    let value = |kind: &str, step: &str| -> f64 {
        let row = rows.iter().find(|row| row[2] == kind && row[3] == step);
        let row = row.unwrap_or_else(|| panic!("no {kind} {step} in\n{csv}"));
        assert_eq!((row[0], row[1]), ("generated.laz", "300000"));
        row[4].parse().expect("a number")
    };
    for step in ["read", "decode", "keys", "sort", "gather", "compress", "write"] {
        assert!(value("bound", step) > 0.0, "{step}");
    }
    let sum = |kind: &str| -> f64 {
        let rows = rows.iter().filter(|row| row[2] == kind);
        rows.map(|row| row[4].parse::<f64>().expect("a number")).sum()
    };
    let near = |a: f64, b: f64| (a - b).abs() <= 0.01 * a.abs().max(1.0);
    assert!(near(sum("bound"), value("limit", "processor")), "steps add up:\n{csv}");
    assert!(near(sum("stage"), value("conversion", "whole")), "stages add up:\n{csv}");
    assert!(value("reading", "all of the store") > 0.0);
    assert!(value("reading", "positions and colours") > 0.0);
    let larger = value("limit", "processor").max(value("limit", "disk"));
    assert!(near(larger, value("limit", "limit")));
    let plot = std::fs::read_to_string(output.join("convert-generated.svg")).expect("the plot");
    assert!(plot.starts_with("<svg") && plot.contains("steps alone") && !plot.contains("NaN"));
    let left: Vec<_> = std::fs::read_dir(&output).expect("it lists").collect();
    assert_eq!(left.len(), 2, "temporary files are gone: {left:?}");
}

#[test]
fn a_named_scan_is_measured_and_a_missing_one_is_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let scan = folder.path().join("few.las");
    let made = esker()
        .args(["generate", "--points", "20k", "-o"])
        .arg(&scan)
        .status()
        .expect("the program starts");
    assert!(made.success());
    let output = folder.path().join("bench");
    let run = |path: &std::path::Path| {
        let mut command = esker();
        command.args(["bench", "convert", "--quick", "-o"]).arg(&output).arg(path);
        command.output().expect("the program starts")
    };
    let done = run(&scan);
    assert_eq!(done.status.code(), Some(0), "{done:?}");
    let table = String::from_utf8(done.stdout).expect("text");
    assert!(table.contains("few.las: 20000 points of 34 bytes"), "{table}");
    assert!(!table.contains("decode"), "uncompressed records are only read:\n{table}");
    let missing = run(&folder.path().join("nowhere.las"));
    assert_eq!(missing.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&missing.stderr).contains("nowhere.las"));
}
