//! Protects exports: every point and attribute comes out in every format, exactly; selections give
//! what filtering all points gives; COPC files are the octrees that they say they are.
//!
//! The oracles are this project's LAS reader, which takes a COPC file as the LAZ file it also is,
//! and parsers of PLY, text and the hierarchy written here from the formats' specifications.

#[path = "support/las_files.rs"]
mod las_files;
#[path = "support/tables.rs"]
mod tables;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use esker::input::{LasScan, PointFormat};
use esker::output::Compression;
use esker::points::record_coordinates;
use esker::sampling::records;
use las_files::{read_all, shared, template, write};
use tables::{Table, read_delimited, read_ply};

fn esker(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_esker")).args(arguments).output().expect("the program starts")
}

fn text(path: &Path) -> &str {
    path.to_str().expect("test paths are UTF-8")
}

/// Runs the program, which must succeed; what it says on standard error.
fn run(arguments: &[&str]) -> String {
    let output = esker(arguments);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {message}");
    message
}

/// A folder with a scan and its store.
struct Case {
    folder: tempfile::TempDir,
    scan: PathBuf,
}

impl Case {
    /// A LAS file of noise at places in a cube of `2^bits` steps.
    fn noise(count: usize, format: u8, extra_bytes: u16, bits: u32, options: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let scan = folder.path().join("scan.las");
        let minor = if format <= 5 { 3 } else { 4 };
        let mut all = records::noise(count, format, extra_bytes, 7);
        let size = usize::from(template(minor, format, extra_bytes).header().record_bytes);
        for record in all.chunks_exact_mut(size) {
            for axis in record[..12].chunks_exact_mut(4) {
                let value = i32::from_le_bytes(axis.try_into().expect("4")) & ((1 << bits) - 1);
                axis.copy_from_slice(&(value - 1000).to_le_bytes());
            }
        }
        write(&scan, &template(minor, format, extra_bytes), Compression::None, &all);
        Case::of(folder, scan, options)
    }

    fn shared(name: &str) -> Option<Self> {
        let folder = tempfile::tempdir().expect("a folder");
        Some(Case::of(folder, shared(name)?, &[]))
    }

    fn of(folder: tempfile::TempDir, scan: PathBuf, options: &[&str]) -> Self {
        let case = Case { folder, scan };
        let store = case.store();
        let arguments = [&["convert", text(&case.scan), "-o", text(&store)], options].concat();
        run(&arguments);
        case
    }

    fn store(&self) -> PathBuf {
        self.folder.path().join("scan.esker")
    }

    fn export(&self, name: &str, options: &[&str]) -> PathBuf {
        let output = self.folder.path().join(name);
        let store = self.store();
        let arguments =
            [&["export", text(&store), "-o", text(&output), "--overwrite"], options].concat();
        run(&arguments);
        output
    }

    fn records(&self) -> (LasScan, Vec<u8>) {
        let scan = LasScan::open(&self.scan).expect("the scan opens");
        let records = read_all(&scan).expect("the scan reads");
        (scan, records)
    }
}

/// Records in an order that does not depend on the file's.
fn sorted(records: &[u8], record_bytes: usize) -> Vec<&[u8]> {
    let mut rows: Vec<&[u8]> = records.chunks_exact(record_bytes).collect();
    rows.sort_unstable();
    rows
}

/// What the fields of a record say, whatever its format; absent ones are 0.
#[derive(Clone, Debug, PartialEq, PartialOrd)]
struct Fields {
    place: [i32; 3],
    intensity: u16,
    returns: [u8; 2],
    class: u8,
    flags: u8,
    direction_and_edge: u8,
    angle: i16,
    user_data: u8,
    source: u16,
    time: u64,
    rgb_nir: [u16; 4],
    extra: Vec<u8>,
}

