//! The frame as one list of steps, and what lives as long as a view does.
//!
//! [`Renderer::render`] reads: choose what to draw, load what is missing, fill the draw table,
//! draw, resolve. Where points come from is behind [`NodeSource`]; how they are coloured is in
//! [`ColorMode`]. A scene that fits the room for it is read in this call, in parallel, all that is
//! wanted or up to a quota per frame; a larger one comes through [`stream`](crate::stream).

#[cfg(feature = "gpu")]
mod alternative;
mod appearance;
mod calibration;
mod calibration_cloud;
mod color;
mod counted;
#[cfg(feature = "gpu")]
mod culling;
#[cfg(feature = "gpu")]
mod culling_costs;
mod culling_view;
mod device;
mod drawing;
mod last_frame;
mod loading;
mod models;
#[cfg(not(feature = "gpu"))]
mod no_culling;
mod node_cache;
mod pacing;
mod plan;
mod reference;
mod renderer;
mod rest;
mod scene_reader;
mod settings;
mod source;
mod stats;
mod streaming;
mod workload;

pub use calibration::{Calibration, FrameTime};
pub use color::{ColorMode, class_color};
pub use counted::CountedWork;
#[cfg(feature = "gpu")]
pub use culling_costs::CullingCostStats;
pub use culling_view::{
    FRUSTUM_COLOR, box_lines, camera_above, count_states, frustum_lines, frustum_reach, state_color,
};
pub use pacing::PacingStats;
pub use reference::reference_picture;
pub use renderer::Renderer;
pub use settings::{
    CullingAnswers, FrameError, FrameSettings, InFrameCheckpoint, Loading, RasterPath,
};
pub use source::{FIRST_PICTURE_BYTES, NodeSource};
pub use stats::{FrameStats, PassTime};
