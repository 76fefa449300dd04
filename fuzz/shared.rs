//! What fuzzing does with bytes: opens them as a file of a format and reads all there is.
//!
//! The fuzz targets and `tests/fuzz_corpus.rs` share this file. A reader may refuse bytes with an
//! error; what it must not do is panic, hand out other than it announced, or take memory that the
//! bytes merely claim (the fuzzer watches that).

#![allow(dead_code, reason = "each fuzz target uses a part")]

use std::ops::Range;
use std::path::Path;

use esker::input::{BlockBuffer, PositionedFile, ReadOptions, Scan, ScanError};
use esker::store::{self, Store};

/// What became of bytes.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// They are no such file, or damaged; why.
    Refused(String),
    /// So many points, or triangles, were read.
    Read(u64),
}

/// The formats that bytes are read as.
pub const TARGETS: [&str; 13] = [
    "las", "laz", "ply", "pcd", "e57", "pts", "ptx", "text", "store", "gltf", "obj", "stl", "faces",
];

/// Most points that are read of one input; a compressed file may hold many.
const MOST_POINTS: u64 = 1 << 20;

/// Reads bytes as one of the [`TARGETS`].
pub fn run(target: &str, bytes: &[u8]) -> Outcome {
    match target {
        "gltf" if bytes.starts_with(b"glTF") => read_model("model.glb", bytes),
        "gltf" | "obj" | "stl" => read_model(&format!("model.{target}"), bytes),
        "faces" => read_model("model.ply", bytes),
        "store" => read_store(&with_store_checksums(bytes)),
        "e57" => read_scan("scan.e57", with_page_checksums(bytes), &ReadOptions::default()),
        "text" => {
            let name = "scan.xyz";
            let salvage = ReadOptions { salvage: true, ..ReadOptions::default() };
            let columns = Some("x,y,z,skip,intensity,r,g,b".to_string());
            let told = ReadOptions { columns, ..ReadOptions::default() };
            read_scan(name, bytes.to_vec(), &salvage);
            let told = read_scan(name, bytes.to_vec(), &told);
            match read_scan(name, bytes.to_vec(), &ReadOptions::default()) {
                Outcome::Refused(_) => told,
                read => read,
            }
        }
        _ => read_scan(&format!("scan.{target}"), bytes.to_vec(), &ReadOptions::default()),
    }
}

/// Makes parallel loops run where they are called: what an input does then depends on it alone,
/// and no time goes into waking threads.
pub fn stay_on_this_thread() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread();
    pool.build_global().expect("no pool was there before");
}

fn read_scan(name: &str, bytes: Vec<u8>, options: &ReadOptions) -> Outcome {
    let opened = Scan::of(PositionedFile::in_memory(bytes), Path::new(name), options);
    let refused = |error: ScanError| Outcome::Refused(error.to_string());
    let scan = match opened {
        Ok(scan) => scan,
        Err(error) => return refused(error),
    };
    let is_text = ["pts", "ptx", "text"].iter().any(|kind| scan.format().starts_with(kind));
    match read_points(&scan) {
        Ok(points) => Outcome::Read(points),
        Err(error) if is_text => panic!("opening has read this text already: {error}"),
        Err(error) => refused(error),
    }
}

fn read_points(scan: &Scan) -> Result<u64, ScanError> {
    let schema = scan.schema();
    assert!(schema.covers_record(), "columns cover records: {schema:?}");
    let lattice = scan.lattice();
    assert!(lattice.scale.is_finite() && lattice.offset.is_finite(), "{lattice:?} is a lattice");
    let record_bytes = schema.record_bytes as usize;
    let mut buffer = BlockBuffer::default();
    let mut total = 0;
    for block in scan.blocks() {
        if total >= MOST_POINTS {
            return Ok(total);
        }
        let mut handed_out = 0;
        let found = scan.read_block::<ScanError>(block, &mut buffer, &mut |first, records| {
            assert!(records.len() % record_bytes == 0, "records are whole");
            assert_eq!(first, block.first_point + handed_out, "records come in order");
            handed_out += (records.len() / record_bytes) as u64;
            Ok(())
        })?;
        assert_eq!(found, handed_out, "what is counted is handed out");
        assert!(!scan.points_exact() || found == block.points, "an exact count is kept");
        total += found;
    }
    assert!(!scan.points_exact() || total == scan.points(), "blocks add up");
    Ok(total)
}

/// Reads bytes as a model, in a folder of its own so that files they name are not there.
fn read_model(name: &str, bytes: &[u8]) -> Outcome {
    let folder = tempfile::Builder::new().prefix("esker-fuzz").tempdir_in(memory());
    let folder = folder.expect("a folder is made");
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("there is room");
    match esker::input::read_model(&path, &esker::input::ModelOptions::default()) {
        Ok(read) => {
            assert_eq!(read.model.check(), Ok(()), "what is read is sound");
            let bounds = read.model.bounds();
            assert!(bounds.min.is_finite() && bounds.max.is_finite(), "{bounds:?} is a box");
            assert!(read.report.lines().iter().all(|line| line.len() < 1000), "lines are short");
            Outcome::Read(read.model.triangle_count())
        }
        Err(error) => Outcome::Refused(error.to_string()),
    }
}

