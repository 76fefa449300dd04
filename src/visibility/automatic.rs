//! Whether asking pays: culling that switches itself off, and tries again.
//!
//! While questions are put, what they save (what lies in the frustum and was not drawn) is weighed
//! against what they cost; if they lose, the frustum alone decides from then on. After a while they
//! are tried again for a few frames. What an attempt lost is a debt: the next one waits until that
//! is no more than a twentieth of what was drawn meanwhile, so that over any longer course this is
//! at most a tenth dearer than the frustum alone. Each attempt in a row that fails doubles the wait
//! besides, up to a bound.
//!
//! Nothing is asked where no frame is known to follow that could use the answers: in the first
//! frame, and after a jump, unless asking paid before it. What lies in the frustum is counted for
//! frames that are judged, and for no others: without questions the frame itself tells.

use crate::geometry::{Containment, Frustum, View};
use crate::hierarchy::BoundingHierarchy;
use crate::ids::TreeNodeId;
use crate::visibility::{CullCounters, CullingCosts, Proxies};

/// Frames that are judged together while questions are put, and of how many one is looked at.
const WINDOW: u32 = 30;
const SAMPLED: u32 = 6;
/// Frames of an attempt; the first ones draw everything and learn.
const ATTEMPT: u32 = 8;
const LEARNING: u32 = 3;
/// Frames without questions until the next attempt: at the very start, usually, and at most.
const FIRST_WAIT: u32 = 1;
const WAIT: u32 = 60;
const LONGEST_WAIT: u32 = 960;
/// Fewer leaves in the frustum are drawn without asking.
const FEWEST_LEAVES: u64 = 64;
/// Share of what is drawn without questions that pays for attempts that failed.
const REPAID: f64 = 0.05;
/// An attempt, or a window, ends early when it has lost as much as so many frames cost without
/// questions.
const MOST_LOST: f64 = 2.0;
/// Frames before an attempt that are timed, so that drawing without questions has a price too.
const TIMED: u32 = 4;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    On,
    Off,
    Attempt,
}

/// Decides frame by frame whether questions are put.
#[derive(Clone, Debug)]
pub struct AutoSwitch {
    phase: Phase,
    /// Frames of the phase so far.
    frames: u32,
    /// Frames still to learn from before one is judged.
    learning: u32,
    wait: u32,
    /// What judged frames of the phase saved, less what they cost.
    gain: f64,
    /// The same of all frames of an attempt.
    net: f64,
    /// What attempts lost and no frame has paid for yet.
    debt: f64,
    asks: bool,
    jumped: bool,
    switches: u32,
    frustum_counts: u64,
}

impl Default for AutoSwitch {
    fn default() -> Self {
        AutoSwitch {
            phase: Phase::Off,
            frames: 0,
            learning: 0,
            wait: FIRST_WAIT,
            gain: 0.0,
            net: 0.0,
            debt: 0.0,
            asks: false,
            jumped: true,
            switches: 0,
            frustum_counts: 0,
        }
    }
}

impl AutoSwitch {
    /// Whether the frame that begins puts questions. `coherent`: its view is near the last one's.
    pub fn begin_frame(&mut self, coherent: bool) -> bool {
        self.asks = self.would_ask(coherent);
        if !coherent {
            self.learning = LEARNING;
        }
        self.jumped = !coherent;
        self.asks
    }

    /// What [`begin_frame`](Self::begin_frame) would say.
    pub fn would_ask(&self, coherent: bool) -> bool {
        match self.phase {
            Phase::Off => false,
            Phase::Attempt => coherent,
            // Where asking pays, the answers serve the frames after the jump; but not if one jump
            // follows the other.
            Phase::On => coherent || !self.jumped,
        }
    }

    /// How often questions were switched on or off.
    pub fn switches(&self) -> u32 {
        self.switches
    }

    /// How often the whole frustum was counted.
    pub fn frustum_counts(&self) -> u64 {
        self.frustum_counts
    }

    /// Whether the frame that comes, or is under way, is one whose time tells prices: an attempt,
    /// the frames right before one, and some while questions are put.
    pub fn is_probing(&self) -> bool {
        match self.phase {
            Phase::Attempt => true,
            Phase::On => self.is_sampled(),
            Phase::Off => self.frames + TIMED >= self.wait,
        }
    }

    fn is_sampled(&self) -> bool {
        (self.frames + 1).is_multiple_of(SAMPLED)
    }

