//! CHC++: the questions of coherent hierarchical culling in batches, for several nodes at once, with
//! tighter boxes, and at times that spread.
//!
//! Hidden nodes wait in one queue until a batch is worth a change of state, and are asked about in
//! groups that are likely to stay hidden together. Visible leaves wait in a second queue of low
//! priority; each is asked about once in some frames, the first time after a random number of them,
//! so that nodes that appeared together do not stay in step. Every part can be switched off; with
//! all off, and batches of one, this is CHC, question for question.
//!
//! After: Mattausch, Bittner and Wimmer, "CHC++: Coherent Hierarchical Culling Revisited", 2008, and,
//! for [`ChcPlusOptions::optimized`], the variant of "Efficient online occlusion culling for shadow
//! maps", Mattausch et al. 2011, section 5.3. The listing there clears the flag of inner nodes
//! only; here every node that is reached is cleared. Its test of the query queue alone while waiting
//! follows the text instead.

use std::collections::VecDeque;

use crate::geometry::Aabb;
use crate::hierarchy::{BoundingHierarchy, TightCut};
use crate::ids::TreeNodeId;
use crate::sampling::Random;
use crate::visibility::coherence::{CoherenceTable, KeepRule};
use crate::visibility::frontier::Order;
use crate::visibility::grouping::best_group;
use crate::visibility::history::{LONGEST_PERSISTENCE, NodeHistory};
use crate::visibility::retest::RetestTable;
use crate::visibility::tight::TightBounds;
use crate::visibility::walk::{LateAnswers, Reached, Walk};
use crate::visibility::{Answer, QueryId};

/// The parts of CHC++ and their sizes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChcPlusOptions {
    /// Batching: hidden nodes are asked about `batch_size` at a time, visible leaves late.
    pub batching: bool,
    /// Hidden nodes that start a batch. 20 to 80 serve alike; more delays answers.
    pub batch_size: u32,
    /// Multiqueries: several hidden nodes in one question.
    pub multiqueries: bool,
    /// Where the probability behind a group comes from.
    pub keep: KeepRule,
    /// Whether the first test of a leaf that turned visible falls on a random frame.
    pub jitter: bool,
    /// Frames between two tests of a visible leaf, at least 1. 5 to 10 are safe.
    pub assumed_visible_frames: u32,
    /// Share of the drawn triangles that may be drawn in vain, as far as known: leaves that go out of
    /// sight soon are asked about more often than once in `assumed_visible_frames`. `None`: no bound,
    /// as published.
    pub in_vain: Option<f64>,
    /// Tight bounds; `None` asks with the node's own box.
    pub tight: Option<TightCut>,
    /// Fewer waits for somewhat more drawing: hidden nodes are asked about before visible leaves
    /// while waiting, visible leaves after the walk; nodes that come back into the frustum keep
    /// their classification.
    pub optimized: bool,
    /// Whether an inner node whose box shows while nothing in it does is left open for some frames,
    /// longer each time. Without it such a node turns visible and hidden in turns, a round each.
    pub remember_splits: bool,
    /// See [`ChcOptions::threshold`](crate::visibility::ChcOptions::threshold); here it bounds a
    /// group's sum.
    pub threshold: u64,
    /// Subtrees that cost less than this many triangles are leaves for the walk; their inner boxes
    /// serve as tight bounds.
    pub leaf_cost: u64,
    /// Order of the walk.
    pub order: Order,
    /// What is done about late answers.
    pub late: LateAnswers,
    /// See [`ChcOptions::seed_first_frame`](crate::visibility::ChcOptions::seed_first_frame).
    pub seed_first_frame: bool,
}

impl Default for ChcPlusOptions {
    fn default() -> Self {
        ChcPlusOptions {
            batching: true,
            batch_size: 50,
            multiqueries: true,
            keep: KeepRule::Measured,
            jitter: true,
            assumed_visible_frames: 10,
            in_vain: Some(0.05),
            tight: Some(TightCut::default()),
            optimized: true,
            remember_splits: true,
            threshold: 0,
            leaf_cost: 0,
            order: Order::Nearest,
            late: LateAnswers::default(),
            seed_first_frame: true,
        }
    }
}

