//! Foreign scan files out: LAS, LAZ and COPC, PLY and text.
//!
//! A writer takes the rows of a schema and what the file says besides points. It rounds nothing,
//! reads no store, and leaves a file under its name only when it is complete.

mod copc;
mod copc_hierarchy;
mod copc_tree;
mod decimal;
mod error;
mod extra_bytes;
mod file;
mod las;
mod las_frame;
mod las_records;
mod las_template;
mod laz_coding;
mod names;
mod ply;
mod positions;
mod rows;
mod text;

pub use copc::write_copc;
pub use copc_tree::ReadNode;
pub use error::WriteError;
pub use las::{Compression, LasWriter, WriteReport};
pub use las_records::{AttributeRanges, FormatChoice, LasRecords};
pub use las_template::{LasFacts, note_on_reference_system};
pub use ply::{PlyEncoding, PlyFacts, PlyFormat};
pub use positions::Positions;
pub use rows::{RowFormat, RowWriter};
pub use text::{TextFormat, TextKind};
