//! How many points of a node show which level.

use crate::octree::OctreeError;

/// Running totals of points per level: the first `totals[i]` points show level `i` of a node.
///
/// Invariants, checked by [`LevelIndex::new`]: never decreasing; the first total is 1 unless the
/// node is empty; the last is the node's point count.
/// After: Wimmer and Scheiblauer 2006, section 6.4.6 of the dissertation chapter (index array).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LevelIndex {
    totals: Box<[u32]>,
}

impl LevelIndex {
    /// Checks the invariants and takes the totals, one per level 0..=depth.
    pub fn new(totals: Vec<u32>) -> Result<Self, OctreeError> {
        let ordered = totals.is_sorted();
        let starts_with_one = totals.first().is_some_and(|&first| first == 1);
        if !ordered || !starts_with_one {
            return Err(OctreeError::LevelTotals { totals });
        }
        Ok(LevelIndex { totals: totals.into() })
    }

    /// All running totals, coarse to fine.
    pub fn totals(&self) -> &[u32] {
        &self.totals
    }

    /// Deepest level within the node (the paper's D).
    pub fn depth(&self) -> u32 {
        self.totals.len() as u32 - 1
    }

    /// Points of the node.
    pub fn point_count(&self) -> u32 {
        self.totals[self.totals.len() - 1]
    }

    /// Mean spacing of the node's points, as a share of its cell's edge, if they lie on a surface.
    ///
    /// The occupied cells of the finest level that has at least four points in each, on average,
    /// stand for the area; with fewer than four points the whole cell does.
    pub fn surface_spacing(&self) -> f64 {
        let points = f64::from(self.point_count());
        let is_full = |&total: &u32| 4.0 * f64::from(total) <= points;
        let level = self.totals.iter().rposition(is_full).unwrap_or(0);
        (-(level as f64)).exp2() * (f64::from(self.totals[level]) / points).sqrt()
    }

    /// Number of leading points that show levels `0..=level`; all of them beyond the deepest.
    pub fn prefix_len(&self, level: u32) -> u32 {
        self.totals[(level as usize).min(self.totals.len() - 1)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn totals_must_rise_from_one() {
        assert!(LevelIndex::new(vec![1, 8, 8, 30]).is_ok());
        for bad in [vec![], vec![0, 3], vec![2, 3], vec![1, 5, 4]] {
            assert!(LevelIndex::new(bad).is_err());
        }
    }

    #[test]
    fn spacing_is_that_of_a_grid_on_a_plane() {
        // 16 x 16 points on a plane through the cell, levels 0..=6 of 1, 4, 16, 64 cells, then 256.
        let index = LevelIndex::new(vec![1, 4, 16, 64, 256, 256, 256]).expect("valid");
        assert_eq!(index.surface_spacing(), 1.0 / 16.0);
        assert_eq!(LevelIndex::new(vec![1, 1]).expect("valid").surface_spacing(), 1.0);
        let crowded = LevelIndex::new(vec![1, 4, 1024]).expect("valid");
        assert_eq!(crowded.surface_spacing(), 1.0 / 32.0);
    }

    #[test]
    fn prefixes_clamp_at_the_deepest_level() {
        let index = LevelIndex::new(vec![1, 8, 30]).expect("valid");
        assert_eq!([0, 1, 2, 9].map(|l| index.prefix_len(l)), [1, 8, 30, 30]);
    }
}
