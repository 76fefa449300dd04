//! What results cost and how far they are from the truth: counters, memory, picture errors.
//!
//! Every error of a picture is stated against the reference picture of the same view (every point,
//! from f64), in pixels and colour steps. Nothing here decides anything.

mod counters;
mod error;

pub use counters::{FrameCounters, peak_rss_bytes};
pub use error::{Displacement, PictureError, Pixels, compare};
