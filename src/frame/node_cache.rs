//! The nodes that are ready to be drawn: their words, on the device or in memory, within a limit.
//!
//! When room is needed, nodes leave that were drawn longest ago, deeper ones first, so that a
//! parent stays as long as its children; a node of the current frame never leaves.

use std::cmp::Reverse;
use std::collections::HashMap;

#[cfg(feature = "gpu")]
use crate::gpu::{Gpu, GpuError, WordArena, WordRange};
use crate::ids::NodeId;

/// A node of a scene: which cloud, which node.
pub type SceneNode = (usize, NodeId);

/// Position words, then colour words of one node.
#[derive(Debug)]
pub enum Words {
    /// In memory.
    Memory(Vec<u32>),
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
    count: u32,
    depth: u32,
    last_frame: u64,
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

/// All ready nodes.
#[derive(Debug)]
pub struct NodeCache {
    storage: Storage,
    nodes: HashMap<SceneNode, ReadyNode>,
    held_words: u64,
    frame: u64,
    evicted: u32,
}

impl NodeCache {
    /// An empty cache.
    pub fn new(storage: Storage) -> Self {
        NodeCache { storage, nodes: HashMap::new(), held_words: 0, frame: 0, evicted: 0 }
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
        if let Some(ready) = self.nodes.get_mut(&node) {
            ready.last_frame = self.frame;
        }
    }

    /// The storage, for binding.
    #[cfg(feature = "gpu")]
    pub fn storage(&self) -> &Storage {
        &self.storage
    }

    /// Bytes of all ready nodes.
    pub fn held_bytes(&self) -> u64 {
        4 * self.held_words
    }

    /// Nodes that had to leave in this frame.
    pub fn evicted(&self) -> u32 {
        self.evicted
    }

    /// Bytes that nodes could still take, if all that this frame does not use left.
    pub fn room_bytes(&self) -> u64 {
        let in_use = self.nodes.values().filter(|ready| ready.last_frame == self.frame);
        let used_bytes: u64 = in_use.map(|ready| 4 * u64::from(ready.count)).sum();
        let limit_bytes = match &self.storage {
            Storage::Memory { limit_bytes } => *limit_bytes,
            #[cfg(feature = "gpu")]
            Storage::Device(arena) => arena.limit_bytes(),
        };
        limit_bytes.saturating_sub(used_bytes)
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
        words: Vec<u32>,
        position_words: u32,
    ) -> bool {
        #[cfg_attr(not(feature = "gpu"), expect(irrefutable_let_patterns, reason = "one variant"))]
        let Storage::Memory { limit_bytes } = self.storage else { return false };
        let count = words.len() as u32;
        while self.held_bytes() + 4 * u64::from(count) > limit_bytes {
            if !self.evict_one() {
                return false;
            }
        }
        self.add(node, depth, Words::Memory(words), position_words, count);
        true
    }

    /// Copies the words of a node to the device; `false` if there is no room.
    #[cfg(feature = "gpu")]
    pub fn insert_on_device(
        &mut self,
        gpu: &Gpu,
        node: SceneNode,
        depth: u32,
        words: &[u32],
        position_words: u32,
    ) -> Result<bool, GpuError> {
        let count = words.len() as u32;
        loop {
            let Storage::Device(arena) = &mut self.storage else { return Ok(false) };
            if let Some(range) = arena.allocate(gpu, count)? {
                arena.write(gpu, range, 0, words);
                self.add(node, depth, Words::Device(range), position_words, count);
                return Ok(true);
            }
            if !self.evict_one() {
                return Ok(false);
            }
        }
    }

    fn add(&mut self, node: SceneNode, depth: u32, words: Words, position_words: u32, count: u32) {
        self.remove(node);
        self.held_words += u64::from(count);
        let last_frame = self.frame;
        self.nodes.insert(node, ReadyNode { words, position_words, count, depth, last_frame });
    }

    fn remove(&mut self, node: SceneNode) {
        let Some(ready) = self.nodes.remove(&node) else { return };
        self.held_words -= u64::from(ready.count);
        #[cfg(feature = "gpu")]
        if let (Words::Device(range), Storage::Device(arena)) = (&ready.words, &mut self.storage) {
            arena.free(*range);
        }
    }

    /// Removes the node that is missed least; `false` if all are in use.
    fn evict_one(&mut self) -> bool {
        let idle = self.nodes.iter().filter(|(_, ready)| ready.last_frame < self.frame);
        let oldest =
            idle.min_by_key(|&(&node, ready)| (ready.last_frame, Reverse(ready.depth), node));
        let Some(node) = oldest.map(|(&node, _)| node) else { return false };
        self.remove(node);
        self.evicted += 1;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_unused_and_deepest_leaves_first() {
        let mut cache = NodeCache::new(Storage::Memory { limit_bytes: 4 * 30 });
        let node = |id| (0, NodeId(id));
        for (id, depth) in [(0, 0), (1, 1), (2, 1)] {
            assert!(cache.insert_in_memory(node(id), depth, vec![0; 10], 8));
        }
        cache.begin_frame();
        cache.touch(node(1));
        assert!(cache.insert_in_memory(node(3), 1, vec![0; 10], 8));
        assert!(!cache.contains(node(2)) && cache.contains(node(0)), "the deeper of two");
        assert!(cache.insert_in_memory(node(4), 1, vec![0; 10], 8));
        assert!(!cache.contains(node(0)));
        assert!(!cache.insert_in_memory(node(5), 1, vec![0; 10], 8), "all are in use");
        assert_eq!((cache.evicted(), cache.held_bytes()), (2, 120));
    }
}
