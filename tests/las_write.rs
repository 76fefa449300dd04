//! The writer of LAS and LAZ files: what goes in comes back, for every point format.
//!
//! Oracles: the records themselves, the bytes of real files, the crate `las` for headers and
//! records, and the sequential decompressor of `laz`.

#[path = "support/las_files.rs"]
mod las_files;

use std::fs::File;
use std::io::{BufReader, Seek, SeekFrom};

use esker::input::{LasScan, LasTemplate, PointFormat, Vlr};
use esker::output::{Compression, LasWriter, WriteError};
use esker::sampling::records;
use las_files::{least_minor, read_all, schema, shared, template, write};

#[test]
fn every_point_format_comes_back_from_las_and_laz() {
    let folder = tempfile::tempdir().unwrap();
    for format in 0..=10u8 {
        for extra in [0, 5] {
            for (minor, suffix) in
                [(least_minor(format), "las"), (4, "las"), (4, "laz"), (least_minor(format), "laz")]
            {
                let path = folder.path().join(format!("{format}-{extra}-{minor}.{suffix}"));
                let laz = suffix == "laz";
                let compression = if laz { Compression::Laz } else { Compression::None };
                let count = 1_500;
                let records = records::noise(count, format, extra, u64::from(format));
                let template = template(minor, format, extra);
                let report = write(&path, &template, compression, &records);
                assert_eq!(report.points, count as u64);
                assert_eq!(report.bytes, std::fs::metadata(&path).unwrap().len());

                let scan = LasScan::open(&path).unwrap();
                let facts = scan.facts();
                assert_eq!((facts.points, facts.points_exact), (count as u64, true));
                assert!(facts.warnings.is_empty(), "{format}: {:?}", facts.warnings);
                assert_eq!(facts.version, format!("1.{minor}"));
                assert!(read_all(&scan).unwrap() == records, "format {format} {extra} {suffix}");
                check_header(&scan, &records);
                if laz {
                    assert!(decompressed(&scan) == records, "format {format} by laz itself");
                }
            }
        }
    }
}

/// Counts, returns and bounds of the header against the records.
fn check_header(scan: &LasScan, records: &[u8]) {
    let header = scan.header();
    let size = usize::from(header.record_bytes);
    let mut returns = [0u64; 16];
    let mut bounds = esker::geometry::Aabb::EMPTY;
    for record in records.chunks_exact(size) {
        let number = record[14] & if header.point_format.number() >= 6 { 15 } else { 7 };
        returns[usize::from(number)] += 1;
        let integers = esker::points::record_coordinates(record).map(i64::from);
        bounds = bounds.including(header.lattice.world(integers.into()));
    }
    assert_eq!(header.bounds, bounds);
    assert_eq!(header.claimed_count(), (records.len() / size) as u64);
    if header.minor == 4 {
        assert_eq!(header.extended_returns.unwrap()[..], returns[1..]);
        assert_eq!(header.extended_count, Some((records.len() / size) as u64));
    }
    let legacy =
        if header.point_format.number() >= 6 { [0; 5] } else { returns[1..6].try_into().unwrap() };
    assert_eq!(header.legacy_returns, legacy);
}

fn decompressed(scan: &LasScan) -> Vec<u8> {
    let vlr = scan.template().vlrs().into_iter().find(Vlr::is_laszip).unwrap();
    let data = &scan.template().vlr_bytes()[vlr.data.start as usize..vlr.data.end as usize];
    let mut file = BufReader::new(File::open(scan.path()).unwrap());
    file.seek(SeekFrom::Start(u64::from(scan.header().point_data_offset))).unwrap();
    let vlr = laz::LazVlr::from_buffer(data).unwrap();
    let mut all = vec![0; scan.points() as usize * usize::from(scan.header().record_bytes)];
    laz::LasZipDecompressor::new(file, vlr).unwrap().decompress_many(&mut all).unwrap();
    all
}

