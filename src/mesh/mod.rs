//! Triangle models: shapes, materials and the objects that place them in the world.
//!
//! A shape ([`Mesh`]) keeps f32 positions about its own origin; an [`Object`] places it in the world
//! in f64. So a building at UTM coordinates is as exact as one at the origin, and one shape may
//! stand in thousands of places. A [`Model`] holds shapes, materials and objects together; objects
//! are what is drawn, hidden and moved. Readers split large shapes into groups of triangles that
//! lie close together ([`compact_groups`]), each an object of its own.
//!
//! Not here: files (`input`), drawing (`passes`), which objects are drawn (`visibility`).

mod compact;
mod model;
mod normals;
pub mod scenes;
mod shape;
mod shapes;

pub use compact::{MOST_GROUP_TRIANGLES, compact_groups};
pub use model::{Material, Model, ModelError, Object, Texture};
pub use shape::Mesh;
