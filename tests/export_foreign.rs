//! Protects exports of stores whose scans were not of the LAS family, or of several kinds: headers
//! are made, attributes find their fields or become extra bytes, and exact floats come back.

#[path = "support/export_case.rs"]
mod export_case;
#[path = "support/las_files.rs"]
mod las_files;
#[path = "support/tables.rs"]
mod tables;

use std::path::Path;

use esker::input::LasScan;
use esker::points::record_coordinates;
use export_case::{Case, run, text};
use las_files::read_all;
use tables::{Table, read_delimited, read_ply};

/// An ASCII PLY file of floats on no lattice; values are those of the index.
fn write_ply(path: &Path, count: u32) {
    let mut content = String::from(
        "ply\nformat ascii 1.0\ncomment made by a test\n\
         element vertex COUNT\nproperty float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\n\
         property float intensity\nproperty double quality\nproperty uchar classification\n\
         property int label\nend_header\n",
    )
    .replace("COUNT", &count.to_string());
    for i in 0..count {
        let [x, y, z] = place(i);
        let label = -(i as i64) * 1000;
        content += &format!(
            "{x} {y} {z} 0 0.6 -0.8 {} {} 7 {} {} {} {label}\n",
            i % 256,
            i / 256,
            i as f32 * 0.1,
            f64::from(i) / 3.0,
            i % 20,
        );
    }
    std::fs::write(path, content).expect("the folder takes a file");
}

/// Floats whose last bits matter.
fn place(i: u32) -> [f32; 3] {
    [(i as f32).sqrt(), 0.1 + (i as f32) / 7.0, 1e-5 * i as f32 - 0.02]
}

fn case(count: u32) -> Case {
    let folder = tempfile::tempdir().expect("a folder");
    let scan = folder.path().join("scan.ply");
    write_ply(&scan, count);
    Case::of(folder, scan, &["--threshold", "100"])
}

/// One row per point, ordered by the label, which counts down from 0.
fn by_label(table: &Table, names: &[&str]) -> Vec<Vec<f64>> {
    let label = table.column("label").expect("a label");
    let mut order: Vec<usize> = (0..table.rows()).collect();
    order.sort_by(|&a, &b| label[b].total_cmp(&label[a]));
    let columns: Vec<&[f64]> = names.iter().map(|name| table.column(name).expect(name)).collect();
    order.iter().map(|&row| columns.iter().map(|column| column[row]).collect()).collect()
}

const NAMES: [&str; 13] = [
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "red",
    "green",
    "blue",
    "intensity",
    "quality",
    "classification",
    "label",
];

/// What [`write_ply`] wrote, in the order of [`NAMES`].
fn expected(i: u32) -> Vec<f64> {
    let mut row: Vec<f64> = place(i).map(f64::from).to_vec();
    row.extend([0.0, f64::from(0.6f32), f64::from(-0.8f32)]);
    row.extend([f64::from(i % 256), f64::from(i / 256), 7.0]);
    row.extend([f64::from(i as f32 * 0.1), f64::from(i) / 3.0, f64::from(i % 20)]);
    row.push(-f64::from(i) * 1000.0);
    row
}

#[test]
fn exact_floats_names_and_types_come_back_in_ply_and_text() {
    let case = case(2000);
    for options in [&[][..], &["--ascii"]] {
        let table = read_ply(&std::fs::read(case.export("out.ply", options)).expect("there"));
        for (i, row) in by_label(&table, &NAMES).iter().enumerate() {
            // Text of a float may be that of the float itself or of its value.
            let same = row.iter().zip(expected(i as u32)).all(|(a, b)| *a as f32 == b as f32);
            assert!(same, "{row:?}");
            assert!(!options.is_empty() || *row == expected(i as u32), "{row:?}");
        }
        let types = ["float"; 6].iter().chain(&["uchar"; 3]);
        let types = types.chain(&["float", "double", "uchar", "int"]);
        for (name, expected) in NAMES.iter().zip(types) {
            assert_eq!(table.type_of(name), Some(*expected), "{name}");
        }
    }
    let content = std::fs::read_to_string(case.export("out.csv", &[])).expect("text");
    let table = read_delimited(&content, ',');
    let names = ["x", "y", "z", "red", "quality", "classification", "label"];
    for (i, row) in by_label(&table, &names).iter().enumerate() {
        let all = expected(i as u32);
        let wanted = [0, 1, 2, 6, 10, 11, 12].map(|column| all[column]);
        assert_eq!(row[..], wanted, "the very floats");
    }
}

