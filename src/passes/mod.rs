//! What draws: one file per pass.
//!
//! Points are drawn in three ways that give the same picture: [`PointsCompute`] (main; 64-bit
//! atomics), [`PointsRaster`] (adapters without them) and [`PointsCpu`] (twin of the first, for
//! machines without any adapter). [`splat`] is the arithmetic they share, [`DrawTable`] the list
//! they draw. Which nodes are drawn is decided in `select`, when and from where they are loaded in
//! `frame`.

mod draw_table;
mod picture;
mod points_cpu;
mod reference;
pub mod splat;

#[cfg(feature = "gpu")]
mod points_compute;
#[cfg(feature = "gpu")]
mod points_raster;
#[cfg(feature = "gpu")]
mod targets;

pub use draw_table::{BatchKind, Batches, CloudDraw, DrawTable, DrawnNode, NodePlace};
pub use picture::{Picture, Tile};
pub use points_cpu::{NodeWords, PointsCpu};
pub use reference::reference_picture;

/// What a point pass on the device draws, and where to.
#[cfg(feature = "gpu")]
#[derive(Clone, Copy)]
pub struct PointDrawing<'a> {
    /// What all draws share.
    pub frame: &'a crate::gpu::layout::GpuFrame,
    /// The nodes.
    pub table: &'a DrawTable,
    /// The words of all of them.
    pub arena: &'a crate::gpu::WordArena,
    /// The textures.
    pub targets: &'a Targets,
}

/// What the commands of one drawing contain.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DrawCounts {
    /// Compute dispatches.
    pub dispatches: u32,
    /// Draw calls, the resolve included.
    pub draw_calls: u32,
    /// Bytes of tables sent to the device.
    pub uploaded_bytes: u64,
}

#[cfg(feature = "gpu")]
pub use points_compute::PointsCompute;
#[cfg(feature = "gpu")]
pub use points_raster::PointsRaster;
#[cfg(feature = "gpu")]
pub use targets::Targets;
