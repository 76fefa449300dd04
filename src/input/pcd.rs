//! PCD, the format of the Point Cloud Library: text, binary, and binary_compressed.
//!
//! Points without finite coordinates, which organised clouds are full of, are left out and
//! counted. The viewpoint becomes the pose of the scan; as in the library it is not applied to the
//! coordinates.
//!
//! Source: "The PCD (Point Cloud Data) file format", documentation of the Point Cloud Library.

mod columns;
mod header;
mod lzf;

use super::detect::{ReadOptions, Signs};
use super::foreign::{ForeignFault, ForeignReader, ScanPart};
use super::positioned_file::PositionedFile;
use super::table::{AsciiEntry, AsciiRows, FixedRows, RowPlan, TableFacts, is_single, open_table};
use columns::ColumnRows;
use header::{Encoding, Header};

/// Suffixes of such files.
pub(super) const SUFFIXES: &[&str] = &["pcd"];

/// Whether a file begins as one.
pub(super) fn claims(signs: &Signs) -> bool {
    if signs.head.starts_with(b"# .PCD") {
        return true;
    }
    let mut lines = signs.head.split(|&byte| byte == b'\n');
    let first = lines.find(|line| !line.starts_with(b"#") && !line.trim_ascii().is_empty());
    first.is_some_and(|line| line.starts_with(b"VERSION") || line.starts_with(b"FIELDS"))
}

/// Opens a file and looks through its points.
pub(super) fn open(
    file: PositionedFile,
    options: &ReadOptions,
) -> Result<Box<dyn ForeignReader>, ForeignFault> {
    let header = Header::read(&file)?;
    let declared = header.fields.iter().map(|field| (field.name.as_str(), field.scalar));
    let mut facts = TableFacts {
        format: header.encoding.name().to_string(),
        is_single: is_single(declared),
        part: ScanPart { name: None, pose: header.pose, points: 0 },
        applies_pose: false,
        skipped: Vec::new(),
        warnings: header.warnings.clone(),
        salvaged: options.salvage.then_some(header.points),
    };
    let (start, points) = (header.bytes, header.points);
    match header.encoding {
        Encoding::Ascii => {
            let entries: Vec<AsciiEntry> =
                header.fields.iter().cloned().map(AsciiEntry::Field).collect();
            let plan = RowPlan::new(&AsciiRows::packed_fields(&entries), true)?;
            let at = (start, header.lines + 1);
            open_table(
                AsciiRows::new(file, at, 0, points, &entries, &plan, options.salvage)?,
                plan,
                facts,
            )
        }
        Encoding::Binary => {
            let plan = RowPlan::new(&header.fields, true)?;
            let salvage = options.salvage;
            let rows = FixedRows::new(file, start, points, plan.row_bytes, None, salvage)?;
            open_table(rows, plan, facts)
        }
        Encoding::Compressed => {
            let plan = RowPlan::new(&header.fields, true)?;
            let rows = ColumnRows::new(&file, start, points, &header.fields, options)?;
            facts.warnings.extend(rows.zeros());
            open_table(rows, plan, facts)
        }
    }
}
