//! The reader of LAS and LAZ files, on real scans: every file gives the points its origin tells,
//! whichever path through the reader they take.
//!
//! Oracles: the counts published with the files, the crate `las` for plain records, the sequential
//! decompressor of `laz` for compressed ones (our reader takes chunks apart itself), and one scan
//! that is stored in two ways.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use esker::input::{Block, BlockBuffer, FileKind, LasError, LasScan, ScanFormat, detect};
use esker::points::{names, record_coordinates};

/// Name, points, point format, minor version.
const FILES: [(&str, u64, u8, u8); 17] = [
    ("4_6_crop.las", 23_875, 3, 2),
    ("autzen-rgb-10m.laz", 10_653_336, 2, 2),
    ("autzen_trim_7.las", 110_000, 7, 4),
    ("epsg_4326.las", 5_380, 0, 2),
    ("extrabytes.las", 1_065, 3, 4),
    ("fullwave-pf10.laz", 10_750, 10, 4),
    ("ign-1km-pf6.laz", 289_055, 6, 4),
    ("ign-semis-2022-pf8.laz", 697_721, 8, 4),
    ("indoor.laz", 808_042, 3, 2),
    ("lion_takanawa.copc.laz", 341_989, 7, 4),
    ("lone-star.copc.laz", 518_862, 6, 4),
    ("lone-star.laz", 518_862, 1, 1),
    ("pdrf4-1.3.laz", 1_024, 4, 3),
    ("pdrf5-1.3.laz", 1_024, 5, 3),
    ("pdrf9-1.4.laz", 1_024, 9, 4),
    ("pf0-pointwise.laz", 11_781, 0, 0),
    ("pf4-1.3-fullwave.las", 999, 4, 3),
];

/// The file of that name among the shared scans; says so where they are not.
fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    let there = path.exists();
    if !there {
        eprintln!("skipped: {} is not there", path.display());
    }
    there.then_some(path)
}

/// All records of a scan, in order.
fn records(scan: &LasScan) -> Vec<u8> {
    let mut all = Vec::new();
    let mut buffer = BlockBuffer::default();
    let record_bytes = scan.schema().record_bytes as usize;
    for block in scan.blocks() {
        let points = read(scan, block, &mut buffer, &mut |first, records| {
            assert_eq!(all.len() as u64, first * record_bytes as u64, "batches follow each other");
            assert!(!records.is_empty() && records.len().is_multiple_of(record_bytes));
            all.extend_from_slice(records);
        });
        assert_eq!(points, block.points);
    }
    all
}

fn read(
    scan: &LasScan,
    block: &Block,
    buffer: &mut BlockBuffer,
    sink: &mut dyn FnMut(u64, &[u8]),
) -> u64 {
    let outcome = scan.read_block::<LasError>(block, buffer, &mut |first, records| {
        sink(first, records);
        Ok(())
    });
    outcome.unwrap()
}

#[test]
fn every_file_holds_the_points_that_its_origin_tells() {
    for (name, points, format, minor) in FILES {
        let Some(path) = shared(name) else { continue };
        let scan = LasScan::open(&path).unwrap();
        let facts = scan.facts();
        assert_eq!(facts.points, points, "{name}");
        assert_eq!(facts.point_format, format, "{name}");
        assert_eq!(facts.version, format!("1.{minor}"), "{name}");
        assert_eq!(facts.points_exact, name != "pf0-pointwise.laz", "{name}");
        assert!(facts.warnings.is_empty(), "{name}: {:?}", facts.warnings);
        assert!(scan.schema().covers_record(), "{name}");
        let laz = name.ends_with(".laz");
        assert_eq!(facts.format, if laz { ScanFormat::Laz } else { ScanFormat::Las });
        assert_eq!(detect(&path).unwrap(), if laz { FileKind::Laz } else { FileKind::Las });
        if name == "autzen-rgb-10m.laz" {
            continue; // Its points are counted below, from two threads.
        }
        let record_bytes = u64::from(facts.record_bytes);
        let all = records(&scan);
        assert_eq!(all.len() as u64, points * record_bytes, "{name}");
        let lattice = scan.lattice();
        let mut bounds = esker::geometry::Aabb::EMPTY;
        for record in all.chunks_exact(record_bytes as usize) {
            let integers = record_coordinates(record).map(i64::from);
            bounds = bounds.including(lattice.world(integers.into()));
        }
        // Headers are right to within ten steps (one rounds), except those of the codec fixtures,
        // whose coordinates are noise, and one in other units than its points.
        if !name.starts_with("pdrf") && name != "pf4-1.3-fullwave.las" {
            let header = scan.header().bounds;
            let off = (bounds.min - header.min).abs().max((bounds.max - header.max).abs());
            assert!(off.cmple(10.01 * lattice.scale).all(), "{name}: {bounds:?} {header:?}");
        }
    }
}

