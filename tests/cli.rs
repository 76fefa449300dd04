//! Protects what scripts depend on: exit codes, one clear line on standard error, JSON on standard
//! output, and that a run that fails or is interrupted leaves nothing behind.

#[path = "support/las_file.rs"]
mod las_file;

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use las_file::{LasPoint, las_bytes, write_las};

fn esker(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_esker")).args(arguments).output().expect("the program starts")
}

fn text(path: &Path) -> &str {
    path.to_str().expect("test paths are UTF-8")
}

fn points(count: i32) -> Vec<LasPoint> {
    (0..count)
        .map(|i| LasPoint {
            position: [i.wrapping_mul(7919) % 100_003, i.wrapping_mul(104_729) % 99_991, i % 1000],
            color: [i as u16 % 256; 3],
            intensity: i as u16,
        })
        .collect()
}

/// What a folder holds, by name.
fn listing(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("the folder lists");
    let mut names: Vec<PathBuf> = entries.map(|e| e.expect("an entry reads").path()).collect();
    names.sort();
    names
}

/// Exit code 1, nothing on standard output, one line on standard error that has all of `words`.
fn assert_refused(output: &Output, words: &[&str]) {
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(output.stdout.is_empty());
    assert_eq!(message.trim_end().lines().count(), 1, "one line: {message}");
    for word in words {
        assert!(message.contains(word), "'{message}' lacks '{word}'");
    }
}

#[test]
fn wrong_usage_is_2_and_help_is_0() {
    assert_eq!(esker(&["convert"]).status.code(), Some(2));
    assert_eq!(esker(&["no-such-command"]).status.code(), Some(2));
    assert_eq!(esker(&["convert", "a.las", "-o", "b", "--memory", "lots"]).status.code(), Some(2));
    assert_eq!(esker(&["convert", "a.las", "-o", "b", "--depth", "40"]).status.code(), Some(2));
    assert_eq!(esker(&["--help"]).status.code(), Some(0));
}

#[test]
fn conversion_tells_its_figures_as_json() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (input, store) = (folder.path().join("a.las"), folder.path().join("a.esker"));
    write_las(&input, &points(5000));
    let output = esker(&["convert", text(&input), "-o", text(&store), "--json"]);
    assert_eq!(output.status.code(), Some(0));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one object");
    assert_eq!(json["points"], 5000);
    let file_bytes = store.metadata().expect("the store is there").len();
    assert_eq!(json["output_bytes"], file_bytes);
    for name in ["seconds", "peak_rss_bytes", "memory_bytes", "nodes"] {
        assert!(json[name].is_number(), "{name} is missing: {json}");
    }
    let info = esker(&["info", text(&store), text(&input), "--json"]);
    for line in String::from_utf8_lossy(&info.stdout).lines() {
        let facts: serde_json::Value = serde_json::from_str(line).expect("an object per line");
        assert_eq!(facts["points"], 5000);
    }
}

#[test]
fn existing_outputs_stay_unless_told() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (input, store) = (folder.path().join("a.las"), folder.path().join("a.esker"));
    write_las(&input, &points(10));
    std::fs::write(&store, "precious").expect("a file can be written");
    let refused = esker(&["convert", text(&input), "-o", text(&store)]);
    assert_refused(&refused, &["a.esker", "exists", "--overwrite"]);
    assert_eq!(std::fs::read(&store).expect("it is there"), b"precious");
    let replaced = esker(&["convert", text(&input), "-o", text(&store), "--overwrite"]);
    assert_eq!(replaced.status.code(), Some(0));
    assert_eq!(esker(&["check", text(&store)]).status.code(), Some(0));
}

