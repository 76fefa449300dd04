//! Loading what a view wants: choose, read, make ready.

use std::collections::HashSet;
use std::time::Instant;

use rayon::prelude::*;

use crate::frame::device::Device;
use crate::frame::node_cache::SceneNode;
use crate::frame::renderer::milliseconds;
use crate::frame::{FrameError, FrameSettings, Loading, Renderer};
use crate::geometry::View;
use crate::gpu::layout::position_words;
use crate::ids::NodeId;
use crate::select::{Availability, Cut, Residency, select_scene};

/// Bytes of nodes read at a time, so that what waits for its upload stays bounded.
const READ_AHEAD_BYTES: u64 = 64 << 20;

impl Renderer {
    /// Chooses what to draw and loads what is missing, until nothing more can or may be loaded.
    pub(super) fn select_and_load(
        &mut self,
        view: &View,
        settings: &FrameSettings,
    ) -> Result<Vec<Cut>, FrameError> {
        let (mut select_ms, mut load_ms) = (0.0, 0.0);
        let mut left_bytes = match settings.loading {
            Loading::All => u64::MAX,
            Loading::Quota { bytes } => bytes,
        };
        let mut without_room: HashSet<SceneNode> = HashSet::new();
        let cuts = loop {
            let start = Instant::now();
            let cuts = self.select(view, settings, &without_room);
            select_ms += milliseconds(start);
            let start = Instant::now();
            for (cloud, cut) in cuts.iter().enumerate() {
                cut.draw.iter().for_each(|drawn| self.cache.touch((cloud, drawn.node)));
            }
            let wanted = self.wanted(&cuts, settings.loading, &without_room);
            if wanted.is_empty() || left_bytes == 0 {
                break cuts;
            }
            let (loaded_bytes, failed) = self.load(&wanted, left_bytes, &mut without_room)?;
            left_bytes = left_bytes.saturating_sub(loaded_bytes);
            load_ms += milliseconds(start);
            let all_drawn_are_there = failed == 0 && without_room.is_empty();
            if settings.loading == Loading::All && all_drawn_are_there {
                break cuts;
            }
            cuts.into_iter().for_each(|cut| self.scratch.recycle(cut));
        };
        self.stats.nodes_without_room = without_room.len() as u32;
        self.note_time("select", select_ms);
        self.note_time("load", load_ms);
        Ok(cuts)
    }

    fn select(
        &mut self,
        view: &View,
        settings: &FrameSettings,
        without_room: &HashSet<SceneNode>,
    ) -> Vec<Cut> {
        let (cache, failed, loading) = (&self.cache, &self.failed, settings.loading);
        let answers: Vec<_> = (0..self.sources.len())
            .map(|cloud| {
                move |node: NodeId| {
                    let node = (cloud, node);
                    // With everything loaded in this call, what has room counts as there.
                    let will_be = || loading == Loading::All && !without_room.contains(&node);
                    if failed.contains(&node) {
                        Availability::Failed
                    } else if cache.contains(node) || will_be() {
                        Availability::Resident
                    } else {
                        Availability::Absent
                    }
                }
            })
            .collect();
        let scene: Vec<_> = self
            .sources
            .iter()
            .zip(&answers)
            .map(|(source, answer)| (source.octree(), answer as &dyn Residency))
            .collect();
        select_scene(&scene, view, &settings.cut, &mut self.scratch)
    }

    /// Nodes to load for these cuts, most wanted first.
    fn wanted(
        &self,
        cuts: &[Cut],
        loading: Loading,
        without_room: &HashSet<SceneNode>,
    ) -> Vec<SceneNode> {
        let mut wanted = Vec::new();
        for (cloud, cut) in cuts.iter().enumerate() {
            match loading {
                Loading::All => {
                    let missing = cut.draw.iter().map(|drawn| (f64::INFINITY, (cloud, drawn.node)));
                    wanted.extend(missing.filter(|&(_, node)| !self.cache.contains(node)));
                }
                Loading::Quota { .. } => {
                    let asked = cut.requests.iter().map(|r| (r.priority_px, (cloud, r.node)));
                    wanted.extend(asked.filter(|(_, node)| !without_room.contains(node)));
                }
            }
        }
        wanted.sort_by(|a, b| b.0.total_cmp(&a.0));
        wanted.into_iter().map(|(_, node)| node).collect()
    }

