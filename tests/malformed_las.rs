//! The reader of LAS and LAZ files against damaged ones: every one is read or refused with a clear
//! line, none brings a panic, a hang, or memory that the file merely claims.
//!
//! Named cases check the fault and its place. Truncation and bit flips are swept over small files
//! of several formats, with fixed seeds; there the check is that every answer is a value, that
//! what is handed out is whole records, and that no more comes out than compressed bytes can hold.

#[path = "support/las_files.rs"]
mod las_files;
#[path = "support/watched_memory.rs"]
mod watched_memory;

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use esker::input::{BlockBuffer, FileKind, LasError, LasFault, LasScan, detect, place};
use esker::output::Compression;
use esker::sampling::{Random, records};
use las_files::{least_minor, read_all, shared, template, write};
use watched_memory::LARGEST;

/// More than any honest need of these small files: a batch of records is 4 MiB at most, and grows
/// by doubling where the test collects them.
const MOST_MEMORY: usize = 48 << 20;

/// A small scan in memory that tests damage and put to disk.
struct Specimen {
    bytes: Vec<u8>,
    folder: tempfile::TempDir,
}

impl Specimen {
    fn new(minor: u8, format: u8, extra: u16, count: usize, compression: Compression) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan");
        let template = template(minor, format, extra);
        let template = template.with_vlr("LASF_Projection", 2112, b"LOCAL_CS[\"x\"]").unwrap();
        write(&path, &template, compression, &records::noise(count, format, extra, 5));
        Specimen { bytes: std::fs::read(&path).unwrap(), folder }
    }

    fn las() -> Self {
        Self::new(2, 3, 0, 500, Compression::None)
    }

    fn laz() -> Self {
        Self::new(2, 3, 0, 500, Compression::Laz)
    }

    fn layered() -> Self {
        Self::new(4, 7, 2, 500, Compression::Laz)
    }

    fn from_file(path: &Path) -> Self {
        let folder = tempfile::tempdir().unwrap();
        Specimen { bytes: std::fs::read(path).unwrap(), folder }
    }

    fn put(mut self, at: usize, value: &[u8]) -> Self {
        self.bytes[at..at + value.len()].copy_from_slice(value);
        self
    }

    fn u32_at(&self, at: usize) -> u32 {
        u32::from_le_bytes(self.bytes[at..at + 4].try_into().unwrap())
    }

    fn points_start(&self) -> usize {
        self.u32_at(place::POINT_DATA_OFFSET) as usize
    }

    fn write(&self, bytes: &[u8]) -> PathBuf {
        let path = self.folder.path().join("damaged");
        std::fs::write(&path, bytes).unwrap();
        path
    }

    fn open(&self) -> Result<LasScan, LasError> {
        LasScan::open(&self.write(&self.bytes))
    }

    /// The fault of opening and reading.
    fn fault(&self) -> LasFault {
        let outcome = self.open().and_then(|scan| read_all(&scan));
        let error = outcome.map(|records| records.len()).expect_err("it is damaged");
        let text = error.to_string();
        assert!(!text.contains('\n') && text.contains("damaged"), "one line with the file: {text}");
        error.fault
    }

    /// The records and the warnings of a file that is odd but readable.
    fn readable(&self) -> (Vec<u8>, Vec<String>) {
        let scan = self.open().unwrap();
        let records = read_all(&scan).unwrap();
        let size = usize::from(scan.header().record_bytes);
        if scan.facts().points_exact {
            assert_eq!(records.len() as u64, scan.points() * size as u64);
        }
        (records, scan.facts().warnings.clone())
    }
}

macro_rules! assert_fault {
    ($fault:expr, $($pattern:tt)+) => {
        let fault = $fault;
        assert!(matches!(fault, $($pattern)+), "{fault}: {fault:?}");
    };
}

