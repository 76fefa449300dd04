//! Readers of PTS, PTX and rows of numbers: every number of the text comes back, in a type that
//! holds it, whatever stands between the columns and wherever blocks end.

#[path = "support/shared_data.rs"]
mod shared_data;
#[path = "support/text_files.rs"]
mod text_files;

use std::fmt::Write;
use std::path::Path;

use esker::input::{CoordinateKind, ForeignReader, TextKind, detect_text};
use esker::sampling::Random;
use esker::store::Store;
use glam::DVec3;
use text_files::{columns, digits, leaving_out, open, open_file, open_with, read, with_columns};

/// A column of numbers, added up in the order of the file.
fn sums(rows: &[Vec<f64>]) -> Vec<f64> {
    let width = rows.first().map_or(0, Vec::len);
    (0..width).map(|column| rows.iter().map(|row| row[column]).sum()).collect()
}

fn near(found: f64, expected: f64) {
    assert!((found - expected).abs() <= 1e-9 * expected.abs(), "{found}, expected {expected}");
}

#[test]
fn separators_give_the_same_points() {
    let rows = [[1.25, -2.0, 3.5, 10.0], [100.125, 0.0, -0.5, 65535.0]];
    for (separator, name) in
        [(" ", "space"), ("\t", "tab"), (",", "comma"), (";", "semicolon"), (" , ", "comma")]
    {
        let lines = rows.map(|row| row.map(|number| number.to_string()).join(separator));
        for (end, last) in [("\n", "\n"), ("\r\n", "\r\n"), ("\n", ""), ("\r\n", "")] {
            let text = format!("{}{last}", lines.join(end));
            let reader = open(&text).unwrap_or_else(|fault| panic!("{text:?}: {fault}"));
            assert_eq!(reader.facts().format, format!("text ({name})"));
            assert_eq!(columns(&reader), "intensity:u16");
            assert_eq!(digits(&reader), Some(3));
            let read = read(&reader);
            assert_eq!(read.positions, rows.map(|row| DVec3::new(row[0], row[1], row[2])));
            assert_eq!(read.attributes, rows.map(|row| vec![row[3]]));
        }
    }
    let doubled = open("1  2 \t 3\n\t4 5 6 \n").expect("blanks may come in runs");
    assert_eq!(read(&doubled).positions, [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)]);
}

#[test]
fn marks_comments_and_empty_lines_are_passed_over() {
    let text = "\u{feff}# made by hand\n\n// twice\n1 2 3\n  # in between\n\n4 5 6\n\n";
    let reader = open(text).expect("the text is right");
    assert_eq!(read(&reader).positions, [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)]);
    assert_eq!(digits(&reader), Some(0));
    assert!(reader.facts().warnings.is_empty(), "{:?}", reader.facts().warnings);
}

#[test]
fn headers_name_and_order_columns() {
    let expected = [DVec3::new(1.5, 2.5, 3.5)];
    for header in ["Z;I;Easting;northing;Class\n", "// Z;I;X;Y;Class\n", "#z;i;x;y;class\n"] {
        let reader = open(format!("{header}3.5;7;1.5;2.5;2\n")).expect("the header is right");
        assert_eq!(columns(&reader), "intensity:u16 classification:u8", "{header}");
        let rows = read(&reader);
        assert_eq!(rows.positions, expected, "{header}");
        assert_eq!(rows.attributes, [[7.0, 2.0]], "{header}");
        assert!(reader.facts().warnings.is_empty(), "{:?}", reader.facts().warnings);
    }
    let quoted = open("\"X [m]\",\"Y [m]\",\"Z [m]\",\"Signal Strength\"\n1.5,2.5,3.5,-1\n");
    let quoted = quoted.expect("the header is right");
    assert_eq!(columns(&quoted), "signal_strength:i32");
    assert_eq!(read(&quoted).positions, expected);
    // A comment that is no header leaves the columns to be guessed.
    let comment = open("# scanned on a Tuesday\n1.5 2.5 3.5 4\n").expect("the text is right");
    assert_eq!(columns(&comment), "intensity:u16");
}

