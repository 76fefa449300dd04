//! Points written as text: PTS, PTX, and rows of numbers such as XYZ, CSV and ASC.
//!
//! A text is looked through once when it is opened, in pieces of whole lines, side by side: rows
//! are counted, bounds taken, and for every column what kind of numbers it holds. What the columns
//! mean is decided from all rows, not from the first few. Blocks then read their own lines again.
//! Not here: which lattice the coordinates go to; what a text is called.
//!
//! Sources: Leica Geosystems, "PTX file format" and "PTS file format" (knowledge base articles);
//! the ways in which CloudCompare, FARO Scene and numpy write columns.

mod columns;
mod layout;
mod number;
mod parts;
mod pieces;
mod preamble;
mod reader;
mod row;
mod sinks;
mod stats;

use super::detect::{ReadOptions, Signs};
use super::foreign::{ForeignFault, ForeignReader};
use super::positioned_file::PositionedFile;

pub use columns::ColumnList;
pub use preamble::{TextKind, detect_text};
pub use reader::{TextOptions, TextReader};
pub use row::BadRows;

/// Suffixes of texts that a folder contributes. Others (`txt`, `csv`) are as often no points; they
/// are read when they are named.
pub const TABLE_SUFFIXES: &[&str] = &["xyz", "xyzrgb", "asc"];

/// Whether a file is a PTS text.
pub(super) fn claims_pts(signs: &Signs) -> bool {
    detect_text(signs.head) == Some(TextKind::Pts)
}

/// Whether a file is a PTX text.
pub(super) fn claims_ptx(signs: &Signs) -> bool {
    detect_text(signs.head) == Some(TextKind::Ptx)
}

/// Whether a file is a text, or calls itself one and should be told why it is none.
pub(super) fn claims_table(signs: &Signs) -> bool {
    let named = ["pts", "ptx", "txt", "csv", "tsv", "xyzi", "xyzn", "neu"];
    TABLE_SUFFIXES.contains(&signs.suffix)
        || named.contains(&signs.suffix)
        || detect_text(signs.head).is_some()
}

/// Opens a text of any kind.
pub(super) fn open(
    file: PositionedFile,
    options: &ReadOptions,
) -> Result<Box<dyn ForeignReader>, ForeignFault> {
    let columns = options.columns.as_ref().map(|list| list.parse()).transpose();
    let columns = columns.map_err(|reason| ForeignFault::at("--columns", reason))?;
    let bad_rows = if options.salvage { BadRows::LeaveOut } else { BadRows::Refuse };
    Ok(Box::new(TextReader::open(file, &TextOptions { columns, bad_rows })?))
}