    /// Reads nodes in parallel and makes them ready, in order, until `quota_bytes` are used up.
    /// Returns the bytes and the number of nodes that could not be read.
    fn load(
        &mut self,
        wanted: &[SceneNode],
        quota_bytes: u64,
        without_room: &mut HashSet<SceneNode>,
    ) -> Result<(u64, usize), FrameError> {
        let (mut loaded_bytes, mut failed) = (0, 0);
        // What has no room is not even read.
        let mut room_bytes = self.cache.room_bytes();
        let mut fitting = Vec::with_capacity(wanted.len());
        for &node in wanted {
            match room_bytes.checked_sub(self.node_bytes(node)) {
                Some(left_bytes) => {
                    room_bytes = left_bytes;
                    fitting.push(node);
                }
                None => {
                    without_room.insert(node);
                }
            }
        }
        let mut rest = &fitting[..];
        while !rest.is_empty() && loaded_bytes < quota_bytes {
            let most_bytes = READ_AHEAD_BYTES.min(quota_bytes - loaded_bytes);
            let count = self.leading_nodes(rest, most_bytes);
            let (now, later) = rest.split_at(count);
            rest = later;
            let read: Vec<_> = now.par_iter().map(|&node| self.read_node(node)).collect();
            for (&node, words) in now.iter().zip(read) {
                match words {
                    Ok((words, position_words)) => {
                        let bytes = 4 * words.len() as u64;
                        loaded_bytes += bytes;
                        if self.insert(node, words, position_words)? {
                            self.stats.nodes_loaded += 1;
                        } else {
                            without_room.insert(node);
                        }
                    }
                    Err(error) => {
                        failed += 1;
                        self.failed.insert(node);
                        self.note_problem(error.to_string());
                    }
                }
            }
            self.flush_uploads();
        }
        Ok((loaded_bytes, failed))
    }

    /// How many leading nodes have at most that many bytes together; at least one.
    fn leading_nodes(&self, nodes: &[SceneNode], most_bytes: u64) -> usize {
        let mut sum_bytes = 0;
        let fitting = nodes.iter().take_while(|&&node| {
            sum_bytes += self.node_bytes(node);
            sum_bytes <= most_bytes
        });
        fitting.count().max(1)
    }

    /// Bytes of a node's words.
    fn node_bytes(&self, (cloud, node): SceneNode) -> u64 {
        let octree = self.sources[cloud].octree();
        let words = position_words(octree.local_bits(node)) + 1;
        4 * u64::from(words) * u64::from(octree.node(node).point_count())
    }

    /// The words of a node, positions first, and how many are positions.
    fn read_node(
        &self,
        (cloud, node): SceneNode,
    ) -> Result<(Vec<u32>, u32), crate::store::NodeReadError> {
        let source = self.sources[cloud].as_ref();
        let mut positions = Vec::new();
        source.read_positions(node, &mut positions)?;
        let position_words = positions.len();
        let mut words = Vec::with_capacity(position_words / 2 * 3);
        words.extend_from_slice(&positions);
        let coloring = &self.coloring[cloud];
        coloring.append_colors(source, node, &positions, &mut words, &mut Vec::new())?;
        Ok((words, position_words as u32))
    }

    fn insert(
        &mut self,
        node: SceneNode,
        words: Vec<u32>,
        position_words: u32,
    ) -> Result<bool, FrameError> {
        let depth = self.sources[node.0].octree().node(node.1).depth;
        match &self.device {
            Device::Cpu { .. } => {
                Ok(self.cache.insert_in_memory(node, depth, words, position_words))
            }
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => {
                let gpu = &on_gpu.gpu;
                let fits = self.cache.insert_on_device(gpu, node, depth, &words, position_words)?;
                if fits {
                    self.stats.bytes_uploaded += 4 * words.len() as u64;
                }
                Ok(fits)
            }
        }
    }

    /// Sends what was written so far, so that copies in waiting do not pile up.
    fn flush_uploads(&self) {
        #[cfg(feature = "gpu")]
        if let Device::Gpu(on_gpu) = &self.device {
            on_gpu.gpu.queue().submit([]);
        }
    }
}
