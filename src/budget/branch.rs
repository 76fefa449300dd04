//! Which alternative to draw in the time that is left: the rule of the in-frame checkpoint.
//!
//! Alternatives stand fine to coarse; each comes with the time that it and all that follows in the
//! frame need. The first that needs strictly less than what is left is drawn, the coarsest if none
//! does. (The paper counts tokens in a command stream; its text skips one too many.)
//! Twin of `shaders/checkpoint.wgsl`; ticks of the GPU's clock, u64, may wrap around.

/// Index of the alternative to draw; `needs` must not be empty.
pub fn choose_alternative(needs: &[u64], left: u64) -> usize {
    assert!(!needs.is_empty(), "there is no alternative");
    needs.iter().position(|&need| need < left).unwrap_or(needs.len() - 1)
}

/// For each alternative, its own time plus that of everything after it in the frame: of the later
/// objects the coarsest alternative, because they will decide for themselves.
pub fn still_needed(alternatives: &[u64], later: &[&[u64]]) -> Vec<u64> {
    let rest = later.iter().filter_map(|object| object.last());
    let rest = rest.fold(0u64, |sum, &need| sum.saturating_add(need));
    alternatives.iter().map(|need| need.saturating_add(rest)).collect()
}

/// Ticks left of a frame that began at `start` and may take `allowed`, when the clock shows `now`.
pub fn ticks_left(start: u64, allowed: u64, now: u64) -> u64 {
    allowed.saturating_sub(now.wrapping_sub(start))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All alternatives are looked at in turn, without shortcuts.
    fn brute_force(needs: &[u64], left: u64) -> usize {
        let mut chosen = needs.len() - 1;
        for i in (0..needs.len()).rev() {
            if needs[i] < left {
                chosen = i;
            }
        }
        chosen
    }

    #[test]
    fn every_order_of_four_needs_agrees_with_looking_at_all() {
        let values = [0u64, 1, 5, 5, u64::MAX];
        for a in values {
            for (b, c, d) in values
                .iter()
                .flat_map(|b| values.iter().map(move |c| (b, c)))
                .flat_map(|(b, c)| values.iter().map(move |d| (*b, *c, *d)))
            {
                let needs = [a, b, c, d];
                for left in [0, 1, 2, 5, 6, u64::MAX] {
                    let chosen = choose_alternative(&needs, left);
                    assert_eq!(chosen, brute_force(&needs, left), "{needs:?} {left}");
                }
            }
        }
    }

    #[test]
    fn a_tie_does_not_fit_and_if_none_fits_it_is_the_coarsest() {
        assert_eq!(choose_alternative(&[10, 5, 2], 10), 1);
        assert_eq!(choose_alternative(&[10, 5, 2], 11), 0);
        assert_eq!(choose_alternative(&[10, 5, 2], 2), 2);
        assert_eq!(choose_alternative(&[10, 5, 2], 0), 2);
        assert_eq!(choose_alternative(&[7], 0), 0);
    }

    #[test]
    fn needs_add_what_follows_at_its_coarsest() {
        assert_eq!(still_needed(&[8, 3], &[&[9, 4], &[], &[2]]), [14, 9]);
        assert_eq!(still_needed(&[u64::MAX, 1], &[&[5]]), [u64::MAX, 6]);
    }

    #[test]
    fn a_clock_that_wraps_still_tells_the_time_left() {
        assert_eq!(ticks_left(u64::MAX - 2, 10, 3), 4);
        assert_eq!(ticks_left(100, 10, 200), 0);
    }
}
