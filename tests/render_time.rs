//! Protects `esker render --time-ms`: odd times are wrong usage or draw the least, the statistics
//! tell what was planned and what it took, and a path of cameras learns as it goes.

#[path = "support/las_file.rs"]
mod las_file;

use std::path::Path;

use assert_cmd::Command;
use las_file::{LasPoint, write_las};
use serde_json::{Value, json};

fn write_scan(path: &Path) {
    let point = |i: i32| LasPoint {
        position: [i % 200 * 20, i / 200 * 20, (i * 7919) % 300],
        color: [(i % 256) as u16, 90, 40],
        intensity: 0,
    };
    write_las(path, &(0..40_000).map(point).collect::<Vec<_>>());
}

fn render(folder: &Path, arguments: &[&str]) -> assert_cmd::assert::Assert {
    Command::new(env!("CARGO_BIN_EXE_esker"))
        .current_dir(folder)
        .args(["render", "scan.las", "--renderer", "cpu", "--size", "96x64", "-o", "out.png"])
        .args(arguments)
        .assert()
}

#[test]
fn times_that_are_none_are_wrong_usage() {
    let folder = tempfile::tempdir().expect("a folder");
    write_scan(&folder.path().join("scan.las"));
    for time in ["NaN", "-1", "inf", "soon", ""] {
        render(folder.path(), &[&format!("--time-ms={time}")]).code(2);
    }
    assert!(!folder.path().join("out.png").exists());
}

#[test]
fn no_time_draws_the_least_and_much_time_draws_all() {
    let folder = tempfile::tempdir().expect("a folder");
    write_scan(&folder.path().join("scan.las"));
    let drawn = |time: &str| -> (u64, Value) {
        render(folder.path(), &["--error-px", "0.01", "--time-ms", time, "--stats", "stats.json"])
            .success();
        let text = std::fs::read_to_string(folder.path().join("stats.json")).expect("statistics");
        let stats: Value = serde_json::from_str(&text).expect("JSON");
        (stats["points_drawn"].as_u64().expect("a count"), stats)
    };
    let (least, stats) = drawn("0");
    assert_eq!((least, &stats["target_ms"]), (1, &json!(0.0)));
    assert_eq!(stats["pacing"]["free_ms"], json!(0.0));
    let (all, stats) = drawn("100000");
    assert_eq!(all, 40_000);
    assert!(stats["pacing"]["predicted_ms"].as_f64().is_some_and(|ms| ms > 0.0), "{stats}");
}

#[test]
fn a_path_of_cameras_is_measured_once_and_learned_from() {
    let folder = tempfile::tempdir().expect("a folder");
    write_scan(&folder.path().join("scan.las"));
    // A square of four metres at coordinates as in UTM.
    let place = |x: f64, y: f64, z: f64| json!([500_000.0 + x, 5_000_000.0 + y, 500.0 + z]);
    let camera = |i: u32| json!({"eye": place(2.0 + 0.1 * f64::from(i), -2.0, 3.0), "target": place(2.0, 2.0, 0.0)});
    let path: Vec<Value> = (0..8).map(camera).collect();
    let text = serde_json::to_string(&path).expect("JSON");
    std::fs::write(folder.path().join("path.json"), text).expect("it is written");
    let arguments = ["--view", "path.json", "--time-ms", "1", "--stats", "stats.json"];
    render(folder.path(), &arguments).success();
    let text = std::fs::read_to_string(folder.path().join("stats.json")).expect("statistics");
    let stats: Value = serde_json::from_str(&text).expect("JSON");
    let frames = stats["frames"].as_array().expect("one each");
    assert_eq!(frames.len(), 8);
    let last = &frames[7]["pacing"];
    let count = |name: &str| last[name].as_u64().expect("a count");
    // The first two frames of a renderer are not learned from.
    assert_eq!(count("frames_learned") + count("frames_together"), 6, "{last}");
}
