//! How much of each drawn node has appeared since its points arrived.
//!
//! A node that was not there when its parent was drawn comes with a rising share of its points and
//! shrinking splats instead of at once. What is there when a scene is first drawn is there at
//! once, and so are nodes that stand on nothing drawn. Without the option nothing is kept.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use crate::stream::SceneNode;

/// When nodes were first drawn.
#[derive(Debug, Default)]
pub(super) struct Appearance {
    /// Time since the start at which a node was first drawn; none if it was there at once.
    since: HashMap<SceneNode, Option<Duration>>,
    start: Option<Instant>,
    now: Duration,
    wait: Duration,
    /// The time to go by instead of the clock's, for tests.
    pub(super) pinned: Option<Duration>,
}

impl Appearance {
    /// Forgets everything: another scene.
    pub(super) fn clear(&mut self) {
        self.since = HashMap::new();
    }

    /// Starts a frame that draws these nodes; `stands_alone` tells those without a drawn ancestor.
    /// Returns how many have not appeared wholly.
    pub(super) fn begin_frame(
        &mut self,
        wait: Duration,
        drawn: impl Iterator<Item = SceneNode>,
        stands_alone: impl Fn(SceneNode) -> bool,
        is_held: impl Fn(SceneNode) -> bool,
    ) -> u32 {
        self.wait = wait;
        if wait.is_zero() {
            self.clear();
            return 0;
        }
        let start = *self.start.get_or_insert_with(Instant::now);
        self.now = self.pinned.unwrap_or_else(|| start.elapsed());
        let is_first = self.since.is_empty();
        let (now, mut appearing) = (self.now, 0);
        for node in drawn {
            let at_once = || is_first || stands_alone(node);
            let since = self.since.entry(node).or_insert_with(|| (!at_once()).then_some(now));
            appearing += u32::from(since.is_some_and(|since| now.saturating_sub(since) < wait));
        }
        // Nodes that were dropped appear anew when they come again.
        self.since.retain(|&node, _| is_held(node));
        appearing
    }

    /// Share of a node's points that has appeared, above 0.
    pub(super) fn share(&self, node: SceneNode) -> f32 {
        match self.since.get(&node) {
            Some(Some(since)) => {
                let passed = self.now.saturating_sub(*since).as_secs_f32();
                (passed / self.wait.as_secs_f32()).clamp(0.001, 1.0)
            }
            _ => 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::NodeId;

    const WAIT: Duration = Duration::from_millis(200);

    fn frame(appearance: &mut Appearance, at_ms: u64, nodes: &[u32]) -> u32 {
        appearance.pinned = Some(Duration::from_millis(at_ms));
        let drawn = nodes.iter().map(|&node| (0, NodeId(node)));
        appearance.begin_frame(WAIT, drawn, |(_, node)| node == NodeId(0), |_| true)
    }

    #[test]
    fn what_comes_later_comes_slowly() {
        let mut appearance = Appearance::default();
        assert_eq!(frame(&mut appearance, 0, &[0, 1]), 0, "the first frame is whole");
        assert_eq!(frame(&mut appearance, 1000, &[0, 1, 2]), 1);
        let share = |appearance: &Appearance, node| appearance.share((0, NodeId(node)));
        assert_eq!((share(&appearance, 1), share(&appearance, 2)), (1.0, 0.001));
        assert_eq!(frame(&mut appearance, 1050, &[0, 1, 2]), 1);
        assert!((share(&appearance, 2) - 0.25).abs() < 1e-6);
        assert_eq!(frame(&mut appearance, 1200, &[0, 1, 2]), 0);
        assert_eq!(share(&appearance, 2), 1.0);
        // Out of sight for a while, but held: it is back at once.
        assert_eq!(frame(&mut appearance, 2000, &[0]), 0);
        assert_eq!(frame(&mut appearance, 3000, &[0, 2]), 0);
    }

    #[test]
    fn what_stands_on_nothing_is_there_at_once_and_what_was_dropped_comes_anew() {
        let mut appearance = Appearance::default();
        frame(&mut appearance, 0, &[5]);
        assert_eq!(frame(&mut appearance, 10, &[5, 0]), 0, "a root");
        let held = |(_, node)| node != NodeId(5);
        appearance.begin_frame(WAIT, [(0, NodeId(0))].into_iter(), |_| false, held);
        assert_eq!(frame(&mut appearance, 20, &[0, 5]), 1);
    }

    #[test]
    fn without_the_option_nothing_is_kept() {
        let mut appearance = Appearance::default();
        frame(&mut appearance, 0, &[0, 1]);
        let drawn = [(0, NodeId(1))].into_iter();
        assert_eq!(appearance.begin_frame(Duration::ZERO, drawn, |_| false, |_| true), 0);
        assert_eq!(appearance.since.capacity(), 0);
    }
}