/// From tables 7 to 17 of the specification.
fn fields(record: &[u8], format: u8, packet_is_extra: bool) -> Fields {
    let word = |at: usize| u16::from_le_bytes(record[at..at + 2].try_into().expect("2"));
    let legacy = format <= 5;
    let base = usize::from(PointFormat::new(format).expect("0 to 10").base_bytes());
    let time_at = match format {
        0 | 2 => None,
        1 | 3..=5 => Some(20),
        _ => Some(22),
    };
    let colour_at = match format {
        2 => Some(20),
        3 | 5 => Some(28),
        7 | 8 | 10 => Some(30),
        _ => None,
    };
    let nir_at = matches!(format, 8 | 10).then_some(36);
    let packet = if matches!(format, 4 | 5 | 9 | 10) { base - 29..base } else { base..base };
    let mut extra = record[base..].to_vec();
    if packet_is_extra {
        // Behind the extra bytes that were there? No: in the order of the record.
        extra.splice(0..0, record[packet].iter().copied());
    }
    let colour = |i: usize| colour_at.map_or(0, |at| word(at + 2 * i));
    Fields {
        place: record_coordinates(record),
        intensity: word(12),
        returns: if legacy {
            [record[14] & 7, record[14] >> 3 & 7]
        } else {
            [record[14] & 15, record[14] >> 4]
        },
        class: if legacy { record[15] & 31 } else { record[16] },
        flags: if legacy { record[15] >> 5 } else { record[15] & 63 },
        direction_and_edge: if legacy { record[14] >> 6 } else { record[15] >> 6 },
        // Degrees and steps of 0.006 degrees, as steps.
        angle: if legacy {
            (f64::from(record[16] as i8) / 0.006).round() as i16
        } else {
            word(18) as i16
        },
        user_data: record[17],
        source: if legacy { word(18) } else { word(20) },
        time: time_at.map_or(0, |at| u64::from_le_bytes(record[at..at + 8].try_into().expect("8"))),
        rgb_nir: [colour(0), colour(1), colour(2), nir_at.map_or(0, word)],
        extra,
    }
}

fn all_fields(records: &[u8], record_bytes: usize, format: u8, is_source: bool) -> Vec<Fields> {
    let rows = records.chunks_exact(record_bytes);
    let mut all: Vec<Fields> = rows.map(|record| fields(record, format, is_source)).collect();
    all.sort_by(|a, b| a.partial_cmp(b).expect("no float is compared"));
    all
}

#[test]
fn copc_holds_every_field_of_every_point_format() {
    for format in 0..=10 {
        let case = Case::noise(6000, format, 5, 12, &[]);
        let (_, source) = case.records();
        let path = case.export("out.copc.laz", &[]);
        let copc = LasScan::open(&path).expect("it reads as LAZ");
        assert_eq!(copc.facts().warnings, Vec::<String>::new(), "format {format}");
        let expected_format = match format {
            2 | 3 | 5 | 7 => 7,
            8 | 10 => 8,
            _ => 6,
        };
        assert_eq!(copc.header().point_format.number(), expected_format, "of format {format}");
        let size = usize::from(PointFormat::new(format).expect("a format").base_bytes()) + 5;
        let expected = all_fields(&source, size, format, true);
        let found = read_all(&copc).expect("it reads");
        let found_size = usize::from(copc.header().record_bytes);
        let found = all_fields(&found, found_size, expected_format, false);
        assert_eq!(expected.len(), found.len());
        for (a, b) in expected.iter().zip(&found) {
            assert_eq!(a, b, "format {format}");
        }
        check_octree(&copc, &path);
    }
}

/// One chunk of a COPC file as its hierarchy tells it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Entry {
    offset: u64,
    bytes: u64,
    points: u64,
}

struct Copc {
    low: [f64; 3],
    edge: f64,
    spacing: f64,
    times: [f64; 2],
    entries: BTreeMap<[u32; 4], Entry>,
}

/// Info record and hierarchy, from copc.io.
fn read_copc(bytes: &[u8]) -> Copc {
    let double = |at: usize| f64::from_le_bytes(bytes[at..at + 8].try_into().expect("8"));
    let long = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().expect("8"));
    let int = |at: usize| i32::from_le_bytes(bytes[at..at + 4].try_into().expect("4"));
    assert_eq!(&bytes[377..381], b"copc", "the first record is COPC's");
    assert_eq!(bytes[375 + 18..375 + 22], [1, 0, 160, 0], "its id and size");
    let info = 375 + 54;
    let half = double(info + 24);
    let mut copc = Copc {
        low: [0, 1, 2].map(|axis| double(info + 8 * axis) - half),
        edge: 2.0 * half,
        spacing: double(info + 32),
        times: [double(info + 56), double(info + 64)],
        entries: BTreeMap::new(),
    };
    assert!(bytes[info + 72..info + 160].iter().all(|&byte| byte == 0), "reserved bytes");
    let mut pages = vec![(long(info + 40) as usize, long(info + 48) as usize)];
    while let Some((start, length)) = pages.pop() {
        for at in (start..start + length).step_by(32) {
            let key = [0, 4, 8, 12].map(|i| int(at + i) as u32);
            let (offset, size, points) = (long(at + 16), int(at + 24), int(at + 28));
            if points < 0 {
                pages.push((offset as usize, size as usize));
                continue;
            }
            let entry = Entry { offset, bytes: size as u64, points: points as u64 };
            assert_eq!(copc.entries.insert(key, entry), None, "{key:?} stands twice");
        }
    }
    copc
}

