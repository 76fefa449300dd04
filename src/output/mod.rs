//! Foreign scan files out: LAS and LAZ.
//!
//! A writer takes the records of a scan and the parts of its file that are not points, and writes
//! a file of the same version and point format. It converts nothing and reads no store.

mod las;

pub use las::{Compression, LasWriteError, LasWriter, WriteReport};
