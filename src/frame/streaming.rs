//! A frame and the loader: what is wished for, what is taken in.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::frame::plan::takes;
use crate::frame::scene_reader::{SceneNodes, SceneReader};
use crate::frame::{ColorMode, FrameError, FrameSettings, Renderer};
use crate::geometry::View;
use crate::select::{CutScratch, CutSettings};
use crate::stream::{
    Loader, Motion, Residency, SceneNode, StreamSettings, StreamStats, StreamWhen, Wish,
};

/// What is read ahead is judged a little finer than what is drawn, so that it reaches beyond the
/// edge of the cut.
const AHEAD_ERROR: f64 = 0.75;
/// Part of the main memory for nodes that is used for what is read ahead.
const AHEAD_SHARE: u64 = 4;

/// Most nodes on a list; far more than come before the next one.
const MAX_WISHES: usize = 4096;

/// What lives as long as the renderer, for streaming.
pub(super) struct Streaming {
    pub(super) settings: StreamSettings,
    wake: Arc<dyn Fn() + Send + Sync>,
    loader: Option<Loader>,
    /// No thread could be started; frames read themselves.
    is_refused: bool,
    motion: Motion,
    began: Instant,
    frames: u32,
    scratch: CutScratch,
    ahead: Vec<SceneNode>,
    ahead_made_for: Option<(View, CutSettings, usize, u64)>,
}

impl Default for Streaming {
    fn default() -> Self {
        Streaming {
            settings: StreamSettings::default(),
            wake: Arc::new(|| {}),
            loader: None,
            is_refused: false,
            motion: Motion::default(),
            began: Instant::now(),
            frames: 0,
            scratch: CutScratch::default(),
            ahead: Vec::new(),
            ahead_made_for: None,
        }
    }
}

impl Streaming {
    /// Ends the loader, if there is one.
    pub(super) fn stop(&mut self) {
        self.loader = None;
    }

    /// Halves what is held in main memory.
    pub(super) fn shrink(&mut self) {
        self.settings.memory_bytes /= 2;
        if let Some(loader) = &mut self.loader {
            loader.shrink(self.settings.memory_bytes);
        }
    }

    /// Tells the loader that the scene, or its colours, are others.
    pub(super) fn set_reader(&mut self, reader: &Arc<SceneReader>) {
        self.ahead_made_for = None;
        if let Some(loader) = &mut self.loader {
            loader.set_reader(Arc::new(SceneNodes(reader.clone())));
        }
    }

    /// Time of this frame on the clock that motion is judged by.
    fn now(&mut self) -> Duration {
        self.frames = self.frames.saturating_add(1);
        match self.settings.frame_time {
            Some(frame_time) => frame_time.saturating_mul(self.frames),
            None => self.began.elapsed(),
        }
    }
}

impl Renderer {
    /// Says how nodes come through the loader; what it holds of the last settings is dropped.
    pub fn set_streaming(&mut self, settings: StreamSettings) {
        self.streaming.settings = settings;
        self.streaming.is_refused = false;
        self.streaming.stop();
        self.last = None;
    }

    /// Has `wake` called, from other threads, when a frame could show more than the last one.
    pub fn set_wake(&mut self, wake: Arc<dyn Fn() + Send + Sync>) {
        self.streaming.wake = wake;
        self.streaming.stop();
    }

    /// The loader; `None` while the scene needs none.
    pub fn loader(&self) -> Option<&Loader> {
        self.streaming.loader.as_ref()
    }

    /// Where a node is on its way to the picture.
    pub fn residency(&self, node: SceneNode) -> Residency {
        if self.cache.contains(node) {
            Residency::Resident
        } else if self.failed.contains(&node) {
            Residency::Failed
        } else {
            self.loader().map_or(Residency::Absent, |loader| loader.residency(node))
        }
    }

    /// Whether frames take their nodes from the loader.
    pub(super) fn streams(&self) -> bool {
        !self.streaming.is_refused
            && match self.streaming.settings.when {
                StreamWhen::Auto => {
                    self.scene_bytes > self.cache.room_bytes(self.largest_node_bytes)
                }
                StreamWhen::Always => !self.sources.is_empty(),
                StreamWhen::Never => false,
            }
    }

    /// Settles what nodes are coloured by; a new mode drops all loaded nodes.
    pub(super) fn settle_colors(&mut self, mode: &ColorMode) {
        if self.reader.as_ref().is_some_and(|reader| reader.mode() == mode) {
            return;
        }
        self.cache.clear();
        self.failed.clear();
        self.plan.invalidate();
        let former = self.former.take();
        let reader = Arc::new(SceneReader::new(self.sources.clone(), mode.clone(), former));
        self.streaming.set_reader(&reader);
        self.reader = Some(reader);
        self.has_noted_colors = false;
    }