/// Hierarchy and chunks agree; points lie in the cubes of their chunks.
fn check_octree(scan: &LasScan, path: &Path) -> Copc {
    let bytes = std::fs::read(path).expect("the file reads");
    let copc = read_copc(&bytes);
    let header = scan.header();
    let size = usize::from(header.record_bytes);
    let chunks: Vec<Entry> = {
        let mut chunks: Vec<Entry> =
            copc.entries.values().copied().filter(|entry| entry.points > 0).collect();
        chunks.sort_by_key(|entry| entry.offset);
        chunks
    };
    // Chunks fill the space between the table's place and the table.
    let first = u64::from(header.point_data_offset) + 8;
    let end = chunks.iter().fold(first, |at, entry| {
        assert_eq!(entry.offset, at, "chunks follow one another");
        at + entry.bytes
    });
    let table = header.point_data_offset as usize;
    let table = u64::from_le_bytes(bytes[table..table + 8].try_into().expect("8"));
    assert_eq!(end, table, "the table of chunks follows the last one");
    let counts: Vec<u64> = scan.blocks().iter().map(|block| block.points).collect();
    assert_eq!(counts, chunks.iter().map(|entry| entry.points).collect::<Vec<_>>());

    let mut records = &read_all(scan).expect("it reads")[..];
    let keys: BTreeMap<u64, [u32; 4]> = copc
        .entries
        .iter()
        .filter(|(_, entry)| entry.points > 0)
        .map(|(key, entry)| (entry.offset, *key))
        .collect();
    let mut times = [f64::INFINITY, f64::NEG_INFINITY];
    for entry in &chunks {
        let (chunk, rest) = records.split_at(entry.points as usize * size);
        records = rest;
        let key = keys[&entry.offset];
        let edge = copc.edge / f64::from(1u32 << key[0]);
        for record in chunk.chunks_exact(size) {
            let world = header.lattice.world(record_coordinates(record).map(i64::from).into());
            for axis in 0..3 {
                let low = copc.low[axis] + edge * f64::from(key[axis + 1]);
                let inside = (low..=low + edge).contains(&world[axis]);
                assert!(inside, "{world} is not in {key:?}, axis {axis} from {low} by {edge}");
            }
            let time = f64::from_le_bytes(record[22..30].try_into().expect("8"));
            times = [times[0].min(time), times[1].max(time)];
        }
    }
    assert!(records.is_empty());
    if !chunks.is_empty() {
        assert_eq!(copc.times, times);
    }
    for key in copc.entries.keys().filter(|key| key[0] > 0) {
        let parent = [key[0] - 1, key[1] / 2, key[2] / 2, key[3] / 2];
        assert!(copc.entries.contains_key(&parent), "{key:?} has no parent");
    }
    assert!(copc.entries.contains_key(&[0; 4]), "there is a root");
    copc
}

