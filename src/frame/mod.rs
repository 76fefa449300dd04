//! The frame as one list of steps, and what lives as long as a view does.
//!
//! [`Renderer::render`] reads: choose what to draw, load what is missing, fill the draw table,
//! draw, resolve. Where points come from is behind [`NodeSource`]; how they are coloured is in
//! [`ColorMode`]. The loader is simple: it reads in this call, in parallel, what the cut asks for,
//! all of it or up to a quota per frame. No thread of its own.

mod color;
mod device;
mod drawing;
mod last_frame;
mod loading;
mod node_cache;
mod reference;
mod renderer;
mod settings;
mod settle_colors;
mod source;
mod stats;

pub use color::{ColorMode, class_color};
pub use reference::reference_picture;
pub use renderer::Renderer;
pub use settings::{FrameError, FrameSettings, Loading, RasterPath};
pub use source::NodeSource;
pub use stats::{FrameStats, PassTime};