    /// Takes in a frame: what it did, and, if that is asked for, what lies in its frustum.
    pub fn observe(
        &mut self,
        counters: &CullCounters,
        costs: &CullingCosts,
        in_frustum: impl FnOnce() -> InFrustum,
    ) {
        match self.phase {
            Phase::Off => self.observe_off(counters, costs),
            // A jump is no part of an attempt.
            _ if !self.asks => {}
            Phase::Attempt => {
                let (all, net) = self.judge(counters, costs, in_frustum());
                self.net += net;
                self.frames += 1;
                if self.learning > 0 {
                    self.learning -= 1;
                } else {
                    self.gain += net;
                }
                if self.frames >= ATTEMPT || self.net < -MOST_LOST * all {
                    self.end_attempt();
                }
            }
            Phase::On => {
                let is_sampled = self.is_sampled();
                self.frames += 1;
                if is_sampled && self.learning == 0 {
                    let (all, net) = self.judge(counters, costs, in_frustum());
                    self.gain += f64::from(SAMPLED) * net;
                    if self.gain < -MOST_LOST * all {
                        self.switch_off();
                        return;
                    }
                }
                self.learning = self.learning.saturating_sub(1);
                if self.frames >= WINDOW {
                    match self.gain >= 0.0 {
                        true => (self.frames, self.gain) = (0, 0.0),
                        false => self.switch_off(),
                    }
                }
            }
        }
    }

    fn observe_off(&mut self, counters: &CullCounters, costs: &CullingCosts) {
        // All that lies in the frustum was drawn.
        let all = costs.of_leaves(counters.leaves_drawn, counters.triangles_drawn);
        self.debt = (self.debt - REPAID * all).max(0.0);
        self.frames = self.frames.saturating_add(1);
        let enough = counters.leaves_drawn >= FEWEST_LEAVES;
        if self.frames >= self.wait && self.debt <= 0.0 && enough {
            self.go(Phase::Attempt);
            (self.net, self.learning) = (0.0, LEARNING);
        }
    }

    /// What the frame would have cost without questions, and what they saved of it.
    fn judge(
        &mut self,
        counters: &CullCounters,
        costs: &CullingCosts,
        in_frustum: InFrustum,
    ) -> (f64, f64) {
        self.frustum_counts += 1;
        let all = costs.of_leaves(in_frustum.leaves, in_frustum.cost);
        (all, all - costs.of_frame(counters))
    }

    fn end_attempt(&mut self) {
        if self.gain > 0.0 && self.frames >= ATTEMPT {
            self.wait = WAIT;
            self.go(Phase::On);
        } else {
            self.wait = (2 * self.wait).clamp(WAIT, LONGEST_WAIT);
            self.debt = (-self.net).max(0.0);
            self.go(Phase::Off);
        }
    }

    fn switch_off(&mut self) {
        self.debt = (-self.gain).max(0.0);
        self.go(Phase::Off);
    }

    fn go(&mut self, phase: Phase) {
        self.switches += 1;
        self.phase = phase;
        self.frames = 0;
        self.gain = 0.0;
    }
}

/// What lies in a view's frustum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InFrustum {
    /// Triangles, or points.
    pub cost: u64,
    /// Leaves.
    pub leaves: u64,
}

