//! `esker generate`: the same seed gives the same file whatever the threads, and what is in the way
//! or asked wrongly is told.

#[path = "support/las_files.rs"]
mod las_files;

use std::path::Path;

use assert_cmd::Command;
use esker::input::LasScan;
use esker::points::names;
use esker::sampling::scene::Scene;
use las_files::read_all;

fn generate(output: &Path, threads: &str, more: &[&str]) -> assert_cmd::assert::Assert {
    let mut command = Command::cargo_bin("esker").unwrap();
    command.env("RAYON_NUM_THREADS", threads);
    command.args(["generate", "--points", "70k", "-o"]).arg(output).args(more).assert()
}

#[test]
fn a_seed_gives_one_cloud() {
    let folder = tempfile::tempdir().unwrap();
    let [one, two, laz, other] =
        ["one.las", "two.las", "three.laz", "other.las"].map(|name| folder.path().join(name));
    generate(&one, "1", &["--seed", "5"]).success();
    generate(&two, "2", &["--seed", "5"]).success();
    generate(&laz, "2", &["--seed", "5"]).success();
    generate(&other, "2", &["--seed", "6"]).success();
    let bytes = std::fs::read(&one).unwrap();
    assert!(bytes == std::fs::read(&two).unwrap());
    let [one, laz, other] = [one, laz, other].map(|path| LasScan::open(&path).unwrap());
    let records = read_all(&one).unwrap();
    assert_eq!(records.len(), 70_000 * 34);
    assert!(records == read_all(&laz).unwrap());
    assert!(records != read_all(&other).unwrap());

    // Each point's time is its number.
    let (_, time) = one.schema().find(names::GPS_TIME).unwrap();
    for (number, record) in (0..).zip(records.chunks_exact(34)) {
        let time = time.scalar.read(&record[time.record_offset as usize..]);
        assert_eq!(Scene::point_of_gps_time(time), number);
    }
}

#[test]
fn coordinates_are_where_they_are_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("moved.las");
    generate(&path, "2", &["--origin", "-500,2000000,10", "--subject", "cube", "--step", "0.01"])
        .success();
    let scan = LasScan::open(&path).unwrap();
    let bounds = scan.header().bounds;
    assert!((-501.0..-498.0).contains(&bounds.min.x) && (498.0..501.0).contains(&bounds.max.x));
    assert!((1_999_999.0..2_000_002.0).contains(&bounds.min.y));
    assert_eq!(scan.lattice().scale.x, 0.01);
}

#[test]
fn what_is_in_the_way_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.las");
    std::fs::write(&path, "mine").unwrap();
    let failure = generate(&path, "2", &[]).failure().code(1);
    let text = String::from_utf8(failure.get_output().stderr.clone()).unwrap();
    assert!(text.contains("scan.las") && text.lines().count() == 1, "{text}");
    assert_eq!(std::fs::read(&path).unwrap(), b"mine");
    generate(&path, "2", &["--overwrite"]).success();
    generate(&folder.path().join("scan.xyz"), "2", &[]).failure().code(1);
    generate(&folder.path().join("b.las"), "2", &["--step", "0"]).failure();
    generate(&folder.path().join("c.las"), "2", &["--origin", "1,2"]).failure().code(2);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}