#[test]
fn guesses_are_told_and_the_user_overrules_them() {
    let text = "1 2 3 4 50 60 70\n";
    let guessed = open(text).expect("the text is right");
    assert_eq!(columns(&guessed), "intensity:u16 rgb:u16x3");
    let told = "columns are guessed to be x,y,z,intensity,red,green,blue; --columns sets them";
    assert_eq!(guessed.facts().warnings, [told]);
    let set = open_with(text, &with_columns("skip,z,y,x,r,skip,time of day")).expect("it fits");
    assert_eq!(columns(&set), "r:u16 time_of_day:u16");
    let rows = read(&set);
    assert_eq!(rows.positions, [DVec3::new(4.0, 3.0, 2.0)]);
    assert_eq!(rows.attributes, [[50.0, 70.0]]);
    assert!(set.facts().warnings.is_empty());
    // What is skipped need not be a number, and a header does not overrule the user.
    let text = "id,z,y,x\n\"a,b\",3,2,1\nc,6,5,4\n";
    let set = open_with(text, &with_columns("skip,z,y,x")).expect("it fits");
    assert_eq!(read(&set).positions, [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)]);
}

#[test]
fn colours_and_normals_become_vectors() {
    let reader = open("x y z r g b nx ny nz\n1 2 3 255 0 7 0 0.6 -0.8\n").expect("it is right");
    assert_eq!(columns(&reader), "rgb:u16x3 normal:f32x3");
    let rows = read(&reader);
    assert_eq!(rows.attributes[0][..3], [255.0, 0.0, 7.0]);
    assert_eq!(rows.attributes[0][3..], [0.0, f64::from(0.6f32), f64::from(-0.8f32)]);
    let wide = open("x y z r g b\n1 2 3 65535 256 0\n").expect("it is right");
    assert_eq!(read(&wide).attributes, [[65535.0, 256.0, 0.0]]);
    // 51/255 = 0.2: fractions that are 255ths come back as the bytes they were.
    let bytes = open("1 2 3 0.2 0.6039216 1\n4 5 6 0 0 0\n").expect("it is right");
    assert_eq!(columns(&bytes), "rgb:u16x3");
    assert_eq!(read(&bytes).attributes, [[51.0, 154.0, 255.0], [0.0, 0.0, 0.0]]);
    let fine = open("1 2 3 0.2 0.5 1\n").expect("it is right");
    assert_eq!(read(&fine).attributes, [[13107.0, 32768.0, 65535.0]]);
    assert!(fine.facts().warnings.iter().any(|w| w.contains("0 to 65535")));
    let none = open("x y z r g b\n1 2 3 -1 0 0.5\n").expect("it is right");
    assert_eq!(columns(&none), "red:i32 green:u16 blue:f32");
}

#[test]
fn types_hold_every_number_of_the_whole_file() {
    // The number that decides stands last, behind several blocks.
    let mut text = String::from("x y z a b c d e gps_time\n");
    for i in 0..100_000 {
        writeln!(text, "{i}.5 1 1 1 1 1 1 1 {}.25", i + 300_000_000).expect("memory suffices");
    }
    text.push_str("0 1.0625 1 70000 5000000000 0.5 0.1234567890123 nan 1\n");
    let reader = open(&text).expect("the text is right");
    assert!(reader.facts().blocks.len() > 1, "the text has several blocks");
    assert_eq!(columns(&reader), "a:i32 b:i64 c:f32 d:f64 e:f32 gps_time:f64");
    assert_eq!(digits(&reader), Some(4));
    let rows = read(&reader);
    let last = rows.attributes.last().expect("there are rows");
    assert_eq!(last[..4], [70000.0, 5e9, 0.5, 0.1234567890123]);
    assert!(last[4].is_nan());
    assert_eq!(rows.attributes[77_777][5], 300_077_777.25);
    assert_eq!(rows.positions[77_777].x, 77_777.5);
}

