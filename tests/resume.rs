//! Protects what happens to a conversion that is killed: the next one goes on from the last note
//! of how far it was, ends in the same bytes, and leaves nothing behind.
//!
//! The killed process is this test program itself, run again for one test that converts and
//! aborts before its n-th write. Notes are made after every piece of work. Loss of power is the same
//! with everything taken away that no note speaks of.

#[path = "support/las_file.rs"]
mod las_file;
#[path = "support/shared_data.rs"]
mod shared_data;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use esker::build::{BuildError, ConvertOptions, Silent, convert};
use las_file::{LasPoint, write_las};

const FILES: usize = 3;
const POINTS: usize = 700;

/// Small memory, so that pages go to disk, and notes all the time.
fn options() -> ConvertOptions {
    ConvertOptions {
        depth: 3,
        threshold: 20,
        threads: 2,
        memory_bytes: 400_000,
        checkpoint_every: Duration::ZERO,
        ..ConvertOptions::default()
    }
}

fn position(i: usize) -> [i32; 3] {
    let mut x = (i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mut next = |n: u64| {
        x ^= x >> 29;
        x = x.wrapping_mul(0xbf58_476d_1ce4_e5b9);
        ((x >> 40) % n) as i32
    };
    // Some crowd in one place, so that chunks share cells.
    if i.is_multiple_of(3) {
        [next(9), next(9), next(9)]
    } else {
        [next(4000), next(4000), next(300)]
    }
}

/// Inputs that are read once (LAS), begun anew because a header lies (`lie.las`), or kept as they were
/// decoded (text).
fn write_inputs(folder: &Path, kind: &str) -> Vec<PathBuf> {
    let files = (0..FILES).map(|file| {
        let path = folder.join(format!("part{file}.{kind}"));
        let numbers = file * POINTS..(file + 1) * POINTS;
        if kind.ends_with("las") {
            let point = |i| LasPoint {
                position: position(i),
                color: [i as u16 % 256, (i / 256) as u16, 7],
                intensity: i as u16,
            };
            write_las(&path, &numbers.map(point).collect::<Vec<_>>());
            if kind == "lie.las" {
                let mut bytes = std::fs::read(&path).expect("it reads");
                // The smallest x; no point is there, which shows when all have been sorted.
                bytes[187..195].copy_from_slice(&(-500f64).to_le_bytes());
                std::fs::write(&path, bytes).expect("it is written");
            }
        } else {
            let mut text = String::new();
            for i in numbers {
                let [x, y, z] = position(i);
                writeln!(text, "{x}.25 {y}.50 {z}.75 {i}").expect("a string takes it");
            }
            std::fs::write(&path, text).expect("the input is written");
        }
        path
    });
    files.collect()
}

fn run(inputs: &[PathBuf], output: &Path, options: &ConvertOptions) -> Result<bool, BuildError> {
    convert(inputs, output, options, &Silent, &AtomicBool::new(false)).map(|report| report.resumed)
}

/// Names in a folder, sorted.
fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("the folder lists");
    let mut names: Vec<String> = entries
        .map(|entry| entry.expect("it reads").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

/// The process that is killed; without the others' word there is nothing to do.
#[test]
fn child_converts_and_aborts() {
    let Some(folder) = std::env::var_os("RESUME_FOLDER").map(PathBuf::from) else { return };
    let kind = std::env::var("RESUME_KIND").expect("the parent says what");
    let last: u64 = std::env::var("RESUME_WRITES").expect("so many").parse().expect("a number");
    let writes = AtomicU64::new(0);
    let before_write = move || {
        if writes.fetch_add(1, Ordering::Relaxed) + 1 == last {
            std::process::abort();
        }
        Ok(())
    };
    let inputs: Vec<PathBuf> =
        (0..FILES).map(|file| folder.join(format!("part{file}.{kind}"))).collect();
    let options = ConvertOptions { before_write: Some(Arc::new(before_write)), ..options() };
    run(&inputs, &folder.join("out.esker"), &options).expect("what is not killed succeeds");
}

/// Runs the child; returns whether it lived to the end.
fn child(folder: &Path, kind: &str, writes: u64) -> bool {
    let status = Command::new(std::env::current_exe().expect("this program"))
        .args(["child_converts_and_aborts", "--exact", "--quiet"])
        .env("RESUME_FOLDER", folder)
        .env("RESUME_KIND", kind)
        .env("RESUME_WRITES", writes.to_string())
        .output()
        .expect("the child starts")
        .status;
    status.success()
}

/// What becomes of bytes that no one waited for, when the power goes.
#[derive(Clone, Copy, PartialEq)]
enum Unsynced {
    /// They are written: the process was killed, the system goes on.
    Kept,
    /// The files end before them.
    Lost,
    /// The files are as long as they were, with other bytes in them.
    Garbled,
}

/// Does that to everything behind what the last note speaks of, which was brought to disk before
/// the note was.
fn lose_power(folder: &Path, unsynced: Unsynced) {
    let work = folder.join(".out.esker.work");
    let note = std::fs::read_to_string(work.join("state.json")).ok();
    let note: Option<serde_json::Value> = note.map(|note| {
        let (_, state) = note.split_once('\n').expect("the job stands before the state");
        serde_json::from_str(state).expect("a note is whole or not there")
    });
    let number = |place: &str| note.as_ref().and_then(|note| note.pointer(place)?.as_u64());
    let synced = [
        (work.join("pages"), number("/pages_end").unwrap_or(0)),
        (work.join("state.new"), 0),
        (folder.join(".out.esker.part"), number("/step/Build/writer/end").unwrap_or(0)),
    ];
    for (path, end) in synced {
        let Ok(mut bytes) = std::fs::read(&path) else { continue };
        assert!(bytes.len() as u64 >= end, "{} is shorter than noted", path.display());
        match unsynced {
            Unsynced::Kept => {}
            Unsynced::Lost => bytes.truncate(end as usize),
            Unsynced::Garbled => bytes[end as usize..].fill(0xa5),
        }
        std::fs::write(&path, bytes).expect("it is written");
    }
}

fn killed_at_every_write(kind: &str, unsynced: Unsynced) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let inputs = write_inputs(folder.path(), kind);
    let before = names(folder.path());
    let reference = folder.path().join("out.esker");
    let once = ConvertOptions { checkpoint_every: Duration::MAX, ..options() };
    assert!(!run(&inputs, &reference, &once).expect("it converts"));
    let expected = std::fs::read(&reference).expect("it reads");
    std::fs::remove_file(&reference).expect("it goes");
    assert_eq!(names(folder.path()), before, "nothing else was left");

    let (mut writes, mut resumed) = (1, 0);
    while !child(folder.path(), kind, writes) {
        let output = folder.path().join("out.esker");
        assert!(!output.exists(), "killed before write {writes}, but the store is there");
        lose_power(folder.path(), unsynced);
        resumed += u64::from(run(&inputs, &output, &options()).expect("the next run ends"));
        assert!(std::fs::read(&output).expect("it reads") == expected, "after write {writes}");
        std::fs::remove_file(&output).expect("it goes");
        assert_eq!(names(folder.path()), before, "left after write {writes}");
        // Every write near the start, then ever fewer: there are thousands of the same kind.
        writes += 1 + writes / if unsynced == Unsynced::Kept { 10 } else { 8 };
    }
    assert!(resumed > 10, "{resumed} runs went on from what was there");
    let whole = std::fs::read(folder.path().join("out.esker")).expect("it reads");
    assert!(whole == expected, "the one that was never killed");
}

#[test]
fn plain_inputs_survive_being_killed_at_every_write() {
    killed_at_every_write("las", Unsynced::Kept);
    killed_at_every_write("lie.las", Unsynced::Kept);
}

#[test]
fn what_was_not_on_disk_when_the_power_went_is_not_trusted() {
    killed_at_every_write("las", Unsynced::Lost);
    killed_at_every_write("xyz", Unsynced::Garbled);
}

#[test]
fn decoded_inputs_survive_being_killed_at_every_write() {
    killed_at_every_write("xyz", Unsynced::Kept);
}

#[test]
fn a_run_that_is_killed_again_and_again_gets_there() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let inputs = write_inputs(folder.path(), "las");
    let output = folder.path().join("out.esker");
    let once = ConvertOptions { checkpoint_every: Duration::MAX, ..options() };
    run(&inputs, &output, &once).expect("it converts");
    let expected = std::fs::read(&output).expect("it reads");
    std::fs::remove_file(&output).expect("it goes");
    let mut deaths = 0;
    // Each life a little longer: a note brings the open page of every chunk to disk first.
    while !child(folder.path(), "las", 250 + 25 * deaths) {
        deaths += 1;
        assert!(deaths < 100, "it gets nowhere");
    }
    assert!(deaths > 1, "it was killed {deaths} times only");
    assert!(std::fs::read(&output).expect("it reads") == expected);
}

