//! Protects what is left of damaged files: `--salvage` takes what can be read, and the account says
//! how much could not be, and why. Without it such files are refused.

#[path = "support/las_file.rs"]
mod las_file;
#[path = "support/shared_data.rs"]
mod shared_data;

use std::sync::atomic::AtomicBool;

use esker::build::{ConvertOptions, ConvertReport, Silent, convert};
use esker::input::{ReadOptions, Scan};
use esker::store::check;
use las_file::{LasPoint, RECORD_BYTES, write_las};

/// Converts bytes as a file of that name; refused without salvage.
fn salvaged(name: &str, bytes: &[u8]) -> ConvertReport {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (input, output) = (folder.path().join(name), folder.path().join("out.esker"));
    std::fs::write(&input, bytes).expect("a file can be written");
    let run = |salvage: bool| {
        let read = ReadOptions { salvage, ..ReadOptions::default() };
        let options = ConvertOptions { read, threads: 2, ..ConvertOptions::default() };
        let input = std::slice::from_ref(&input);
        convert(input, &output, &options, &Silent, &AtomicBool::new(false))
    };
    assert!(run(false).is_err(), "{name}: damaged files are refused");
    let report = run(true).unwrap_or_else(|error| panic!("{name}: {error}"));
    assert_eq!(check(&output).expect("it opens").findings, [], "{name}");
    report
}

/// In = kept + dropped, and some was kept and some not.
fn assert_account(name: &str, report: &ConvertReport, claimed: u64) {
    assert_eq!(report.points + report.dropped_points, claimed, "{name}");
    assert!(report.points > 0 && report.dropped_points > 0, "{name}: {report:?}");
    let reasons: Vec<&str> =
        report.sources.iter().flat_map(|s| &s.dropped).map(|d| d.reason.as_str()).collect();
    assert!(reasons.iter().any(|r| r.starts_with("could not be read: ")), "{name}: {reasons:?}");
}

fn shared(name: &str) -> Option<Vec<u8>> {
    shared_data::file(name).map(|path| std::fs::read(path).expect("the file reads"))
}

fn points_of(name: &str) -> u64 {
    let path = shared_data::file(name).expect("it is there");
    Scan::open(&path, &ReadOptions::default()).expect("it opens").points()
}

#[test]
fn a_truncated_las_file_gives_its_whole_records() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("whole.las");
    let point = |i: i32| LasPoint { position: [i, 2 * i, 3], color: [1, 2, 3], intensity: 4 };
    write_las(&path, &(0..1000).map(point).collect::<Vec<_>>());
    let bytes = std::fs::read(&path).unwrap();
    let report = salvaged("cut.las", &bytes[..227 + 600 * RECORD_BYTES + 11]);
    assert_eq!((report.points, report.dropped_points), (600, 400));
    assert_account("cut.las", &report, 1000);
}

#[test]
fn a_truncated_laz_file_gives_the_chunks_before_the_end() {
    for name in ["lone-star.laz", "ign-1km-pf6.laz"] {
        let Some(bytes) = shared(name) else { return };
        let report = salvaged(name, &bytes[..bytes.len() * 2 / 3]);
        assert_account(name, &report, points_of(name));
        assert!(report.points > points_of(name) / 3, "{name}: {}", report.points);
    }
}

#[test]
fn a_damaged_chunk_costs_itself_only() {
    let name = "ign-1km-pf6.laz";
    let Some(mut bytes) = shared(name) else { return };
    let path = shared_data::file(name).unwrap();
    let scan = Scan::open(&path, &ReadOptions::default()).unwrap();
    let block = scan.blocks()[1].clone();
    // The sizes of its layers, so that it cannot be taken apart.
    let start = block.bytes.start as usize;
    bytes[start + 30..start + 80].fill(0xff);
    let report = salvaged(name, &bytes);
    assert_account(name, &report, scan.points());
    assert_eq!(report.dropped_points, block.points);
}

/// A row of text that cannot be read costs itself only, and so does an end that comes too early.
fn tables_of_text() {
    let rows = |count: usize| -> String {
        let row = |i| match i {
            300 => "12 1.5 \u{1}3\n".to_string(),
            i => format!("{i} {}.5 -1\n", 2 * i),
        };
        (0..count).map(row).collect()
    };
    let ply = "ply\nformat ascii 1.0\nelement vertex 1000\nproperty float x\n\
               property float y\nproperty float z\nend_header\n";
    let pcd = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n\
               WIDTH 1000\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1000\nDATA ascii\n";
    for (name, head) in [("text.ply", ply), ("text.pcd", pcd)] {
        for (count, kept) in [(1000, 999), (700, 699)] {
            let report = salvaged(name, format!("{head}{}", rows(count)).as_bytes());
            assert_eq!((report.points, report.dropped_points), (kept, 1000 - kept), "{name}");
            assert_account(name, &report, 1000);
        }
    }
}

/// What is decompressed before the damage counts: coordinates first, zeros for what is lost.
fn compressed_columns() {
    let column = |scale: f32| (0..1000).flat_map(move |i| (scale * i as f32).to_le_bytes());
    let raw: Vec<u8> = [1.0, 2.0, 0.25, 7.0].into_iter().flat_map(column).collect();
    let literals = |part: &[u8]| [&[part.len() as u8 - 1], part].concat();
    let packed: Vec<u8> = raw.chunks(32).flat_map(literals).collect();
    let head = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\n\
                COUNT 1 1 1 1\nWIDTH 1000\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1000\n\
                DATA binary_compressed\n";
    let file = |bytes: usize| {
        let data = &packed[..bytes / 32 * 33];
        let sizes = [packed.len() as u32, raw.len() as u32].map(u32::to_le_bytes).concat();
        [head.as_bytes(), &sizes, data].concat()
    };
    // All coordinates, and half of the intensities.
    let report = salvaged("columns.pcd", &file(14_016));
    assert_eq!((report.points, report.dropped_points), (1000, 0));
    assert!(report.warnings[0].contains("intensity from point 504 on"), "{:?}", report.warnings);
    // Up to the z of a point in the middle.
    let report = salvaged("columns.pcd", &file(8_000 + 4 * 560));
    assert_eq!((report.points, report.dropped_points), (560, 440));
    assert_account("columns.pcd", &report, 1000);
}

#[test]
fn tables_and_e57_files_give_what_is_whole() {
    let rows: Vec<u8> = (0..1000)
        .flat_map(|i| [i as f32, 2.0 * i as f32, 0.5])
        .flat_map(f32::to_le_bytes)
        .collect();
    let ply = "ply\nformat binary_little_endian 1.0\nelement vertex 1000\nproperty float x\n\
               property float y\nproperty float z\nend_header\n";
    let pcd = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n\
               WIDTH 1000\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1000\nDATA binary\n";
    for (name, head) in [("cut.ply", ply), ("cut.pcd", pcd)] {
        let report = salvaged(name, &[head.as_bytes(), &rows[..12 * 700 + 5]].concat());
        assert_eq!((report.points, report.dropped_points), (700, 300), "{name}");
        assert_account(name, &report, 1000);
    }
    tables_of_text();
    compressed_columns();
    let name = "bunnyFloat.e57";
    let Some(mut bytes) = shared(name) else { return };
    let page = 1024 * (bytes.len() / 1024 / 2);
    bytes[page + 100] ^= 0x55;
    let report = salvaged(name, &bytes);
    let came_in: u64 = report.sources.iter().map(|source| source.points).sum();
    assert_account(name, &report, came_in);
}