#[test]
fn coordinates_are_decimal_as_long_as_that_is_exact() {
    let kind = |text: &str| open(text).expect("the text is right").facts().coordinates;
    assert_eq!(kind("1 2 3\n"), CoordinateKind::Decimal { digits: 0 });
    assert_eq!(kind("1.2500 2 3.1\n"), CoordinateKind::Decimal { digits: 2 });
    assert_eq!(kind("635577.790000 848882.15 406.1\n"), CoordinateKind::Decimal { digits: 2 });
    assert_eq!(kind("1.5 2 3e2\n"), CoordinateKind::F64);
    assert_eq!(kind("0.12345678901234567 2 3\n"), CoordinateKind::F64);
    assert_eq!(kind("123456789.12345678 2 3\n"), CoordinateKind::F64);
    // Steps of the lattice give back the numbers of the text.
    let mut random = Random::new(3, 0);
    let mut text = String::new();
    let mut expected = Vec::new();
    for _ in 0..20_000 {
        let steps = [0, 1, 2].map(|_| random.below(4_000_000_000) as i64 - 2_000_000_000);
        let number = |step: i64| {
            let sign = if step < 0 { "-" } else { "" };
            format!("{sign}{}.{:05}", step.abs() / 100_000, step.abs() % 100_000)
        };
        writeln!(text, "{}", steps.map(number).join(" ")).expect("memory suffices");
        expected.push(steps);
    }
    let reader = open(&text).expect("the text is right");
    assert_eq!(digits(&reader), Some(5));
    for (position, steps) in read(&reader).positions.iter().zip(expected) {
        assert_eq!((*position * 1e5).round().to_array().map(|step| step as i64), steps);
    }
}

#[test]
fn what_is_not_finite_is_dropped_and_counted() {
    let text = "1,2,3,4\nnan,2,3,4\n1,inf,3,4\n,2,3,4\n1,2,1.#QNAN,4\n5,6,7,8\n";
    let reader = open(text).expect("the text is right");
    assert_eq!((reader.facts().points, reader.facts().dropped_points), (2, 4));
    let rows = read(&reader);
    assert_eq!(rows.positions, [DVec3::new(1.0, 2.0, 3.0), DVec3::new(5.0, 6.0, 7.0)]);
    assert_eq!(rows.attributes, [[4.0], [8.0]]);
    assert_eq!(reader.facts().parts[0].points, 6);
}

#[test]
fn pts_scans_follow_one_another() {
    let text = "2\n1 2 3 -7 10 20 30\n4 5 6 2047 11 21 31\n3\n1 1 1 5\n2 2 2 6\n3 3 3 0.5\n";
    let reader = open(text).expect("the text is right");
    let facts = reader.facts();
    assert_eq!(facts.format, "pts");
    assert_eq!(facts.parts.iter().map(|part| part.points).collect::<Vec<_>>(), [2, 3]);
    assert_eq!(facts.blocks.iter().map(|block| block.part).collect::<Vec<_>>(), [0, 1]);
    assert_eq!(columns(&reader), "intensity:f32 rgb:u16x3");
    let rows = read(&reader);
    assert_eq!(rows.positions.len(), 5);
    assert_eq!(rows.attributes[1], [2047.0, 11.0, 21.0, 31.0]);
    assert_eq!(rows.attributes[4], [0.5, 0.0, 0.0, 0.0]);
    assert!(facts.warnings[0].contains("different columns"), "{:?}", facts.warnings);
}

#[test]
fn pts_rows_come_in_several_widths() {
    for (row, expected) in [
        ("1 2 3", ""),
        ("1 2 3 4", "intensity:u16"),
        ("1 2 3 4 5 6", "rgb:u16x3"),
        ("1 2 3 -4 5 6 7", "intensity:i32 rgb:u16x3"),
        ("1 2 3 4 5 6 0.25", "rgb:u16x3 intensity:f32"),
        ("1 2 3 -4 5 6 7 0 0.6 -0.8", "intensity:i32 rgb:u16x3 normal:f32x3"),
    ] {
        let reader = open(format!("1\n{row}\n")).expect("the text is right");
        assert_eq!(columns(&reader), expected, "{row}");
        assert_eq!(reader.facts().points, 1);
        assert!(reader.facts().warnings.is_empty(), "{:?}", reader.facts().warnings);
    }
}

#[test]
fn pts_counts_may_be_too_small_but_not_too_large() {
    let few = open("1\n1 2 3\n4 5 6\n").expect("nothing is lost");
    assert_eq!(few.facts().points, 2);
    assert_eq!(few.facts().warnings, ["scan 1 counts 1 rows and has 2"]);
    let none = open("0\n").expect("an empty scan is a scan");
    assert_eq!((none.facts().points, none.facts().blocks.len()), (0, 0));
    let lost = open_with("9\n1 2 3\n4 5 6\n", &leaving_out()).expect("the user asked for it");
    assert_eq!(lost.facts().points, 2);
    assert_eq!(lost.facts().warnings, ["scan 1 counts 9 rows and has 2"]);
}

