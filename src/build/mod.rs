//! The preprocessor: scan files into the nodes of a store, within a bound on memory.
//!
//! One pass over the input finds its true bounds (headers are not trusted). What fits memory is
//! sorted by Morton code and built top down, in parallel (`subtree`, `point_tree`); what does not
//! is partitioned on disk first (`out_of_core`). Both give the same octree, byte for byte, for any
//! number of threads and any memory cap.
//! After: Wimmer and Scheiblauer, "Instant Points", 2006; departures: `docs/instant-points.md`.

mod convert;
mod encode;
mod error;
mod options;
mod out_of_core;
mod point_tree;
mod progress;
mod rows;
mod sources;
mod spill;
mod subtree;

pub use convert::{ConvertReport, convert};
pub use error::BuildError;
pub use options::{ConvertOptions, DEPTH_RANGE, available_memory};
pub use point_tree::Representative;
pub use progress::{Progress, Silent, Stage};
