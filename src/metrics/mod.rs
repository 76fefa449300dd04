//! What results cost and how far they are from the truth: memory and picture errors.
//!
//! Every error of a picture is stated against the reference picture of the same view (every point,
//! from f64), in pixels and colour steps. Nothing here decides anything.

mod error;
mod memory;
mod processor;

pub use error::{Displacement, PictureError, Pixels, compare};
pub use memory::{peak_rss_bytes, rss_bytes};
pub use processor::processor_ms;
