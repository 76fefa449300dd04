//! Coherent hierarchical culling: last frame's classification is the guess, acted on at once.
//!
//! Inner nodes that were visible are opened without a question; leaves that were visible are drawn
//! at once and asked about for the next frame; hidden nodes are asked about as a whole. A node that
//! turns visible makes its ancestors visible; an inner node none of whose descendants was seen ends
//! the frame hidden and is one question in the next.
//!
//! After: Bittner, Wimmer, Piringer and Purgathofer, "Coherent Hierarchical Culling", 2004, and
//! Wimmer and Bittner, "Hardware Occlusion Queries Made Useful", 2005, with the corrections that the
//! walk up ends at the root, and that a flag only counts if it is of the last frame.

use std::collections::VecDeque;

use crate::hierarchy::BoundingHierarchy;
use crate::ids::TreeNodeId;
use crate::visibility::frontier::Order;
use crate::visibility::near_optimal::Judge;
use crate::visibility::walk::{LateAnswers, Reached, Walk};
use crate::visibility::{Answer, QueryId};

/// The options of the papers' section 4.6, and ours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChcOptions {
    /// A node with at most this many visible samples counts as hidden. 0 is exact; more than 0
    /// loses up to this many pixels a node and needs a device that counts.
    pub threshold: u64,
    /// A leaf found visible is asked about again after this many frames; 1 asks in every frame.
    pub assume_visible_frames: u32,
    /// Whether leaves that were visible are asked about by drawing them, without a box.
    pub geometry_queries: bool,
    /// Order of the walk.
    pub order: Order,
    /// Subtrees that cost less than this are leaves. 0: the tree's own.
    pub leaf_cost: u64,
    /// What is done about late answers.
    pub late: LateAnswers,
    /// Whether answers that only the next frame needs are left to it, instead of waiting.
    pub defer_verification: bool,
    /// Whether a first frame, or one after a jump, takes all leaves in the frustum as visible
    /// instead of opening the tree level by level.
    pub seed_first_frame: bool,
}