/// A folder in memory, if there is one.
fn memory() -> std::path::PathBuf {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() { memory.to_path_buf() } else { std::env::temp_dir() }
}

/// Opens a store, checks it, and decodes every section of every node.
fn read_store(bytes: &[u8]) -> Outcome {
    let file = tempfile::Builder::new().prefix("esker-fuzz").tempfile_in(memory());
    let file = file.expect("the folder takes files");
    std::fs::write(file.path(), bytes).expect("there is room");
    if let Err(error) = store::check(file.path()) {
        return Outcome::Refused(error.to_string());
    }
    let store = match Store::open(file.path()) {
        Ok(store) => store,
        Err(error) => return Outcome::Refused(error.to_string()),
    };
    let mut points = 0;
    let mut records = Vec::new();
    for index in 0..store.octree().nodes().len() {
        let node = esker::ids::NodeId(index as u32);
        if let Err(error) = store.read_records(node, &mut records) {
            return Outcome::Refused(error.to_string());
        }
        points += u64::from(store.octree().nodes()[index].point_count());
    }
    Outcome::Read(points)
}

/// An E57 file is pages of 1020 bytes and their checksum. With the checksums set right, changed
/// bytes reach what stands behind them.
fn with_page_checksums(bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for page in bytes.chunks_exact_mut(1024) {
        let (payload, checksum) = page.split_at_mut(1020);
        checksum.copy_from_slice(&crc32c::crc32c(payload).to_be_bytes());
    }
    bytes
}

/// A store with all checksums and its length set right, as far as its parts can be found; offsets
/// as in `FORMAT.md`.
fn with_store_checksums(bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    if bytes.len() < 256 {
        return bytes;
    }
    // One slot of the header is kept right: the second, if it begins as one.
    if bytes[8] > 1 {
        if bytes[128..136] == bytes[..8] {
            bytes.copy_within(128..256, 0);
        }
        bytes[128..256].fill(0);
        bytes[12..16].copy_from_slice(&2u32.to_le_bytes());
    }
    let length = bytes.len() as u64;
    bytes[16..24].copy_from_slice(&length.to_le_bytes());
    set_section_checksums(&mut bytes);
    for part in [24, 48, 72] {
        if let Some(range) = part_at(&bytes, part) {
            let checksum = crc32c::crc32c(&bytes[range]);
            bytes[part + 16..part + 20].copy_from_slice(&checksum.to_le_bytes());
        }
    }
    let checksum = crc32c::crc32c(&bytes[..124]);
    bytes[124..128].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

/// The bytes of a part whose offset and size stand at a place of the header.
fn part_at(bytes: &[u8], place: usize) -> Option<Range<usize>> {
    let start = usize::try_from(word(bytes, place)?).ok()?;
    let end = start.checked_add(usize::try_from(word(bytes, place + 8)?).ok()?)?;
    (end <= bytes.len()).then_some(start..end)
}

fn word(bytes: &[u8], place: usize) -> Option<u64> {
    let eight = bytes.get(place..place.checked_add(8)?)?;
    Some(u64::from_le_bytes(eight.try_into().expect("the range has 8 bytes")))
}

/// Sets the checksums of sections in the rows of the directory. How many sections there are stands
/// in the metadata.
fn set_section_checksums(bytes: &mut [u8]) -> Option<()> {
    let metadata: serde_json::Value = serde_json::from_slice(&bytes[part_at(bytes, 24)?]).ok()?;
    let sections = metadata.get("sections")?.as_array()?.len();
    let depth = usize::try_from(metadata.get("depth")?.as_u64()?).ok().filter(|d| *d < 32)?;
    let directory = part_at(bytes, 48)?;
    let is_first_version = bytes[8] == 1;
    let first = if is_first_version { 40 } else { 48 } + 4 * (depth + 1);
    let row_bytes = first + 12 * sections;
    let mut at = usize::try_from(word(bytes, 96)?).ok()?;
    for row in directory.step_by(row_bytes) {
        if !is_first_version {
            at = usize::try_from(word(bytes, row + 40)?).ok()?;
        }
        for section in (row + first..row + row_bytes).step_by(12) {
            let end = at.checked_add(usize::try_from(word(bytes, section)?).ok()?)?;
            let checksum = crc32c::crc32c(bytes.get(at..end)?);
            bytes.get_mut(section + 8..section + 12)?.copy_from_slice(&checksum.to_le_bytes());
            at = end;
        }
    }
    Some(())
}
