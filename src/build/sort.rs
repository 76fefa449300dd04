//! Sorting a chunk's points by Morton code: a radix sort over the highest bits in which they
//! differ, then the few that these do not tell apart.

use crate::build::rows::RowTable;
use crate::geometry::MortonKey;

/// Widest digit: the counts of a pass stay in the first-level cache.
const DIGIT_BITS: u32 = 11;
const DIGIT_VALUES: usize = 1 << DIGIT_BITS;
/// So few items are sorted by insertion.
const FEW: usize = 16;

/// Memory of a sort.
#[derive(Default)]
pub struct SortScratch {
    packed: Vec<u64>,
    spare: Vec<u64>,
}

/// Hands out all rows of a table, each by its code and slot: by Morton code, equal codes by input
/// index. No code may be smaller than `base`.
pub fn sort_rows<K: MortonKey>(
    rows: RowTable,
    base: K,
    scratch: &mut SortScratch,
    mut take: impl FnMut(K, u32),
) {
    let slot_bits = rows.slot_bits();
    let SortScratch { packed, spare } = scratch;
    packed.clear();
    // A place behind the base and a slot are half the bytes to move.
    let mut fits = true;
    let most_offset = u64::MAX.checked_shr(slot_bits).unwrap_or(0);
    for page in rows.slots() {
        packed.extend(page.map(|(slot, row)| {
            let offset = K::read(row).offset_from(base).filter(|&offset| offset <= most_offset);
            fits &= offset.is_some();
            offset.unwrap_or(0) << slot_bits | u64::from(slot)
        }));
    }
    let index = |slot: u32| rows.layout().index(rows.row(slot));
    if !fits {
        let mut all: Vec<(K, u64, u32)> = Vec::with_capacity(packed.len());
        for page in rows.slots() {
            all.extend(page.map(|(slot, row)| (K::read(row), rows.layout().index(row), slot)));
        }
        all.sort_unstable();
        return all.into_iter().for_each(|(key, _, slot)| take(key, slot));
    }
    sort_packed(packed, spare, slot_bits);
    let key = |packed: u64| base.at_offset(packed.checked_shr(slot_bits).unwrap_or(0));
    let slot = |packed: u64| (packed & !(u64::MAX << slot_bits)) as u32;
    let is_equal = |a: u64, b: u64| (a ^ b) >> slot_bits == 0;
    let mut rest = packed.as_slice();
    while let [first, tail @ ..] = rest {
        if tail.first().is_none_or(|second| !is_equal(*first, *second)) {
            take(key(*first), slot(*first));
            rest = tail;
            continue;
        }
        let equal = 1 + tail.iter().take_while(|other| is_equal(*first, **other)).count();
        let (group, tail) = rest.split_at(equal);
        let mut slots: Vec<u32> = group.iter().map(|&packed| slot(packed)).collect();
        slots.sort_by_cached_key(|&slot| index(slot));
        slots.into_iter().for_each(|slot| take(key(*first), slot));
        rest = tail;
    }
}

/// Sorts numbers of which the lowest `free_bits` differ between all that are else equal and need no
/// order of their own.
///
/// Two passes over the highest bits leave groups of a few, as points of a chunk crowd nowhere
/// much; where they do, a comparison sort takes over.
fn sort_packed(packed: &mut Vec<u64>, spare: &mut Vec<u64>, free_bits: u32) {
    if packed.len() <= 256 {
        return packed.sort_unstable();
    }
    let range = packed.iter().fold((u64::MAX, 0), |(a, b), &item| (a.min(item), b.max(item)));
    let least = range.0 & (u64::MAX << free_bits);
    let bits = u64::BITS - (range.1 - least).leading_zeros();
    let low = bits.saturating_sub(2 * DIGIT_BITS).max(free_bits);
    spare.resize(packed.len(), 0);
    let digit = |item: u64, shift: u32| ((item - least) >> shift) as usize & (DIGIT_VALUES - 1);
    // Above all bits every digit is 0.
    let shifts = [low.min(u64::BITS - 1), (low + DIGIT_BITS).min(u64::BITS - 1)];
    let mut places = [[0u32; DIGIT_VALUES]; 2];
    for &item in packed.iter() {
        for (places, shift) in places.iter_mut().zip(shifts) {
            places[digit(item, shift)] += 1;
        }
    }
    for (places, shift) in places.iter_mut().zip(shifts) {
        let mut start = 0;
        for place in places.iter_mut() {
            start += std::mem::replace(place, start);
        }
        for &item in packed.iter() {
            let place = &mut places[digit(item, shift)];
            spare[*place as usize] = item;
            *place += 1;
        }
        std::mem::swap(packed, spare);
    }
    if low > free_bits {
        sort_nearly_sorted(packed, |item| (item - least) >> low);
    }
}

