//! Small LAS and LAZ files of any version and point format, for tests.

#![allow(dead_code, reason = "each test binary uses a part")]

use std::path::{Path, PathBuf};

use esker::input::{BlockBuffer, LasError, LasScan, LasTemplate, NewScan, PointFormat};
use esker::output::{Compression, LasWriter, WriteReport};
use esker::points::{Lattice, Schema};
use glam::DVec3;

/// Millimetres, at coordinates as UTM gives them.
pub fn lattice() -> Lattice {
    Lattice { scale: DVec3::splat(0.001), offset: DVec3::new(476_000.0, 5_429_000.0, 300.0) }
}

/// The least minor version that knows a point format.
pub fn least_minor(point_format: u8) -> u8 {
    match point_format {
        0 | 1 => 0,
        2 | 3 => 2,
        4 | 5 => 3,
        _ => 4,
    }
}

pub fn template(minor: u8, point_format: u8, extra_bytes: u16) -> LasTemplate {
    LasTemplate::for_new_scan(&NewScan {
        minor,
        point_format: PointFormat::new(point_format).unwrap(),
        extra_bytes,
        lattice: lattice(),
        system_identifier: "TEST",
        generating_software: "esker tests",
        creation: (1, 2026),
    })
}

/// Schema of a template's records, extra bytes undescribed.
pub fn schema(template: &LasTemplate) -> Schema {
    let header = template.header();
    header.point_format.schema(header.record_bytes, &[]).0
}

/// Writes records under a template.
pub fn write(
    path: &Path,
    template: &LasTemplate,
    compression: Compression,
    records: &[u8],
) -> WriteReport {
    let mut writer = LasWriter::create(path, template, &schema(template), compression).unwrap();
    writer.write(records).unwrap();
    writer.finish(&mut std::io::empty()).unwrap()
}

/// All records of a scan in the order of the file, or the first error.
pub fn read_all(scan: &LasScan) -> Result<Vec<u8>, LasError> {
    let mut all = Vec::new();
    let mut buffer = BlockBuffer::default();
    for block in scan.blocks() {
        scan.read_block::<LasError>(block, &mut buffer, &mut |_, records| {
            all.extend_from_slice(records);
            Ok(())
        })?;
    }
    Ok(all)
}

/// The file of that name among the shared scans; says so where they are not.
pub fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    let there = path.exists();
    if !there {
        eprintln!("skipped: {} is not there", path.display());
    }
    there.then_some(path)
}