    /// Notes what could not be read for the colours, once.
    pub(super) fn note_color_problems(&mut self) {
        let Some(reader) = self.reader.clone() else { return };
        if let Some(settled) = reader.settled()
            && !std::mem::replace(&mut self.has_noted_colors, true)
        {
            settled.problems.iter().for_each(|problem| self.note_problem(problem.clone()));
        }
    }

    /// Publishes what is missing and takes in what is there. Whether anything came or failed.
    pub(super) fn take_in(
        &mut self,
        view: &View,
        settings: &FrameSettings,
        quota_bytes: u64,
    ) -> Result<bool, FrameError> {
        if !self.has_loader() {
            return Ok(false);
        }
        let missing = self.missing();
        let ahead = self.list_ahead(view, settings, &missing);
        let wish =
            |(node, ahead): (SceneNode, bool)| Wish { node, size: self.node_size(node), ahead };
        let now = missing.into_iter().map(|node| (node, false));
        let all = now.chain(ahead.into_iter().map(|node| (node, true)));
        let wishes = all.take(MAX_WISHES).map(wish).collect();
        let (cache, failed) = (&self.cache, &self.failed);
        let mut going: HashSet<SceneNode> = HashSet::new();
        let sources = &self.sources;
        // A node never becomes ready before its parent.
        let may_go = |(cloud, node): SceneNode| {
            let parent = sources[cloud].octree().node(node).parent.map(|parent| (cloud, parent));
            let may = parent.is_none_or(|parent| {
                cache.contains(parent) || failed.contains(&parent) || going.contains(&parent)
            });
            if may {
                going.insert((cloud, node));
            }
            may
        };
        let loader = self.streaming.loader.as_mut().expect("it was just asked for");
        let exchange = loader.exchange(wishes, quota_bytes, may_go);
        let changed = !exchange.ready.is_empty() || !exchange.failed.is_empty();
        for (node, loaded) in exchange.ready {
            self.insert(node, loaded)?;
        }
        self.flush_uploads();
        let any_failed = !exchange.failed.is_empty();
        for (node, error) in exchange.failed {
            self.note_failure(node, error.to_string());
        }
        if any_failed {
            self.plan_and_touch(view, settings);
        }
        Ok(changed)
    }

    /// Starts the loader if there is none; `false` if the system gives no thread.
    fn has_loader(&mut self) -> bool {
        if self.streaming.loader.is_some() {
            return true;
        }
        let Some(reader) = self.reader.clone() else { return false };
        match Loader::start(self.streaming.settings, self.streaming.wake.clone()) {
            Ok(mut loader) => {
                loader.set_reader(Arc::new(SceneNodes(reader)));
                self.streaming.loader = Some(loader);
                true
            }
            Err(error) => {
                self.streaming.is_refused = true;
                self.note_problem(format!("no thread to load nodes: {error}"));
                false
            }
        }
    }

    /// What will be wanted where the camera is going, or next if it stands still; best first, none
    /// of it there or `missing` now, and no more than its share of the main memory.
    fn list_ahead(
        &mut self,
        view: &View,
        settings: &FrameSettings,
        missing: &[SceneNode],
    ) -> Vec<SceneNode> {
        let look_ahead = self.streaming.settings.look_ahead;
        if look_ahead.is_zero() {
            return Vec::new();
        }
        let now = self.streaming.now();
        self.streaming.motion.note(view, now);
        let there = self.streaming.motion.view_after(look_ahead).unwrap_or(*view);
        let mut cut = settings.cut;
        cut.error_px *= AHEAD_ERROR;
        cut.point_budget = cut.point_budget.saturating_add(cut.point_budget / 4);
        let made_for = (there, cut, self.failed.len(), self.concealment());
        if self.streaming.ahead_made_for != Some(made_for) {
            let mut scratch = std::mem::take(&mut self.streaming.scratch);
            let cuts = self.ideal_cuts(&there, &cut, &mut scratch);
            self.streaming.ahead = self.best_first(&cuts);
            cuts.into_iter().for_each(|cut| scratch.recycle(cut));
            self.streaming.scratch = scratch;
            self.streaming.ahead_made_for = Some(made_for);
        }
        let missing: HashSet<SceneNode> = missing.iter().copied().collect();
        let mut left_bytes = self.streaming.settings.memory_bytes / AHEAD_SHARE;
        let is_there = |node| self.cache.contains(node) || missing.contains(&node);
        let ahead = self.streaming.ahead.iter().copied().filter(|&node| !is_there(node));
        ahead.take_while(|&node| takes(&mut left_bytes, self.word_bytes(node))).collect()
    }

    /// What the loader did, for the statistics.
    pub(super) fn stream_stats(&mut self) -> Option<StreamStats> {
        self.streaming.loader.as_mut().map(Loader::stats)
    }
}