#[test]
fn bad_inputs_are_refused_in_one_line_and_leave_nothing() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let store = folder.path().join("out.esker");
    let sound = las_bytes(&points(100), 0, 0.001, [0.0; 3]);
    let with = |at: usize, bytes: &[u8]| {
        let mut file = sound.clone();
        file[at..at + bytes.len()].copy_from_slice(bytes);
        file
    };
    let cases: [(&str, Vec<u8>, &[&str]); 9] = [
        ("empty.las", Vec::new(), &["empty"]),
        ("text.las", b"x y z\n1 2 3\n".repeat(50), &["LASF"]),
        ("cut-header.las", sound[..150].to_vec(), &["header"]),
        ("cut-points.las", sound[..sound.len() - 500].to_vec(), &["record"]),
        ("version.las", with(25, &[9]), &["1.9"]),
        ("format.las", with(104, &[77]), &["format"]),
        ("scale-zero.las", with(131, &0f64.to_le_bytes()), &["scale"]),
        ("scale-nan.las", with(139, &f64::NAN.to_le_bytes()), &["scale"]),
        ("offset.las", with(96, &u32::MAX.to_le_bytes()), &["offset"]),
    ];
    for (name, bytes, words) in cases {
        let input = folder.path().join(name);
        std::fs::write(&input, bytes).expect("a file can be written");
        let before = listing(folder.path());
        let refused = esker(&["convert", text(&input), "-o", text(&store)]);
        assert_refused(&refused, &[&[name][..], words].concat());
        assert_eq!(listing(folder.path()), before, "{name} left something behind");
    }
    let missing = esker(&["convert", "no/such/scan.las", "-o", text(&store)]);
    assert_refused(&missing, &["no/such/scan.las"]);
    let nowhere = folder.path().join("no/such/folder/out.esker");
    let input = folder.path().join("sound.las");
    write_las(&input, &points(10));
    assert_refused(&esker(&["convert", text(&input), "-o", text(&nowhere)]), &["out.esker"]);
}

#[test]
fn valid_oddities_are_converted() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let same = vec![points(1)[0]; 70_000];
    let mut inverted = las_bytes(&points(300), 0, 0.001, [0.0; 3]);
    let (max, min) = (inverted[179..187].to_vec(), inverted[187..195].to_vec());
    inverted[179..187].copy_from_slice(&min);
    inverted[187..195].copy_from_slice(&max);
    let mut far_box = las_bytes(&points(300), 0, 0.001, [0.0; 3]);
    far_box[179..187].copy_from_slice(&1e300f64.to_le_bytes());
    let cases = [
        ("zero.las", las_bytes(&[], 0, 0.001, [0.0; 3]), 0),
        ("one.las", las_bytes(&points(1), 0, 0.001, [0.0; 3]), 1),
        ("same.las", las_bytes(&same, 0, 0.001, [0.0; 3]), 70_000),
        ("inverted.las", inverted, 300),
        ("far-box.las", far_box, 300),
    ];
    for (name, bytes, count) in cases {
        let (input, store) = (folder.path().join(name), folder.path().join("out.esker"));
        std::fs::write(&input, bytes).expect("a file can be written");
        let output = esker(&["convert", text(&input), "-o", text(&store), "--overwrite", "--json"]);
        assert_eq!(output.status.code(), Some(0), "{name}: {output:?}");
        let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one object");
        assert_eq!(json["points"], count, "{name}");
        assert_eq!(esker(&["check", text(&store)]).status.code(), Some(0), "{name}");
        let back = folder.path().join("back.las");
        let export = esker(&["export", text(&store), "-o", text(&back), "--overwrite", "--json"]);
        let json: serde_json::Value = serde_json::from_slice(&export.stdout).expect("one object");
        assert_eq!(json["points"], count, "{name}");
    }
}

