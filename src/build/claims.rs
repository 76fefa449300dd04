//! What headers claim of an input, where that is enough to begin with sorting its points.
//!
//! Only plain LAS records are taken at their word: their number follows from the file's length, and
//! reading them again, should the bounds prove wrong, costs little.

use crate::build::seen::Seen;
use crate::build::sources::{Source, Sources};
use crate::geometry::MortonKey;

impl Sources {
    /// Number and bounds of all points, if the headers tell them plausibly.
    pub(super) fn claims(&self, depth: u32) -> Option<Seen> {
        if self.is_sampled() || self.salvages() {
            return None;
        }
        let mut all = Seen::default();
        for (number, source) in self.scans().iter().enumerate() {
            if source.scan.points() > 0 {
                all.join(&claimed(source, self.shift(number))?);
            }
        }
        (all.points > 0 && all.root_bits(depth) <= u128::MAX_BITS).then_some(all)
    }
}

fn claimed(source: &Source, shift: [i64; 3]) -> Option<Seen> {
    let scan = source.scan.las()?;
    if source.scan.is_compressed() || !source.scan.points_exact() || !source.keeps_coordinates() {
        return None;
    }
    let bounds = scan.header().bounds;
    let steps = |world| {
        let steps = scan.lattice().lattice(world).round();
        let fits = |step: &f64| (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(step);
        let all_fit = steps.to_array().iter().all(fits);
        all_fit.then(|| [0, 1, 2].map(|axis| steps[axis] as i64 + shift[axis]))
    };
    let (min, max) = (steps(bounds.min)?, steps(bounds.max)?);
    let is_box = (0..3).all(|axis| min[axis] <= max[axis]);
    is_box.then_some(Seen { points: scan.points(), min, max, color_union: 0 })
}