/// Sorts numbers that are in order by `group`, which rises with them.
fn sort_nearly_sorted(items: &mut [u64], group: impl Fn(u64) -> u64) {
    let mut end = 1;
    while end < items.len() {
        let item = items[end];
        let mut at = end;
        while at > 0 && items[at - 1] > item && end - at <= FEW {
            items[at] = items[at - 1];
            at -= 1;
        }
        items[at] = item;
        end += 1;
        if end - at > FEW {
            // A crowd.
            let crowd = group(item);
            let start = items[..at].partition_point(|&other| group(other) < crowd);
            let count = items[end..].iter().take_while(|&&other| group(other) == crowd).count();
            items[start..end + count].sort_unstable();
            end += count;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::build::rows::RowLayout;
    use proptest::prelude::*;

    fn check<K: MortonKey>(points: Vec<(K, u64)>) {
        let layout = RowLayout::for_tests::<K>();
        let stride = layout.stride();
        let mut bytes = vec![0; points.len() * stride];
        for (row, &(key, index)) in bytes.chunks_exact_mut(stride).zip(&points) {
            layout.write(row, key, index, &[]);
        }
        // Pages of 64 rows, the third of which ends early.
        let (mut pages, mut rest) = (Vec::new(), bytes.as_slice());
        while !rest.is_empty() {
            let most = if pages.len() == 2 { 5 } else { 64 };
            let (page, tail) = rest.split_at(rest.len().min(most * stride));
            pages.push(page);
            rest = tail;
        }
        let rows = RowTable::new(&pages, 6, layout);
        let base = points.iter().map(|&(key, _)| key).min().unwrap_or_default();
        let mut found = Vec::new();
        sort_rows(rows, base, &mut SortScratch::default(), |key: K, slot| {
            assert_eq!(K::read(rows.row(slot)), key);
            found.push((key, layout.index(rows.row(slot))));
        });
        let mut expected = points;
        expected.sort();
        assert_eq!(found, expected);
    }

    /// Different indices for keys, in no order that keeps step with them.
    fn with_indices<K>(keys: Vec<K>, first: u64) -> Vec<(K, u64)> {
        let count = keys.len() as u64;
        let step = (count / 2..).find(|step| count % 2 == 1 || step % 2 == 1).unwrap_or(1);
        let place = |i: u64| if step.is_multiple_of(count.max(2)) { i } else { i ^ 1 };
        keys.into_iter().zip(0..).map(|(key, i)| (key, first + place(i))).collect()
    }

    proptest! {
        #[test]
        fn equals_a_stable_sort(
            keys in proptest::collection::vec(any::<u64>(), 0..3000),
            shift in 0u32..64,
            base: u64,
            first in prop_oneof![Just(0), Just(u64::from(u32::MAX) - 100)],
        ) {
            let base = base >> 1;
            let keys = keys.iter().map(|key| base + (key >> shift >> 1)).collect();
            check::<u64>(with_indices(keys, first));
        }

        #[test]
        fn crowds_sort_too(
            crowds in proptest::collection::vec((any::<u64>(), 1u64..200, 0u32..30), 1..40),
        ) {
            let crowd = |(start, count, shift): (u64, u64, u32)| {
                (0..count).map(move |i| (start >> 2) + (i.wrapping_mul(0x9e37_79b9) & ((1 << shift) - 1)))
            };
            let keys = crowds.into_iter().flat_map(crowd).collect();
            check::<u64>(with_indices(keys, 7));
        }

        #[test]
        fn wide_codes_sort_too(keys in proptest::collection::vec(any::<[u32; 3]>(), 256..600), bits in 1u32..=32) {
            let key = |cell: &[u32; 3]| <u128 as MortonKey>::encode(cell.map(|c| c >> (32 - bits)));
            check::<u128>(with_indices(keys.iter().map(key).collect(), 0));
        }
    }
}
