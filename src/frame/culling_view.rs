//! What is culled, to look at: boxes over the picture, and the culling of one camera seen from
//! another.
//!
//! Boxes are worked out when somebody asks for them, from what the last frame left behind; a frame
//! does nothing for them. Where the view frustum alone decides, the tree is made and walked then.
//! While culling is frozen, frames from any view draw what was chosen for the view it was frozen
//! in: the same points of the same nodes, the same objects.

use glam::DVec3;

use crate::frame::Renderer;
use crate::frame::models::Models;
use crate::geometry::{Aabb, Camera, Containment, Frustum, View, box_edges, segment_on_screen};
use crate::hierarchy::Bvh;
use crate::ids::{ObjectId, TreeNodeId};
use crate::passes::ScreenLine;
use crate::visibility::{
    Algorithm, Answer, Culler, NodeState, NodeStatus, OcclusionDevice, QueryId,
};

/// Culling as it was for one view.
pub(super) struct Frozen {
    pub(super) view: View,
    /// What is drawn of the models.
    pub(super) objects: Vec<ObjectId>,
    states: Vec<NodeStatus>,
}

/// A tree walked only to be looked at, and the view it was walked for.
pub(super) struct Explained {
    tree: Bvh,
    culler: Culler,
    walked_for: Option<(View, bool)>,
}

impl Renderer {
    /// What became of the scene in the last frame: the largest nodes of each state, in no order.
    /// While culling is frozen: in the frame before.
    pub fn culling_states(&mut self) -> Vec<NodeStatus> {
        if let Some(frozen) = &self.frozen {
            return frozen.states.clone();
        }
        #[cfg(feature = "gpu")]
        if let Some(culling) = &self.culling {
            let states = culling.culler.states(&culling.tree(&self.sources));
            self.forget_culling_states();
            return states;
        }
        self.models.as_mut().map_or_else(Vec::new, |models| models.states())
    }

    /// Drops what [`culling_states`](Self::culling_states) made for itself.
    pub fn forget_culling_states(&mut self) {
        if let Some(models) = &mut self.models {
            models.explained = None;
        }
    }

    /// Keeps what is drawn as it was in the last frame, which showed `view`, whatever frames show
    /// from now on.
    pub fn freeze_culling(&mut self, view: &View) {
        let states = self.culling_states();
        let objects = self.drawn_objects();
        self.frozen = Some(Box::new(Frozen { view: *view, objects, states }));
        self.last = None;
    }

    /// Lets each frame choose for its own view again.
    pub fn thaw_culling(&mut self) {
        if self.frozen.take().is_some() {
            self.plan.invalidate();
            self.last = None;
        }
    }

    /// The objects that the last frame drew.
    fn drawn_objects(&self) -> Vec<ObjectId> {
        #[cfg(feature = "gpu")]
        if let Some(culling) = &self.culling {
            return culling.drawn_objects(&self.sources);
        }
        self.models.as_ref().map_or_else(Vec::new, |models| models.visible.clone())
    }

    /// The view that culling is frozen in.
    pub fn frozen_view(&self) -> Option<&View> {
        self.frozen.as_ref().map(|frozen| &frozen.view)
    }
}

impl Models {
    fn states(&mut self) -> Vec<NodeStatus> {
        let Some((view, everything)) = self.chosen_for else { return Vec::new() };
        if self.explained.is_none() {
            let culler = Culler::new(Algorithm::Frustum);
            let explained = Explained { tree: self.tree(), culler, walked_for: None };
            self.explained = Some(Box::new(explained));
        }
        let Some(explained) = &mut self.explained else { return Vec::new() };
        if explained.walked_for != Some((view, everything)) {
            explained.culler.set_algorithm(match everything {
                true => Algorithm::None,
                false => Algorithm::Frustum,
            });
            explained.culler.frame(&explained.tree, &view, &mut NoDevice);
            explained.walked_for = Some((view, everything));
        }
        explained.culler.states(&explained.tree)
    }
}

/// Draws nothing.
pub(super) struct NoDevice;

impl OcclusionDevice for NoDevice {
    fn begin_frame(&mut self, _: &View) {}

    fn draw(&mut self, _: TreeNodeId) {}

    fn query(&mut self, _: &[Aabb]) -> QueryId {
        QueryId(0)
    }

    fn draw_and_query(&mut self, _: TreeNodeId) -> QueryId {
        QueryId(0)
    }

