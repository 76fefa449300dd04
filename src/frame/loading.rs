//! Loading what a view wants: in this call, or through the loader.
//!
//! A picture on its own reads all it wants and waits for it. A window takes a share per frame: if
//! the scene fits the room for it, it reads that share itself and no thread is started; if not,
//! the loader reads and the frame takes what is there.

use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;

use crate::frame::device::Device;
use crate::frame::renderer::milliseconds;
use crate::frame::{FrameError, FrameSettings, Loading, Renderer};
use crate::geometry::View;
use crate::select::Cut;
use crate::stream::{LoadedNode, SceneNode, read_with_retries};

/// Bytes of nodes read at a time, so that what waits for its upload stays bounded.
const READ_AHEAD_BYTES: u64 = 64 << 20;

impl Renderer {
    /// Brings in what the view wants, as far as the settings allow in this frame. Whether anything
    /// that is drawn may have changed by it.
    pub(super) fn load(
        &mut self,
        view: &View,
        settings: &FrameSettings,
    ) -> Result<bool, FrameError> {
        let start = Instant::now();
        self.settle_colors(&settings.color);
        let mut changed = self.plan_and_touch(view, settings);
        let mut left_bytes = match settings.loading {
            Loading::All => u64::MAX,
            Loading::Quota { bytes } => bytes.max(1),
        };
        if settings.loading != Loading::All && self.streams() {
            changed |= self.take_in(view, settings, left_bytes)?;
        } else {
            if !self.streams() {
                self.streaming.stop();
            }
            // Again only for what stands in for nodes that cannot be read.
            let is_first = settings.loading != Loading::All && self.cache.held_bytes() == 0;
            while left_bytes > 0 {
                let mut missing = self.missing();
                if missing.is_empty() {
                    break;
                }
                if is_first {
                    self.keep_what_is_at_hand(&mut missing);
                }
                let loaded_bytes = self.read_now(&missing, left_bytes)?;
                left_bytes = left_bytes.saturating_sub(loaded_bytes);
                changed = true;
                if !self.plan_and_touch(view, settings) && settings.loading != Loading::All {
                    break;
                }
            }
        }
        self.note_color_problems();
        self.stats.nodes_requested = self.missing().len() as u32;
        self.stats.nodes_without_room = self.plan.beyond + self.no_room.len() as u32;
        let planning_ms = self.noted_ms("select");
        self.note_time("load", milliseconds(start) - planning_ms);
        Ok(changed)
    }

    /// Leaves what needs no disk, if there is any: the first picture of a scene does not wait for
    /// more.
    fn keep_what_is_at_hand(&self, missing: &mut Vec<SceneNode>) {
        if let Some(reader) = &self.reader
            && missing.first().is_some_and(|&node| reader.is_at_hand(node))
        {
            missing.retain(|&node| reader.is_at_hand(node));
        }
    }

    /// What is drawn of what is there.
    pub(super) fn select_loaded(&mut self, view: &View, settings: &FrameSettings) -> Vec<Cut> {
        let start = Instant::now();
        let mut scratch = std::mem::take(&mut self.scratch);
        let is_whole = self.stats.nodes_requested == 0 && self.stats.nodes_without_room == 0;
        let cuts = if is_whole {
            // The plan is the picture; it is made again if somebody needs it again.
            self.plan.invalidate();
            std::mem::take(&mut self.plan.cuts)
        } else {
            self.select(view, &settings.cut, &mut scratch, |node| self.availability(node))
        };
        self.scratch = scratch;
        for (cloud, cut) in cuts.iter().enumerate() {
            cut.shown().for_each(|drawn| self.cache.touch((cloud, drawn.node)));
        }
        self.note_time("select", milliseconds(start));
        cuts
    }

    /// Makes the plan fit the view, and keeps what it wants from leaving. Whether it is new.
    pub(super) fn plan_and_touch(&mut self, view: &View, settings: &FrameSettings) -> bool {
        let start = Instant::now();
        let is_new = self.update_plan(view, &settings.cut);
        self.note_time("select", milliseconds(start));
        if is_new {
            self.no_room.clear();
        }
        for &node in &self.plan.wanted {
            self.cache.touch(node);
        }
        is_new
    }

