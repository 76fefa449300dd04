//! What a view wants to have, whatever is loaded yet, clipped at the room there is for it.
//!
//! A walk that takes every node for loaded finds all that the complete picture is made of, so that
//! a loader knows it from the first frame on and need not go down level by level. Best first by
//! size on screen, a parent stands before its children. What does not fit the room is cut off at
//! the end of the list: it is not asked for, nothing that fits is dropped for it, and a view that
//! stands still comes to rest.

use crate::frame::Renderer;
use crate::geometry::View;
use crate::gpu::layout::position_words;
use crate::ids::NodeId;
use crate::select::{Availability, Cut, CutScratch, CutSettings, Residency, select_scene};
use crate::stream::{NodeSize, SceneNode};

/// What one view wants.
#[derive(Default)]
pub(super) struct Plan {
    made_for: Option<MadeFor>,
    /// The complete picture.
    pub(super) cuts: Vec<Cut>,
    /// Its nodes that have room, best first.
    pub(super) wanted: Vec<SceneNode>,
    /// Number of its nodes that have none.
    pub(super) beyond: u32,
}

/// All that a plan depends on, within one scene.
#[derive(Clone, Copy, Debug, PartialEq)]
struct MadeFor {
    view: View,
    cut: CutSettings,
    limit_bytes: u64,
    failed: usize,
    concealment: u64,
}

impl Plan {
    /// Makes it be made again.
    pub(super) fn invalidate(&mut self) {
        self.made_for = None;
    }
}

impl Renderer {
    /// Makes the plan fit a view; whether it is another one than before.
    pub(super) fn update_plan(&mut self, view: &View, cut: &CutSettings) -> bool {
        let made_for = MadeFor {
            view: *view,
            cut: *cut,
            limit_bytes: self.cache.room_bytes(self.largest_node_bytes),
            failed: self.failed.len(),
            concealment: self.concealment(),
        };
        if self.plan.made_for == Some(made_for) {
            return false;
        }
        let mut plan = std::mem::take(&mut self.plan);
        plan.cuts.drain(..).for_each(|cut| self.scratch.recycle(cut));
        let mut scratch = std::mem::take(&mut self.scratch);
        plan.cuts = self.ideal_cuts(view, cut, &mut scratch);
        self.scratch = scratch;
        let beyond = self.list_wanted(&plan.cuts, made_for.limit_bytes, &mut plan.wanted);
        plan.beyond = beyond;
        plan.made_for = Some(made_for);
        self.plan = plan;
        true
    }

    /// What would be drawn if all that can be read were there.
    pub(super) fn ideal_cuts(
        &self,
        view: &View,
        cut: &CutSettings,
        scratch: &mut CutScratch,
    ) -> Vec<Cut> {
        self.select(view, cut, scratch, |node| {
            if self.failed.contains(&node) {
                Availability::Failed
            } else if self.is_concealed(node) {
                Availability::Concealed
            } else {
                Availability::Resident
            }
        })
    }

    /// Whether a node can be drawn now.
    pub(super) fn availability(&self, node: SceneNode) -> Availability {
        if self.failed.contains(&node) {
            Availability::Failed
        } else if self.is_concealed(node) {
            Availability::Concealed
        } else if self.cache.contains(node) {
            Availability::Resident
        } else {
            Availability::Absent
        }
    }

    /// Chooses what to draw, given what is there.
    pub(super) fn select(
        &self,
        view: &View,
        cut: &CutSettings,
        scratch: &mut CutScratch,
        availability: impl Fn(SceneNode) -> Availability,
    ) -> Vec<Cut> {
        let availability = &availability;
        let answers: Vec<_> = (0..self.sources.len())
            .map(|cloud| move |node: NodeId| availability((cloud, node)))
            .collect();
        let scene: Vec<_> = self
            .sources
            .iter()
            .zip(&answers)
            .map(|(source, answer)| (source.octree(), answer as &dyn Residency))
            .collect();
        select_scene(&scene, view, cut, scratch)
    }

    /// Replaces `wanted` by the nodes of some cuts, best first, as far as they fit `limit_bytes`;
    /// the number of those that do not.
    pub(super) fn list_wanted(
        &self,
        cuts: &[Cut],
        limit_bytes: u64,
        wanted: &mut Vec<SceneNode>,
    ) -> u32 {
        let all = self.best_first(cuts);
        let mut left_bytes = limit_bytes;
        let fits = |&node: &SceneNode| takes(&mut left_bytes, self.word_bytes(node));
        wanted.clear();
        wanted.extend(all.iter().copied().take_while(fits));
        (all.len() - wanted.len()) as u32
    }

    /// The nodes that some cuts draw: the largest on screen first, parents before children.
    pub(super) fn best_first(&self, cuts: &[Cut]) -> Vec<SceneNode> {
        let mut all: Vec<(f64, u32, SceneNode)> = Vec::new();
        for (cloud, cut) in cuts.iter().enumerate() {
            let octree = self.sources[cloud].octree();
            all.extend(cut.shown().map(|drawn| {
                (drawn.priority_px, octree.node(drawn.node).depth, (cloud, drawn.node))
            }));
        }
        all.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
        all.into_iter().map(|(.., node)| node).collect()
    }

    /// Bytes of a node's words.
    pub(super) fn word_bytes(&self, (cloud, node): SceneNode) -> u64 {
        let octree = self.sources[cloud].octree();
        let words = position_words(octree.local_bits(node)) + 1;
        4 * u64::from(words) * u64::from(octree.node(node).point_count())
    }

    /// What is known of a node's sizes.
    pub(super) fn node_size(&self, (cloud, node): SceneNode) -> NodeSize {
        let word_bytes = self.word_bytes((cloud, node));
        let stored = self.reader.as_ref().and_then(|reader| reader.stored_bytes((cloud, node)));
        // Stored bytes are never more than what they hold.
        let stored_bytes = stored.unwrap_or(word_bytes);
        let depth = self.sources[cloud].octree().node(node).depth;
        NodeSize { stored_bytes, word_bytes, depth }
    }

    /// The node above one; `None` above a root.
    pub(super) fn parent(&self, (cloud, node): SceneNode) -> Option<SceneNode> {
        let parent = self.sources[cloud].octree().node(node).parent?;
        Some((cloud, parent))
    }
}

/// Takes `bytes` from what is left, if there are as many.
pub(super) fn takes(left_bytes: &mut u64, bytes: u64) -> bool {
    let left = left_bytes.checked_sub(bytes);
    *left_bytes = left.unwrap_or(0);
    left.is_some()
}
