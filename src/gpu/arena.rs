//! Words of many nodes in few storage buffers.
//!
//! A node's words stand in one range of one shard; a shard is a buffer no larger than a binding may
//! be. Shards are made when needed and start small, so a small scene holds little. Ranges are
//! found first-fit and merge with their neighbours when freed. Who must leave when memory ends is
//! not decided here.

use std::collections::BTreeMap;

use crate::gpu::{Gpu, GpuError};

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
    buffer: wgpu::Buffer,
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
        let usual_bytes = FIRST_SHARD_BYTES << self.shards.len().min(16);
        let allowed_bytes = self.limit_bytes.saturating_sub(self.held_bytes()) & !0xff;
        let size = usual_bytes.max(needed_bytes).min(self.max_shard_bytes).min(allowed_bytes);
        if size < needed_bytes {
            return Ok(false);
        }
        let buffer = gpu.checked("hold more points", || {
            gpu.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some("point words"),
                size,
                usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        });
        match buffer {
            Ok(buffer) => {
                self.shards.push(Shard { buffer, free: FreeRanges::new((size / 4) as u32) });
                Ok(true)
            }
            // The device is smaller than the limit: a smaller piece, or stay with what there is.
            Err(GpuError::OutOfMemory { .. }) if size / 2 >= needed_bytes => {
                self.limit_bytes = self.held_bytes() + size / 2;
                self.add_shard(gpu, count)
            }
            Err(GpuError::OutOfMemory { .. }) => {
                self.limit_bytes = self.held_bytes();
                Ok(false)
            }
            Err(error) => Err(error),
        }
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

/// Free ranges by their start.
#[derive(Debug)]
struct FreeRanges {
    count_by_first: BTreeMap<u32, u32>,
}

impl FreeRanges {
    fn new(count: u32) -> Self {
        FreeRanges { count_by_first: BTreeMap::from([(0, count)]) }
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
    }
}