    fn answer(&mut self, _: QueryId) -> Answer {
        // Visible: nothing is lost by it.
        Answer::Samples(1)
    }

    fn wait(&mut self, _: QueryId) {}

    fn end_frame(&mut self) {}

    fn state_switches(&self) -> u64 {
        0
    }

    fn rounds(&self) -> u64 {
        0
    }
}

/// The colour that a state is shown in.
pub fn state_color(state: NodeState) -> [u8; 3] {
    match state {
        NodeState::Drawn => [90, 220, 110],
        NodeState::Forced => [255, 214, 64],
        NodeState::Hidden => [255, 82, 64],
        NodeState::Outside => [110, 150, 215],
    }
}

/// Colour of the frustum that culling is frozen in.
pub const FRUSTUM_COLOR: [u8; 3] = [255, 255, 255];

/// How many nodes there are of each state, in the order of [`NodeState::ALL`].
pub fn count_states(states: &[NodeStatus]) -> [usize; 4] {
    NodeState::ALL.map(|state| states.iter().filter(|status| status.state == state).count())
}

/// The edges of the boxes that a view shows, as lines over its picture, and how many boxes were left
/// out: at most `most` are shown, those that are the largest on screen.
///
/// Hidden ones stand last, so that they are drawn over the others.
pub fn box_lines(view: &View, states: &[NodeStatus], most: usize) -> (Vec<ScreenLine>, usize) {
    let frustum = Frustum::new(view);
    let mut shown: Vec<(f64, &NodeStatus)> = states
        .iter()
        .filter(|status| frustum.test_box(&status.bounds) != Containment::Outside)
        .map(|status| {
            let distance = status.bounds.distance(view.camera.eye).max(view.camera.near);
            (status.bounds.diagonal() / distance, status)
        })
        .collect();
    shown.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.node.cmp(&b.1.node)));
    let left_out = shown.len().saturating_sub(most);
    shown.truncate(most);
    let order = |state| match state {
        NodeState::Outside => 0,
        NodeState::Drawn => 1,
        NodeState::Forced => 2,
        NodeState::Hidden => 3,
    };
    shown.sort_by_key(|(_, status)| order(status.state));
    let mut lines = Vec::new();
    for (_, status) in shown {
        let color = state_color(status.state);
        lines.extend(
            box_edges(&status.bounds).into_iter().filter_map(|edge| line(view, edge, color)),
        );
    }
    (lines, left_out)
}

/// The frustum of one view in the picture of another, from its eye to `reach`.
pub fn frustum_lines(view: &View, of: &View, reach: f64) -> Vec<ScreenLine> {
    let (width, height) = (f64::from(of.width_px), f64::from(of.height_px));
    let corner = |x: f64, y: f64| of.unproject(x, y, reach);
    let far = [corner(0.0, 0.0), corner(width, 0.0), corner(width, height), corner(0.0, height)];
    let sides = far.map(|corner| [of.camera.eye, corner]);
    let rim = [0, 1, 2, 3].map(|at| [far[at], far[(at + 1) % 4]]);
    let edges = sides.into_iter().chain(rim);
    edges.filter_map(|edge| line(view, edge, FRUSTUM_COLOR)).collect()
}

/// A camera above and behind another one that sees what lies before it, and what it looks at.
pub fn camera_above(first: &Camera, bounds: &Aabb) -> (Camera, DVec3) {
    let level = DVec3::new(first.forward.x, first.forward.y, 0.0);
    let ahead = level.try_normalize().unwrap_or(DVec3::Y);
    let reach = frustum_reach(bounds);
    let target = first.eye + 0.4 * reach * ahead;
    let eye = first.eye - 0.25 * reach * ahead + 0.75 * reach * DVec3::Z;
    (Camera::looking_at(eye, target, DVec3::Z, first.fov_y_rad, first.near), target)
}

/// How far the frustum of the first camera is drawn.
pub fn frustum_reach(bounds: &Aabb) -> f64 {
    let diagonal = bounds.diagonal();
    if diagonal > 0.0 { 0.5 * diagonal } else { 1.0 }
}

fn line(view: &View, [from, to]: [DVec3; 2], color: [u8; 3]) -> Option<ScreenLine> {
    let ends = segment_on_screen(view, from, to)?;
    Some(ScreenLine { ends: ends.map(|end| end.as_vec2().to_array()), color })
}