/// A PTX scan of two columns and two rows, one of its rays without a return.
fn ptx_scan(matrix: &str) -> String {
    format!(
        "2\n2\n10 20 30\n1 0 0\n0 1 0\n0 0 1\n{matrix}\
         1.5 0 0 0.25\n0 0 0 0.5\n0 2.5 0 0.75\n0 0 3.5 1\n"
    )
}

const IDENTITY: &str = "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";
/// A quarter turn around z, then a step.
const TURNED: &str = "0 1 0 0\n-1 0 0 0\n0 0 1 0\n100.5 200 -300 1\n";

#[test]
fn ptx_at_the_identity_stays_decimal() {
    let reader = open(ptx_scan(IDENTITY)).expect("the text is right");
    let facts = reader.facts();
    assert_eq!((facts.format.as_str(), facts.points, facts.dropped_points), ("ptx", 3, 1));
    assert_eq!(digits(&reader), Some(1));
    assert_eq!(columns(&reader), "intensity:f32");
    let rows = read(&reader);
    let expected = [DVec3::X * 1.5, DVec3::Y * 2.5, DVec3::Z * 3.5];
    assert_eq!(rows.positions, expected);
    assert_eq!(rows.attributes, [[0.25], [0.75], [1.0]]);
    let pose = facts.parts[0].pose.expect("the axes are a rotation");
    assert_eq!(pose.translation, DVec3::new(10.0, 20.0, 30.0));
    assert_eq!(facts.parts[0].points, 4);
}

#[test]
fn ptx_matrices_move_points_scan_by_scan() {
    let text = ptx_scan(TURNED) + &ptx_scan(IDENTITY);
    let reader = open(text).expect("the text is right");
    let facts = reader.facts();
    assert_eq!(facts.coordinates, CoordinateKind::Computed);
    assert_eq!((facts.points, facts.dropped_points, facts.parts.len()), (6, 2, 2));
    let rows = read(&reader);
    let step = DVec3::new(100.5, 200.0, -300.0);
    assert_eq!(rows.positions[0], step + DVec3::Y * 1.5);
    assert_eq!(rows.positions[1], step - DVec3::X * 2.5);
    assert_eq!(rows.positions[2], step + DVec3::Z * 3.5);
    assert_eq!(rows.positions[3], DVec3::X * 1.5);
    let pose = facts.parts[0].pose.expect("the matrix is a rotation");
    assert_eq!(pose.translation, step);
    assert!((pose.rotation * DVec3::X).abs_diff_eq(DVec3::Y, 1e-12));
}

#[test]
fn ptx_matrices_that_scale_move_points_but_are_no_pose() {
    let scaled = "2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1\n";
    let reader = open(ptx_scan(scaled)).expect("the text is right");
    assert_eq!(read(&reader).positions[0], DVec3::X * 3.0);
    assert_eq!(reader.facts().parts[0].pose, None);
    assert!(reader.facts().warnings[0].contains("no rotation"), "{:?}", reader.facts().warnings);
}

#[test]
fn many_scans_and_long_texts_are_cut_anywhere() {
    // Rows of changing length in scans of changing size, over several pieces.
    let mut random = Random::new(11, 0);
    let mut text = String::new();
    let mut expected = Vec::new();
    for scan in 0..60u64 {
        let count = random.below(4_000);
        writeln!(text, "{count}").expect("memory suffices");
        for _ in 0..count {
            let id = expected.len() as f64;
            let pad = " ".repeat(random.below(60) as usize);
            writeln!(text, "{id} {scan}.25 {pad}-1 {scan}").expect("memory suffices");
            expected.push((id, scan as f64));
        }
    }
    let reader = open(&text).expect("the text is right");
    assert!(text.len() > 5 << 20, "the text is longer than a piece: {} bytes", text.len());
    assert_eq!(reader.facts().parts.len(), 60);
    let rows = read(&reader);
    assert_eq!(rows.positions.len(), expected.len());
    for ((position, attributes), (id, scan)) in
        rows.positions.iter().zip(&rows.attributes).zip(expected)
    {
        assert_eq!(*position, DVec3::new(id, scan + 0.25, -1.0));
        assert_eq!(*attributes, [scan]);
    }
}

