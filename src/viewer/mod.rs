//! The window: look at stores, scans and models, fly through them, choose how they are drawn.
//!
//! [`run`] opens it; [`Viewer`] is what it does, [`CameraControl`] how mouse and keys move the
//! camera. Points are drawn by the same frame as everywhere; this room decides when. A thread of
//! its own opens files and converts scans ([`Opening`]); nothing else runs beside the window.

mod app;
mod camera_control;
mod canvas;
mod culling_panel;
mod culling_view;
mod kept;
mod keys;
mod look_panel;
mod models;
mod opening;
mod panels;
mod preview;
mod scene;
mod shown;
mod statistics;
mod statistics_box;
mod steering;
mod window;

pub use app::{Viewer, ViewerOptions, first_settings};
pub use camera_control::{CameraControl, DragKind};
pub use canvas::Canvas;
pub use culling_view::CullingViewStatistics;
pub use models::OpenedModel;
pub use opening::{
    Advance, KeptIn, ListFolder, Opened, OpenedFile, Opening, OpeningOptions, Sign, Wake,
};
pub use statistics::{Milestone, Statistics};
pub use window::{WindowOptions, run};
