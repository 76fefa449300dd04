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

pub use columns::ColumnList;
pub use preamble::{HEAD_BYTES, TextKind, detect_text};
pub use reader::{TextOptions, TextReader};
pub use row::BadRows;