#[test]
fn copc_chunks_are_neither_tiny_nor_huge() {
    // A filled cube on few steps: half of its cells at the depth of single steps, and a heap of
    // coincident points that no cell divides.
    let folder = tempfile::tempdir().expect("a folder");
    let scan = folder.path().join("scan.las");
    let mut all = records::noise(420_000, 0, 0, 3);
    for (i, record) in all.chunks_exact_mut(20).enumerate() {
        let heap = i % 7 < 2;
        for axis in record[..12].chunks_exact_mut(4) {
            let value = i32::from_le_bytes(axis.try_into().expect("4")) & 0xff;
            axis.copy_from_slice(&(if heap { 77 } else { value }).to_le_bytes());
        }
    }
    write(&scan, &template(2, 0, 0), Compression::None, &all);
    let case = Case::of(folder, scan, &["--threshold", "20", "--depth", "8"]);
    let path = case.export("out.copc.laz", &[]);
    let copc = LasScan::open(&path).expect("it reads as LAZ");
    assert_eq!(copc.points(), 420_000);
    let tree = check_octree(&copc, &path);
    assert_eq!(tree.spacing, tree.edge / 256.0);
    let has_children = |key: &[u32; 4]| {
        tree.entries
            .keys()
            .any(|k| k[0] == key[0] + 1 && [0, 1, 2].iter().all(|a| k[a + 1] / 2 == key[a + 1]))
    };
    for (key, entry) in &tree.entries {
        assert!(entry.points <= 110_000, "{key:?}: {} points", entry.points);
        if !has_children(key) {
            assert!(entry.points >= 500, "leaf {key:?}: {} points", entry.points);
        }
    }
    assert!(tree.entries.len() > 8, "large nodes were divided: {}", tree.entries.len());
}

#[test]
fn copc_bytes_do_not_depend_on_threads() {
    let case = Case::noise(150_000, 3, 0, 14, &[]);
    let files: Vec<Vec<u8>> = ["1", "3"]
        .iter()
        .map(|threads| {
            let output = case.folder.path().join("t.copc.laz");
            let done = Command::new(env!("CARGO_BIN_EXE_esker"))
                .args(["export", text(&case.store()), "-o", text(&output), "--overwrite"])
                .env("RAYON_NUM_THREADS", threads)
                .status()
                .expect("the program starts");
            assert!(done.success());
            std::fs::read(&output).expect("it is there")
        })
        .collect();
    assert!(files[0] == files[1]);
}

#[test]
fn copc_takes_no_point_one_point_and_unequal_scales() {
    for count in [0, 1] {
        let case = Case::noise(count, 1, 0, 10, &[]);
        let path = case.export("out.copc.laz", &[]);
        let copc = LasScan::open(&path).expect("it reads as LAZ");
        assert_eq!(copc.points(), count as u64);
        check_octree(&copc, &path);
    }
    // Degrees along x and y, metres along z: cells of the store are no cubes.
    let Some(case) = Case::shared("epsg_4326.las") else { return };
    let path = case.export("out.copc.laz", &[]);
    let copc = LasScan::open(&path).expect("it reads as LAZ");
    check_octree(&copc, &path);
    let (_, source) = case.records();
    let found = read_all(&copc).expect("it reads");
    let found = all_fields(&found, 30, 6, false);
    assert!(found == all_fields(&source, 20, 0, true));
}

#[test]
fn real_scans_come_back_from_copc() {
    for name in ["lion_takanawa.copc.laz", "fullwave-pf10.laz", "extrabytes.las", "4_6_crop.las"] {
        let Some(case) = Case::shared(name) else { continue };
        let (scan, source) = case.records();
        let path = case.export("out.copc.laz", &[]);
        let copc = LasScan::open(&path).expect("it reads as LAZ");
        check_octree(&copc, &path);
        assert_eq!(copc.facts().warnings, Vec::<String>::new(), "{name}");
        let (from, to) = (scan.header().point_format.number(), copc.header().point_format.number());
        let found = read_all(&copc).expect("it reads");
        let found = all_fields(&found, usize::from(copc.header().record_bytes), to, false);
        let expected = all_fields(&source, usize::from(scan.header().record_bytes), from, true);
        assert!(found == expected, "{name}");
        let names = |scan: &LasScan| -> Vec<String> {
            let base = scan.header().point_format;
            let fields = base.schema(base.base_bytes(), &[]).0.attributes.len();
            scan.schema().attributes[fields..].iter().map(|a| a.name.clone()).collect()
        };
        if from < 9 {
            assert_eq!(names(&scan), names(&copc), "{name}");
        } else {
            assert_eq!(names(&copc)[0], "wavepacket_index", "{name}");
        }
        assert_eq!(scan.facts().crs.wkt, copc.facts().crs.wkt, "{name}");
        assert_eq!(scan.facts().crs.geotiff_keys, copc.facts().crs.geotiff_keys, "{name}");
    }
}

