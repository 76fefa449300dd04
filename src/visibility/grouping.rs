//! How many hidden nodes to ask about at once.
//!
//! A group of nodes, each likely to stay hidden, is decided by one question if all stay hidden; if
//! not, each is asked about again. The expected number of questions of a group of `n > 1` is
//! `1 + p_fail n`; of a single node it is 1, since a single failure needs no second question (the
//! paper's formula charges it one, which joins nodes that never should be: with `p = 0.29` fifty of
//! them). A group grows, most stable nodes first, while the nodes decided per question increase.
//!
//! After: Mattausch et al. 2008, section 5.1.

/// Size of the best group from the front of probabilities sorted downward, at least 1, and the nodes
/// it decides per expected question.
///
/// `charge_singles` is the published cost.
pub fn best_group(
    keep: impl Iterator<Item = f64>,
    most: usize,
    charge_singles: bool,
) -> (usize, f64) {
    let mut best = (1, 0.0);
    let mut all_keep = 1.0;
    for (at, p) in keep.take(most.max(1)).enumerate() {
        all_keep *= p;
        let size = (at + 1) as f64;
        let again = if at == 0 && !charge_singles { 0.0 } else { 1.0 - all_keep };
        let value = size / (1.0 + again * size);
        if at > 0 && value <= best.1 {
            break;
        }
        best = (at + 1, value);
    }
    best
}

/// Sizes of the groups that probabilities, sorted downward, fall into.
pub fn group_sizes(keep: &[f64], most: usize, charge_singles: bool) -> Vec<usize> {
    let mut sizes = Vec::new();
    let mut from = 0;
    while from < keep.len() {
        let (size, _) = best_group(keep[from..].iter().copied(), most, charge_singles);
        sizes.push(size);
        from += size;
    }
    sizes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Random;

    #[test]
    fn equal_probabilities_give_the_known_sizes() {
        assert_eq!(group_sizes(&[0.99; 50], 50, false), [11, 11, 11, 11, 6]);
        assert_eq!(group_sizes(&[0.29; 50], 50, false), [1; 50]);
        assert_eq!(group_sizes(&[0.29; 50], 50, true), [50], "the published cost");
        assert_eq!(group_sizes(&[0.999; 50], 50, false), [32, 18]);
        assert_eq!(group_sizes(&[1.0; 50], 20, false), [20, 20, 10]);
        for (p, size, value) in
            [(0.7325, 3, 1.06), (0.8953, 4, 1.65), (0.9551, 5, 2.47), (0.995, 15, 7.19)]
        {
            let (found, worth) = best_group(std::iter::repeat_n(p, 200), 200, false);
            assert_eq!(found, size, "p = {p}");
            assert!((worth - value).abs() < 0.01, "{worth} for p = {p}");
        }
    }

    fn cost(keep: &[f64], sizes: &[usize]) -> f64 {
        let mut from = 0;
        let mut sum = 0.0;
        for &size in sizes {
            let fail = 1.0 - keep[from..from + size].iter().product::<f64>();
            sum += if size == 1 { 1.0 } else { 1.0 + fail * size as f64 };
            from += size;
        }
        sum
    }

    /// The least expected cost of any division into runs.
    fn least_cost(keep: &[f64]) -> f64 {
        let mut least = vec![0.0; keep.len() + 1];
        for end in 1..=keep.len() {
            let mut product = 1.0;
            least[end] = f64::INFINITY;
            for from in (0..end).rev() {
                product *= keep[from];
                let size = (end - from) as f64;
                let own = if size == 1.0 { 1.0 } else { 1.0 + (1.0 - product) * size };
                least[end] = f64::min(least[end], least[from] + own);
            }
        }
        least[keep.len()]
    }

    #[test]
    fn greedy_groups_are_near_the_best_division() {
        for (count, sets, bound) in [(50, 600, 1.10), (14, 3000, 1.40)] {
            let mut sum = 0.0;
            for set in 0..sets {
                let mut random = Random::new(2, set);
                let skew = random.between(0.2, 6.0);
                let mut keep: Vec<f64> =
                    (0..count).map(|_| 1.0 - 0.71 * random.unit().powf(skew)).collect();
                keep.sort_by(|a, b| b.total_cmp(a));
                let ratio = cost(&keep, &group_sizes(&keep, 50, false)) / least_cost(&keep);
                assert!(ratio <= bound, "{ratio} for set {set} of {count}");
                sum += ratio;
            }
            assert!(sum / (sets as f64) < 1.05, "mean {}", sum / sets as f64);
        }
    }
}