impl ChcPlusOptions {
    /// All parts off, batches of one: plain CHC.
    pub const PLAIN: ChcPlusOptions = ChcPlusOptions {
        batching: false,
        batch_size: 1,
        multiqueries: false,
        keep: KeepRule::Measured,
        jitter: false,
        assumed_visible_frames: 1,
        in_vain: None,
        tight: None,
        optimized: false,
        remember_splits: false,
        threshold: 0,
        leaf_cost: 0,
        order: Order::Nearest,
        late: LateAnswers::Rounds(4),
        seed_first_frame: true,
    };
}

#[derive(Clone, Copy, Debug)]
enum Asked {
    /// Hidden nodes, as a range of `ChcPlus::members`.
    Hidden { first: u32, count: u32 },
    /// A leaf that was visible.
    VisibleLeaf(TreeNodeId),
}

#[derive(Clone, Copy, Debug)]
struct Record {
    asked: Asked,
    query: QueryId,
}

impl Record {
    fn is_hidden(&self) -> bool {
        matches!(self.asked, Asked::Hidden { .. })
    }
}

/// Frames for which a split node is left open, at first; doubled up to `MOST_SPLITS` times.
const SPLIT_FRAMES: u32 = 8;
const MOST_SPLITS: u8 = 6;

/// Frames over which failed groups are counted, and for which groups are then given up.
const FAILURE_FRAMES: usize = 8;

/// What lasts from frame to frame.
#[derive(Clone, Debug, Default)]
pub(super) struct ChcPlus {
    /// Questions in flight.
    queue: VecDeque<Record>,
    members: Vec<TreeNodeId>,
    /// Hidden nodes waiting for a question: the paper's i-queue.
    hidden: Vec<TreeNodeId>,
    /// Visible leaves waiting for a question: the v-queue.
    visible: VecDeque<TreeNodeId>,
    /// Leaves waiting to be drawn: the render queue.
    draws: Vec<TreeNodeId>,
    /// Inner nodes that were visible and opened in the last frame.
    opened: Vec<TreeNodeId>,
    hidden_table: CoherenceTable,
    visible_table: CoherenceTable,
    retests: RetestTable,
    tight: TightBounds,
    boxes: Vec<Aabb>,
    sorted: Vec<(f64, TreeNodeId)>,
    /// Multiqueries and failed ones of the last frames.
    failures: [(u32, u32); FAILURE_FRAMES],
    /// No groups before this frame.
    singles_until: u32,
    /// Whether leaves are drawn at once, as CHC does.
    draws_at_once: bool,
}

impl ChcPlus {
    /// Starts over: another scene, or another algorithm was at work.
    pub fn forget(&mut self) {
        *self = ChcPlus::default();
    }

    /// Chooses tight bounds anew, for boxes that moved far.
    pub fn forget_tight_bounds(&mut self) {
        self.tight.forget();
    }

    /// How likely hidden nodes are to stay hidden.
    pub fn hidden_table(&self) -> &CoherenceTable {
        &self.hidden_table
    }

    /// One frame. `seed`: take everything in the frustum as visible.
    pub fn frame<H: BoundingHierarchy>(
        &mut self,
        walk: &mut Walk<H>,
        options: &ChcPlusOptions,
        seed: bool,
    ) {
        let seed = seed && options.seed_first_frame;
        walk.inherit_on_reentry = options.optimized;
        self.draws_at_once = !options.batching;
        if let Some(limits) = options.tight {
            self.tight.prepare(walk.tree, limits);
        }
        self.retests.begin_frame();
        self.finish_last_frame(walk, options);
        walk.start(options.order);
        loop {
            while let Some(record) = self.queue.front()
                && walk.device.answer(record.query) != Answer::Unknown
            {
                self.take_answer(walk, options);
            }
            if let Some(node) = walk.frontier.pop() {
                self.take(walk, node, options, seed);
            } else if !self.go_on_without_nodes(walk, options) {
                break;
            }
        }
        self.draw_waiting(walk);
        while let Some(leaf) = self.visible.pop_front() {
            self.ask_visible(walk, leaf, options);
        }
        self.count_failures(walk);
        self.hidden_table.end_frame();
        self.visible_table.end_frame();
    }

