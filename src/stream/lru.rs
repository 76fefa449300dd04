//! Which of the things in a cache leaves first: the longest unused; of these the deepest.
//!
//! Sizes and order only; the things themselves are kept by the owner. Time is a count that the
//! owner raises (frames, lists). A parent that is used whenever its children are leaves after
//! them, because of two things of one time the deeper one is first.

use std::cmp::Reverse;
use std::collections::{BTreeSet, HashMap};
use std::hash::Hash;

#[derive(Clone, Copy, Debug)]
struct Entry {
    bytes: u64,
    depth: u32,
    last_use: u64,
}

/// Keys with a size, a depth and the time of their last use, in the order of leaving.
///
/// Invariant: `order` has one row per entry, and `bytes` is the sum of their sizes.
#[derive(Clone, Debug)]
pub struct Lru<K> {
    entries: HashMap<K, Entry>,
    order: BTreeSet<(u64, Reverse<u32>, K)>,
    bytes: u64,
}

impl<K> Default for Lru<K> {
    fn default() -> Self {
        Lru { entries: HashMap::new(), order: BTreeSet::new(), bytes: 0 }
    }
}

impl<K: Copy + Ord + Hash> Lru<K> {
    /// Number of keys.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Sum of the sizes.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Whether a key is there.
    pub fn contains(&self, key: K) -> bool {
        self.entries.contains_key(&key)
    }

    /// When a key was last used.
    pub fn last_use(&self, key: K) -> Option<u64> {
        self.entries.get(&key).map(|entry| entry.last_use)
    }

    /// Adds a key, or replaces what is known of it.
    pub fn insert(&mut self, key: K, bytes: u64, depth: u32, now: u64) {
        self.remove(key);
        self.entries.insert(key, Entry { bytes, depth, last_use: now });
        self.order.insert((now, Reverse(depth), key));
        self.bytes += bytes;
    }

    /// Notes that a key is used; `false` if it is not there.
    pub fn touch(&mut self, key: K, now: u64) -> bool {
        let Some(entry) = self.entries.get_mut(&key) else { return false };
        if entry.last_use != now {
            self.order.remove(&(entry.last_use, Reverse(entry.depth), key));
            entry.last_use = now;
            self.order.insert((now, Reverse(entry.depth), key));
        }
        true
    }

    /// Takes a key out; its size, if it was there.
    pub fn remove(&mut self, key: K) -> Option<u64> {
        let entry = self.entries.remove(&key)?;
        self.order.remove(&(entry.last_use, Reverse(entry.depth), key));
        self.bytes -= entry.bytes;
        Some(entry.bytes)
    }

    /// The key that leaves first, unless all were used at `now` or later.
    pub fn oldest_before(&self, now: u64) -> Option<K> {
        self.order.first().filter(|(last_use, ..)| *last_use < now).map(|&(.., key)| key)
    }

    /// Sum of the sizes of what was used at `now` or later.
    pub fn bytes_since(&self, now: u64) -> u64 {
        // Few things are used in one frame compared to all that are kept.
        let recent = self.order.iter().rev().take_while(|(last_use, ..)| *last_use >= now);
        recent.map(|(.., key)| self.entries[key].bytes).sum()
    }

    /// All keys, those that leave first before the others.
    pub fn keys(&self) -> impl Iterator<Item = K> + '_ {
        self.order.iter().map(|&(.., key)| key)
    }

    /// Takes all keys out.
    pub fn clear(&mut self) {
        self.entries.clear();
        self.order.clear();
        self.bytes = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same rules in the simplest form: a list that is searched.
    #[derive(Default)]
    struct Slow(Vec<(u32, u64, u32, u64)>);

    impl Slow {
        fn oldest_before(&self, now: u64) -> Option<u32> {
            let idle = self.0.iter().filter(|entry| entry.3 < now);
            idle.min_by_key(|&&(key, _, depth, used)| (used, Reverse(depth), key)).map(|e| e.0)
        }
    }

    /// Row 21 of the acceptance table: the same evictions as a search through a list, over
    /// 10^5 random accesses, and nothing of the current time among them.
    #[test]
    fn evictions_are_those_of_a_search_through_a_list() {
        const LIMIT: u64 = 4_000;
        let mut state = 0x9e37_79b9_7f4a_7c15u64;
        let mut next = |below: u64| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) % below
        };
        let (mut lru, mut slow) = (Lru::default(), Slow::default());
        let (mut now, mut evictions) = (0, 0);
        for access in 0..100_000u32 {
            if access % 16 == 0 {
                now += 1;
            }
            let key = next(400) as u32;
            let (bytes, depth) = (10 + u64::from(key % 37), key % 9);
            if lru.touch(key, now) {
                let entry = slow.0.iter_mut().find(|entry| entry.0 == key).expect("both have it");
                entry.3 = now;
                continue;
            }
            lru.insert(key, bytes, depth, now);
            slow.0.push((key, bytes, depth, now));
            while lru.bytes() > LIMIT {
                let victim = lru.oldest_before(now);
                assert_eq!(victim, slow.oldest_before(now), "access {access}");
                let Some(victim) = victim else { break };
                assert!(lru.last_use(victim) < Some(now));
                lru.remove(victim);
                slow.0.retain(|entry| entry.0 != victim);
                evictions += 1;
            }
            assert_eq!(lru.bytes(), slow.0.iter().map(|entry| entry.1).sum::<u64>());
            let since: u64 = slow.0.iter().filter(|e| e.3 >= now).map(|e| e.1).sum();
            assert_eq!(lru.bytes_since(now), since);
        }
        assert!(evictions > 10_000, "{evictions}");
    }

    /// A child that is used together with its ancestors is gone before any of them.
    #[test]
    fn parents_leave_after_their_children() {
        let mut lru = Lru::default();
        let mut state = 7u64;
        for now in 0..2_000 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695);
            // A path of a binary tree: node n has the children 2n and 2n + 1.
            let leaf = 64 + (state >> 40) as u32 % 64;
            for node in (0..7).map(|up| leaf >> up) {
                let depth = node.ilog2();
                if !lru.touch(node, now) {
                    lru.insert(node, 1, depth, now);
                }
            }
            while lru.bytes() > 40 {
                let victim = lru.oldest_before(now).expect("a path has 7 nodes");
                let child_stays = [2 * victim, 2 * victim + 1].iter().any(|&c| lru.contains(c));
                assert!(!child_stays, "{victim} leaves before its children");
                lru.remove(victim);
            }
        }
    }
}