#[test]
fn blocks_read_alike_from_any_thread() {
    use rayon::prelude::*;
    let text: String = (0..200_000).map(|i| format!("{i} {}.5 7 {}\n", i % 77, i % 256)).collect();
    let reader = open(&text).expect("the text is right");
    let in_order = read(&reader);
    let blocks: Vec<Vec<DVec3>> = (0..reader.facts().blocks.len())
        .into_par_iter()
        .rev()
        .map_init(esker::input::RowBuffer::default, |buffer, block| {
            reader.read_block(block, buffer).expect("the block reads");
            buffer.positions.clone()
        })
        .collect();
    let joined: Vec<DVec3> = blocks.into_iter().rev().flatten().collect();
    assert_eq!(joined, in_order.positions);
}

#[test]
fn kinds_are_told_from_the_first_lines() {
    let kind = |text: &str| detect_text(text.as_bytes());
    assert_eq!(kind("12\n1 2 3\n"), Some(TextKind::Pts));
    assert_eq!(kind("0\n"), Some(TextKind::Pts));
    assert_eq!(kind(&ptx_scan(IDENTITY)), Some(TextKind::Ptx));
    assert_eq!(kind("1 2 3\n"), Some(TextKind::Table));
    assert_eq!(kind("X,Y,Z\n1,2,3\n"), Some(TextKind::Table));
    assert_eq!(kind("# a comment\n1;2;3\n"), Some(TextKind::Table));
    assert_eq!(kind("1,5 2,5 3,5\n"), Some(TextKind::Table), "refused with a reason later");
    assert_eq!(kind("\u{feff}1 2 3\n"), Some(TextKind::Table));
    for other in
        ["", "hello world\n", "LASF", "ply\nformat ascii 1.0\n", "1 2\n3 4\n", "7f\0\0 1 2"]
    {
        assert_eq!(kind(other), None, "{other:?}");
    }
}

fn esker(arguments: &[&str]) -> assert_cmd::Command {
    let mut command = assert_cmd::Command::cargo_bin("esker").expect("the program is built");
    command.args(arguments);
    command
}

#[test]
fn columns_are_set_on_the_command_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let (text, store) = (path("scan.txt"), path("scan.esker"));
    std::fs::write(&text, "oak;3.5;2.5;1.5;9\nash;6;5;4;7\n").expect("it is written");
    let columns = ["--columns", "skip,z,y,x,amplitude"];
    esker(&["info", &text]).assert().code(1);
    let info = esker(&[&["info", &text, "--json"], &columns[..]].concat()).assert().success();
    let info: serde_json::Value =
        serde_json::from_slice(&info.get_output().stdout).expect("it is JSON");
    assert_eq!(info["points"], 2);
    assert_eq!(info["attributes"][0]["name"], "amplitude");
    let convert = ["convert", &text, "-o", &store, "--progress", "none"];
    esker(&[&convert[..], &columns[..]].concat()).assert().success();
    let points = Store::open(Path::new(&store)).expect("it opens").metadata().points;
    assert_eq!(points, 2);
    esker(&["info", &text, "--columns", "x,y"]).assert().code(2);
}