/// Values of a record by the names of the columns that text gives them.
fn expected_columns(scan: &LasScan, records: &[u8], name: &str) -> Vec<f64> {
    let size = usize::from(scan.header().record_bytes);
    let (attribute, component) = match name {
        "red" | "green" | "blue" => {
            ("rgb", ["red", "green", "blue"].iter().position(|n| *n == name).expect("listed"))
        }
        other => (other, 0),
    };
    let (_, attribute) = scan.schema().find(attribute).expect("the scan has it");
    let at = attribute.record_offset as usize + component * attribute.scalar.bytes();
    records.chunks_exact(size).map(|record| attribute.scalar.read(&record[at..])).collect()
}

/// Rows in an order that does not depend on the file's: by all columns.
fn sorted_rows(columns: &[&[f64]]) -> Vec<Vec<u64>> {
    let count = columns.first().map_or(0, |column| column.len());
    let mut rows: Vec<Vec<u64>> =
        (0..count).map(|i| columns.iter().map(|column| column[i].to_bits()).collect()).collect();
    rows.sort_unstable();
    rows
}

/// The decimal of a lattice coordinate, computed with whole numbers from the decimals that stand
/// for step and offset.
fn decimal(steps: i32, step: (i128, u32), offset: (i128, u32)) -> String {
    let digits = step.1.max(offset.1);
    let value = i128::from(steps) * step.0 * 10i128.pow(digits - step.1)
        + offset.0 * 10i128.pow(digits - offset.1);
    let (sign, value) = (if value < 0 { "-" } else { "" }, value.unsigned_abs());
    let power = 10u128.pow(digits);
    if digits == 0 {
        return format!("{sign}{value}");
    }
    format!("{sign}{}.{:0>width$}", value / power, value % power, width = digits as usize)
}

fn check_table(case: &Case, table: &Table, names: &[&str]) {
    let (scan, records) = case.records();
    let size = usize::from(scan.header().record_bytes);
    let lattice = scan.lattice();
    let world: Vec<_> = records
        .chunks_exact(size)
        .map(|record| lattice.world(record_coordinates(record).map(i64::from).into()))
        .collect();
    let mut expected: Vec<Vec<f64>> =
        (0..3).map(|axis| world.iter().map(|place| place[axis]).collect()).collect();
    expected.extend(names.iter().map(|name| expected_columns(&scan, &records, name)));
    let found: Vec<&[f64]> = ["x", "y", "z"]
        .iter()
        .chain(names)
        .map(|name| table.column(name).unwrap_or_else(|| panic!("no {name}: {:?}", table.names)))
        .collect();
    let expected: Vec<&[f64]> = expected.iter().map(Vec::as_slice).collect();
    assert!(sorted_rows(&found) == sorted_rows(&expected), "{:?}", table.names);
}

#[test]
fn ply_keeps_names_types_and_values() {
    let cases = ["ign-semis-2022-pf8.laz", "extrabytes.las", "4_6_crop.las"];
    for case in cases.iter().filter_map(|name| Case::shared(name)) {
        let (scan, _) = case.records();
        let names: Vec<&str> = scan
            .schema()
            .attributes
            .iter()
            .filter(|a| a.components == 1)
            .map(|a| a.name.as_str())
            .chain(["red", "green", "blue"])
            .collect();
        for options in [&[][..], &["--ascii"]] {
            let path = case.export("out.ply", options);
            let table = read_ply(&std::fs::read(&path).expect("it is there"));
            // Text holds the decimals; binary what f64 makes of step and offset.
            if options.is_empty() {
                check_table(&case, &table, &names);
            }
            for attribute in scan.schema().attributes.iter().filter(|a| a.components == 1) {
                let expected = match format!("{:?}", attribute.scalar).as_str() {
                    "U8" => "uchar",
                    "I8" => "char",
                    "U16" => "ushort",
                    "I16" => "short",
                    "U32" => "uint",
                    "I32" => "int",
                    "F32" => "float",
                    _ => "double",
                };
                assert_eq!(table.type_of(&attribute.name), Some(expected), "{}", attribute.name);
            }
            assert_eq!(table.rows() as u64, scan.points());
        }
        let binary = read_ply(&std::fs::read(case.export("a.ply", &[])).expect("binary"));
        let ascii = read_ply(&std::fs::read(case.export("b.ply", &["--ascii"])).expect("ascii"));
        for name in &names {
            let (a, b) = (binary.column(name).expect("there"), ascii.column(name).expect("there"));
            assert!(a == b, "{name}: the order is that of the store, so rows correspond");
        }
    }
}