#[test]
fn folders_and_several_files_make_one_store() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let tiles = folder.path().join("tiles");
    std::fs::create_dir_all(tiles.join("deeper")).expect("folders can be made");
    let all = points(3000);
    for (i, part) in all.chunks(1000).enumerate() {
        // Each tile has an offset of its own, whole steps away.
        let shift = 5000 * i as i32;
        let shifted: Vec<LasPoint> = part
            .iter()
            .map(|p| LasPoint {
                position: [p.position[0] - shift, p.position[1], p.position[2]],
                ..*p
            })
            .collect();
        let bytes = las_bytes(&shifted, 1000 * i as u64, 0.01, [f64::from(shift) * 0.01, 0.0, 0.0]);
        let name = if i == 2 { "deeper/c.las".into() } else { format!("{i}.las") };
        std::fs::write(tiles.join(name), bytes).expect("a file can be written");
    }
    let (store, one) = (folder.path().join("tiles.esker"), folder.path().join("one.las"));
    std::fs::write(&one, las_bytes(&all, 0, 0.01, [0.0; 3])).expect("a file can be written");
    assert_eq!(esker(&["convert", text(&tiles), "-o", text(&store)]).status.code(), Some(0));
    let records = |input: &Path| {
        let store = folder.path().join("x.esker");
        let (input, store_name) = (text(input), text(&store));
        if !input.ends_with(".esker") {
            let done = esker(&["convert", input, "-o", store_name, "--overwrite"]);
            assert_eq!(done.status.code(), Some(0));
        }
        let from = if input.ends_with(".esker") { input } else { store_name };
        let back = folder.path().join("back.las");
        let done = esker(&["export", from, "-o", text(&back), "--overwrite"]);
        assert_eq!(done.status.code(), Some(0));
        let bytes = std::fs::read(back).expect("the export reads");
        let mut records: Vec<Vec<u8>> =
            bytes[227..].chunks_exact(las_file::RECORD_BYTES).map(<[u8]>::to_vec).collect();
        records.sort_unstable();
        records
    };
    let (tiled, whole) = (records(&store), records(&one));
    assert_eq!(tiled.len(), 3000);
    assert!(tiled == whole, "tiles hold the points of the whole");

    // Another lattice in the folder: the common one of 0.01 and 0.03 is finer by nothing.
    std::fs::write(tiles.join("odd.las"), las_bytes(&points(5), 0, 0.03, [0.0; 3]))
        .expect("a file can be written");
    let done = esker(&["convert", text(&tiles), "-o", text(&store), "--overwrite", "--json"]);
    assert_eq!(done.status.code(), Some(0));
    let json: serde_json::Value = serde_json::from_slice(&done.stdout).expect("one object");
    assert_eq!(json["points"], 3005);
    assert_eq!(esker(&["check", text(&store)]).status.code(), Some(0));
}

#[cfg(unix)]
#[test]
fn an_interrupted_conversion_ends_with_130_and_leaves_nothing() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (input, store) = (folder.path().join("big.las"), folder.path().join("big.esker"));
    write_las(&input, &points(1_500_000));
    let mut child = Command::new(env!("CARGO_BIN_EXE_esker"))
        .args(["convert", text(&input), "-o", text(&store), "--threads", "1", "--progress", "json"])
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut stderr = BufReader::new(child.stderr.take().expect("it is piped"));
    let mut message = String::new();
    stderr.read_line(&mut message).expect("it tells that it reads");
    let id = child.id().to_string();
    let kill = Command::new("kill").args(["-INT", &id]).status().expect("kill runs");
    assert!(kill.success());
    stderr.read_to_string(&mut message).expect("its messages are text");
    let status = child.wait().expect("it ends");
    assert_eq!(status.code(), Some(130), "{message}");
    assert!(message.contains("interrupted"), "{message}");
    assert_eq!(listing(folder.path()), [input], "nothing is left behind");
}

#[test]
fn a_reader_that_has_seen_enough_is_no_fault() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scan = folder.path().join("scan.las");
    write_las(&scan, &points(100));
    let mut child = Command::new(env!("CARGO_BIN_EXE_esker"))
        .args(["info", text(&scan)])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    // Closed before a line was read.
    drop(child.stdout.take());
    let output = child.wait_with_output().expect("the program ends");
    assert_eq!(output.status.code(), Some(0));
    assert_eq!(String::from_utf8_lossy(&output.stderr), "");
}

#[test]
fn points_are_added_to_a_store() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = |name: &str| folder.path().join(name);
    write_las(&file("a.las"), &points(3000));
    write_las(&file("b.las"), &points(700));
    let (a, b, store) = (file("a.las"), file("b.las"), file("s.esker"));
    assert!(esker(&["convert", text(&a), "-o", text(&store)]).status.success());
    let output = esker(&["convert", "--append", text(&store), text(&b), "--json"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one object");
    assert_eq!((json["points"].as_u64(), json["new_points"].as_u64()), (Some(3700), Some(700)));
    assert!(esker(&["check", text(&store)]).status.success());
    let both = esker(&["convert", "--append", text(&store), text(&b), "-o", text(&store)]);
    assert_eq!(both.status.code(), Some(2), "an output and a store to append to");
}
