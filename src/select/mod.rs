//! Decides which nodes are drawn, how many points of each, and what to ask for.
//!
//! [`level`](LevelRule) says when a cell is fine enough, [`select_nodes`] walks the octree under
//! the point budget, [`splat`](SplatPolicy) says how large the points of each node are drawn.
//! Pure arithmetic over the octree in memory: no files, no GPU, no clock.

mod cut;
mod level;
mod splat;
mod walk;

pub use cut::{
    AllResident, Availability, Cut, CutCounters, CutScratch, CutSettings, DrawNode, Request,
    Residency, select_nodes, select_scene,
};
pub use level::{CellSpan, LevelRule, RuleCell, off_axis_cosine, projected_px, required_level};
pub use splat::{
    DrawnRow, SplatDrawing, SplatPolicy, SplatSettings, SplatShape, SplatSize, mean_spacing,
};
