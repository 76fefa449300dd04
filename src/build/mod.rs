//! The preprocessor: scan files into the nodes of a store, within a bound on memory.
//!
//! One pass over the input finds its true bounds (headers are not trusted; where they are easily
//! verified, they replace the pass, `claims`). A second sorts the points into chunks of neighbours (`plan`, `partition`), in pages that stay in memory as long as
//! there is room (`pages`). Chunks are built side by side (`chunk`, `home`, `node`); nodes that
//! reach over several are put together from their parts (`spanning`). The octree is the same, byte
//! for byte, for any number of threads and any memory cap.
//! After: Wimmer and Scheiblauer, "Instant Points", 2006; departures: `docs/instant-points.md`.

mod append;
mod budget;
mod checkpoint;
mod chunk;
mod claims;
mod convert;
mod dense_chunk;
mod disk;
mod encode;
mod error;
mod home;
mod in_order;
mod large;
mod levels;
mod machine;
mod node;
mod options;
mod ordered;
mod packing;
mod paged_rows;
mod pages;
mod partition;
mod plan;
mod progress;
mod rows;
mod seen;
mod sort;
mod sources;
mod spanning;
mod steps;
mod survey;
mod work;

pub use append::{AppendReport, append};
pub use convert::{ConvertReport, convert, convert_sources, kept_work};
pub use error::BuildError;
pub use machine::available_memory;
pub use node::Representative;
pub use options::{ConvertOptions, DEPTH_RANGE};
pub use progress::{PointSample, Progress, Silent, Stage, StageTime};
pub use sources::{Source, Sources};
pub use work::BeforeWrite;
