//! The nodes that are ready to be drawn: their words, on the device or in memory, within a limit.
//!
//! When room is needed, nodes leave that were drawn longest ago, deeper ones first, so that a
//! parent stays as long as its children; a node of the current frame never leaves.

use std::collections::HashMap;
use std::sync::Arc;

#[cfg(feature = "gpu")]
use crate::gpu::{Gpu, GpuError, WordArena, WordRange};
use crate::stream::{LoadedNode, Lru, SceneNode};

/// Position words, then colour words of one node.
#[derive(Debug)]
pub enum Words {
    /// In memory.
    Memory(Arc<LoadedNode>),
    /// On the device.
    #[cfg(feature = "gpu")]
    Device(WordRange),
}

/// One node that is ready.
#[derive(Debug)]
pub struct ReadyNode {
    /// Its words.
    pub words: Words,
    /// How many of them are positions.
    pub position_words: u32,
}

/// Where words go.
#[derive(Debug)]
pub enum Storage {
    /// Memory, for the CPU pass.
    Memory {
        /// Most bytes held.
        limit_bytes: u64,
    },
    /// Storage buffers of the device.
    #[cfg(feature = "gpu")]
    Device(WordArena),
}

/// A limit below which a cache does not shrink.
const SMALLEST_BYTES: u64 = 1 << 20;

/// All ready nodes.
#[derive(Debug)]
pub struct NodeCache {
    storage: Storage,
    nodes: HashMap<SceneNode, ReadyNode>,
    lru: Lru<SceneNode>,
    frame: u64,
    evicted: u32,
    #[cfg(feature = "gpu")]
    bytes_moved: u64,
}

impl NodeCache {
    /// An empty cache.
    pub fn new(storage: Storage) -> Self {
        let (nodes, lru) = (HashMap::new(), Lru::default());
        NodeCache {
            storage,
            nodes,
            lru,
            frame: 0,
            evicted: 0,
            #[cfg(feature = "gpu")]
            bytes_moved: 0,
        }
    }

    /// Starts a frame; nodes touched from here on stay until the next one.
    pub fn begin_frame(&mut self) {
        self.frame += 1;
        self.evicted = 0;
    }

    /// Whether a node is ready.
    pub fn contains(&self, node: SceneNode) -> bool {
        self.nodes.contains_key(&node)
    }

    /// A ready node.
    pub fn get(&self, node: SceneNode) -> Option<&ReadyNode> {
        self.nodes.get(&node)
    }

    /// Marks a node as used by this frame.
    pub fn touch(&mut self, node: SceneNode) {
        self.lru.touch(node, self.frame);
    }

    /// The storage, for binding.
    #[cfg(feature = "gpu")]
    pub fn storage(&self) -> &Storage {
        &self.storage
    }

    /// Bytes of all ready nodes.
    pub fn held_bytes(&self) -> u64 {
        self.lru.bytes()
    }

    /// Most bytes that ready nodes may have.
    pub fn limit_bytes(&self) -> u64 {
        match &self.storage {
            Storage::Memory { limit_bytes } => *limit_bytes,
            #[cfg(feature = "gpu")]
            Storage::Device(arena) => arena.limit_bytes(),
        }
    }

    /// Bytes of nodes, none larger than `largest_bytes`, that surely have room together: the
    /// limit, but for what the ends of several buffers may leave free.
    #[cfg_attr(not(feature = "gpu"), expect(unused_variables, reason = "memory has one piece"))]
    pub fn room_bytes(&self, largest_bytes: u64) -> u64 {
        match &self.storage {
            Storage::Memory { limit_bytes } => *limit_bytes,
            #[cfg(feature = "gpu")]
            Storage::Device(arena) => arena.room_bytes(largest_bytes),
        }
    }

    /// Bytes moved within the device so far.
    #[cfg(feature = "gpu")]
    pub fn bytes_moved(&self) -> u64 {
        self.bytes_moved
    }

    /// Nodes that had to leave in this frame.
    pub fn evicted(&self) -> u32 {
        self.evicted
    }

    /// Makes room for others: gives up about half of what is held, the limit included. `false` if
    /// there is next to nothing left to give.
    pub fn shrink(&mut self) -> bool {
        if self.limit_bytes() < SMALLEST_BYTES {
            return false;
        }
        match &mut self.storage {
            Storage::Memory { limit_bytes } => {
                *limit_bytes = (*limit_bytes / 2).min(self.lru.bytes().max(SMALLEST_BYTES));
                let limit_bytes = *limit_bytes;
                while self.held_bytes() > limit_bytes {
                    let Some(node) = self.lru.oldest_before(u64::MAX) else { break };
                    self.remove(node);
                    self.evicted += 1;
                }
                true
            }
            #[cfg(feature = "gpu")]
            Storage::Device(arena) => {
                let Some(last) = arena.last_shard() else { return false };
                let is_there = |ready: &ReadyNode| matches!(&ready.words, Words::Device(range) if range.shard == last);
                let gone: Vec<SceneNode> = self
                    .nodes
                    .iter()
                    .filter(|(_, ready)| is_there(ready))
                    .map(|(&node, _)| node)
                    .collect();
                self.evicted += gone.len() as u32;
                gone.into_iter().for_each(|node| self.remove(node));
                if let Storage::Device(arena) = &mut self.storage {
                    arena.give_up_shard();
                }
                true
            }
        }
    }

