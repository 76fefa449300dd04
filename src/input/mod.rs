//! Foreign scan files in, as blocks of raw point records.
//!
//! [`Scan`] opens a file of any format, tells what it claims and what it holds, and hands out its
//! points as records, block by block, from as many threads as ask. No byte of a file is trusted:
//! lengths are checked before arithmetic and before allocation, and whatever is wrong becomes a
//! [`ScanError`] that names the file, the place and the reason. Nothing here knows the store.
//!
//! Files of the LAS family ([`LasScan`]) hand out the records that stand in them. Those of other
//! formats are read by a [`ForeignReader`] and put on a lattice (`placing`, `foreign_scan`);
//! `detect` says where a new format is registered.
//!
//! Source: ASPRS, "LAS Specification 1.4 - R15", 2019; Isenburg, "LASzip", 2013, whose decoder the
//! crate `laz` provides. How a reader here goes beyond that crate stands in `laz_layout` and
//! `laz_decode`.

mod crs;
mod detect;
mod e57;
mod error;
mod foreign;
mod foreign_scan;
mod guard;
mod header;
mod las_layout;
mod laz_decode;
mod laz_layout;
mod laz_point14;
mod laz_times;
mod mesh;
mod pcd;
mod placing;
mod ply;
mod point_format;
mod positioned_file;
mod sample;
mod scan;
mod scan_file;
mod table;
mod template;
mod text;
mod vlr;

pub use crs::Crs;
pub use detect::{FileKind, ReadOptions, detect, scan_suffixes};
pub use error::{LasError, LasFault, ScanError};
pub use foreign::{
    Column, CoordinateKind, ForeignFacts, ForeignFault, ForeignReader, MOST_BLOCK_ROWS, Pose,
    RowBlock, RowBuffer, ScanPart, Unread,
};
pub use foreign_scan::ForeignScan;
pub use guard::without_panic;
pub use header::{LasHeader, ReturnCounts, place};
pub use mesh::{
    ModelFormat, ModelOptions, ModelReadError, ModelReport, ReadModel, UpAxis, detect_model,
    model_suffixes, read_model, read_model_until,
};
pub use placing::{Placing, decimal_lattice, fine_lattice, reaches};
pub use point_format::{ExtraBytes, PointFormat, describes_extra_bytes, extra_bytes};
pub use positioned_file::{Cancel, PositionedFile};
pub use sample::RUN_RECORDS;
pub use scan::{
    Block, BlockBuffer, BoundsFacts, LasScan, RecordSink, ScanFacts, ScanFormat, VlrFacts,
};
pub use scan_file::Scan;
pub use template::{ByteRange, LasTemplate, NewScan};
pub use text::{BadRows, ColumnList, TextKind, TextOptions, TextReader, detect_text};
pub use vlr::{EVLR_HEADER_BYTES, VLR_HEADER_BYTES, Vlr, evlr_header};