#[test]
fn what_is_no_scan_is_told() {
    let specimen = Specimen::las();
    let open = |path: &Path| LasScan::open(path).map(|_| ()).unwrap_err().fault;
    assert_fault!(open(specimen.folder.path()), LasFault::NotAFile { found: "a directory" });
    assert_fault!(open(Path::new("/no/such/file.las")), LasFault::Io { action: "open", .. });
    assert_fault!(open(&specimen.write(b"")), LasFault::Empty);
    assert_fault!(open(&specimen.write(b"ply\nformat ascii 1.0\n")), LasFault::NotAScan { .. });
    let text = open(&specimen.write(b"\x89PNG\r\n\x1a\n")).to_string();
    assert!(text.contains(r"\x89PNG\r\n"), "{text}");
    assert_fault!(
        open(&specimen.write(&specimen.bytes[..226])),
        LasFault::HeaderTruncated { file_bytes: 226, needed_bytes: 227 }
    );
    #[cfg(unix)]
    assert_fault!(open(Path::new("/dev/null")), LasFault::NotAFile { .. });

    assert_eq!(detect(&specimen.write(b"LASF")).unwrap(), FileKind::Las);
    assert_eq!(detect(&specimen.write(b"x")).unwrap(), FileKind::Other);
    assert_eq!(detect(&specimen.write(&Specimen::laz().bytes)).unwrap(), FileKind::Laz);
    assert!(detect(specimen.folder.path()).is_err());
}

#[test]
fn headers_that_make_no_sense_are_told() {
    let las = Specimen::las;
    assert_fault!(las().put(25, &[6]).fault(), LasFault::UnknownVersion { major: 1, minor: 6 });
    assert_fault!(las().put(24, &[2]).fault(), LasFault::UnknownVersion { major: 2, .. });
    assert_fault!(las().put(104, &[11]).fault(), LasFault::UnknownPointFormat { format: 11 });
    assert_fault!(
        las().put(104, &[0x80 | 63]).fault(),
        LasFault::UnknownPointFormat { format: 63 }
    );
    let short = las().put(place::RECORD_BYTES, &33u16.to_le_bytes());
    assert_fault!(
        short.fault(),
        LasFault::RecordLength { record_bytes: 33, format: 3, least_bytes: 34 }
    );
    let small = las().put(place::HEADER_BYTES, &200u16.to_le_bytes());
    assert_fault!(small.fault(), LasFault::HeaderSize { header_bytes: 200, .. });
    let wide = las().put(place::HEADER_BYTES, &u16::MAX.to_le_bytes());
    assert_fault!(wide.fault(), LasFault::HeaderTruncated { needed_bytes: 65_535, .. });
    for offset in [0, 226, u32::MAX] {
        let moved = las().put(place::POINT_DATA_OFFSET, &offset.to_le_bytes());
        assert_fault!(moved.fault(), LasFault::PointDataOffset { .. });
    }
    let many = las().put(place::VLR_COUNT, &u32::MAX.to_le_bytes());
    assert_fault!(many.fault(), LasFault::Limit { what: "number of VLRs", .. });
    let more = las().put(place::VLR_COUNT, &2u32.to_le_bytes());
    assert_fault!(more.fault(), LasFault::Record { kind: "VLR", index: 2, count: 2, .. });
    let long = las().put(227 + 20, &u16::MAX.to_le_bytes());
    assert_fault!(long.fault(), LasFault::Record { kind: "VLR", index: 1, byte: 227, .. });
}

#[test]
fn coordinates_that_name_no_place_are_told() {
    for (value, axis) in [0.0, -0.01, f64::NAN, f64::INFINITY].into_iter().zip("xyzx".chars()) {
        let at = place::SCALE + 8 * "xyz".find(axis).unwrap();
        let fault = Specimen::las().put(at, &value.to_le_bytes()).fault();
        let text = fault.to_string();
        assert!(text.starts_with(&format!("{axis} scale factor is {value}")), "{text}");
    }
    for value in [f64::NAN, f64::NEG_INFINITY] {
        let fault = Specimen::laz().put(place::OFFSET + 8, &value.to_le_bytes()).fault();
        assert_fault!(fault, LasFault::Offset { axis: 'y', byte: 163, .. });
    }
    for value in [1e305, 1e-320f64] {
        let fault = Specimen::las().put(place::SCALE, &value.to_le_bytes()).fault();
        assert_fault!(fault, LasFault::Lattice { axis: 'x', .. });
    }
}