#[test]
fn numbers_of_a_text_come_out_of_a_store_as_they_went_in() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let (text, store, csv) = (path("scan.pts"), path("scan.esker"), path("scan.csv"));
    let mut random = Random::new(17, 0);
    let mut rows = Vec::new();
    for _ in 0..20_000 {
        let [x, y, z] = [0; 3].map(|_| random.below(2_000_000) as i64 - 1_000_000);
        let place = |step: i64, base: i64| {
            let sign = if step < 0 && base == 0 { "-" } else { "" };
            let step = (step + 1000 * base).abs();
            format!("{sign}{}.{:03}", step / 1000, step % 1000)
        };
        let [i, r, g, b] = [0; 4].map(|_| random.below(256));
        rows.push(format!(
            "{} {} {} {i} {r} {g} {b}",
            place(x, 635_000),
            place(y, 5_848_000),
            place(z, 0)
        ));
    }
    std::fs::write(&text, format!("{}\n{}\n", rows.len(), rows.join("\n"))).expect("it is written");
    esker(&["convert", &text, "-o", &store, "--progress", "none"]).assert().success();
    esker(&["export", &store, "-o", &csv]).assert().success();
    let exported = std::fs::read_to_string(&csv).expect("it reads");
    let mut lines = exported.lines();
    assert_eq!(lines.next(), Some("x,y,z,intensity,red,green,blue"));
    // Points stand in another order; zeros at the end are no part of a number.
    let normal = |line: &str, separator: char| -> String {
        let shorten = |number: &str| match number.contains('.') {
            true => number.trim_end_matches('0').trim_end_matches('.').to_string(),
            false => number.to_string(),
        };
        line.split(separator).map(shorten).collect::<Vec<_>>().join(" ")
    };
    let mut found: Vec<String> = lines.map(|line| normal(line, ',')).collect();
    let mut expected: Vec<String> = rows.iter().map(|line| normal(line, ' ')).collect();
    found.sort();
    expected.sort();
    assert!(found == expected, "{:?} and {:?}", &found[..3], &expected[..3]);
}

// The expected sums of the following are numpy's (`loadtxt`, `sum(0)`).

#[test]
fn the_shared_pts_comes_back() {
    let Some(path) = shared_data::file("indoor-sample.pts") else { return };
    let reader = open_file(&path);
    let facts = reader.facts();
    assert_eq!((facts.points, facts.dropped_points), (202_011, 0));
    assert_eq!(facts.bounds[0], DVec3::new(-22.16, -1.95, -7.7));
    assert_eq!(facts.bounds[1], DVec3::new(5.63, 7.55, 12.17));
    assert_eq!(digits(&reader), Some(2));
    assert_eq!(columns(&reader), "intensity:u16 rgb:u16x3");
    let rows = read(&reader);
    assert_eq!(rows.positions[100_000], DVec3::new(-11.03, 4.5, 5.96));
    let total: DVec3 = rows.positions.iter().sum();
    near(total.x, -1445081.41);
    near(total.y, 594749.98);
    near(total.z, 775537.51);
    assert_eq!(sums(&rows.attributes), [0.0; 4]);
}

#[test]
fn the_shared_xyz_comes_back() {
    let Some(path) = shared_data::file("pump.xyz") else { return };
    let reader = open_file(&path);
    let facts = reader.facts();
    assert_eq!((facts.points, facts.dropped_points), (155_201, 0));
    assert_eq!(facts.bounds[0], DVec3::new(-2.90376, -5.3011, -1.8997));
    assert_eq!(facts.bounds[1], DVec3::new(1.7216, -0.79265, 1.843));
    assert_eq!(digits(&reader), Some(5));
    assert_eq!(columns(&reader), "rgb:u16x3");
    let rows = read(&reader);
    let total: DVec3 = rows.positions.iter().sum();
    near(total.x, -74913.29549);
    near(total.y, -409112.08044);
    near(total.z, -147000.47992);
    assert_eq!(sums(&rows.attributes), [5023067.0, 5904063.0, 4008525.0]);
}

#[test]
fn the_shared_ptx_comes_back() {
    let Some(path) = shared_data::file("autzen-color.ptx") else { return };
    let reader = open_file(&path);
    let facts = reader.facts();
    assert_eq!((facts.points, facts.dropped_points, facts.parts.len()), (1065, 0, 1));
    assert_eq!(facts.bounds[0], DVec3::new(635619.85, 848899.7, 406.59));
    assert_eq!(digits(&reader), Some(2));
    assert_eq!(columns(&reader), "intensity:f32 rgb:u16x3");
    let rows = read(&reader);
    assert_eq!(rows.positions[500], DVec3::new(636235.6, 852536.45, 421.46));
    let row = [f64::from(0.006348f32), 163.0, 137.0, 155.0];
    assert_eq!(rows.attributes[500], row);
    let total = sums(&rows.attributes);
    assert!((total[0] - 19.863535).abs() < 1e-5);
    assert_eq!(total[1..], [129567.0, 118582.0, 134764.0]);
}