#[test]
fn blocks_are_independent_of_thread_and_order() {
    let Some(path) = shared("autzen-rgb-10m.laz") else { return };
    let scan = LasScan::open(&path).unwrap();
    // Every eighth chunk keeps this quick in a debug build; the last, odd one is among them.
    let blocks: Vec<&Block> = scan.blocks().iter().rev().step_by(8).collect();
    let sums = |blocks: Vec<&Block>| -> HashMap<u64, (u64, u32)> {
        let mut sums = HashMap::new();
        let mut buffer = BlockBuffer::default();
        for block in blocks {
            let mut sum = 0;
            let points = read(&scan, block, &mut buffer, &mut |_, records| {
                sum = crc32c::crc32c_append(sum, records);
            });
            assert_eq!(points, block.points);
            sums.insert(block.first_point, (points, sum));
        }
        sums
    };
    let one = sums(blocks.clone());
    let halves = std::thread::scope(|scope| {
        let (even, odd) = blocks.split_at(blocks.len() / 2);
        let threads =
            [even, odd].map(|half| scope.spawn(|| sums(half.iter().rev().copied().collect())));
        threads.map(|thread| thread.join().unwrap())
    });
    let two: HashMap<_, _> = halves.into_iter().flatten().collect();
    assert_eq!(one, two);
    assert_eq!(scan.blocks().iter().map(|block| block.points).sum::<u64>(), 10_653_336);
}

#[test]
fn plain_columns_are_those_of_the_las_crate() {
    for (name, points, ..) in FILES.into_iter().filter(|file| file.0.ends_with(".las")) {
        let Some(path) = shared(name) else { continue };
        let scan = LasScan::open(&path).unwrap();
        let all = records(&scan);
        let theirs = las::Reader::from_path(&path).unwrap().read_all().unwrap();
        assert_eq!(theirs.len() as u64, points);
        let rows = || all.chunks_exact(scan.schema().record_bytes as usize);
        let column = |attribute: &str, component: usize| -> Option<Vec<f64>> {
            let (_, attribute) = scan.schema().find(attribute)?;
            let at = attribute.record_offset as usize + component * attribute.scalar.bytes();
            Some(rows().map(|row| attribute.scalar.read(&row[at..])).collect())
        };
        let coordinate = |axis: usize| rows().map(move |row| record_coordinates(row)[axis]);
        assert!(theirs.x_raw().eq(coordinate(0)), "{name} x");
        assert!(theirs.y_raw().eq(coordinate(1)), "{name} y");
        assert!(theirs.z_raw().eq(coordinate(2)), "{name} z");
        let same = |attribute: &str, component: usize, theirs: Option<Vec<f64>>| {
            assert!(column(attribute, component) == theirs, "{name} {attribute} {component}");
        };
        same(names::INTENSITY, 0, Some(theirs.intensity().map(f64::from).collect()));
        same(names::USER_DATA, 0, Some(theirs.user_data().map(f64::from).collect()));
        same(names::POINT_SOURCE_ID, 0, Some(theirs.point_source_id().map(f64::from).collect()));
        same(names::GPS_TIME, 0, theirs.gps_time().map(|times| times.collect()));
        for channel in 0..3 {
            let pick = |(r, g, b)| f64::from([r, g, b][channel]);
            same(names::RGB, channel, theirs.rgb().map(|colors| colors.map(pick).collect()));
        }
        same(names::NIR, 0, theirs.nir().map(|nir| nir.map(f64::from).collect()));
        let format = scan.header().point_format;
        assert!(theirs.return_number().eq(rows().map(|row| format.return_number(row))));
    }
}