#[test]
fn extended_records_past_the_end_are_told() {
    let layered = || Specimen::layered().put(place::EVLR_COUNT, &1u32.to_le_bytes());
    for start in [u64::MAX, u64::MAX - 59, 1 << 40] {
        let fault = layered().put(place::EVLR_START, &start.to_le_bytes()).fault();
        assert_fault!(fault, LasFault::Record { kind: "EVLR", index: 1, .. });
    }
    let within = layered().put(place::EVLR_START, &375u64.to_le_bytes());
    assert_fault!(within.fault(), LasFault::Record { kind: "EVLR", .. });
    let many = layered().put(place::EVLR_START, &375u64.to_le_bytes());
    let many = many.put(place::EVLR_COUNT, &u32::MAX.to_le_bytes());
    assert_fault!(many.fault(), LasFault::Limit { what: "number of EVLRs", .. });
}

#[test]
fn a_truncated_las_file_is_told_with_its_record() {
    let las = Specimen::las();
    let start = las.points_start();
    for (bytes, whole) in [(34 * 300, 300), (34 * 300 + 33, 300), (0, 0), (34 * 500 - 1, 499)] {
        let path = las.write(&las.bytes[..start + bytes]);
        let fault = LasScan::open(&path).map(|_| ()).unwrap_err().fault;
        let (record, end) = (whole + 1, (start + bytes) as u64);
        match fault {
            LasFault::Truncated { record: told, count: 500, end_byte, .. } => {
                assert_eq!((told, end_byte), (record, end));
            }
            other => panic!("{other}"),
        }
    }
    let huge = Specimen::las().put(place::LEGACY_COUNT, &u32::MAX.to_le_bytes());
    assert_fault!(huge.fault(), LasFault::Truncated { record: 501, count: 4_294_967_295, .. });
}

#[test]
fn a_las_count_that_is_too_low_loses_no_point() {
    let whole = Specimen::las().readable().0;
    for count in [0u32, 1, 499] {
        let (records, warnings) =
            Specimen::las().put(place::LEGACY_COUNT, &count.to_le_bytes()).readable();
        assert!(records == whole);
        let told = warnings.iter().any(|text| text.contains(&format!("claims {count} points")));
        assert!(told, "{warnings:?}");
    }
    // Zeros behind the last record are room that someone allocated, not points.
    let mut padded = Specimen::las();
    padded.bytes.extend([0; 34 * 3 + 5]);
    let (records, warnings) = padded.readable();
    assert!(records == whole && warnings[0].contains("107 bytes of zeros"), "{warnings:?}");
    // Less than a record is not a record.
    let mut odd = Specimen::las();
    odd.bytes.extend([7; 33]);
    let (records, warnings) = odd.readable();
    assert!(records == whole && warnings[0].contains("33 bytes after"), "{warnings:?}");
}

#[test]
fn a_count_that_returns_or_extended_records_contradict_is_told() {
    // 500 points by return, 700 claimed: the file is whole, the count is wrong. Records of noise
    // have return number 0 too, so the sum is put right first.
    let mut las = Specimen::las();
    for i in 0..5 {
        let count = if i == 0 { 500u32 } else { 0 };
        las = las.put(place::LEGACY_RETURNS + 4 * i, &count.to_le_bytes());
    }
    let (records, warnings) = las.put(place::LEGACY_COUNT, &700u32.to_le_bytes()).readable();
    assert_eq!(records.len(), 500 * 34);
    assert!(warnings[0].contains("claims 700 points, the file holds 500"), "{warnings:?}");
    // Version 1.4 has two counts; what the file holds decides.
    let las = Specimen::new(4, 3, 0, 500, Compression::None);
    let (records, warnings) = las.put(place::COUNT, &77u64.to_le_bytes()).readable();
    assert_eq!(records.len(), 500 * 34);
    assert_eq!(warnings.len(), 2, "{warnings:?}");
}

#[test]
fn a_wrong_box_is_only_a_warning() {
    let las = Specimen::las().put(place::BOUNDS, &f64::NAN.to_le_bytes());
    assert!(las.readable().1[0].contains("bounds"));
    let inverted = Specimen::laz().put(place::BOUNDS + 8, &1e9f64.to_le_bytes());
    assert!(inverted.readable().1[0].contains("inverted"));
}