#[test]
fn work_of_another_job_is_removed_and_not_gone_on_with() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let inputs = write_inputs(folder.path(), "las");
    assert!(!child(folder.path(), "las", 500), "it is killed");
    assert!(names(folder.path()).contains(&".out.esker.work".to_string()));
    let output = folder.path().join("out.esker");
    // Another threshold is another store.
    let other = ConvertOptions { threshold: 21, ..options() };
    assert!(!run(&inputs, &output, &other).expect("it converts"), "it began anew");
    assert!(!names(folder.path()).contains(&".out.esker.work".to_string()));
}

#[test]
fn a_disk_that_fills_up_is_an_error_and_leaves_nothing() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let inputs = write_inputs(folder.path(), "xyz");
    let before = names(folder.path());
    let output = folder.path().join("out.esker");
    let mut failures = 0;
    // Notes wait for the disk: without them there are many more tries.
    let tries = (1..).step_by(11).map(|last| (last, Duration::MAX));
    let tries = tries.take(40).chain((1..).step_by(301).map(|last| (last, Duration::ZERO)));
    for (last, checkpoint_every) in tries {
        let writes = AtomicU64::new(0);
        let before_write = move || match writes.fetch_add(1, Ordering::Relaxed) + 1 >= last {
            true => Err(std::io::ErrorKind::StorageFull.into()),
            false => Ok(()),
        };
        let before_write: Option<esker::build::BeforeWrite> = Some(Arc::new(before_write));
        let options = ConvertOptions { before_write, checkpoint_every, ..options() };
        match run(&inputs, &output, &options) {
            Ok(_) if checkpoint_every.is_zero() => break,
            Ok(_) => std::fs::remove_file(&output).expect("it goes"),
            Err(error) => {
                failures += 1;
                let message = error.to_string();
                assert!(message.contains("out.esker"), "{message}");
                assert!(message.contains("no storage space"), "{message}");
                assert_eq!(names(folder.path()), before, "left after write {last}");
            }
        }
    }
    assert!(failures > 10, "{failures} tries failed");
}

