//! Protects exports to PLY and text, and selections in every format: every point and attribute comes
//! out exactly, and a selection gives what filtering all points gives.

#[path = "support/export_case.rs"]
mod export_case;
#[path = "support/las_files.rs"]
mod las_files;
#[path = "support/tables.rs"]
mod tables;

use esker::input::{LasScan, PointFormat};
use esker::points::record_coordinates;
use export_case::{Case, Fields, all_fields, esker, sorted, text};
use las_files::read_all;
use tables::{Table, read_delimited, read_ply};

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