#[test]
fn las_and_copc_get_a_header_and_extra_bytes() {
    let case = case(3000);
    for name in ["out.las", "out.laz", "out.copc.laz"] {
        let scan = LasScan::open(&case.export(name, &[])).expect("it opens");
        assert_eq!(scan.facts().warnings, Vec::<String>::new(), "{name}");
        assert_eq!((scan.points(), scan.header().minor), (3000, 4));
        assert_eq!(scan.header().point_format.number(), 7, "there are colours");
        let schema = scan.schema();
        let at = |name: &str| {
            let (_, attribute) = schema.find(name).unwrap_or_else(|| panic!("no {name}"));
            (attribute.record_offset as usize, attribute.scalar)
        };
        assert!(schema.find("coordinate_residual").is_none(), "LAS has no place for it");
        let (label_at, label) = at("label");
        let records = read_all(&scan).expect("it reads");
        let size = schema.record_bytes as usize;
        let step = scan.lattice().scale;
        let mut seen = vec![false; 3000];
        for record in records.chunks_exact(size) {
            let i = (label.read(&record[label_at..]) / -1000.0) as u32;
            assert!(!std::mem::replace(&mut seen[i as usize], true), "{i} twice");
            let all = expected(i);
            let world = scan.lattice().world(record_coordinates(record).map(i64::from).into());
            for axis in 0..3 {
                let off = (world[axis] - all[axis]).abs();
                assert!(off <= 0.5 * step[axis], "{world} for {all:?}, steps of {step}");
            }
            let columns = [
                ("normal_y", 4),
                ("normal_z", 5),
                ("intensity_f32", 9),
                ("quality", 10),
                ("classification", 11),
                ("label", 12),
            ];
            for (name, column) in columns {
                let (at, scalar) = at(name);
                assert_eq!(scalar.read(&record[at..]), all[column], "{name} of {i}");
            }
            let red = u16::from_le_bytes([record[30], record[31]]);
            assert_eq!(f64::from(red), all[6]);
            assert_eq!(record[14], 0x11, "the only return");
        }
        assert!(seen.iter().all(|&seen| seen));
    }
}

#[test]
fn bounds_go_by_exact_positions() {
    let case = case(500);
    // The border runs through a point, and the next float above it leaves that point out.
    let border = place(200)[0];
    let bounds = |low: f64| format!("{low},-1000,-1000,1000,1000,1000");
    let count = |low: f64| {
        let path = case.export("out.ply", &["--bounds", &bounds(low)]);
        read_ply(&std::fs::read(path).expect("it is there")).rows()
    };
    assert_eq!(count(f64::from(border)), 300);
    assert_eq!(count(f64::from(border.next_up())), 299);
}

#[test]
fn what_a_file_cannot_say_is_told() {
    let case = case(200);
    let output = case.folder.path().join("out.las");
    let message = run(&["export", text(&case.store()), "-o", text(&output)]);
    assert!(message.contains("out.las") && message.contains("exact floats"), "{message}");
    let output = case.folder.path().join("out.xyz");
    let message = run(&["export", text(&case.store()), "-o", text(&output)]);
    assert!(message.contains("quality") && message.contains("label"), "{message}");
}

#[test]
fn scans_of_several_kinds_come_out_in_one_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let (ply, csv) = (folder.path().join("a.ply"), folder.path().join("b.csv"));
    write_ply(&ply, 100);
    std::fs::write(&csv, "x,y,z,intensity\n1.25,2.5,3.75,17\n4.5,5.25,6.125,18\n").expect("text");
    let store = folder.path().join("scan.esker");
    run(&["convert", text(&ply), text(&csv), "-o", text(&store)]);
    for name in ["out.laz", "out.copc.laz"] {
        let output = folder.path().join(name);
        run(&["export", text(&store), "-o", text(&output)]);
        let scan = LasScan::open(&output).expect("it opens");
        assert_eq!(scan.points(), 102);
        let (_, source) = scan.schema().find("source").expect("each point tells its source");
        let at = source.record_offset as usize;
        let records = read_all(&scan).expect("it reads");
        let rows = records.chunks_exact(scan.schema().record_bytes as usize);
        assert_eq!(rows.filter(|row| source.scalar.read(&row[at..]) == 1.0).count(), 2);
    }
}
