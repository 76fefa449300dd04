//! What every algorithm does alike: look at a node, draw it, open it.

use crate::geometry::{Aabb, Containment, Frustum, View};
use crate::hierarchy::BoundingHierarchy;
use crate::ids::TreeNodeId;
use crate::visibility::frontier::{Frontier, Order};
use crate::visibility::{
    Answer, CullCounters, OcclusionDevice, Proxies, QueryId, ViewHistory, meets_near_plane,
};

/// What is done about answers that are not there when the walk has nothing else to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LateAnswers {
    /// Submit and wait, up to this many times a frame; what is open then is drawn. Exact.
    Rounds(u32),
    /// Go on without: the next frame learns it. Something that comes into sight is missing for a
    /// frame or more; only for comparison.
    NextFrame,
}

impl Default for LateAnswers {
    fn default() -> Self {
        // A round costs less than drawing whole what further rounds would find hidden, and most frames
        // need few: on llvmpipe sixteen draw half of the triangles of four in the pipe jungle, in nine
        // tenths of the time.
        LateAnswers::Rounds(16)
    }
}

/// How much of its persistence a node keeps that comes back into the frustum.
const REENTRY_PERSISTENCE: u16 = 3;

/// One frame's walk over one tree.
pub(super) struct Walk<'a, H> {
    pub tree: &'a H,
    pub view: &'a View,
    pub history: &'a mut ViewHistory,
    pub device: &'a mut dyn OcclusionDevice,
    pub counters: &'a mut CullCounters,
    /// Leaves drawn, in order.
    pub drawn: &'a mut Vec<TreeNodeId>,
    pub frontier: &'a mut Frontier,
    frustum: Frustum,
    proxies: Proxies,
    leaf_cost: u64,
    waits: u32,
    /// Whether nodes that come back into the frustum keep their classification.
    pub inherit_on_reentry: bool,
}

/// What [`Walk::reach`] found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reached {
    /// Outside the frustum.
    Outside,
    /// The box meets the near plane and cannot be asked about.
    Near {
        /// Whether it was visible in the last frame.
        was_visible: bool,
    },
    /// To be decided.
    Inside {
        /// Whether it was visible in the last frame, or is taken so.
        was_visible: bool,
    },
}

/// The parts of a [`Walk`] that outlive it.
pub(super) struct Parts<'a> {
    pub history: &'a mut ViewHistory,
    pub device: &'a mut dyn OcclusionDevice,
    pub counters: &'a mut CullCounters,
    pub drawn: &'a mut Vec<TreeNodeId>,
    pub frontier: &'a mut Frontier,
}

impl<'a, H: BoundingHierarchy> Walk<'a, H> {
    /// A walk in which subtrees that cost less than `leaf_cost` count as leaves.
    pub fn new(tree: &'a H, view: &'a View, leaf_cost: u64, parts: Parts<'a>) -> Self {
        let Parts { history, device, counters, drawn, frontier } = parts;
        Walk {
            tree,
            view,
            history,
            device,
            counters,
            drawn,
            frontier,
            frustum: Frustum::new(view),
            proxies: Proxies::new(view),
            leaf_cost,
            waits: 0,
            inherit_on_reentry: false,
        }
    }

    /// Starts at the root, and draws what no box is known for.
    pub fn start(&mut self, order: Order) {
        self.frontier.clear(order);
        let roots = self.tree.root().map(|root| (0.0, root));
        self.frontier.push(roots.into_iter());
        for node in self.tree.always_drawn() {
            self.draw(node);
        }
    }

    /// Whether the walk goes no further down here.
    pub fn is_leaf(&self, node: TreeNodeId) -> bool {
        self.tree.is_leaf(node) || self.tree.cost(node) < self.leaf_cost
    }

    /// The box that is asked about.
    pub fn proxy(&self, node: TreeNodeId) -> Aabb {
        self.proxies.of(self.tree, node)
    }

    /// The rule that boxes are widened by.
    pub fn proxies(&self) -> &Proxies {
        &self.proxies
    }

    /// Whether a box is seen in part at least, occlusion aside.
    pub fn in_frustum(&self, bounds: &Aabb) -> bool {
        self.frustum.test_box(bounds) != Containment::Outside
    }