impl InFrustum {
    /// Sums up a tree.
    pub fn count<H: BoundingHierarchy>(tree: &H, view: &View, leaf_cost: u64) -> Self {
        let (frustum, proxies) = (Frustum::new(view), Proxies::new(view));
        let mut found = InFrustum::default();
        let roots = tree.root().into_iter().map(|root| (root, false));
        let mut open: Vec<(TreeNodeId, bool)> = roots.collect();
        while let Some((node, mut inside)) = open.pop() {
            if !inside {
                match frustum.test_box(&proxies.of(tree, node)) {
                    Containment::Outside => continue,
                    Containment::Inside => inside = true,
                    Containment::Partial => {}
                }
            }
            if tree.is_leaf(node) || tree.cost(node) < leaf_cost {
                found.cost += tree.cost(node);
                found.leaves += 1;
            } else {
                open.extend(tree.children(node).map(|child| (child, inside)));
            }
        }
        for node in tree.always_drawn() {
            found.cost += tree.cost(node);
            found.leaves += 1;
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COSTS: CullingCosts = CullingCosts {
        query: 1.0,
        query_pixel: 0.0,
        round: 0.0,
        leaf: 0.0,
        triangle: 1.0,
        pixel: 0.0,
    };

    /// Frames in which `in_frustum` triangles in 1000 leaves could be drawn, of which `hidden` are
    /// hidden, and asking takes `queries` questions: their cost, and how many asked.
    fn run(
        switch: &mut AutoSwitch,
        frames: u32,
        coherent: impl Fn(u32) -> bool,
        [in_frustum, hidden, queries]: [u64; 3],
    ) -> (f64, u32) {
        let (mut cost, mut asking) = (0.0, 0);
        for frame in 0..frames {
            let asks = switch.begin_frame(coherent(frame));
            asking += u32::from(asks);
            let counters = CullCounters {
                leaves_drawn: 1000,
                triangles_drawn: if asks { in_frustum - hidden } else { in_frustum },
                queries_issued: if asks { queries } else { 0 },
                rounds: 1,
                ..CullCounters::default()
            };
            cost += COSTS.of_frame(&counters);
            switch.observe(&counters, &COSTS, || InFrustum { cost: in_frustum, leaves: 1000 });
        }
        (cost, asking)
    }

    #[test]
    fn losing_questions_cost_at_most_a_tenth_whatever_they_cost() {
        // From cheap questions to some that cost many times what they could save.
        for queries in [1, 30, 100, 1000, 20_000, 1_000_000] {
            let mut switch = AutoSwitch::default();
            let all = [1000, 0, queries];
            let (mut cost, mut asking) = (0.0, 0);
            // At the end of every course, not only at this one's.
            for hundreds in 1..=60 {
                let (more, frames) = run(&mut switch, 100, |_| true, all);
                (cost, asking) = (cost + more, asking + frames);
                let bound = 1.1 * 1000.0 * 100.0 * f64::from(hundreds);
                // The first attempt is not paid for by what comes later than the course.
                let first = f64::from(ATTEMPT).min(1.0 + 2000.0 / queries as f64) * queries as f64;
                assert!(cost <= bound + first, "{queries} questions: {cost} of {bound}");
            }
            assert!(asking > 0 && asking <= 11 * ATTEMPT, "{asking} of 6000 frames asked");
        }
    }

    #[test]
    fn paying_questions_stay_and_lost_ones_come_back_when_they_pay() {
        let mut switch = AutoSwitch::default();
        let (_, asking) = run(&mut switch, 300, |frame| frame > 0, [10_000, 9_000, 100]);
        assert_eq!(asking, 299, "all but the first");
        // What is hidden is gone: the rest of a window, another one, and the next attempts.
        let (_, asking) = run(&mut switch, 400, |_| true, [10_000, 0, 500]);
        assert!(asking <= 2 * WINDOW + 2 * ATTEMPT, "{asking}");
        // It is back.
        let (_, asking) = run(&mut switch, 700, |_| true, [10_000, 9_000, 100]);
        assert!(asking >= 200, "{asking}");
        assert!(switch.switches() >= 4);
    }

    #[test]
    fn the_frustum_is_counted_only_for_frames_that_are_judged() {
        let mut switch = AutoSwitch::default();
        run(&mut switch, 601, |_| true, [1000, 0, 1000]);
        assert!(switch.frustum_counts() <= 4 * u64::from(ATTEMPT), "{}", switch.frustum_counts());
        let mut switch = AutoSwitch::default();
        run(&mut switch, 601, |_| true, [10_000, 9000, 10]);
        let most = u64::from(600 / SAMPLED + ATTEMPT);
        assert!(switch.frustum_counts() <= most, "{}", switch.frustum_counts());
    }

    #[test]
    fn nothing_is_asked_in_a_first_frame_nor_in_one_jump_after_the_other() {
        let hidden = [10_000, 9_000, 100];
        let mut switch = AutoSwitch::default();
        assert_eq!(run(&mut switch, 1, |_| false, hidden).1, 0);
        let mut switch = AutoSwitch::default();
        assert_eq!(run(&mut switch, 200, |_| false, hidden).1, 0);
        // Where it pays one jump is asked about, the following ones are not.
        let mut switch = AutoSwitch::default();
        run(&mut switch, 100, |frame| frame > 0, hidden);
        assert_eq!(run(&mut switch, 50, |_| false, hidden).1, 1);
        assert_eq!(run(&mut switch, 50, |frame| frame % 10 > 0, hidden).1, 49);
    }

    #[test]
    fn few_leaves_are_not_worth_an_attempt() {
        let mut switch = AutoSwitch::default();
        for _ in 0..500 {
            assert!(!switch.begin_frame(true));
            let counters = CullCounters { leaves_drawn: 63, ..CullCounters::default() };
            switch.observe(&counters, &COSTS, || panic!("nothing to judge"));
        }
    }
}