#[test]
fn chunks_are_the_same_for_any_number_of_threads_and_any_batches() {
    let folder = tempfile::tempdir().unwrap();
    let records = records::noise(230_000, 1, 0, 3);
    let template = template(2, 1, 0);
    let mut files = Vec::new();
    for (threads, batch) in [(1, 230_000), (2, 1), (3, 70_001)] {
        let path = folder.path().join(format!("{threads}.laz"));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut writer =
                LasWriter::create(&path, &template, &schema(&template), Compression::Laz).unwrap();
            for part in records.chunks(28 * batch) {
                writer.write(part).unwrap();
            }
            writer.finish(&mut std::io::empty()).unwrap();
        });
        files.push(std::fs::read(&path).unwrap());
        let scan = LasScan::open(&path).unwrap();
        let chunks: Vec<u64> = scan.blocks().iter().map(|block| block.points).collect();
        assert_eq!(chunks, [50_000, 50_000, 50_000, 50_000, 30_000]);
        assert!(read_all(&scan).unwrap() == records);
    }
    assert!(files[0] == files[1] && files[0] == files[2]);
}

/// A real file read and written again, with its extended records.
fn written_again(name: &str, suffix: &str) -> Option<(LasScan, LasScan, tempfile::TempDir)> {
    let source = LasScan::open(&shared(name)?).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(format!("again.{suffix}"));
    let compression = if suffix == "laz" { Compression::Laz } else { Compression::None };
    let mut writer =
        LasWriter::create(&path, source.template(), source.schema(), compression).unwrap();
    writer.write(&read_all(&source).unwrap()).unwrap();
    let mut evlrs = Vec::new();
    for range in source.template().evlrs() {
        let mut bytes = vec![0; (range.end - range.start) as usize];
        source.read_bytes(range.start, &mut bytes).unwrap();
        evlrs.extend(bytes);
    }
    writer.finish(&mut &evlrs[..]).unwrap();
    let again = LasScan::open(&path).unwrap();
    Some((source, again, folder))
}

#[test]
fn real_files_come_back_with_their_records_and_variable_length_records() {
    let names = [
        "4_6_crop.las",
        "autzen_trim_7.las",
        "epsg_4326.las",
        "extrabytes.las",
        "fullwave-pf10.laz",
        "lion_takanawa.copc.laz",
        "pdrf4-1.3.laz",
        "pdrf9-1.4.laz",
        "pf0-pointwise.laz",
        "pf4-1.3-fullwave.las",
    ];
    for name in names {
        for suffix in ["las", "laz"] {
            let Some((source, again, _folder)) = written_again(name, suffix) else { continue };
            assert!(read_all(&source).unwrap() == read_all(&again).unwrap(), "{name} {suffix}");
            assert_eq!(again.facts().warnings, Vec::<String>::new(), "{name} {suffix}");
            assert_eq!(source.schema(), again.schema());
            assert_eq!(source.facts().crs, again.facts().crs);
            let kept = |scan: &LasScan| -> Vec<(String, u16, Vec<u8>)> {
                let vlrs = scan.template().vlrs();
                let vlrs = vlrs.into_iter().chain(scan.evlrs().iter().cloned());
                let kept = vlrs.filter(|vlr| !vlr.is_laszip() && !vlr.is_copc());
                kept.map(|vlr| (vlr.user_id.clone(), vlr.record_id, data(scan, &vlr))).collect()
            };
            assert_eq!(kept(&source), kept(&again), "{name} {suffix}");
            let laszip = again.template().vlrs().iter().filter(|vlr| vlr.is_laszip()).count();
            assert_eq!(laszip, usize::from(suffix == "laz"));
            check_rest_of_header(&source, &again, name);
        }
    }
}

fn data(scan: &LasScan, vlr: &Vlr) -> Vec<u8> {
    if vlr.extended {
        let mut bytes = vec![0; (vlr.data.end - vlr.data.start) as usize];
        scan.read_bytes(vlr.data.start, &mut bytes).unwrap();
        bytes
    } else {
        scan.template().vlr_bytes()[vlr.data.start as usize..vlr.data.end as usize].to_vec()
    }
}

/// Everything in the header except counts, bounds, places and the compression bit.
fn check_rest_of_header(source: &LasScan, again: &LasScan, name: &str) {
    let [a, b] = [source, again].map(|scan| scan.template().header_bytes());
    for part in [0..96, 105..107, 131..179] {
        assert_eq!(a[part.clone()], b[part.clone()], "{name} bytes {part:?}");
    }
    assert_eq!(a.len(), b.len());
}