    /// Comes to a node: stamps it and clears its flag, unless it is outside the frustum.
    pub fn reach(&mut self, node: TreeNodeId) -> Reached {
        self.counters.nodes_visited += 1;
        let bounds = self.proxy(node);
        let frame = self.history.frame();
        if !self.in_frustum(&bounds) {
            self.counters.frustum_culled += 1;
            self.history.node(node).last_outside = frame;
            return Reached::Outside;
        }
        let was_visible = self.classification(node);
        let history = self.history.node(node);
        history.visible = false;
        history.forced = false;
        history.last_visited = frame;
        if meets_near_plane(self.view, &bounds) {
            self.counters.near_plane_forced += 1;
            self.history.node(node).forced = true;
            return Reached::Near { was_visible };
        }
        Reached::Inside { was_visible }
    }

    /// Whether the node counts as visible last frame; sets the rest of its memory straight if it was
    /// not reached then.
    fn classification(&mut self, node: TreeNodeId) -> bool {
        let frame = self.history.frame();
        let last = frame.wrapping_sub(1);
        let parent = self.tree.parent(node);
        let parent_reentered = parent.is_some_and(|parent| {
            let parent = self.history.node(parent);
            parent.reentered && parent.last_visited == frame
        });
        let history = self.history.node(node);
        history.reentered = false;
        if history.last_visited == last && last != 0 {
            return history.visible;
        }
        let known = history.last_visited != 0;
        if self.inherit_on_reentry && known && (parent_reentered || history.last_outside == last) {
            history.reentered = true;
            history.persistence = history.persistence.min(REENTRY_PERSISTENCE);
            return history.visible;
        }
        history.next_test = frame;
        history.persistence = 0;
        false
    }

    /// Makes a node and its ancestors visible.
    pub fn pull_up(&mut self, node: TreeNodeId) {
        self.history.pull_up(self.tree, node);
    }

    /// Counts a leaf as drawn; `true` the first time in this frame.
    pub fn count_draw(&mut self, node: TreeNodeId) -> bool {
        let first = self.history.mark_drawn(node);
        if first {
            self.counters.leaves_drawn += 1;
            self.counters.triangles_drawn += self.tree.cost(node);
            self.drawn.push(node);
        }
        first
    }

    /// Draws a leaf, once a frame.
    pub fn draw(&mut self, node: TreeNodeId) {
        if self.count_draw(node) {
            self.device.draw(node);
        }
    }

    /// Puts a node's children up to be looked at.
    pub fn push_children(&mut self, node: TreeNodeId) {
        let eye = self.view.camera.eye;
        let tree = self.tree;
        let keyed = tree.children(node).map(|child| (tree.bounds(child).distance(eye), child));
        self.frontier.push(keyed);
    }

    /// Whether another round may be waited for.
    pub fn may_wait(&self, late: LateAnswers) -> bool {
        match late {
            LateAnswers::Rounds(most) => self.waits < most,
            LateAnswers::NextFrame => false,
        }
    }

    /// Waits for an answer.
    pub fn wait(&mut self, query: QueryId) {
        self.waits += 1;
        self.counters.blocking_waits += 1;
        self.device.wait(query);
    }

    /// The samples of a question, waited for if they are not known.
    pub fn samples(&mut self, query: QueryId) -> u64 {
        if self.device.answer(query) == Answer::Unknown {
            self.wait(query);
        }
        match self.device.answer(query) {
            Answer::Samples(samples) => samples,
            // A device that cannot tell after waiting is lost; to guess visible loses nothing.
            Answer::Unknown => u64::MAX,
        }
    }

    /// Whether a visible leaf is to be asked about in this frame.
    pub fn is_due(&mut self, node: TreeNodeId) -> bool {
        let at = self.history.node(node).next_test;
        self.history.is_due(at)
    }

    /// Draws a subtree's leaves inside the frustum without asking, and marks them seen.
    ///
    /// The subtree's root was reached already.
    pub fn force(&mut self, root: TreeNodeId, mut draw: impl FnMut(&mut Self, TreeNodeId)) {
        self.counters.forced_subtrees += 1;
        let mut open = vec![root];
        while let Some(node) = open.pop() {
            if node != root && self.reach(node) == Reached::Outside {
                continue;
            }
            if self.is_leaf(node) {
                self.pull_up(node);
                self.history.node(node).forced = true;
                draw(self, node);
            } else {
                open.extend(self.tree.children(node));
            }
        }
    }
}
