//! Words of many nodes in few storage buffers.
//!
//! A node's words stand in one range of one shard; a shard is a buffer no larger than a binding may
//! be. Shards are made when needed and start small, so a small scene holds little. Ranges are
//! found first-fit and merge with their neighbours when freed; when free room is in pieces that are
//! too short, [`WordArena::pack`] moves what is in a shard together. Who must leave when memory ends
//! is not decided here.

use std::collections::BTreeMap;

use crate::gpu::{Gpu, GpuError, HeldBuffer};

/// A limit that memory running out never goes below.
const LEAST_BYTES: u64 = 256 << 10;
/// Size of the first shard, bytes; each further one is twice as large, up to the limit.
const FIRST_SHARD_BYTES: u64 = 16 << 20;

/// Where a node's words are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct WordRange {
    /// The shard.
    pub shard: usize,
    /// First word.
    pub first: u32,
    /// Number of words.
    pub count: u32,
}

/// Storage buffers and their free ranges.
///
/// Invariant: free and handed-out ranges of a shard do not overlap and cover it; adjacent free
/// ranges are merged.
#[derive(Debug)]
pub struct WordArena {
    shards: Vec<Shard>,
    limit_bytes: u64,
    max_shard_bytes: u64,
}

#[derive(Debug)]
struct Shard {
    buffer: HeldBuffer,
    free: FreeRanges,
}

impl WordArena {
    /// An empty arena that will hold at most `limit_bytes`.
    pub fn new(gpu: &Gpu, limit_bytes: u64) -> Self {
        let limits = gpu.device().limits();
        let binding = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        // Word indices are u32, and half of that keeps sums of two of them safe.
        let max_shard_bytes = binding.min(1 << 31) & !0xff;
        WordArena { shards: Vec::new(), limit_bytes, max_shard_bytes }
    }

    /// Finds room for `count` words; `Ok(None)` if the arena is full.
    pub fn allocate(&mut self, gpu: &Gpu, count: u32) -> Result<Option<WordRange>, GpuError> {
        for (shard, existing) in self.shards.iter_mut().enumerate() {
            if let Some(first) = existing.free.take(count) {
                return Ok(Some(WordRange { shard, first, count }));
            }
        }
        if !self.add_shard(gpu, count)? {
            return Ok(None);
        }
        let shard = self.shards.len() - 1;
        let first = self.shards[shard].free.take(count).expect("a new shard has room");
        Ok(Some(WordRange { shard, first, count }))
    }

    /// Gives a range back.
    pub fn free(&mut self, range: WordRange) {
        self.shards[range.shard].free.give(range.first, range.count);
    }

    /// Copies words to a range, from its word `at` on.
    pub fn write(&self, gpu: &Gpu, range: WordRange, at: u32, words: &[u32]) {
        assert!(at as usize + words.len() <= range.count as usize, "words exceed their range");
        let offset = 4 * (u64::from(range.first) + u64::from(at));
        let buffer = &self.shards[range.shard].buffer;
        gpu.queue().write_buffer(buffer, offset, bytemuck::cast_slice(words));
    }

    /// A shard that has `count` words free, if in several pieces.
    pub fn shard_with(&self, count: u32) -> Option<usize> {
        self.shards.iter().position(|shard| shard.free.total() >= u64::from(count))
    }

    /// Moves all ranges of a shard to its start, one after the other, so that what is free becomes
    /// one piece; returns the bytes moved. `ranges` must be all that were handed out there; on an
    /// error they stay as they are.
    pub fn pack(
        &mut self,
        gpu: &Gpu,
        shard: usize,
        ranges: &mut [&mut WordRange],
    ) -> Result<u64, GpuError> {
        ranges.sort_unstable_by_key(|range| range.first);
        let counts = || ranges.iter().map(|range| (range.first, range.count));
        let moves = moves_down(counts());
        let used: u32 = counts().map(|(_, count)| count).sum();
        let Shard { buffer, free } = &mut self.shards[shard];
        // A buffer cannot be copied onto itself.
        let descriptor = wgpu::BufferDescriptor {
            label: Some("points on the move"),
            size: 4 * u64::from(BETWEEN_WORDS.min(used.max(1))),
            usage: wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        };
        let between = gpu.create_buffer("move points", &descriptor)?;
        gpu.checked("move points", || {
            let mut encoder = gpu.device().create_command_encoder(&Default::default());
            for Move { pieces, to } in &moves {
                let mut at = 0;
                for &(from, count) in pieces {
                    let bytes = 4 * u64::from(count);
                    encoder.copy_buffer_to_buffer(buffer, 4 * u64::from(from), &between, at, bytes);
                    at += bytes;
                }
                encoder.copy_buffer_to_buffer(&between, 0, buffer, 4 * u64::from(*to), at);
            }
            gpu.queue().submit([encoder.finish()]);
        })?;
        let mut end = 0;
        for range in ranges.iter_mut() {
            range.first = end;
            end += range.count;
        }
        free.become_the_end_from(used);
        let words =
            |step: &Move| step.pieces.iter().map(|&(_, count)| u64::from(count)).sum::<u64>();
        Ok(4 * moves.iter().map(words).sum::<u64>())
    }