#[test]
fn an_uncompressed_file_comes_back_byte_for_byte() {
    // Files whose headers are exact and whose writers left nothing unusual.
    for name in ["autzen_trim_7.las", "extrabytes.las", "4_6_crop.las", "pf4-1.3-fullwave.las"] {
        let Some((source, again, _folder)) = written_again(name, "las") else { continue };
        let [a, b] = [&source, &again].map(|scan| std::fs::read(scan.path()).unwrap());
        assert_eq!(a.len(), b.len(), "{name}");
        let points = source.header().point_data_offset as usize;
        assert!(a[points..] == b[points..], "{name}");
        let header = usize::from(source.header().header_bytes);
        assert!(a[header..points] == b[header..points], "{name}");
    }
}

#[test]
fn no_point_and_one_point_make_files() {
    let folder = tempfile::tempdir().unwrap();
    for format in [0, 4, 6, 10] {
        for count in [0, 1] {
            for compression in [Compression::None, Compression::Laz] {
                let path = folder.path().join("few.las");
                let records = records::noise(count, format, 0, 1);
                write(&path, &template(4, format, 0), compression, &records);
                let scan = LasScan::open(&path).unwrap();
                assert_eq!(scan.points(), count as u64);
                assert!(scan.facts().warnings.is_empty(), "{:?}", scan.facts().warnings);
                assert!(read_all(&scan).unwrap() == records);
            }
        }
    }
}

#[test]
fn nothing_stands_under_the_name_before_the_end_nor_is_left_without_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.laz");
    let template = template(2, 0, 0);
    let mut writer =
        LasWriter::create(&path, &template, &schema(&template), Compression::Laz).unwrap();
    writer.write(&records::noise(10, 0, 0, 1)).unwrap();
    assert!(!path.exists());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file beside it");
    drop(writer);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn what_cannot_be_written_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let template = template(2, 0, 0);
    let other = PointFormat::new(1).unwrap().schema(28, &[]).0;
    let path = folder.path().join("scan.las");
    let wrong = LasWriter::create(&path, &template, &other, Compression::None);
    assert!(matches!(wrong, Err(WriteError::RecordBytes { found: 28, expected: 20, .. })));
    let nowhere = folder.path().join("no/such/folder.las");
    let wrong = LasWriter::create(&nowhere, &template, &schema(&template), Compression::None);
    let text = wrong.err().unwrap().to_string();
    assert!(text.contains("cannot create") && text.contains("folder.las"), "{text}");
    // An extended record that ends early.
    let writer =
        LasWriter::create(&path, &template, &schema(&template), Compression::None).unwrap();
    let wrong = writer.finish(&mut &[7u8; 59][..]);
    assert!(matches!(wrong, Err(WriteError::Evlr { index: 1, .. })), "{wrong:?}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_template_keeps_the_place_of_its_records() {
    let plain = template(4, 6, 0);
    let with = plain.with_vlr("LASF_Projection", 2112, b"LOCAL_CS[\"x\"]\0").unwrap();
    let with = with.with_vlr("someone", 7, &[1, 2, 3]).unwrap();
    let parsed = LasTemplate::new(
        with.header_bytes().to_vec(),
        with.vlr_bytes().to_vec(),
        with.evlrs().to_vec(),
    );
    assert_eq!(parsed.unwrap(), with);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.laz");
    write(&path, &with, Compression::Laz, &records::noise(3, 6, 0, 1));
    let scan = LasScan::open(&path).unwrap();
    let ids: Vec<_> = scan.facts().vlrs.iter().map(|vlr| vlr.record_id).collect();
    assert_eq!(ids, [2112, 7, 22_204]);
    assert_eq!(scan.facts().crs.wkt.as_deref(), Some("LOCAL_CS[\"x\"]"));
    let mut short = with.header_bytes().to_vec();
    short[100] = 9; // nine records claimed
    assert!(LasTemplate::new(short, with.vlr_bytes().to_vec(), Vec::new()).is_err());
}
