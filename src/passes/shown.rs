//! Which of a node's points are drawn when only a share of them is.
//!
//! Levels are even over the node, so the first of them are drawn whole. Of the last one a share is:
//! of each block of successive points, which lie close together, as many, in an order that takes
//! the farthest apart first. So a share is even, a larger one contains a smaller one, and what is
//! not drawn is not even looked at: places count only what is. From a place to its point:
//! [`point_at`](crate::passes::splat::point_at).

use crate::gpu::layout::{GpuNode, SHARE_BLOCK};
use crate::octree::LevelIndex;
use crate::passes::splat::point_at;

/// Leading levels, and a share of the one after them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shown {
    /// One past the last point that may be drawn.
    pub(super) end: u32,
    /// Points of the leading levels.
    pub(super) whole_count: u32,
    /// Of each block of the others, so many.
    pub(super) kept_of_block: u32,
}

/// Levels with more points than this are drawn whole or not at all: beyond, the single precision
/// by which shaders find a place's block would not do.
const MOST_SHARED: u32 = 1 << 20;

impl Shown {
    /// About a share of `count` leading points; at least one.
    pub(super) fn of(levels: &LevelIndex, count: u32, share: f32) -> Self {
        if share >= 1.0 || share.is_nan() || count == 0 {
            return Shown::whole(count);
        }
        let wanted = (f64::from(share.max(0.0)) * f64::from(count)).max(1.0);
        let totals = levels.totals();
        let level = totals.partition_point(|&total| f64::from(total) < wanted);
        let end = totals.get(level).map_or(count, |&total| total.min(count));
        let start = level.checked_sub(1).map_or(0, |before| totals[before]);
        let kept = (wanted - f64::from(start)) / f64::from((end - start).max(1));
        let kept_of_block = (kept * f64::from(SHARE_BLOCK)).round() as u32;
        if kept_of_block >= SHARE_BLOCK || end - start > MOST_SHARED {
            Shown::whole(end)
        } else if kept_of_block == 0 && start > 0 {
            Shown::whole(start)
        } else {
            Shown { end, whole_count: start, kept_of_block: kept_of_block.max(1) }
        }
    }

    fn whole(count: u32) -> Self {
        Shown { end: count, whole_count: count, kept_of_block: 0 }
    }

    /// Places to be looked at: those of the points that are drawn, and a few empty ones where the
    /// last block is not full.
    pub(super) fn places(&self) -> u32 {
        let blocks = (self.end - self.whole_count).div_ceil(SHARE_BLOCK);
        self.whole_count + blocks * self.kept_of_block
    }

    /// Inverse of `kept_of_block`, 0 without a share.
    pub(super) fn kept_inverse(&self) -> f32 {
        match self.kept_of_block {
            0 => 0.0,
            kept => (kept as f32).recip(),
        }
    }

    /// Points that are drawn of a node.
    pub(super) fn points_of(node: &GpuNode) -> u64 {
        let others = node.drawn_count - node.whole_count;
        let (blocks, rest) = (others / SHARE_BLOCK, others % SHARE_BLOCK);
        let last = node.whole_count + blocks * node.kept_of_block;
        let in_last = match rest {
            0 => 0,
            _ => (last..last + node.kept_of_block)
                .filter(|&place| point_at(node, place).is_some())
                .count(),
        };
        u64::from(last) + in_last as u64
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;

    use super::*;

    fn levels() -> LevelIndex {
        LevelIndex::new(vec![1, 5, 21, 85]).expect("valid")
    }

    fn node(shown: Shown) -> GpuNode {
        GpuNode {
            drawn_count: shown.end,
            whole_count: shown.whole_count,
            kept_of_block: shown.kept_of_block,
            kept_inverse: shown.kept_inverse(),
            ..GpuNode::zeroed()
        }
    }

    fn points(shown: Shown) -> Vec<u32> {
        let node = node(shown);
        let mut points: Vec<u32> =
            (0..shown.places()).filter_map(|place| point_at(&node, place)).collect();
        assert_eq!(Shown::points_of(&node), points.len() as u64, "{shown:?}");
        points.sort_unstable();
        points
    }

    #[test]
    fn a_share_takes_whole_levels_and_part_of_one() {
        let of = |count, share| Shown::of(&levels(), count, share);
        assert_eq!([of(85, 1.0), of(85, 7.0), of(85, f32::NAN)], [Shown::whole(85); 3]);
        let half = of(84, 0.5);
        assert_eq!((half.end, half.whole_count), (84, 21));
        assert!((f64::from(half.kept_of_block) / 256.0 - 1.0 / 3.0).abs() < 1.0 / 256.0);
        assert_eq!(of(84, 0.25), Shown::whole(21));
        for share in [0.0, -1.0, 1e-9] {
            assert_eq!(of(85, share), Shown::whole(1), "a point at least");
        }
        assert_eq!(of(0, 0.5).end, 0);
        // Only some leading points were to be drawn at all.
        let cut = of(30, 0.99);
        assert_eq!((cut.end, cut.whole_count), (30, 21));
    }

    /// Whatever the share: as many points as wanted, each once, those of smaller shares among them,
    /// and hardly a place without one.
    #[test]
    fn shares_are_even_and_contain_each_other() {
        let levels = LevelIndex::new(vec![1, 100, 5_000]).expect("valid");
        let mut before: Vec<u32> = Vec::new();
        for step in 0..=1000 {
            let shown = Shown::of(&levels, 5_000, step as f32 / 1000.0);
            let points = points(shown);
            assert!(points.windows(2).all(|pair| pair[0] < pair[1]), "none twice");
            let wanted = (5_000.0 * f64::from(step) / 1000.0).max(1.0);
            assert!((points.len() as f64 - wanted).abs() < 40.0, "{step}: {}", points.len());
            assert!(shown.places() as usize <= points.len() + 256, "{shown:?}");
            assert!(before.iter().all(|point| points.binary_search(point).is_ok()), "{step}");
            // Successive points are close together: nowhere are there many without one.
            let others: Vec<u32> =
                points.iter().copied().filter(|&p| p >= shown.whole_count).collect();
            if shown.kept_of_block >= 16 {
                let gaps = others.windows(2).map(|pair| pair[1] - pair[0]);
                let most = 2 * SHARE_BLOCK / shown.kept_of_block + 1;
                assert!(gaps.max() <= Some(most), "{step}: {shown:?}");
            }
            before = points;
        }
        assert_eq!(before.len(), 5_000);
    }

    /// Single precision finds the block of every place of the largest levels.
    #[test]
    fn places_of_large_levels_have_their_points() {
        let levels = LevelIndex::new(vec![1, MOST_SHARED + 1]).expect("valid");
        for kept in [1, 3, 7, 85, 171, 254, 255] {
            let share = kept as f32 / SHARE_BLOCK as f32;
            let shown = Shown::of(&levels, MOST_SHARED + 1, share);
            assert_eq!(shown.kept_of_block, kept);
            let points = points(shown);
            assert!(points.windows(2).all(|pair| pair[0] < pair[1]), "{kept}: none twice");
            assert_eq!(points.len() as u32, 1 + MOST_SHARED / SHARE_BLOCK * kept, "{kept}");
        }
        let larger = LevelIndex::new(vec![1, MOST_SHARED + 2]).expect("valid");
        assert_eq!(Shown::of(&larger, MOST_SHARED + 2, 0.5).kept_of_block, 0, "whole");
    }
}