#[test]
fn laz_counts_that_lie_lose_no_point_and_add_none() {
    for specimen in [Specimen::laz, Specimen::layered] {
        let whole = specimen().readable().0;
        let large = specimen().bytes[25] == 4;
        for count in [0u64, 1, 250, 499, 501, 60_000, 4_000_000_000] {
            let damaged = if large {
                specimen().put(place::COUNT, &count.to_le_bytes())
            } else {
                specimen().put(place::LEGACY_COUNT, &(count as u32).to_le_bytes())
            };
            let (records, warnings) = damaged.readable();
            assert!(records == whole, "{count}: {} bytes", records.len());
            assert_eq!(warnings.len(), 1, "{warnings:?}");
            assert!(warnings[0].contains("500"), "{warnings:?}");
        }
    }
}

#[test]
fn a_truncated_laz_file_is_told() {
    for specimen in [Specimen::laz(), Specimen::layered()] {
        let start = specimen.points_start();
        let ends = [start, start + 4, start + 8, start + 100, specimen.bytes.len() - 1];
        for end in ends {
            let path = specimen.write(&specimen.bytes[..end]);
            let fault = LasScan::open(&path).map(|_| ()).unwrap_err().fault;
            assert_fault!(fault, LasFault::ChunkTable { .. });
        }
    }
}

#[test]
fn a_damaged_chunk_is_told_with_its_place() {
    // The first record of a layered chunk is followed by its count and the sizes of its layers.
    let layered = Specimen::layered();
    let layers = layered.points_start() + 8 + 38;
    for value in [u32::MAX, 1 << 31, 1 << 20] {
        let fault = Specimen::layered().put(layers + 4, &value.to_le_bytes()).fault();
        assert_fault!(fault, LasFault::Chunk { chunk: 0, point: 0, .. });
    }
    let none = Specimen::layered().put(layers, &0u32.to_le_bytes()).fault();
    assert_fault!(none, LasFault::Chunk { chunk: 0, .. });
    let more = Specimen::layered().put(layers, &600u32.to_le_bytes()).fault();
    assert_fault!(more, LasFault::Chunk { chunk: 0, .. });
}

#[test]
fn a_laz_description_that_does_not_fit_is_told() {
    let find = |specimen: &Specimen| {
        let name = b"laszip encoded";
        let at = specimen.bytes.windows(name.len()).position(|window| window == name).unwrap();
        at - 2 + 54
    };
    let at = find(&Specimen::laz());
    let laszip = |offset: usize, value: &[u8]| Specimen::laz().put(at + offset, value).fault();
    assert_fault!(laszip(0, &[9]), LasFault::Laszip { .. });
    assert_fault!(laszip(0, &[3]), LasFault::Laszip { .. });
    assert_fault!(laszip(2, &[1]), LasFault::Laszip { .. });
    assert_fault!(laszip(32, &[2]), LasFault::Laszip { .. }); // an item fewer
    assert_fault!(laszip(32, &[0xff, 0xff]), LasFault::Laszip { .. });
    assert_fault!(laszip(34, &[99]), LasFault::Laszip { .. }); // an item of another kind
    assert_fault!(laszip(38, &[7]), LasFault::Laszip { .. }); // of an unknown version
    let gone = Specimen::laz().put(at - 54 + 2, b"x").fault();
    assert!(gone.to_string().contains("missing"), "{gone}");
}

#[test]
fn chunk_tables_that_lie_are_told() {
    let specimen = Specimen::laz();
    let start = specimen.points_start();
    let table = i64::from_le_bytes(specimen.bytes[start..start + 8].try_into().unwrap()) as usize;
    for value in [start as i64 + 1, start as i64 + 7, i64::MAX, specimen.bytes.len() as i64 - 7] {
        let fault = Specimen::laz().put(start, &value.to_le_bytes()).fault();
        assert_fault!(fault, LasFault::ChunkTable { .. });
    }
    let version = Specimen::laz().put(table, &[1]).fault();
    assert_fault!(version, LasFault::ChunkTable { .. });
    for count in [u32::MAX, 1 << 20, 2000] {
        let fault = Specimen::laz().put(table + 4, &count.to_le_bytes()).fault();
        assert!(fault.to_string().contains(&format!("{count} chunks")), "{fault}");
    }
    // Without a pointer, chunks follow each other and the header's count is what there is.
    for specimen in [Specimen::laz, Specimen::layered] {
        let whole = specimen().readable().0;
        let start = specimen().points_start();
        let (records, warnings) = specimen().put(start, &(-1i64).to_le_bytes()).readable();
        assert!(records == whole && warnings[0].contains("no chunk table"), "{warnings:?}");
    }
}