    /// Nothing to look at: asks what waits, then waits for what was asked. `false` at the end.
    fn go_on_without_nodes<H: BoundingHierarchy>(
        &mut self,
        walk: &mut Walk<H>,
        options: &ChcPlusOptions,
    ) -> bool {
        let waiting = self.queue.iter().any(Record::is_hidden);
        let fill_with_visible = waiting && !options.optimized && !self.visible.is_empty();
        if fill_with_visible {
            if let Some(leaf) = self.visible.pop_front() {
                self.ask_visible(walk, leaf, options);
            }
            return true;
        }
        if !self.hidden.is_empty() {
            self.ask_hidden(walk, options);
            return true;
        }
        if !waiting {
            return false;
        }
        self.draw_waiting(walk);
        let first = self.queue.iter().find(|record| record.is_hidden()).map(|record| record.query);
        match (options.late, first) {
            (LateAnswers::NextFrame, _) | (_, None) => false,
            (_, Some(query)) if walk.may_wait(options.late) => {
                walk.wait(query);
                true
            }
            _ => {
                self.force_open_questions(walk, options);
                true
            }
        }
    }

    /// No further round: what is still open is drawn.
    fn force_open_questions<H: BoundingHierarchy>(
        &mut self,
        walk: &mut Walk<H>,
        options: &ChcPlusOptions,
    ) {
        let mut open = Vec::new();
        self.queue.retain(|record| {
            if let Asked::Hidden { first, count } = record.asked {
                open.extend_from_slice(&self.members[first as usize..][..count as usize]);
            }
            !record.is_hidden()
        });
        for node in open {
            walk.force(node, |walk, leaf| {
                self.schedule(walk, leaf, options, true);
                self.draw_later(walk, leaf);
            });
        }
    }

    /// A node from the front of the walk.
    fn take<H: BoundingHierarchy>(
        &mut self,
        walk: &mut Walk<H>,
        node: TreeNodeId,
        options: &ChcPlusOptions,
        seed: bool,
    ) {
        let was_visible = match walk.reach(node) {
            Reached::Outside => return,
            Reached::Near { .. } => {
                walk.pull_up(node);
                self.open(walk, node);
                return;
            }
            Reached::Inside { was_visible } => was_visible || seed,
        };
        if !was_visible {
            if options.remember_splits && self.is_split(walk, node) {
                self.opened.push(node);
                self.open(walk, node);
                return;
            }
            self.hidden.push(node);
            let most = if options.batching { options.batch_size.max(1) as usize } else { 1 };
            if self.hidden.len() >= most {
                self.ask_hidden(walk, options);
            }
            return;
        }
        if walk.is_leaf(node) {
            if !walk.is_due(node) {
                // Assumed visible, for its ancestors too.
                walk.pull_up(node);
            } else if options.batching {
                self.visible.push_back(node);
            } else {
                self.draw_waiting(walk);
                self.ask_visible(walk, node, options);
            }
        } else {
            walk.history.node(node).persistence = 0;
            self.opened.push(node);
        }
        self.open(walk, node);
    }

    /// Whether a hidden inner node is to be left open, its children asked about instead.
    fn is_split<H: BoundingHierarchy>(&self, walk: &mut Walk<H>, node: TreeNodeId) -> bool {
        let NodeHistory { split_until, splits, .. } = *walk.history.node(node);
        splits > 0 && !walk.history.is_due(split_until) && !walk.is_leaf(node)
    }

    /// Judges an inner node that was opened in the last frame.
    fn count_split<H: BoundingHierarchy>(&self, walk: &mut Walk<H>, node: TreeNodeId) {
        let frame = walk.history.frame();
        let history = walk.history.node(node);
        if history.visible {
            history.splits = 0;
        } else if history.opened_at != 0 && frame.wrapping_sub(history.opened_at) <= 2 {
            // Its box showed a frame ago, and nothing in it did.
            history.splits = (history.splits + 1).min(MOST_SPLITS);
            history.split_until = frame.wrapping_add(SPLIT_FRAMES << (history.splits - 1));
        }
    }

    fn open<H: BoundingHierarchy>(&mut self, walk: &mut Walk<H>, node: TreeNodeId) {
        if walk.is_leaf(node) {
            self.draw_later(walk, node);
        } else {
            walk.push_children(node);
        }
    }