#[test]
fn sigkill_at_random_moments_of_a_real_scan() {
    let Some(scan) = shared_data::file("autzen_trim_7.las") else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let output = folder.path().join("out.esker");
    let mut command = Command::new(env!("CARGO_BIN_EXE_esker"));
    command.arg("convert").arg(&scan).arg("-o").arg(&output);
    command.args(["--progress", "none", "--memory", "60MB", "--checkpoint-seconds", "0.02"]);
    let began = std::time::Instant::now();
    assert!(command.output().expect("it starts").status.success());
    let whole = began.elapsed();
    let expected = std::fs::read(&output).expect("it reads");
    let mut killed = 0;
    for i in 0..50u32 {
        std::fs::remove_file(&output).expect("it goes");
        // A third of them are killed a second time.
        for round in 0..1 + u32::from(i % 3 == 0) {
            let mut child = command.stdout(Stdio::null()).spawn().expect("it starts");
            std::thread::sleep(whole * ((i * 37 + round * 11) % 50) / 50);
            child.kill().expect("it is ours");
            killed += u32::from(!child.wait().expect("it ends").success());
        }
        if !output.exists() {
            let last = command.output().expect("it starts");
            assert!(last.status.success(), "{}", String::from_utf8_lossy(&last.stderr));
        }
        assert!(std::fs::read(&output).expect("it reads") == expected, "moment {i}");
    }
    assert!(killed > 20, "{killed} were killed before they ended");
    let again = command.output().expect("it starts");
    assert_eq!(again.status.code(), Some(1), "the store is there");
    assert_eq!(names(folder.path()), ["out.esker"]);
}