#[test]
fn a_chunk_table_pointer_at_the_end_of_the_file_is_found() {
    let mut specimen = Specimen::new(2, 1, 0, 60_000, Compression::Laz);
    let whole = specimen.readable().0;
    let start = specimen.points_start();
    let pointer: [u8; 8] = specimen.bytes[start..start + 8].try_into().unwrap();
    specimen.bytes.extend(pointer);
    let specimen = specimen.put(start, &(-1i64).to_le_bytes());
    let scan = specimen.open().unwrap();
    assert_eq!((scan.blocks().len(), scan.points()), (2, 60_000));
    assert!(read_all(&scan).unwrap() == whole);
}

#[test]
fn a_laz_file_of_no_points_may_end_where_they_would_start() {
    for (minor, format) in [(2, 3), (4, 6)] {
        let specimen = Specimen::new(minor, format, 0, 0, Compression::Laz);
        let start = specimen.points_start();
        // Some writers leave the place of the chunk table, unknown, some not even that.
        let specimen = specimen.put(start, &(-1i64).to_le_bytes());
        for end in [start, start + 8] {
            let scan = LasScan::open(&specimen.write(&specimen.bytes[..end])).unwrap();
            assert_eq!((scan.points(), scan.blocks().len()), (0, 0));
        }
    }
}

#[test]
fn a_file_that_shrinks_under_the_reader_is_told() {
    for specimen in [Specimen::las(), Specimen::laz(), Specimen::layered()] {
        let scan = specimen.open().unwrap();
        let start = specimen.points_start();
        std::fs::write(scan.path(), &specimen.bytes[..start + 100]).unwrap();
        let fault = read_all(&scan).map(|records| records.len()).unwrap_err().fault;
        let text = fault.to_string();
        assert_fault!(fault, LasFault::Shrunk { .. } | LasFault::Chunk { .. });
        assert!(text.contains("ended at byte") || text.contains("became shorter"), "{text}");
    }
}

#[test]
fn the_oldest_laz_has_the_points_that_its_bytes_hold() {
    let Some(path) = shared("pf0-pointwise.laz") else { return };
    let whole = Specimen::from_file(&path).readable().0;
    assert_eq!(whole.len(), 11_781 * 20);
    let fewer = Specimen::from_file(&path).put(place::LEGACY_COUNT, &5_000u32.to_le_bytes());
    assert!(fewer.readable().0 == whole);
    let more = Specimen::from_file(&path).put(place::LEGACY_COUNT, &20_000u32.to_le_bytes());
    let fault = more.fault();
    assert_fault!(fault, LasFault::Chunk { chunk: 0, point: 11_700..=11_800, .. });
}

#[test]
fn noise_behind_a_header_claims_nothing() {
    let mut noise = vec![0; 40_000];
    Random::new(3, 3).fill(&mut noise);
    for specimen in [Specimen::las, Specimen::laz, Specimen::layered] {
        for from in [0, 4, 104, 227, 375] {
            let mut bytes = specimen().bytes[..from].to_vec();
            bytes.extend(&noise);
            check(&specimen(), &bytes, "noise");
        }
        let start = specimen().points_start();
        let mut bytes = specimen().bytes[..start].to_vec();
        bytes.extend(&noise);
        check(&specimen(), &bytes, "noise for points");
    }
}

/// What came of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Answer {
    Refused,
    ReadWithWarnings,
    Whole,
}

/// Opens and reads; any answer is right that is a value within bounds.
fn check(specimen: &Specimen, bytes: &[u8], what: &str) -> Answer {
    let path = specimen.write(bytes);
    let answer = read_bounded(&path, bytes.len());
    let largest = LARGEST.load(Ordering::Relaxed);
    assert!(largest <= MOST_MEMORY, "{what}: {largest} bytes at once");
    answer
}