    /// What is wanted, has room and is not there, best first.
    pub(super) fn missing(&mut self) -> Vec<SceneNode> {
        let mut missing = Vec::new();
        for &node in &self.plan.wanted {
            if self.cache.contains(node) || self.no_room.contains(&node) {
                continue;
            }
            // Below what found no room there is none either: a node never stays without its
            // parent.
            if self.parent(node).is_some_and(|parent| self.no_room.contains(&parent)) {
                self.no_room.insert(node);
            } else {
                missing.push(node);
            }
        }
        missing
    }

    /// Reads nodes in parallel in this call and makes them ready, in order, until `quota_bytes`
    /// are used up, but at least one. Returns the bytes.
    fn read_now(&mut self, missing: &[SceneNode], quota_bytes: u64) -> Result<u64, FrameError> {
        let Some(reader) = self.reader.clone() else { return Ok(0) };
        let mut loaded_bytes = 0;
        let mut rest = missing;
        while !rest.is_empty() && loaded_bytes < quota_bytes {
            let most_bytes = READ_AHEAD_BYTES.min(quota_bytes - loaded_bytes);
            let (now, later) = rest.split_at(self.leading_nodes(rest, most_bytes));
            rest = later;
            let read = |&node: &SceneNode| read_with_retries(|| reader.read(node));
            let read: Vec<_> = now.par_iter().map(read).collect();
            self.stats.nodes_waited_for += now.len() as u32;
            for (&node, (loaded, retries)) in now.iter().zip(read) {
                self.stats.reads_retried += retries;
                match loaded {
                    Ok(loaded) => {
                        loaded_bytes += loaded.bytes();
                        self.insert(node, Arc::new(loaded))?;
                    }
                    Err(error) => self.note_failure(node, error.to_string()),
                }
            }
            self.flush_uploads();
        }
        Ok(loaded_bytes)
    }

    /// Makes a node ready; one that finds no room is not asked for again in this view.
    pub(super) fn insert(
        &mut self,
        node: SceneNode,
        loaded: Arc<LoadedNode>,
    ) -> Result<(), FrameError> {
        let depth = self.sources[node.0].octree().node(node.1).depth;
        let bytes = loaded.bytes();
        let fits = match &self.device {
            Device::Cpu { .. } => self.cache.insert_in_memory(node, depth, loaded),
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => {
                let moved_before = self.cache.bytes_moved();
                let fits = self.cache.insert_on_device(&on_gpu.gpu, node, depth, &loaded)?;
                self.stats.bytes_moved += self.cache.bytes_moved() - moved_before;
                fits
            }
        };
        if fits {
            self.stats.nodes_loaded += 1;
            if !matches!(self.device, Device::Cpu { .. }) {
                self.stats.bytes_uploaded += bytes;
            }
        } else {
            self.no_room.insert(node);
        }
        Ok(())
    }

    /// Notes a node that cannot be read.
    pub(super) fn note_failure(&mut self, node: SceneNode, reason: String) {
        self.failed.insert(node);
        self.note_problem(format!("{reason}; coarser points stand in"));
    }

    /// How many leading nodes have at most that many bytes together; at least one.
    fn leading_nodes(&self, nodes: &[SceneNode], most_bytes: u64) -> usize {
        let mut sum_bytes = 0;
        let fitting = nodes.iter().take_while(|&&node| {
            sum_bytes += self.word_bytes(node);
            sum_bytes <= most_bytes
        });
        fitting.count().max(1)
    }

    /// Sends what was written so far, so that copies in waiting do not pile up.
    pub(super) fn flush_uploads(&self) {
        #[cfg(feature = "gpu")]
        if let Device::Gpu(on_gpu) = &self.device {
            on_gpu.gpu.queue().submit([]);
        }
    }
}