    /// Removes all nodes.
    pub fn clear(&mut self) {
        let all: Vec<_> = self.nodes.keys().copied().collect();
        all.into_iter().for_each(|node| self.remove(node));
    }

    /// Takes in the words of a node in memory; `false` if there is no room.
    pub fn insert_in_memory(
        &mut self,
        node: SceneNode,
        depth: u32,
        loaded: Arc<LoadedNode>,
    ) -> bool {
        #[cfg_attr(not(feature = "gpu"), expect(irrefutable_let_patterns, reason = "one variant"))]
        let Storage::Memory { limit_bytes } = self.storage else { return false };
        let bytes = loaded.bytes();
        while self.held_bytes() + bytes > limit_bytes {
            if !self.evict_one() {
                return false;
            }
        }
        let position_words = loaded.position_words;
        self.add(node, depth, ReadyNode { words: Words::Memory(loaded), position_words }, bytes);
        true
    }

    /// Copies the words of a node to the device; `false` if there is no room.
    #[cfg(feature = "gpu")]
    pub fn insert_on_device(
        &mut self,
        gpu: &Gpu,
        node: SceneNode,
        depth: u32,
        loaded: &LoadedNode,
    ) -> Result<bool, GpuError> {
        let count = loaded.words.len() as u32;
        loop {
            let Storage::Device(arena) = &mut self.storage else { return Ok(false) };
            if let Some(range) = arena.allocate(gpu, count)? {
                arena.write(gpu, range, 0, &loaded.words);
                let position_words = loaded.position_words;
                let ready = ReadyNode { words: Words::Device(range), position_words };
                self.add(node, depth, ready, loaded.bytes());
                return Ok(true);
            }
            if !self.evict_one() && !self.join_free_room(gpu, count)? {
                return Ok(false);
            }
        }
    }

    /// Moves what is in a buffer together, if that makes room for `count` words in one piece.
    #[cfg(feature = "gpu")]
    fn join_free_room(&mut self, gpu: &Gpu, count: u32) -> Result<bool, GpuError> {
        let Storage::Device(arena) = &mut self.storage else { return Ok(false) };
        let Some(shard) = arena.shard_with(count) else { return Ok(false) };
        let mut ranges: Vec<&mut WordRange> = self
            .nodes
            .values_mut()
            .filter_map(|ready| match &mut ready.words {
                Words::Device(range) if range.shard == shard => Some(range),
                _ => None,
            })
            .collect();
        match arena.pack(gpu, shard, &mut ranges) {
            Ok(bytes) => {
                self.bytes_moved += bytes;
                Ok(true)
            }
            // Not even for the piece that is moved at a time: everything stays where it is.
            Err(GpuError::OutOfMemory { .. }) => Ok(false),
            Err(error) => Err(error),
        }
    }

    fn add(&mut self, node: SceneNode, depth: u32, ready: ReadyNode, bytes: u64) {
        self.remove(node);
        self.lru.insert(node, bytes, depth, self.frame);
        self.nodes.insert(node, ready);
    }

    fn remove(&mut self, node: SceneNode) {
        let Some(ready) = self.nodes.remove(&node) else { return };
        self.lru.remove(node);
        #[cfg(feature = "gpu")]
        if let (Words::Device(range), Storage::Device(arena)) = (&ready.words, &mut self.storage) {
            arena.free(*range);
        }
        #[cfg(not(feature = "gpu"))]
        drop(ready);
    }

    /// Removes the node that is missed least; `false` if all are in use.
    fn evict_one(&mut self) -> bool {
        let Some(node) = self.lru.oldest_before(self.frame) else { return false };
        self.remove(node);
        self.evicted += 1;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::NodeId;

    #[test]
    fn the_longest_unused_and_deepest_leaves_first() {
        let mut cache = NodeCache::new(Storage::Memory { limit_bytes: 4 * 30 });
        let node = |id| (0, NodeId(id));
        let words = || Arc::new(LoadedNode { words: vec![0; 10], position_words: 8 });
        for (id, depth) in [(0, 0), (1, 1), (2, 1)] {
            assert!(cache.insert_in_memory(node(id), depth, words()));
        }
        cache.begin_frame();
        cache.touch(node(1));
        assert!(cache.insert_in_memory(node(3), 1, words()));
        assert!(!cache.contains(node(2)) && cache.contains(node(0)), "the deeper of two");
        assert!(cache.insert_in_memory(node(4), 1, words()));
        assert!(!cache.contains(node(0)));
        assert!(!cache.insert_in_memory(node(5), 1, words()), "all are in use");
        assert_eq!((cache.evicted(), cache.held_bytes()), (2, 120));
    }
}
