//! Sorting a chunk's points by Morton code: a radix sort over the bits in which they differ.

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
const MOST_DIGIT_BITS: u32 = 11;

/// Memory of a sort.
#[derive(Default)]
pub struct SortScratch<K> {
    items: Vec<Item<K>>,
    packed: Vec<u64>,
    spare: Vec<u64>,
}

/// Replaces `items` by all rows of a table: by Morton code, equal codes by input index.
pub fn sort_rows<K: MortonKey>(
    rows: RowTable,
    items: &mut Vec<Item<K>>,
    scratch: &mut SortScratch<K>,
) {
    items.clear();
    items.extend(rows.slots().map(|(slot, row)| Item { key: K::read(row), slot }));
    sort_by_key(items, scratch);
    let layout = rows.layout();
    for equal in items.chunk_by_mut(|a, b| a.key == b.key) {
        if equal.len() > 1 {
            equal.sort_unstable_by_key(|item| layout.index(rows.row(item.slot)));
        }
    }
}

/// Sorts by key; points of equal keys keep their order.
fn sort_by_key<K: MortonKey>(items: &mut Vec<Item<K>>, scratch: &mut SortScratch<K>) {
    let Some(first) = items.first() else { return };
    let base = first.key;
    if items.len() < 256 {
        items.sort_by_key(|item| item.key);
        return;
    }
    let bits = items.iter().map(|item| item.key.differing_bits(base)).max().unwrap_or(0);
    let place_bits = usize::BITS - (items.len() - 1).leading_zeros();
    if bits + place_bits > u64::BITS {
        return radix_sort(items, &mut scratch.items, bits, |item, low, width| {
            item.key.digit(low, width)
        });
    }
    // Half the bytes to move: what differs of the key, and the place.
    let SortScratch { packed, spare, items: unsorted } = scratch;
    packed.clear();
    packed.extend(
        items.iter().zip(0u64..).map(|(item, i)| item.key.low_bits(bits) << place_bits | i),
    );
    radix_sort(packed, spare, bits, |item, low, width| {
        (item >> (place_bits + low)) as usize & ((1 << width) - 1)
    });
    std::mem::swap(items, unsorted);
    let place_mask = (1 << place_bits) - 1;
    items.clear();
    items.extend(packed.iter().map(|item| unsorted[(item & place_mask) as usize]));
}

fn radix_sort<T: Copy + Default>(
    items: &mut Vec<T>,
    spare: &mut Vec<T>,
    bits: u32,
    digit: impl Fn(&T, u32, u32) -> usize,
) {
    let passes = bits.div_ceil(MOST_DIGIT_BITS);
    if passes == 0 {
        return;
    }
    let width = bits.div_ceil(passes);
    if spare.len() < items.len() {
        spare.resize(items.len(), T::default());
    }
    spare.truncate(items.len());
    let mut counts = vec![0u32; (passes as usize) << width];
    for item in items.iter() {
        for pass in 0..passes {
            counts[((pass as usize) << width) + digit(item, pass * width, width)] += 1;
        }
    }
    for (pass, counts) in counts.chunks_exact_mut(1 << width).enumerate() {
        let mut start = 0;
        for count in counts.iter_mut() {
            start += std::mem::replace(count, start);
        }
        let low = pass as u32 * width;
        for item in items.iter() {
            let place = &mut counts[digit(item, low, width)];
            spare[*place as usize] = *item;
            *place += 1;
        }
        std::mem::swap(items, spare);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn equals_a_stable_sort(
            keys in proptest::collection::vec(any::<u64>(), 0..3000),
            shift in 0u32..63,
            base: u64,
        ) {
            let item = |(i, key): (usize, &u64)| Item {
                key: base & !(u64::MAX >> shift) | key >> shift,
                slot: i as u32,
            };
            let mut items: Vec<Item<u64>> = keys.iter().enumerate().map(item).collect();
            let mut expected = items.clone();
            expected.sort_by_key(|item| item.key);
            sort_by_key(&mut items, &mut SortScratch::default());
            prop_assert_eq!(items, expected);
        }

        #[test]
        fn wide_codes_sort_too(keys in proptest::collection::vec(any::<[u32; 3]>(), 256..600)) {
            let key = |cell: &[u32; 3]| <u128 as MortonKey>::encode(*cell);
            let mut items: Vec<Item<u128>> =
                keys.iter().map(|cell| Item { key: key(cell), slot: 0 }).collect();
            sort_by_key(&mut items, &mut SortScratch::default());
            prop_assert!(items.is_sorted_by_key(|item| item.key));
        }
    }
}