#[test]
fn compressed_records_are_those_of_the_sequential_decompressor() {
    for (name, points, ..) in FILES.into_iter().filter(|file| file.0.ends_with(".laz")) {
        if name == "autzen-rgb-10m.laz" {
            continue;
        }
        let Some(path) = shared(name) else { continue };
        let scan = LasScan::open(&path).unwrap();
        let ours = records(&scan);
        let vlr = scan.template().vlrs().into_iter().find(|vlr| vlr.is_laszip()).unwrap();
        let data = &scan.template().vlr_bytes()[vlr.data.start as usize..vlr.data.end as usize];
        let mut file = BufReader::new(File::open(&path).unwrap());
        file.seek(SeekFrom::Start(u64::from(scan.header().point_data_offset))).unwrap();
        let vlr = laz::LazVlr::from_buffer(data).unwrap();
        let mut theirs = laz::LasZipDecompressor::new(file, vlr).unwrap();
        let mut record = vec![0; scan.schema().record_bytes as usize];
        for (index, our) in ours.chunks_exact(record.len()).enumerate().take(points as usize) {
            theirs.decompress_one(&mut record).unwrap();
            assert_eq!(our, record, "{name}, point {index}");
        }
    }
}

#[test]
fn a_scan_as_laz_and_as_copc_is_the_same_cloud() {
    let (Some(laz), Some(copc)) = (shared("lone-star.laz"), shared("lone-star.copc.laz")) else {
        return;
    };
    let sorted = |path: &Path| {
        let scan = LasScan::open(path).unwrap();
        let record_bytes = scan.schema().record_bytes as usize;
        let lattice = scan.lattice();
        let mut positions: Vec<[i64; 3]> = records(&scan)
            .chunks_exact(record_bytes)
            .map(|record| {
                // Both files measure in quarters of a millimetre, from different origins.
                let world = lattice.world(record_coordinates(record).map(i64::from).into());
                (world / 0.000_25).round().as_i64vec3().to_array()
            })
            .collect();
        positions.sort_unstable();
        positions
    };
    assert!(sorted(&laz) == sorted(&copc));
}

#[test]
fn reference_systems_are_kept_and_their_codes_told() {
    let codes = [
        ("4_6_crop.las", Some(2903)),
        ("autzen_trim_7.las", None),
        ("epsg_4326.las", Some(4326)),
        ("ign-semis-2022-pf8.laz", Some(2154)),
        ("ign-1km-pf6.laz", Some(2154)),
        ("lone-star.copc.laz", None),
        ("indoor.laz", None),
    ];
    for (name, code) in codes {
        let Some(path) = shared(name) else { continue };
        let scan = LasScan::open(&path).unwrap();
        assert_eq!(scan.facts().crs.epsg, code, "{name}");
    }
}

#[test]
fn columns_carry_the_names_that_files_give_them() {
    let columns = [
        ("extrabytes.las", "Colors Reserved Flags Intensity Time"),
        ("ign-semis-2022-pf8.laz", "Deviation confidence"),
        ("lion_takanawa.copc.laz", "OriginId"),
        ("pdrf4-1.3.laz", "extra"),
        ("pdrf9-1.4.laz", "FIELD_0 FIELD_1 FIELD_2 FIELD_3"),
    ];
    for (name, expected) in columns {
        let Some(path) = shared(name) else { continue };
        let scan = LasScan::open(&path).unwrap();
        let base = usize::from(scan.header().point_format.base_bytes());
        let attributes = scan.schema().attributes.iter();
        let extra: Vec<_> = attributes.filter(|a| a.record_offset as usize >= base).collect();
        let names: Vec<_> = extra.iter().map(|a| a.name.as_str()).collect();
        assert_eq!(names.join(" "), expected, "{name}");
    }
}