    /// Bytes of ranges, none longer than `largest_bytes`, that surely find room together once all
    /// shards are packed: each shard but one may be left with nearly so much free.
    pub fn room_bytes(&self, largest_bytes: u64) -> u64 {
        let (existing, held_bytes) = (self.shards.len() as u64, self.held_bytes());
        let left_bytes = self.limit_bytes.saturating_sub(held_bytes) & !0xff;
        let shards = shards_in_the_end(existing, left_bytes, self.max_shard_bytes);
        let unsure_bytes = shards.saturating_sub(1).saturating_mul(largest_bytes);
        held_bytes.saturating_add(left_bytes).saturating_sub(unsure_bytes)
    }

    /// The buffer of a shard.
    pub fn buffer(&self, shard: usize) -> &wgpu::Buffer {
        &self.shards[shard].buffer
    }

    /// Most bytes that all buffers may have together.
    pub fn limit_bytes(&self) -> u64 {
        self.limit_bytes
    }

    /// Bytes of all buffers.
    pub fn held_bytes(&self) -> u64 {
        self.shards.iter().map(|shard| shard.buffer.size()).sum()
    }

    fn add_shard(&mut self, gpu: &Gpu, count: u32) -> Result<bool, GpuError> {
        let needed_bytes = (4 * u64::from(count)).next_multiple_of(256);
        let allowed_bytes = self.limit_bytes.saturating_sub(self.held_bytes());
        let existing = self.shards.len() as u64;
        let usual_bytes = shard_bytes(existing, allowed_bytes, self.max_shard_bytes);
        let most_bytes = (allowed_bytes & !0xff).min(self.max_shard_bytes);
        let mut size = usual_bytes.max(needed_bytes).min(most_bytes);
        let held_bytes = self.held_bytes();
        while size >= needed_bytes {
            let descriptor = wgpu::BufferDescriptor {
                label: Some("point words"),
                size,
                usage: wgpu::BufferUsages::STORAGE
                    | wgpu::BufferUsages::COPY_SRC
                    | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            };
            match gpu.create_buffer("hold more points", &descriptor) {
                Ok(buffer) => {
                    self.shards.push(Shard { buffer, free: FreeRanges::new((size / 4) as u32) });
                    return Ok(true);
                }
                // The device is smaller than the limit: a smaller piece, or what there is. A little
                // is asked for again and again: there may be memory again.
                Err(GpuError::OutOfMemory { .. }) => {
                    size = (size / 2) & !0xff;
                    let least_bytes = LEAST_BYTES.min(self.limit_bytes);
                    self.limit_bytes = held_bytes.saturating_add(size).max(least_bytes);
                }
                Err(error) => return Err(error),
            }
        }
        Ok(false)
    }

    /// Ranges of which shard go with the last shard, the next to be given up; `None` without any.
    pub fn last_shard(&self) -> Option<usize> {
        self.shards.len().checked_sub(1)
    }

    /// Gives the last shard back to the device, whatever is in it; its ranges must not be used any
    /// more. From now on no more is taken than what is left, or half of it if that is nothing.
    pub fn give_up_shard(&mut self) {
        let Some(shard) = self.shards.pop() else { return };
        // The device frees it when nothing that was sent uses it any more.
        self.limit_bytes = match self.held_bytes() {
            0 => shard.buffer.size() / 2,
            held => held,
        };
    }
}

/// Size of the shard that is made after `existing` ones while `left_bytes` may still be held.
fn shard_bytes(existing: u64, left_bytes: u64, max_shard_bytes: u64) -> u64 {
    let usual_bytes = FIRST_SHARD_BYTES << existing.min(16);
    usual_bytes.min(max_shard_bytes).min(left_bytes & !0xff)
}

/// How many shards there are, from `existing` ones on, when `left_bytes` are used up too.
fn shards_in_the_end(existing: u64, left_bytes: u64, max_shard_bytes: u64) -> u64 {
    let (mut count, mut left_bytes) = (existing, left_bytes & !0xff);
    while left_bytes > 0 {
        let size = shard_bytes(count, left_bytes, max_shard_bytes).max(0x100);
        if size >= max_shard_bytes {
            // All others are as large.
            return count + left_bytes.div_ceil(size);
        }
        count += 1;
        left_bytes = left_bytes.saturating_sub(size);
    }
    count
}

/// Words that are moved at a time.
const BETWEEN_WORDS: u32 = 1 << 20;

/// Pieces that are moved together: where each begins and how long it is, and where the first goes;
/// the others go behind it.
#[derive(Debug, PartialEq, Eq)]
struct Move {
    pieces: Vec<(u32, u32)>,
    to: u32,
}