fn read_bounded(path: &Path, file_bytes: usize) -> Answer {
    let Ok(scan) = LasScan::open(path) else { return Answer::Refused };
    assert!(scan.schema().covers_record());
    let record_bytes = scan.schema().record_bytes as usize;
    let mut buffer = BlockBuffer::default();
    // The models of the coder give a symbol no less than a 32,768th of the interval, and a point
    // takes several symbols: 1000 points a byte is out of reach.
    let most = 1000 * file_bytes;
    let mut points = 0;
    for block in scan.blocks() {
        let outcome = scan.read_block::<LasError>(block, &mut buffer, &mut |_, records| {
            assert!(!records.is_empty() && records.len().is_multiple_of(record_bytes));
            points += records.len() / record_bytes;
            assert!(points <= most, "{points} points of {file_bytes} bytes");
            Ok(())
        });
        if outcome.is_err() {
            return Answer::Refused;
        }
    }
    if scan.facts().warnings.is_empty() { Answer::Whole } else { Answer::ReadWithWarnings }
}

fn small_specimens() -> Vec<(String, Specimen)> {
    let mut specimens = Vec::new();
    for format in [0, 3, 5, 6, 10] {
        for (name, compression) in [("las", Compression::None), ("laz", Compression::Laz)] {
            let specimen = Specimen::new(least_minor(format), format, 3, 40, compression);
            specimens.push((format!("{name}, format {format}"), specimen));
        }
    }
    specimens
}

#[test]
fn every_truncation_gives_a_value() {
    for (name, specimen) in small_specimens() {
        let bytes = &specimen.bytes;
        let start = specimen.points_start();
        // Densely over the header, the records behind it and the end, coarsely over the points.
        let ends = (0..bytes.len()).filter(|end| {
            end % 7 == 0 || (start..start + 12).contains(end) || bytes.len() - end < 24
        });
        for end in ends {
            let answer = check(&specimen, &bytes[..end], &name);
            assert_ne!(answer, Answer::Whole, "{name}: {end} of {} bytes", bytes.len());
        }
        assert_eq!(check(&specimen, bytes, &name), Answer::Whole, "{name} undamaged");
    }
}

#[test]
fn every_flipped_bit_gives_a_value() {
    let mut read = 0;
    for (name, specimen) in small_specimens() {
        let mut random = Random::new(9, specimen.bytes.len() as u64);
        let length = specimen.bytes.len();
        for _ in 0..400 {
            let mut bytes = specimen.bytes.clone();
            // Half of the flips in header and records, where structure is.
            let within = if random.below(2) == 0 { specimen.points_start() + 16 } else { length };
            for _ in 0..1 + random.below(3) {
                bytes[random.below(within as u64) as usize] ^= 1 << random.below(8);
            }
            read += u32::from(check(&specimen, &bytes, &name) != Answer::Refused);
        }
    }
    // Many flips hit values that mean nothing to the structure: those files must still be read.
    assert!(read > 500, "{read} of 4000 were read");
}

#[test]
fn every_flipped_byte_of_the_structure_gives_a_value() {
    for (name, specimen) in [("laz", Specimen::laz()), ("layered", Specimen::layered())] {
        let start = specimen.points_start();
        let table = specimen.bytes.len() - 20..specimen.bytes.len();
        let structure = (94..start + 24).step_by(3).chain(table);
        for at in structure {
            for value in [0x00, 0x7f, 0x80, 0xff] {
                let mut bytes = specimen.bytes.clone();
                bytes[at] = value;
                check(&specimen, &bytes, name);
            }
        }
    }
}

#[test]
fn real_files_with_flipped_bits_give_a_value() {
    for name in ["pdrf9-1.4.laz", "pdrf5-1.3.laz", "pf0-pointwise.laz", "extrabytes.las"] {
        let Some(path) = shared(name) else { continue };
        let specimen = Specimen::from_file(&path);
        let mut random = Random::new(21, 4);
        for _ in 0..60 {
            let mut bytes = specimen.bytes.clone();
            for _ in 0..1 + random.below(8) {
                let at = random.below(bytes.len() as u64) as usize;
                bytes[at] = random.bits() as u8;
            }
            check(&specimen, &bytes, name);
        }
    }
}