impl Default for ChcOptions {
    fn default() -> Self {
        ChcOptions {
            threshold: 0,
            assume_visible_frames: 1,
            geometry_queries: false,
            order: Order::Nearest,
            leaf_cost: 0,
            late: LateAnswers::default(),
            defer_verification: true,
            seed_first_frame: true,
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Record {
    node: TreeNodeId,
    query: QueryId,
    was_visible: bool,
}

/// What lasts from frame to frame.
#[derive(Clone, Debug, Default)]
pub(super) struct Chc {
    queue: VecDeque<Record>,
    /// Inner nodes that were visible and opened in the last frame.
    opened: Vec<TreeNodeId>,
    /// Decides whether a question pays; without it every question is put.
    pub judge: Option<Judge>,
}

impl Chc {
    pub fn forget(&mut self) {
        self.queue.clear();
        self.opened.clear();
    }

    /// One frame. `seed`: take everything in the frustum as visible.
    pub fn frame<H: BoundingHierarchy>(
        &mut self,
        walk: &mut Walk<H>,
        options: &ChcOptions,
        seed: bool,
    ) {
        self.finish_last_frame(walk, options);
        if let Some(judge) = &mut self.judge {
            judge.begin_frame();
        }
        walk.start(options.order);
        loop {
            self.drain(walk, options);
            let Some(node) = walk.frontier.pop() else { break };
            match walk.reach(node) {
                Reached::Outside => {}
                Reached::Near { .. } => {
                    walk.pull_up(node);
                    self.open(walk, node);
                }
                Reached::Inside { was_visible } => {
                    let seed = seed && options.seed_first_frame;
                    self.decide(walk, node, was_visible || seed, options);
                }
            }
        }
        if !options.defer_verification && options.late != LateAnswers::NextFrame {
            while let Some(record) = self.queue.front().copied() {
                if walk.device.answer(record.query) == Answer::Unknown {
                    walk.wait(record.query);
                }
                self.take_answer(walk, options);
            }
        }
    }

    /// Reads what the last frame left open.
    fn finish_last_frame<H: BoundingHierarchy>(
        &mut self,
        walk: &mut Walk<H>,
        options: &ChcOptions,
    ) {
        let last = walk.history.frame().wrapping_sub(1);
        while let Some(record) = self.queue.pop_front() {
            let seen = walk.samples(record.query) > options.threshold;
            if walk.history.node(record.node).last_visited != last {
                // A node that was forgotten since is of no concern any more.
                continue;
            }
            self.tested(walk, &record, seen);
            if seen {
                walk.pull_up(record.node);
                walk.counters.pulled_down += u64::from(!record.was_visible);
                let again = options.assume_visible_frames.max(1);
                walk.history.node(record.node).next_test = last.wrapping_add(again);
            }
        }
        for node in self.opened.drain(..) {
            let node = walk.history.node(node);
            walk.counters.pulled_up += u64::from(!node.visible && node.last_visited == last);
        }
    }

    /// Acts on the guess, and asks where it is to be checked.
    fn decide<H: BoundingHierarchy>(
        &mut self,
        walk: &mut Walk<H>,
        node: TreeNodeId,
        was_visible: bool,
        options: &ChcOptions,
    ) {
        let leaf = walk.is_leaf(node);
        if was_visible && leaf && !walk.is_due(node) {
            // Without this the ancestors would end the frame hidden.
            walk.pull_up(node);
            self.open(walk, node);
            return;
        }
        if was_visible && !leaf {
            self.opened.push(node);
            self.open(walk, node);
            return;
        }
        if let Some(judge) = &mut self.judge
            && !judge.pays(walk, node, was_visible)
        {
            walk.pull_up(node);
            self.open(walk, node);
            return;
        }
        walk.counters.queries_issued += 1;
        if was_visible {
            walk.counters.queries_visible_leaf += 1;
        } else {
            walk.counters.queries_hidden += 1;
            walk.counters.hidden_nodes_decided += 1;
        }
        if was_visible && options.geometry_queries && walk.count_draw(node) {
            let query = walk.device.draw_and_query(node);
            self.queue.push_back(Record { node, query, was_visible });
            return;
        }
        walk.counters.query_boxes += 1;
        let proxy = walk.proxy(node);
        let query = walk.device.query(&[proxy]);
        self.queue.push_back(Record { node, query, was_visible });
        if was_visible {
            self.open(walk, node);
        }
    }

    /// Takes answers from the front while they are known; waits for one if there is nothing else to
    /// do and a hidden node hangs on it.
    fn drain<H: BoundingHierarchy>(&mut self, walk: &mut Walk<H>, options: &ChcOptions) {
        while let Some(record) = self.queue.front().copied() {
            if walk.device.answer(record.query) != Answer::Unknown {
                self.take_answer(walk, options);
                continue;
            }
            if !walk.frontier.is_empty() || options.late == LateAnswers::NextFrame {
                return;
            }
            let Some(hidden) = self.queue.iter().find(|record| !record.was_visible) else { return };
            if walk.may_wait(options.late) {
                let query = hidden.query;
                walk.wait(query);
                continue;
            }
            // No further round: what is open is drawn.
            let open: Vec<TreeNodeId> = self
                .queue
                .iter()
                .filter(|record| !record.was_visible)
                .map(|record| record.node)
                .collect();
            self.queue.retain(|record| record.was_visible);
            for node in open {
                walk.force(node, |walk, leaf| walk.draw(leaf));
            }
        }
    }

    fn take_answer<H: BoundingHierarchy>(&mut self, walk: &mut Walk<H>, options: &ChcOptions) {
        let Some(record) = self.queue.pop_front() else { return };
        let seen = walk.samples(record.query) > options.threshold;
        self.tested(walk, &record, seen);
        if !seen {
            // The flag was cleared when the node was reached.
            return;
        }
        walk.pull_up(record.node);
        let again = options.assume_visible_frames.max(1);
        walk.history.node(record.node).next_test = walk.history.frame().wrapping_add(again);
        if !record.was_visible {
            walk.counters.pulled_down += 1;
            self.open(walk, record.node);
        }
    }

    /// Draws a leaf, or puts up the children of an inner node.
    fn open<H: BoundingHierarchy>(&mut self, walk: &mut Walk<H>, node: TreeNodeId) {
        if walk.is_leaf(node) {
            walk.draw(node);
            if let Some(judge) = &mut self.judge {
                judge.drew(walk, node);
            }
        } else {
            walk.push_children(node);
        }
    }

    fn tested<H: BoundingHierarchy>(&mut self, walk: &mut Walk<H>, record: &Record, seen: bool) {
        if let Some(judge) = &mut self.judge {
            judge.tested(walk, record.node, record.was_visible, seen);
        }
    }
}
