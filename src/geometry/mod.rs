//! Shapes and spaces: boxes, views, frusta, Morton codes. Arithmetic only.

mod aabb;
mod frustum;
mod morton;
mod preset;
pub mod raster;
mod segment;
mod view;

pub use aabb::Aabb;
pub use frustum::{CellDescent, ClipCell, Containment, Frustum};
pub use morton::MortonKey;
pub use preset::ViewPreset;
pub use segment::{box_edges, segment_on_screen};
pub use view::{Camera, View};
