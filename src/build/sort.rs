//! Sorting a chunk's points by Morton code: a radix sort over the highest bits in which they
//! differ, then the few points that these do not tell apart.

use crate::build::rows::RowTable;
use crate::geometry::MortonKey;

/// A point of a chunk: its Morton code and the slot of its row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Item<K> {
    /// Morton code over all bits of the root cube.
    pub key: K,
    /// Where the row is.
    pub slot: u32,
}

/// Widest digit: the counts of a pass stay in the first-level cache.
const DIGIT_BITS: u32 = 11;
const DIGIT_VALUES: usize = 1 << DIGIT_BITS;
/// So few items are sorted by insertion.
const FEW: usize = 16;

/// Memory of a sort.
#[derive(Default)]
pub struct SortScratch<K> {
    /// In the order of the rows.
    unsorted: Vec<Item<K>>,
    indices: Vec<u64>,
    packed: Vec<u64>,
    spare: Vec<u64>,
    orders: Vec<u32>,
}

impl<K> SortScratch<K> {
    /// Per sorted item its order of arrival: rises with the input index.
    pub fn orders(&self) -> &[u32] {
        &self.orders
    }
}

/// Replaces `items` by all rows of a table: by Morton code, equal codes by input index.
pub fn sort_rows<K: MortonKey>(
    rows: RowTable,
    items: &mut Vec<Item<K>>,
    scratch: &mut SortScratch<K>,
) {
    let layout = rows.layout();
    scratch.unsorted.clear();
    scratch.indices.clear();
    for page in rows.slots() {
        scratch.unsorted.extend(page.clone().map(|(slot, row)| Item { key: K::read(row), slot }));
        scratch.indices.extend(page.map(|(_, row)| layout.index(row)));
    }
    sort(items, scratch);
}

/// Sorts what is `unsorted` into `items` and `orders`.
fn sort<K: MortonKey>(items: &mut Vec<Item<K>>, scratch: &mut SortScratch<K>) {
    let SortScratch { unsorted, indices, packed, spare, orders } = scratch;
    items.clear();
    orders.clear();
    rank(indices);
    let keys = || unsorted.iter().map(|item| item.key);
    let (Some(least), Some(most)) = (keys().min(), keys().max()) else { return };
    let place_bits = usize::BITS - (unsorted.len() - 1).leading_zeros();
    let bits = most.offset_from(least).map(|range| u64::BITS - range.leading_zeros());
    match bits.filter(|bits| bits + place_bits <= u64::BITS) {
        // An offset and a place are half the bytes to move.
        Some(bits) => {
            packed.clear();
            packed.extend(unsorted.iter().zip(0u64..).map(|(item, place)| {
                item.key.offset_from(least).unwrap_or(0) << place_bits | place
            }));
            sort_packed(packed, spare, bits + place_bits, place_bits);
            let mask = (1u64 << place_bits) - 1;
            let place = |packed: &u64| (packed & mask) as usize;
            items.extend(packed.iter().map(|packed| Item {
                key: least.at_offset(packed >> place_bits),
                slot: unsorted[place(packed)].slot,
            }));
            orders.extend(packed.iter().map(|packed| indices[place(packed)] as u32));
        }
        None => {
            let mut places: Vec<u32> = (0..unsorted.len() as u32).collect();
            places.sort_unstable_by_key(|&place| unsorted[place as usize].key);
            items.extend(places.iter().map(|&place| unsorted[place as usize]));
            orders.extend(places.iter().map(|&place| indices[place as usize] as u32));
        }
    }
    sort_equal(items, orders);
}

/// Makes indices fit 32 bits: where one does not, all become their ranks. Only their order counts.
fn rank(indices: &mut [u64]) {
    if indices.iter().all(|&index| index <= u64::from(u32::MAX)) {
        return;
    }
    let mut sorted = indices.to_vec();
    sorted.sort_unstable();
    for index in indices {
        *index = sorted.partition_point(|other| other < index) as u64;
    }
}

/// Brings items of equal keys into their order of arrival.
fn sort_equal<K: MortonKey>(items: &mut [Item<K>], orders: &mut [u32]) {
    let mut start = 0;
    while start < items.len() {
        let key = items[start].key;
        let equal = items[start + 1..].iter().take_while(|item| item.key == key).count();
        let end = start + 1 + equal;
        if equal > 0 {
            let equal = items[start..end].iter().zip(&orders[start..end]);
            let mut sorted: Vec<(u32, Item<K>)> = equal.map(|(item, &o)| (o, *item)).collect();
            sorted.sort_unstable_by_key(|&(order, _)| order);
            for (i, (order, item)) in (start..end).zip(sorted) {
                (items[i], orders[i]) = (item, order);
            }
        }
        start = end;
    }
}

/// Sorts numbers of so many bits, of which the lowest `free_bits` differ between all that are else
/// equal and need no order of their own.
///
/// Two passes over the highest bits leave groups of a few, as points of a chunk crowd nowhere
/// much; where they do, a comparison sort takes over.
fn sort_packed(packed: &mut Vec<u64>, spare: &mut Vec<u64>, bits: u32, free_bits: u32) {
    if packed.len() <= 256 {
        return packed.sort_unstable();
    }
    let low = bits.saturating_sub(2 * DIGIT_BITS).max(free_bits);
    spare.resize(packed.len(), 0);
    let digit = |item: u64, shift: u32| (item >> shift) as usize & (DIGIT_VALUES - 1);
    let shifts = [low, low + DIGIT_BITS];
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
    if low <= free_bits {
        return;
    }
    let mut rest = packed.as_mut_slice();
    while let Some(first) = rest.first() {
        let top = first >> low;
        let count = 1 + rest[1..].iter().take_while(|&item| item >> low == top).count();
        let (group, tail) = rest.split_at_mut(count);
        if count > 1 {
            sort_group(group);
        }
        rest = tail;
    }
}

fn sort_group(group: &mut [u64]) {
    if group.len() > FEW {
        return group.sort_unstable();
    }
    for end in 1..group.len() {
        let item = group[end];
        let mut at = end;
        while at > 0 && group[at - 1] > item {
            group[at] = group[at - 1];
            at -= 1;
        }
        group[at] = item;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn check<K: MortonKey>(points: Vec<(K, u64)>) {
        let mut scratch = SortScratch {
            unsorted: (0..).zip(&points).map(|(slot, &(key, _))| Item { key, slot }).collect(),
            indices: points.iter().map(|&(_, index)| index).collect(),
            ..SortScratch::default()
        };
        let mut items = Vec::new();
        sort(&mut items, &mut scratch);
        let mut expected: Vec<u32> = (0..points.len() as u32).collect();
        expected.sort_by_key(|&slot| points[slot as usize]);
        let slots: Vec<u32> = items.iter().map(|item| item.slot).collect();
        assert_eq!(slots, expected);
        assert!(items.iter().all(|item| item.key == points[item.slot as usize].0));
        // Orders compare as the indices do.
        let index = |place: usize| points[items[place].slot as usize].1;
        for (place, pair) in scratch.orders().windows(2).enumerate() {
            assert_eq!(pair[0].cmp(&pair[1]), index(place).cmp(&index(place + 1)));
        }
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