    fn draw_later<H: BoundingHierarchy>(&mut self, walk: &mut Walk<H>, leaf: TreeNodeId) {
        if self.draws_at_once {
            walk.draw(leaf);
        } else if walk.count_draw(leaf) {
            self.draws.push(leaf);
        }
    }

    /// Hands the render queue to the device; before every batch, so that questions see it.
    fn draw_waiting<H: BoundingHierarchy>(&mut self, walk: &mut Walk<H>) {
        for leaf in self.draws.drain(..) {
            walk.device.draw(leaf);
        }
    }

    fn ask_visible<H: BoundingHierarchy>(
        &mut self,
        walk: &mut Walk<H>,
        leaf: TreeNodeId,
        options: &ChcPlusOptions,
    ) {
        walk.counters.queries_issued += 1;
        walk.counters.queries_visible_leaf += 1;
        let query = self.ask(walk, &[leaf], options);
        self.queue.push_back(Record { asked: Asked::VisibleLeaf(leaf), query });
    }

    fn ask<H: BoundingHierarchy>(
        &mut self,
        walk: &mut Walk<H>,
        nodes: &[TreeNodeId],
        options: &ChcPlusOptions,
    ) -> QueryId {
        self.boxes.clear();
        for &node in nodes {
            if options.tight.is_some() {
                self.tight.boxes(walk.tree, node, walk.proxies(), &mut self.boxes);
            } else {
                self.boxes.push(walk.proxy(node));
            }
        }
        walk.counters.query_boxes += self.boxes.len() as u64;
        walk.device.query(&self.boxes)
    }

    /// Asks about all waiting hidden nodes, in groups.
    fn ask_hidden<H: BoundingHierarchy>(&mut self, walk: &mut Walk<H>, options: &ChcPlusOptions) {
        self.draw_waiting(walk);
        let groups = options.multiqueries && walk.history.is_due(self.singles_until);
        let mut sorted = std::mem::take(&mut self.sorted);
        sorted.clear();
        for node in self.hidden.drain(..) {
            let persistence = walk.history.node(node).persistence;
            sorted.push((self.hidden_table.keep(persistence, options.keep), node));
        }
        if groups {
            sorted.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        }
        let most = options.batch_size.max(1) as usize;
        let mut from = 0;
        while from < sorted.len() {
            let rest = &sorted[from..];
            let size = if groups {
                best_group(rest.iter().map(|(keep, _)| *keep), most, false).0
            } else {
                1
            };
            let first = self.members.len();
            self.members.extend(rest[..size].iter().map(|(_, node)| *node));
            self.ask_group(walk, first, size, options);
            from += size;
        }
        self.sorted = sorted;
    }

    /// One question about a range of `members`.
    fn ask_group<H: BoundingHierarchy>(
        &mut self,
        walk: &mut Walk<H>,
        first: usize,
        count: usize,
        options: &ChcPlusOptions,
    ) {
        walk.counters.queries_issued += 1;
        if count == 1 {
            walk.counters.queries_hidden += 1;
        } else {
            walk.counters.multiqueries += 1;
        }
        let members = std::mem::take(&mut self.members);
        let query = self.ask(walk, &members[first..first + count], options);
        self.members = members;
        let asked = Asked::Hidden { first: first as u32, count: count as u32 };
        self.queue.push_back(Record { asked, query });
    }

    fn take_answer<H: BoundingHierarchy>(&mut self, walk: &mut Walk<H>, options: &ChcPlusOptions) {
        let Some(record) = self.queue.pop_front() else { return };
        let seen = walk.samples(record.query) > options.threshold;
        match record.asked {
            Asked::VisibleLeaf(leaf) => {
                self.tested(walk, leaf, true, seen);
                if seen {
                    walk.pull_up(leaf);
                    self.schedule(walk, leaf, options, false);
                }
            }
            Asked::Hidden { first, count } if count > 1 && seen => {
                walk.counters.multiqueries_failed += 1;
                self.draw_waiting(walk);
                for at in first..first + count {
                    self.ask_group(walk, at as usize, 1, options);
                }
            }
            Asked::Hidden { first, count } => {
                walk.counters.hidden_nodes_decided += u64::from(count);
                for at in first..first + count {
                    let node = self.members[at as usize];
                    self.tested(walk, node, false, seen);
                    if seen {
                        walk.counters.pulled_down += 1;
                        walk.pull_up(node);
                        walk.history.node(node).opened_at = walk.history.frame();
                        self.schedule(walk, node, options, true);
                        self.open(walk, node);
                    }
                }
            }
        }
    }

