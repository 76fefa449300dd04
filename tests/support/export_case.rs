//! A scan, its store and what `esker export` makes of it; and what records of any point format say.

#![allow(dead_code, reason = "each test binary uses a part")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use esker::input::{LasScan, PointFormat};
use esker::output::Compression;
use esker::points::record_coordinates;
use esker::sampling::records;

use crate::las_files::{read_all, shared, template, write};

pub fn esker(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_esker")).args(arguments).output().expect("the program starts")
}

pub fn text(path: &Path) -> &str {
    path.to_str().expect("test paths are UTF-8")
}

/// Runs the program, which must succeed; what it says on standard error.
pub fn run(arguments: &[&str]) -> String {
    let output = esker(arguments);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {message}");
    message
}

/// A folder with a scan and its store.
pub struct Case {
    pub folder: tempfile::TempDir,
    pub scan: PathBuf,
}

impl Case {
    /// A LAS file of noise at places in a cube of `2^bits` steps.
    pub fn noise(count: usize, format: u8, extra_bytes: u16, bits: u32, options: &[&str]) -> Self {
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

    pub fn shared(name: &str) -> Option<Self> {
        let folder = tempfile::tempdir().expect("a folder");
        Some(Case::of(folder, shared(name)?, &[]))
    }

    pub fn of(folder: tempfile::TempDir, scan: PathBuf, options: &[&str]) -> Self {
        let case = Case { folder, scan };
        let store = case.store();
        let arguments = [&["convert", text(&case.scan), "-o", text(&store)], options].concat();
        run(&arguments);
        case
    }

    pub fn store(&self) -> PathBuf {
        self.folder.path().join("scan.esker")
    }

    pub fn export(&self, name: &str, options: &[&str]) -> PathBuf {
        let output = self.folder.path().join(name);
        let store = self.store();
        let arguments =
            [&["export", text(&store), "-o", text(&output), "--overwrite"], options].concat();
        run(&arguments);
        output
    }

    pub fn records(&self) -> (LasScan, Vec<u8>) {
        let scan = LasScan::open(&self.scan).expect("the scan opens");
        let records = read_all(&scan).expect("the scan reads");
        (scan, records)
    }
}

/// Records in an order that does not depend on the file's.
pub fn sorted(records: &[u8], record_bytes: usize) -> Vec<&[u8]> {
    let mut rows: Vec<&[u8]> = records.chunks_exact(record_bytes).collect();
    rows.sort_unstable();
    rows
}

/// What the fields of a record say, whatever its format; absent ones are 0.
#[derive(Clone, Debug, PartialEq, PartialOrd)]
pub struct Fields {
    pub place: [i32; 3],
    pub intensity: u16,
    pub returns: [u8; 2],
    pub class: u8,
    pub flags: u8,
    pub direction_and_edge: u8,
    pub angle: i16,
    pub user_data: u8,
    pub source: u16,
    pub time: u64,
    pub rgb_nir: [u16; 4],
    pub extra: Vec<u8>,
}

/// From tables 7 to 17 of the specification.
pub fn fields(record: &[u8], format: u8, packet_is_extra: bool) -> Fields {
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

pub fn all_fields(records: &[u8], record_bytes: usize, format: u8, is_source: bool) -> Vec<Fields> {
    let rows = records.chunks_exact(record_bytes);
    let mut all: Vec<Fields> = rows.map(|record| fields(record, format, is_source)).collect();
    all.sort_by(|a, b| a.partial_cmp(b).expect("no float is compared"));
    all
}
