//! Protects `esker bench stability`: every sweep is there, places are exact to a twentieth of a
//! pixel, and no way of drawing loses a picture or makes up numbers.

use assert_cmd::Command;

#[test]
fn a_quick_run_finds_places_exact_and_pictures_whole() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = Command::new(env!("CARGO_BIN_EXE_esker"))
        .args(["bench", "stability", "--quick", "-o"])
        .arg(folder.path())
        .assert()
        .success();
    let table = String::from_utf8(run.get_output().stdout.clone()).expect("text");
    let csv = std::fs::read_to_string(folder.path().join("stability.csv")).expect("the rows");
    let mut lines = csv.lines();
    let header: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let column = |name: &str| header.iter().position(|column| *column == name).expect("a column");
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    for sweep in ["offset", "extent", "near plane", "field of view", "set", "view"] {
        assert!(rows.iter().any(|row| row[0] == sweep), "{sweep} is missing in:\n{table}");
    }
    for (case, path) in [("1e8 m", "cpu"), ("coincident", "cpu"), ("16384x4 pixels", "cpu")] {
        let found = rows.iter().any(|row| row[1].contains(case) && row[3] == path);
        assert!(found, "{case} by {path} is missing in:\n{table}");
    }
    for row in &rows {
        let number = |name: &str| row[column(name)].parse::<f64>().expect("a number");
        assert!(number("displacement_max_px") <= 0.05, "{row:?}");
        assert_eq!((number("empty_pictures"), number("not_a_number")), (0.0, 0.0), "{row:?}");
        // Far away all points are at one distance and pixel; of equal distances the rasterizer
        // keeps another point.
        let is_tied = row[1].contains("1e9 m") || row[1].contains("16384");
        assert!(number("wrong_fraction") <= 0.005 || is_tied, "{row:?}");
    }
    let plot = std::fs::read_to_string(folder.path().join("stability.svg")).expect("the plot");
    assert!(plot.starts_with("<svg") && !plot.contains("NaN"));
}