/// How ranges, sorted by their start, come to stand one after the other. No move writes what a
/// later one reads: everything goes down.
fn moves_down(ranges: impl Iterator<Item = (u32, u32)>) -> Vec<Move> {
    let mut moves: Vec<Move> = Vec::new();
    let (mut end, mut room) = (0, 0);
    for (mut from, mut count) in ranges {
        if from == end && moves.is_empty() {
            end += count;
            continue;
        }
        while count > 0 {
            if room == 0 {
                moves.push(Move { pieces: Vec::new(), to: end });
                room = BETWEEN_WORDS;
            }
            let now = count.min(room);
            moves.last_mut().expect("just made").pieces.push((from, now));
            (from, count, room, end) = (from + now, count - now, room - now, end + now);
        }
    }
    moves
}

/// Free ranges by their start.
#[derive(Debug)]
struct FreeRanges {
    count_by_first: BTreeMap<u32, u32>,
    all: u32,
}

impl FreeRanges {
    fn new(count: u32) -> Self {
        FreeRanges { count_by_first: BTreeMap::from([(0, count)]), all: count }
    }

    fn total(&self) -> u64 {
        self.count_by_first.values().map(|&count| u64::from(count)).sum()
    }

    /// Everything before `first` is handed out, the rest is free.
    fn become_the_end_from(&mut self, first: u32) {
        self.count_by_first = match self.all - first {
            0 => BTreeMap::new(),
            count => BTreeMap::from([(first, count)]),
        };
    }

    fn take(&mut self, count: u32) -> Option<u32> {
        let (&first, &free) = self.count_by_first.iter().find(|&(_, &free)| free >= count)?;
        self.count_by_first.remove(&first);
        if free > count {
            self.count_by_first.insert(first + count, free - count);
        }
        Some(first)
    }

    fn give(&mut self, first: u32, count: u32) {
        let (mut first, mut count) = (first, count);
        if let Some((&before, &free)) = self.count_by_first.range(..first).next_back()
            && before + free == first
        {
            self.count_by_first.remove(&before);
            (first, count) = (before, free + count);
        }
        if let Some(free) = self.count_by_first.remove(&(first + count)) {
            count += free;
        }
        self.count_by_first.insert(first, count);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn freed_ranges_merge_on_both_sides() {
        let mut free = FreeRanges::new(100);
        let starts: Vec<_> = [10, 20, 30].map(|count| free.take(count).expect("room")).into();
        assert_eq!(starts, [0, 10, 30]);
        assert_eq!(free.take(41), None, "40 are left");
        free.give(0, 10);
        free.give(30, 30);
        assert_eq!(free.count_by_first, BTreeMap::from([(0, 10), (30, 70)]));
        free.give(10, 20);
        assert_eq!(free.count_by_first, BTreeMap::from([(0, 100)]));
        free.become_the_end_from(30);
        assert_eq!((free.total(), free.take(70)), (70, Some(30)));
    }

    #[test]
    fn ranges_move_down_in_pieces_that_never_overlap_what_is_to_come() {
        let moves = moves_down([(0, 5), (5, 7), (20, 4), (30, 6)].into_iter());
        assert_eq!(moves, [Move { pieces: vec![(20, 4), (30, 6)], to: 12 }]);
        assert_eq!(moves_down([(0, 5), (5, 7)].into_iter()), [], "nothing to do");
        let long = BETWEEN_WORDS + 10;
        let moves = moves_down([(1, long), (long + 5, 3)].into_iter());
        let first = Move { pieces: vec![(1, BETWEEN_WORDS)], to: 0 };
        let second =
            Move { pieces: vec![(1 + BETWEEN_WORDS, 10), (long + 5, 3)], to: BETWEEN_WORDS };
        assert_eq!(moves, [first, second]);
    }

    #[test]
    fn shards_grow_up_to_the_limit() {
        const MIB: u64 = 1 << 20;
        let sizes = |mut left: u64| {
            let mut sizes = Vec::new();
            while left > 0 && sizes.len() < 9 {
                sizes.push(shard_bytes(sizes.len() as u64, left, 128 * MIB));
                left -= sizes.last().expect("just made");
            }
            sizes
        };
        for (limit, expected) in [
            (10, vec![10]),
            (60, vec![16, 32, 12]),
            (300, vec![16, 32, 64, 128, 60]),
            (500, vec![16, 32, 64, 128, 128, 128, 4]),
        ] {
            let expected: Vec<u64> = expected.into_iter().map(|size| size * MIB).collect();
            assert_eq!(sizes(limit * MIB), expected);
            let counted = shards_in_the_end(0, limit * MIB, 128 * MIB);
            assert_eq!(counted, expected.len() as u64);
        }
        assert_eq!(shards_in_the_end(2, 255, 128 * MIB), 2);
        assert_eq!(shards_in_the_end(0, u64::MAX, 128 * MIB), (1 << 37) + 3, "no loop of as many");
    }
}
