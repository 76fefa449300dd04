//! Whether asking pays: culling that switches itself off, and tries again.
//!
//! While queries are on, what they saved (triangles in the frustum that were not drawn) is weighed
//! against what they cost, over some frames; if they lose, the frustum alone decides from then on.
//! After a while they are tried again for a few frames; each attempt in a row that fails doubles the
//! wait, up to a bound.

use crate::geometry::{Containment, Frustum, View};
use crate::hierarchy::BoundingHierarchy;
use crate::ids::TreeNodeId;
use crate::visibility::{CullCounters, CullingCosts, Proxies};

/// Frames over which gain and loss are summed.
const WINDOW: u32 = 30;
/// Frames of an attempt; the first ones draw everything and learn.
const ATTEMPT: u32 = 8;
const LEARNING: u32 = 3;
/// Frames until the next attempt, at first and at most.
const WAIT: u32 = 60;
const LONGEST_WAIT: u32 = 960;
/// Fewer leaves in the frustum are drawn without asking.
const FEWEST_LEAVES: u64 = 64;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    On,
    Off,
    Attempt,
}

/// Decides frame by frame whether queries are put.
#[derive(Clone, Debug)]
pub struct AutoSwitch {
    phase: Phase,
    frames: u32,
    wait: u32,
    gain: f64,
    switches: u32,
}

impl Default for AutoSwitch {
    fn default() -> Self {
        AutoSwitch { phase: Phase::Attempt, frames: 0, wait: WAIT, gain: 0.0, switches: 0 }
    }
}

impl AutoSwitch {
    /// Whether the coming frame puts queries.
    pub fn wants_queries(&self) -> bool {
        self.phase != Phase::Off
    }

    /// How often queries were switched on or off.
    pub fn switches(&self) -> u32 {
        self.switches
    }

    /// Takes in a frame: what it did, and what the frustum alone would have drawn.
    pub fn observe(
        &mut self,
        counters: &CullCounters,
        in_frustum: &InFrustum,
        costs: &CullingCosts,
    ) {
        self.frames += 1;
        match self.phase {
            Phase::Off => {
                if self.frames >= self.wait && in_frustum.leaves_at_least >= FEWEST_LEAVES {
                    self.go(Phase::Attempt);
                }
                return;
            }
            Phase::Attempt if self.frames <= LEARNING => return,
            _ => {}
        }
        let saved = in_frustum.cost.saturating_sub(counters.triangles_drawn);
        let spent = costs.query * counters.queries_issued as f64
            + costs.round * counters.rounds.saturating_sub(1) as f64;
        self.gain += costs.triangle * saved as f64 - spent;
        let over = match self.phase {
            Phase::Attempt => self.frames >= ATTEMPT,
            _ => self.frames >= WINDOW,
        };
        if !over {
            return;
        }
        if self.gain > 0.0 {
            self.wait = WAIT;
            if self.phase == Phase::On {
                (self.frames, self.gain) = (0, 0.0);
            } else {
                self.go(Phase::On);
            }
        } else {
            if self.phase == Phase::Attempt {
                self.wait = (2 * self.wait).min(LONGEST_WAIT);
            }
            self.go(Phase::Off);
        }
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
    /// Leaves counted, up to where counting them stopped mattering.
    pub leaves_at_least: u64,
}

impl InFrustum {
    /// Sums up a tree; subtrees fully inside are not entered once enough leaves are counted.
    pub fn count<H: BoundingHierarchy>(tree: &H, view: &View, leaf_cost: u64) -> Self {
        let (frustum, proxies) = (Frustum::new(view), Proxies::new(view));
        let mut found = InFrustum::default();
        let mut open: Vec<TreeNodeId> = tree.root().into_iter().collect();
        while let Some(node) = open.pop() {
            let leaf = tree.is_leaf(node) || tree.cost(node) < leaf_cost;
            match frustum.test_box(&proxies.of(tree, node)) {
                Containment::Outside => {}
                Containment::Inside if found.leaves_at_least >= FEWEST_LEAVES => {
                    found.cost += tree.cost(node);
                }
                _ if leaf => {
                    found.cost += tree.cost(node);
                    found.leaves_at_least += 1;
                }
                _ => open.extend(tree.children(node)),
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(saved: u64, queries: u64) -> (CullCounters, InFrustum) {
        let counters = CullCounters {
            triangles_drawn: 1000,
            queries_issued: queries,
            rounds: 1,
            ..CullCounters::default()
        };
        (counters, InFrustum { cost: 1000 + saved, leaves_at_least: 1000 })
    }

    #[test]
    fn losing_queries_are_switched_off_and_tried_less_and_less() {
        let costs = CullingCosts::default();
        let mut switch = AutoSwitch::default();
        let (counters, seen) = frame(0, 100);
        let mut on = 0;
        for _ in 0..4000 {
            on += u32::from(switch.wants_queries());
            switch.observe(&counters, &seen, &costs);
        }
        // Attempts after waits of 120, 240, 480, 960 and so on.
        assert!(on <= 9 * ATTEMPT, "{on} frames of 4000 with queries");
        assert!(switch.switches() >= 6);
    }

    #[test]
    fn paying_queries_stay_on_and_losing_ones_come_back_when_they_pay() {
        let costs = CullingCosts::default();
        let mut switch = AutoSwitch::default();
        let (paying, losing) = (frame(1_000_000, 100), frame(0, 100));
        for _ in 0..200 {
            switch.observe(&paying.0, &paying.1, &costs);
            assert!(switch.wants_queries());
        }
        for _ in 0..=2 * WINDOW {
            switch.observe(&losing.0, &losing.1, &costs);
        }
        assert!(!switch.wants_queries());
        for _ in 0..WAIT + ATTEMPT {
            switch.observe(&paying.0, &paying.1, &costs);
        }
        assert!(switch.wants_queries());
    }
}