    /// Takes a test into the node's history and the tables.
    fn tested<H: BoundingHierarchy>(
        &mut self,
        walk: &mut Walk<H>,
        node: TreeNodeId,
        was_visible: bool,
        visible: bool,
    ) {
        let table = if was_visible { &mut self.visible_table } else { &mut self.hidden_table };
        let history = walk.history.node(node);
        let kept = visible == was_visible;
        if was_visible {
            let cost = walk.tree.cost(node);
            self.retests.record(history.persistence, u32::from(history.waited), cost, !visible);
        }
        table.record(history.persistence, kept);
        history.persistence =
            if kept { (history.persistence + 1).min(LONGEST_PERSISTENCE) } else { 0 };
    }

    /// Sets the frame of a visible leaf's next test.
    fn schedule<H: BoundingHierarchy>(
        &mut self,
        walk: &mut Walk<H>,
        leaf: TreeNodeId,
        options: &ChcPlusOptions,
        turned_visible: bool,
    ) {
        let period = options.assumed_visible_frames.max(1);
        let history = walk.history.node(leaf);
        let tested = history.last_visited;
        let mut random = Random::new(u64::from(leaf.0), u64::from(tested));
        let bounded = options
            .in_vain
            .map_or(period, |share| self.retests.period(history.persistence, share, period));
        let wait = if bounded < period {
            // Random, so that leaves that appeared together part. May pass the period by up to three
            // frames: cut off there, more is drawn in vain (row B11: 1.157 instead of 1.12).
            bounded.div_ceil(2) + random.below(u64::from(bounded)) as u32
        } else if turned_visible && options.jitter && period > 1 {
            1 + random.below(u64::from(period - 1)) as u32
        } else {
            period
        };
        history.next_test = tested.wrapping_add(wait);
        history.waited = wait.min(255) as u8;
    }

    /// Reads what the last frame left open: tests of visible leaves, and, where late answers are
    /// left to the next frame, of hidden nodes.
    fn finish_last_frame<H: BoundingHierarchy>(
        &mut self,
        walk: &mut Walk<H>,
        options: &ChcPlusOptions,
    ) {
        let last = walk.history.frame().wrapping_sub(1);
        while let Some(record) = self.queue.pop_front() {
            let seen = walk.samples(record.query) > options.threshold;
            let (nodes, was_visible) = match record.asked {
                Asked::VisibleLeaf(leaf) => (vec![leaf], true),
                Asked::Hidden { first, count } => {
                    (self.members[first as usize..][..count as usize].to_vec(), false)
                }
            };
            for node in nodes {
                if walk.history.node(node).last_visited != last {
                    continue;
                }
                self.tested(walk, node, was_visible, seen);
                if seen {
                    walk.counters.pulled_down += u64::from(!was_visible);
                    walk.pull_up(node);
                    self.schedule(walk, node, options, !was_visible);
                }
            }
        }
        for node in std::mem::take(&mut self.opened) {
            let history = walk.history.node(node);
            if history.last_visited == last {
                walk.counters.pulled_up += u64::from(!history.visible);
                self.count_split(walk, node);
            }
        }
        self.members.clear();
        self.hidden.clear();
        self.visible.clear();
        self.draws.clear();
    }

    /// Gives groups up for a while when more than half of them failed.
    fn count_failures<H: BoundingHierarchy>(&mut self, walk: &mut Walk<H>) {
        let frame = walk.history.frame();
        let counted = (walk.counters.multiqueries as u32, walk.counters.multiqueries_failed as u32);
        self.failures[frame as usize % FAILURE_FRAMES] = counted;
        let (asked, failed) =
            self.failures.iter().fold((0, 0), |(a, f), (asked, failed)| (a + asked, f + failed));
        if asked > 0 && 2 * failed > asked {
            self.singles_until = frame.wrapping_add(FAILURE_FRAMES as u32 + 1);
            self.failures = [(0, 0); FAILURE_FRAMES];
        }
    }
}
