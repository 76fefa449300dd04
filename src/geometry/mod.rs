//! Shapes and spaces: boxes, views, Morton codes. Arithmetic only.

mod aabb;
mod morton;
mod view;

pub use aabb::Aabb;
pub use morton::MortonKey;
pub use view::{Camera, View};
