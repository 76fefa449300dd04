//! What a frame did and how long it took.

use serde::Serialize;

use crate::frame::PacingStats;
use crate::stream::StreamStats;
use crate::visibility::CullCounters;

/// Counters and times of one frame. Counters repeat on any machine, times do not.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct FrameStats {
    /// The picture was still right and nothing was drawn; the counters of work are 0.
    pub unchanged: bool,
    /// Nothing is left to load for this view.
    pub complete: bool,
    /// Points drawn, hidden ones included.
    pub points_drawn: u64,
    /// About how many pixels the splats of these points have together, hidden ones included.
    pub splat_pixels: u64,
    /// Bytes of these points that drawing reads if none is hidden: positions and colours.
    pub point_bytes: u64,
    /// Nodes drawn.
    pub nodes_drawn: u32,
    /// Nodes drawn that are still appearing.
    pub nodes_appearing: u32,
    /// Objects of models drawn.
    pub objects_drawn: u32,
    /// Objects of models left out because they are out of sight.
    pub objects_culled: u32,
    /// What occlusion culling did; absent where the view frustum alone decided. That of `two-pass`
    /// stays on the device: it and the objects and triangles drawn are those of the latest frame
    /// whose counts came back.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub culling: Option<CullCounters>,
    /// What drawing and asking cost, as far as culling has measured it.
    #[cfg(feature = "gpu")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub culling_costs: Option<crate::frame::CullingCostStats>,
    /// Triangles of the objects drawn, hidden ones included.
    pub triangles_drawn: u64,
    /// Draw calls.
    pub draw_calls: u32,
    /// Compute dispatches.
    pub dispatches: u32,
    /// Nodes that became ready in this frame.
    pub nodes_loaded: u32,
    /// Nodes that this frame waited for while they were read and unpacked; 0 if the loader does
    /// that.
    pub nodes_waited_for: u32,
    /// Nodes that the view wants, have room, and are not there yet.
    pub nodes_requested: u32,
    /// Reads of this frame's own that failed for a passing reason and were tried again.
    pub reads_retried: u32,
    /// Nodes that cannot be read.
    pub nodes_failed: u32,
    /// Nodes taken out of memory for others.
    pub nodes_evicted: u32,
    /// Nodes that the view wants beyond the room there is for nodes; they are not asked for.
    pub nodes_without_room: u32,
    /// Nodes left out because they are out of sight.
    pub nodes_culled: u32,
    /// Nodes left out because they stand behind other things.
    pub nodes_hidden: u32,
    /// Points that these would have added.
    pub points_hidden: u64,
    /// Nodes left out because what is drawn there is fine enough.
    pub nodes_fine_enough: u32,
    /// Nodes wanted that the budget left out (those known when the walk ended).
    pub nodes_over_budget: u32,
    /// Nodes taken from the priority queue; 0 if all of the cloud fits the budget.
    pub queue_pops: u32,
    /// Bytes read from disk since the last frame.
    pub bytes_read: u64,
    /// Bytes sent to the device: words of nodes and tables of the frame.
    pub bytes_uploaded: u64,
    /// Bytes of points moved on the device, so that free room became one piece.
    pub bytes_moved: u64,
    /// Bytes of points held for drawing.
    pub node_bytes: u64,
    /// What the loader did and holds; absent while the scene needs none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stream: Option<StreamStats>,
    /// Parts that the picture was drawn in.
    pub tiles: u32,
    /// Time of the whole call.
    pub frame_ms: f64,
    /// Time per step, in order. Steps on the GPU are those of the latest frame whose clock was
    /// read, none without timestamps.
    pub passes: Vec<PassTime>,
    /// How the frame was fitted into its target time; `None` without one.
    pub pacing: Option<PacingStats>,
    /// The first nodes that could not be read, with the reason.
    pub problems: Vec<String>,
}

/// Time of one step of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PassTime {
    /// The step.
    pub pass: &'static str,
    /// Which clock: `cpu` or `gpu`.
    pub clock: &'static str,
    /// Its time.
    pub pass_ms: f64,
}
