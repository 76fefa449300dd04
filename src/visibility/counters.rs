//! What a frame of culling did, counted; the same on every machine.

use serde::Serialize;

/// Counts of one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct CullCounters {
    /// Nodes reached.
    pub nodes_visited: u64,
    /// Nodes found outside the view frustum.
    pub frustum_culled: u64,
    /// Questions put to the device; a group counts once.
    pub queries_issued: u64,
    /// Of these: about a leaf that was visible.
    pub queries_visible_leaf: u64,
    /// Of these: about a hidden node alone.
    pub queries_hidden: u64,
    /// Of these: about several hidden nodes at once.
    pub multiqueries: u64,
    /// Multiqueries that found something visible, so that each node was asked about again.
    pub multiqueries_failed: u64,
    /// Hidden nodes decided by a question, each node of a group counted.
    pub hidden_nodes_decided: u64,
    /// Boxes drawn for questions.
    pub query_boxes: u64,
    /// Nodes taken as visible because their box meets the near plane.
    pub near_plane_forced: u64,
    /// Inner nodes that were visible and ended the last frame hidden, one question from now on.
    pub pulled_up: u64,
    /// Hidden nodes that turned out visible.
    pub pulled_down: u64,
    /// Leaves drawn.
    pub leaves_drawn: u64,
    /// Triangles, or points, drawn.
    pub triangles_drawn: u64,
    /// Changes between drawing and asking.
    pub state_switches: u64,
    /// Submissions of work.
    pub rounds: u64,
    /// Times that the next step had to wait for an answer.
    pub blocking_waits: u64,
    /// Nodes drawn whole because no further round was allowed.
    pub forced_subtrees: u64,
}

impl CullCounters {
    /// Adds another frame's counts.
    pub fn add(&mut self, other: &CullCounters) {
        self.nodes_visited += other.nodes_visited;
        self.frustum_culled += other.frustum_culled;
        self.queries_issued += other.queries_issued;
        self.queries_visible_leaf += other.queries_visible_leaf;
        self.queries_hidden += other.queries_hidden;
        self.multiqueries += other.multiqueries;
        self.multiqueries_failed += other.multiqueries_failed;
        self.hidden_nodes_decided += other.hidden_nodes_decided;
        self.query_boxes += other.query_boxes;
        self.near_plane_forced += other.near_plane_forced;
        self.pulled_up += other.pulled_up;
        self.pulled_down += other.pulled_down;
        self.leaves_drawn += other.leaves_drawn;
        self.triangles_drawn += other.triangles_drawn;
        self.state_switches += other.state_switches;
        self.rounds += other.rounds;
        self.blocking_waits += other.blocking_waits;
        self.forced_subtrees += other.forced_subtrees;
    }
}
