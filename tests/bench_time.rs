//! Protects `esker bench time`: from a scan to tables, CSV files with every row, and plots; and what
//! of it repeats on any machine.

use std::collections::BTreeMap;

use assert_cmd::Command;

/// Relative RMS error and share of under-estimates by study, scene and estimator.
fn scores(csv: &str) -> BTreeMap<(String, String, String), (f64, f64)> {
    let mut rows = csv.lines();
    let header: Vec<&str> = rows.next().expect("a header").split(',').collect();
    let column = |name: &str| header.iter().position(|h| *h == name).expect("a column");
    let (rms, under) = (column("relative_rms"), column("under"));
    // Names of scenes hold commas: columns are counted from the end.
    let from_end = |row: &[&str], at: usize| -> f64 {
        row[row.len() - (header.len() - at)].parse().expect("a number")
    };
    rows.map(|row| {
        let cells: Vec<&str> = row.split(',').collect();
        let scene = cells[1..cells.len() - (header.len() - 2)].join(",");
        let estimator = cells[cells.len() - (header.len() - 2)].to_owned();
        let key = (cells[0].to_owned(), scene, estimator);
        (key, (from_end(&cells, rms), from_end(&cells, under)))
    })
    .collect()
}

#[test]
fn a_quick_run_judges_every_estimator() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = folder.path().join("out/bench");
    let run = Command::new(env!("CARGO_BIN_EXE_esker"))
        .args(["bench", "time", "--quick", "--size", "160x96", "-o"])
        .arg(&output)
        .assert()
        .success();
    let table = String::from_utf8(run.get_output().stdout.clone()).expect("text");
    for words in ["pos conservative", "cell bound", "H5 on-line", "flight of", "shortest"] {
        assert!(table.contains(words), "{words} is missing in:\n{table}");
    }
    let csv = std::fs::read_to_string(output.join("time.csv")).expect("the rows");
    let scores = scores(&csv);
    let of = |study: &str, scene: &str, estimator: &str| -> (f64, f64) {
        let found = scores
            .iter()
            .find(|((a, b, c), _)| a == study && b.starts_with(scene) && c == estimator);
        *found.unwrap_or_else(|| panic!("no row {study} {scene} {estimator} in:\n{csv}")).1
    };
    // Simulated: sums beat counting, tables never predict too little.
    for scene in ["city, queue 4", "forest", "terrain"] {
        assert!(of("objects", scene, "pos").0 < of("objects", scene, "H1").0, "{scene}");
        assert_eq!(of("objects", scene, "pos conservative").1, 0.0, "{scene}");
    }
    assert!(of("objects", "city, queue 4", "H4").0 < of("objects", "city, queue 4", "H3").0);
    assert_eq!(of("objects", "city, queue 4, cells", "cell bound").1, 0.0);
    // Counted: pixels matter where splat sizes vary.
    for estimator in ["H4", "H5"] {
        let (with_pixels, _) = of("counted", "generated", estimator);
        assert!(with_pixels < of("counted", "generated", "c x points").0, "{estimator}");
    }
    assert!(scores.keys().any(|key| key.0 == "timed") && scores.keys().any(|key| key.0 == "kept"));
    let plot = std::fs::read_to_string(output.join("time.svg")).expect("the plot");
    assert!(plot.starts_with("<svg") && plot.contains("<polyline") && !plot.contains("NaN"));
    let frames = std::fs::read_to_string(output.join("time-frames.csv")).expect("the frames");
    assert_eq!(frames.lines().filter(|line| line.contains(",counted,")).count(), 2 * 40);
}