#[test]
fn text_prints_decimals_exactly_on_the_lattice() {
    let case = Case::noise(3000, 6, 0, 20, &[]);
    let (scan, records) = case.records();
    // Steps of 0.001 from 476000, 5429000 and 300: see the support file.
    let offsets = [476_000, 5_429_000, 300];
    let size = usize::from(scan.header().record_bytes);
    let mut expected: Vec<[String; 3]> = records
        .chunks_exact(size)
        .map(|record| {
            let steps = record_coordinates(record);
            [0, 1, 2].map(|axis| decimal(steps[axis], (1, 3), (offsets[axis], 0)))
        })
        .collect();
    expected.sort_unstable();
    for (name, separator, lines) in
        [("out.csv", ',', 1), ("out.txt", ' ', 1), ("out.xyz", ' ', 0), ("out.pts", ' ', 1)]
    {
        let content = std::fs::read_to_string(case.export(name, &[])).expect("text");
        let mut found: Vec<[String; 3]> = content
            .lines()
            .skip(lines)
            .map(|line| {
                let mut parts = line.split(separator).map(str::to_string);
                [0, 1, 2].map(|_| parts.next().expect("three coordinates"))
            })
            .collect();
        found.sort_unstable();
        assert!(found == expected, "{name}");
        if name == "out.pts" {
            assert_eq!(content.lines().next(), Some("3000"));
        }
    }
}

#[test]
fn text_takes_packed_fields_apart() {
    for format in [3, 8] {
        let case = Case::noise(500, format, 0, 16, &[]);
        let (_, records) = case.records();
        let size = usize::from(PointFormat::new(format).expect("a format").base_bytes());
        let all = all_fields(&records, size, format, true);
        for (name, separator) in [("out.csv", ','), ("out.txt", ' ')] {
            let content = std::fs::read_to_string(case.export(name, &[])).expect("text");
            let table = read_delimited(&content, separator);
            type Take = fn(&Fields) -> f64;
            let columns: [(&str, Take); 9] = [
                ("intensity", |f| f64::from(f.intensity)),
                ("return_number", |f| f64::from(f.returns[0])),
                ("number_of_returns", |f| f64::from(f.returns[1])),
                ("classification", |f| f64::from(f.class)),
                ("withheld", |f| f64::from(f.flags >> 2 & 1)),
                ("edge_of_flight_line", |f| f64::from(f.direction_and_edge >> 1)),
                ("point_source_id", |f| f64::from(f.source)),
                ("gps_time", |f| f64::from_bits(f.time)),
                ("green", |f| f64::from(f.rgb_nir[1])),
            ];
            let found: Vec<&[f64]> =
                columns.iter().map(|(name, _)| table.column(name).expect("a column")).collect();
            let expected: Vec<Vec<f64>> =
                columns.iter().map(|(_, take)| all.iter().map(take).collect()).collect();
            let expected: Vec<&[f64]> = expected.iter().map(Vec::as_slice).collect();
            assert!(sorted_rows(&found) == sorted_rows(&expected), "format {format} {name}");
        }
    }
}

