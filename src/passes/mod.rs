//! What draws: one file per pass.
//!
//! Points are drawn in four ways that give the same picture: [`PointsCompute`] with 64-bit atomics
//! (main) or 32-bit ones, [`PointsRaster`] (adapters without either) and [`PointsCpu`] (twin of the
//! first, for machines without any adapter). [`FinishSettings`] tells what is done to the picture
//! afterwards. Triangles of models are drawn into the same picture by [`Meshes`] and [`MeshesCpu`].
//! [`splat`] is the arithmetic they share, [`DrawTable`] the list
//! they draw. Which nodes are drawn is decided in `select`, when and from where they are loaded in
//! `frame`.

mod alternatives;
mod depth_pyramid_cpu;
mod draw_table;
mod finish_cpu;
mod lines;
mod mesh_list;
mod mesh_tables;
mod meshes_cpu;
mod picture;
mod points_cpu;
mod rasterize;
mod reference;
mod shown;
pub mod splat;

#[cfg(feature = "gpu")]
mod bindings;
#[cfg(feature = "gpu")]
mod checkpoint;
#[cfg(feature = "gpu")]
mod culled_scene;
#[cfg(feature = "gpu")]
mod depth_pyramid;
#[cfg(feature = "gpu")]
mod finish;
#[cfg(feature = "gpu")]
mod grow;
#[cfg(feature = "gpu")]
mod mesh_upload;
#[cfg(feature = "gpu")]
mod meshes;
#[cfg(feature = "gpu")]
mod occlusion;
#[cfg(feature = "gpu")]
mod points_bare;
#[cfg(feature = "gpu")]
mod points_compute;
#[cfg(feature = "gpu")]
mod points_raster;
#[cfg(feature = "gpu")]
mod points_raster_ties;
#[cfg(feature = "gpu")]
mod points_rounds;
#[cfg(feature = "gpu")]
mod pyramid_answers;
#[cfg(feature = "gpu")]
mod targets;
#[cfg(feature = "gpu")]
mod two_pass;

pub use alternatives::{CheckpointPlan, DrawPart};
pub use depth_pyramid_cpu::DepthPyramidCpu;
pub use draw_table::{BatchKind, Batches, CloudDraw, DrawTable, DrawnNode, NodePlace, splat_edge};
pub use finish_cpu::{
    EyeDome, FinishSettings, MAX_FINISH_RADIUS_PX, fill_gaps, finish, light_eye_dome,
};
pub use lines::{ScreenLine, draw_line};
pub use mesh_list::{DrawOrder, MeshCounts};
pub use meshes_cpu::MeshesCpu;
pub use picture::{Picture, Tile};
pub use points_cpu::{NodeWords, PointsCpu};
pub use rasterize::{ClipVertex, Fragment, RasterTarget, rasterize};
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
    /// How splats that share a size are drawn.
    pub splat_drawing: crate::select::SplatDrawing,
    /// Whether the depth target is written too, which the rasterizer always does.
    pub wants_depth: bool,
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
pub use checkpoint::{Checkpoint, Decision};
#[cfg(feature = "gpu")]
pub use culled_scene::{
    CulledDraws, CulledOutput, CulledPoints, CulledRecording, CulledScene, SceneTree,
};
#[cfg(feature = "gpu")]
pub use depth_pyramid::DepthPyramid;
#[cfg(feature = "gpu")]
pub use finish::Finish;
#[cfg(feature = "gpu")]
pub use meshes::{MeshColor, MeshList, MeshOutput, Meshes};
#[cfg(feature = "gpu")]
pub use occlusion::OcclusionQueries;
#[cfg(feature = "gpu")]
pub use points_bare::PointsBare;
#[cfg(feature = "gpu")]
pub use points_compute::{EarlyOut, PointsCompute};
#[cfg(feature = "gpu")]
pub use points_raster::{PointsRaster, Ties};
#[cfg(feature = "gpu")]
pub use pyramid_answers::PyramidAnswers;
#[cfg(feature = "gpu")]
pub use targets::{DepthTarget, Targets};
#[cfg(feature = "gpu")]
pub use two_pass::{TwoPass, TwoPassCounts, TwoPassDrawing};
