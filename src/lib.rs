//! Esker: scans into an on-disk nested octree of sequential point trees, and pictures out of it.
//!
//! `ARCHITECTURE.md` tells how the rooms fit; `FORMAT.md` gives the store byte by byte.

pub mod budget;
pub mod build;
pub mod commands;
pub mod frame;
pub mod geometry;
pub mod gpu;
pub mod hierarchy;
pub mod ids;
pub mod input;
pub mod mesh;
pub mod metrics;
pub mod octree;
pub mod output;
pub mod passes;
pub mod points;
pub mod sampling;
pub mod select;
pub mod store;
pub mod stream;
#[cfg(feature = "viewer")]
pub mod viewer;
pub mod visibility;