#[test]
fn selections_give_what_filtering_gives_in_every_format() {
    let case = Case::noise(60_000, 7, 0, 12, &["--threshold", "50"]);
    let (scan, records) = case.records();
    let size = usize::from(scan.header().record_bytes);
    let lattice = scan.lattice();
    let (low, high) = ([200, 300, -1000], [1500, 2500, 1900]);
    let corner = |steps: [i32; 3]| lattice.world(steps.map(i64::from).into());
    let bounds: Vec<String> = [corner(low), corner(high)]
        .iter()
        .flat_map(|c| c.to_array())
        .map(|v| v.to_string())
        .collect();
    let bounds = bounds.join(",");
    let inside = |record: &[u8]| {
        let steps = record_coordinates(record);
        (0..3).all(|axis| (low[axis]..=high[axis]).contains(&steps[axis]))
    };
    let classes = |record: &[u8]| [2u8, 6, 200].contains(&record[16]);
    let filtered: Vec<u8> = records
        .chunks_exact(size)
        .filter(|record| inside(record) && classes(record))
        .flatten()
        .copied()
        .collect();
    assert!(filtered.len() > 50 * size, "the test selects something");
    let options = ["--bounds", &bounds, "--class", "2,6,200"];
    for name in ["out.las", "out.laz", "out.copc.laz"] {
        let path = case.export(name, &options);
        let found = LasScan::open(&path).expect("it opens");
        assert!(found.facts().warnings.is_empty(), "{name}: {:?}", found.facts().warnings);
        let found = read_all(&found).expect("it reads");
        assert!(sorted(&found, size) == sorted(&filtered, size), "{name}");
    }
    let places = |records: &[u8]| {
        let mut places: Vec<[i32; 3]> =
            records.chunks_exact(size).map(record_coordinates).collect();
        places.sort_unstable();
        places
    };
    for name in ["out.ply", "out.csv", "out.pts", "out.xyz", "out.txt"] {
        let path = case.export(name, &options);
        let bytes = std::fs::read(&path).expect("it is there");
        let table = match name.rsplit('.').next().expect("a suffix") {
            "ply" => read_ply(&bytes),
            suffix => {
                let content = String::from_utf8(bytes).expect("text");
                let separator = if suffix == "csv" { ',' } else { ' ' };
                match suffix {
                    "csv" | "txt" => read_delimited(&content, separator),
                    "pts" => {
                        let (count, rest) = content.split_once('\n').expect("a first line");
                        assert_eq!(count.trim().parse(), Ok(filtered.len() / size), "{name}");
                        read_delimited(&format!("x y z i r g b\n{rest}"), separator)
                    }
                    _ => read_delimited(&format!("x y z i r g b\n{content}"), separator),
                }
            }
        };
        let column = |name| table.column(name).expect("there").to_vec();
        let (x, y, z) = (column("x"), column("y"), column("z"));
        let mut found: Vec<[i32; 3]> = (0..x.len())
            .map(|i| lattice.lattice(glam::DVec3::new(x[i], y[i], z[i])).round().as_ivec3().into())
            .collect();
        found.sort_unstable();
        assert!(found == places(&filtered), "{name}");
    }
    // A budget: exactly as many, the same in every format, each of them a point of the scan.
    for budget in ["1", "1000", "30001"] {
        let count: u64 = budget.parse().expect("a number");
        let mut seen: Option<Vec<u8>> = None;
        for name in ["out.las", "out.copc.laz"] {
            let found = LasScan::open(&case.export(name, &["--budget", budget])).expect("it opens");
            assert_eq!(found.points(), count, "{name}");
            let found = sorted(&read_all(&found).expect("it reads"), size).concat();
            assert!(seen.as_ref().is_none_or(|seen| *seen == found), "{name}");
            seen = Some(found);
        }
    }
}

#[test]
fn a_failed_export_leaves_nothing_and_an_existing_file_stays() {
    let case = Case::noise(20_000, 3, 0, 14, &[]);
    let store = case.store();
    let mut bytes = std::fs::read(&store).expect("the store reads");
    let at = bytes.len() * 3 / 4;
    bytes[at] ^= 0x55;
    std::fs::write(&store, bytes).expect("it can be damaged");
    for name in ["out.las", "out.laz", "out.copc.laz", "out.ply", "out.csv"] {
        let output = case.folder.path().join(name);
        let before = std::fs::read_dir(case.folder.path()).expect("it lists").count();
        let failed = esker(&["export", text(&store), "-o", text(&output)]);
        assert_eq!(failed.status.code(), Some(1), "{name}");
        let message = String::from_utf8_lossy(&failed.stderr).into_owned();
        assert!(message.contains("scan.esker") && message.contains("checksum"), "{message}");
        let after = std::fs::read_dir(case.folder.path()).expect("it lists").count();
        assert_eq!(before, after, "{name} left something behind");
        std::fs::write(&output, "precious").expect("a file");
        let refused = esker(&["export", text(&store), "-o", text(&output)]);
        assert_eq!(refused.status.code(), Some(1));
        assert!(String::from_utf8_lossy(&refused.stderr).contains("--overwrite"));
        assert_eq!(std::fs::read(&output).expect("it is there"), b"precious");
        std::fs::remove_file(&output).expect("it goes");
    }
    let odd = case.folder.path().join("out.obj");
    let refused = esker(&["export", text(&store), "-o", text(&odd)]);
    assert!(String::from_utf8_lossy(&refused.stderr).contains(".copc.laz"));
}
