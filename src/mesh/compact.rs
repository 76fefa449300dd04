//! Triangles in groups that lie close together, so that parts of a large shape can be hidden.

use glam::DVec3;

/// Most triangles of one group. A group is the smallest thing that culling leaves out: fewer would
/// make more objects to decide on than that saves, more would draw what nobody sees.
pub const MOST_GROUP_TRIANGLES: usize = 4096;

/// Splits triangles with these centres into groups of at most `most`: by the median across the
/// longest side of their box, again and again. Groups differ in size by one at most, and each
/// lists its triangles in ascending order.
pub fn compact_groups(centers: &[DVec3], most: usize) -> Vec<Vec<u32>> {
    let mut all: Vec<u32> = (0..centers.len() as u32).collect();
    let mut groups = Vec::new();
    split(centers, &mut all, centers.len().div_ceil(most.max(1)), &mut groups);
    groups
}

fn split(centers: &[DVec3], part: &mut [u32], count: usize, groups: &mut Vec<Vec<u32>>) {
    if count <= 1 {
        let mut group = part.to_vec();
        group.sort_unstable();
        groups.extend((!group.is_empty()).then_some(group));
        return;
    }
    let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for &triangle in part.iter() {
        min = min.min(centers[triangle as usize]);
        max = max.max(centers[triangle as usize]);
    }
    let axis = (max - min).max_position();
    let left = count / 2;
    let at = (part.len() as u128 * left as u128 / count as u128) as usize;
    // Ties by number, so that the groups are the same on every machine.
    part.select_nth_unstable_by(at, |&a, &b| {
        centers[a as usize][axis].total_cmp(&centers[b as usize][axis]).then(a.cmp(&b))
    });
    let (lower, upper) = part.split_at_mut(at);
    split(centers, lower, left, groups);
    split(centers, upper, count - left, groups);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_hold_each_triangle_once_and_are_compact() {
        let centers: Vec<DVec3> = (0..10_000u32)
            .map(|i| DVec3::new(f64::from(i % 100), f64::from(i / 100), 0.0))
            .collect();
        let groups = compact_groups(&centers, 600);
        assert_eq!(groups.len(), 17);
        let mut seen: Vec<u32> = groups.concat();
        seen.sort_unstable();
        assert!(seen.iter().copied().eq(0..10_000));
        for group in &groups {
            assert!((588..=600).contains(&group.len()), "{}", group.len());
            let x = |i: &u32| i % 100;
            let wide = group.iter().map(x).max().zip(group.iter().map(x).min());
            assert!(wide.is_some_and(|(max, min)| max - min < 60), "no strip across the shape");
        }
    }

    #[test]
    fn coincident_and_absent_triangles_end() {
        assert_eq!(compact_groups(&[], 4), Vec::<Vec<u32>>::new());
        let groups = compact_groups(&[DVec3::ONE; 9], 4);
        assert_eq!(groups.iter().map(Vec::len).collect::<Vec<_>>(), [3, 3, 3]);
    }
}
