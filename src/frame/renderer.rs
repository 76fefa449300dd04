//! One view of a scene: its frames, and what is kept between them.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::frame::appearance::Appearance;
#[cfg(feature = "gpu")]
use crate::frame::culling::SceneCulling;
use crate::frame::culling_view::Frozen;
use crate::frame::device::Device;
#[cfg(feature = "gpu")]
use crate::frame::device::{GpuPass, OnGpu};
use crate::frame::models::Models;
use crate::frame::node_cache::{NodeCache, Storage};
use crate::frame::pacing::Pacer;
use crate::frame::plan::Plan;
use crate::frame::scene_reader::{Former, SceneReader};
use crate::frame::settings::check_view;
use crate::frame::streaming::Streaming;
use crate::frame::{
    FrameError, FrameSettings, FrameStats, Loading, NodeSource, PassTime, RasterPath,
};
use crate::geometry::{Aabb, View};
#[cfg(feature = "gpu")]
use crate::gpu::{Gpu, PassTimer, WordArena, shader::PixelAtomics};
use crate::ids::NodeId;
use crate::passes::{DrawTable, Picture, PointsCpu, Tile};
#[cfg(feature = "gpu")]
use crate::passes::{EarlyOut, Finish, PointsCompute, PointsRaster, Ties};
use crate::select::{Cut, CutScratch, mean_spacing};
use crate::stream::SceneNode;

/// Draws a scene from changing views.
pub struct Renderer {
    pub(super) device: Device,
    pub(super) sources: Vec<Arc<dyn NodeSource>>,
    /// Only while there are models.
    pub(super) models: Option<Box<Models>>,
    /// Only while what is drawn stays as it was for another view.
    pub(super) frozen: Option<Box<Frozen>>,
    /// What occlusion culling knows; only while it is asked for.
    #[cfg(feature = "gpu")]
    pub(super) culling: Option<Box<SceneCulling>>,
    /// Bytes that all nodes of the scene have when they are ready.
    pub(super) scene_bytes: u64,
    /// The most that one of them has.
    pub(super) largest_node_bytes: u64,
    /// Reads nodes in the colours they have now.
    pub(super) reader: Option<Arc<SceneReader>>,
    pub(super) has_noted_colors: bool,
    /// How the scene was coloured that this one takes the place of.
    pub(super) former: Option<Former>,
    pub(super) cache: NodeCache,
    pub(super) plan: Plan,
    /// Nodes of the plan that found no room, because it is in pieces.
    pub(super) no_room: HashSet<SceneNode>,
    pub(super) streaming: Streaming,
    /// Bytes read up to the last frame.
    read_before: u64,
    pub(super) failed: HashSet<SceneNode>,
    pub(super) problems: Vec<String>,
    pub(super) scratch: CutScratch,
    pub(super) table: DrawTable,
    pub(super) appearance: Appearance,
    /// Smallest mean spacing of the points of a cloud of the scene; infinite without points.
    pub(super) mean_spacing: f64,
    pub(super) last: Option<(View, FrameSettings, bool)>,
    pub(super) stats: FrameStats,
    /// Budget of the last frame, which a target time may make smaller than the one asked for.
    pub(super) drawn_budget: u64,
    /// Only while frames have a target time.
    pub(super) pacer: Option<Box<Pacer>>,
}
/// Times that a frame is drawn until it shows all that came into sight.
const MOST_TRIES: u32 = 8;
/// Problems that are kept in words.
const MAX_PROBLEMS: usize = 8;

impl Renderer {
    /// A renderer without a device; it holds at most `limit_bytes` of points.
    pub fn on_cpu(limit_bytes: u64) -> Self {
        let device = Device::Cpu { pass: PointsCpu::default(), meshes: None, picture: None };
        Renderer::new(device, Storage::Memory { limit_bytes })
    }

    /// A renderer on a device; it holds at most `limit_bytes` of points there.
    #[cfg(feature = "gpu")]
    pub fn on_gpu(gpu: Arc<Gpu>, path: RasterPath, limit_bytes: u64) -> Result<Self, FrameError> {
        let compute = |atomics| -> Result<_, FrameError> {
            let pass = PointsCompute::new(&gpu, atomics, EarlyOut::Auto)?;
            Ok(GpuPass::Compute(Box::new(pass)))
        };
        let pass = match path {
            RasterPath::Compute => compute(gpu.wide_atomics())?,
            RasterPath::Compute32 => compute(PixelAtomics::Narrow)?,
            RasterPath::Raster => {
                GpuPass::Raster(Box::new(PointsRaster::new(&gpu, Ties::default())?))
            }
            RasterPath::Cpu => return Ok(Renderer::on_cpu(limit_bytes)),
        };
        Renderer::with_pass(gpu, pass, limit_bytes)
    }

    /// A renderer by 64-bit atomics whose points look first, or do not; to measure what that saves.
    #[cfg(feature = "gpu")]
    pub fn with_early_out(
        gpu: Arc<Gpu>,
        early_out: EarlyOut,
        limit_bytes: u64,
    ) -> Result<Self, FrameError> {
        let pass = PointsCompute::new(&gpu, gpu.wide_atomics(), early_out)?;
        Renderer::with_pass(gpu, GpuPass::Compute(Box::new(pass)), limit_bytes)
    }

    /// A renderer by a plain list of points, of which the first at a depth stays; to measure what
    /// the other ways are better and dearer by.
    #[cfg(feature = "gpu")]
    pub fn with_point_list(gpu: Arc<Gpu>, limit_bytes: u64) -> Result<Self, FrameError> {
        let pass = PointsRaster::new(&gpu, Ties::FirstDrawn)?;
        Renderer::with_pass(gpu, GpuPass::Raster(Box::new(pass)), limit_bytes)
    }

    #[cfg(feature = "gpu")]
    fn with_pass(gpu: Arc<Gpu>, pass: GpuPass, limit_bytes: u64) -> Result<Self, FrameError> {
        let timer = PassTimer::new(&gpu)?;
        let finish = Finish::new(&gpu)?;
        let storage = Storage::Device(WordArena::new(&gpu, limit_bytes));
        let device = Device::Gpu(Box::new(OnGpu {
            gpu,
            pass,
            timer,
            targets: None,
            finish,
            meshes: None,
            occlusion: None,
            two_pass: None,
            culled_depth: None,
            has_depth: false,
            shading_repeats: 1,
        }));
        Ok(Renderer::new(device, storage))
    }

    fn new(device: Device, storage: Storage) -> Self {
        Renderer {
            device,
            sources: Vec::new(),
            models: None,
            frozen: None,
            #[cfg(feature = "gpu")]
            culling: None,
            scene_bytes: 0,
            largest_node_bytes: 0,
            reader: None,
            has_noted_colors: false,
            former: None,
            cache: NodeCache::new(storage),
            plan: Plan::default(),
            no_room: HashSet::new(),
            streaming: Streaming::default(),
            read_before: 0,
            failed: HashSet::new(),
            problems: Vec::new(),
            scratch: CutScratch::default(),
            table: DrawTable::default(),
            appearance: Appearance::default(),
            mean_spacing: 0.0,
            last: None,
            stats: FrameStats::default(),
            drawn_budget: 0,
            pacer: None,
        }
    }

    /// How points are drawn.
    pub fn path(&self) -> RasterPath {
        match &self.device {
            Device::Cpu { .. } => RasterPath::Cpu,
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => match &on_gpu.pass {
                GpuPass::Compute(pass) if pass.atomics() == PixelAtomics::Narrow => {
                    RasterPath::Compute32
                }
                GpuPass::Compute(_) => RasterPath::Compute,
                GpuPass::Raster(_) => RasterPath::Raster,
            },
        }
    }

    /// Replaces the points of the scene; what was loaded of the old ones is dropped. Models stay.
    pub fn set_scene(&mut self, sources: Vec<Arc<dyn NodeSource>>) {
        self.thaw_culling();
        self.sources = sources;
        self.read_before = self.bytes_read();
        self.scene_bytes = self.all_node_bytes().sum();
        self.largest_node_bytes = self.all_node_bytes().max().unwrap_or(0);
        self.reader = None;
        self.former = None;
        #[cfg(feature = "gpu")]
        {
            self.culling = None;
        }
        self.plan.invalidate();
        self.no_room.clear();
        self.streaming.stop();
        self.failed.clear();
        self.problems.clear();
        self.cache.clear();
        self.appearance.clear();
        let spacings = self.sources.iter().map(|source| mean_spacing(source.octree()));
        self.mean_spacing = spacings.filter(|&spacing| spacing > 0.0).fold(f64::INFINITY, f64::min);
        self.last = None;
    }

    /// The time that nodes appear by from now on, instead of the clock's; for tests.
    pub fn pin_time(&mut self, time: Duration) {
        self.appearance.pinned = Some(time);
    }

    /// Replaces the scene by one that shows the same more exactly: where ranges of colours are
    /// nearly those that are shown, they stay as they are.
    pub fn replace_scene(&mut self, sources: Vec<Arc<dyn NodeSource>>) {
        let shown = self
            .reader
            .take()
            .and_then(|reader| Some((reader.mode().clone(), reader.settled()?.coloring.clone())));
        let former = shown.or(self.former.take());
        self.set_scene(sources);
        self.former = former;
    }

    /// The box of all points and models of the scene; empty without any.
    pub fn bounds(&self) -> Aabb {
        let boxes = self.sources.iter().map(|source| source.bounds());
        boxes.fold(self.model_bounds(), |all, bounds| all.union(&bounds))
    }

    /// Statistics of the last frame.
    pub fn stats(&self) -> &FrameStats {
        &self.stats
    }

    /// Draws a frame: the steps in order. The picture is then in [`color_view`](Self::color_view)
    /// or [`picture`](Self::picture). Nothing is drawn if the last frame still holds.
    ///
    /// The picture must fit one target; [`render_picture`](Self::render_picture) draws any size.
    pub fn render(
        &mut self,
        view: &View,
        settings: &FrameSettings,
    ) -> Result<&FrameStats, FrameError> {
        let start = Instant::now();
        check_view(view)?;
        if self.still_holds(view, settings) {
            self.stats = FrameStats {
                unchanged: true,
                complete: true,
                node_bytes: self.cache.held_bytes(),
                stream: self.stream_stats(),
                frame_ms: milliseconds(start),
                problems: self.problems.clone(),
                ..FrameStats::default()
            };
            self.collect_gpu_times();
            return Ok(&self.stats);
        }
        for _ in 0..MOST_TRIES {
            while let Err(error) = self.try_frame(view, settings) {
                self.shrink_for(error)?;
            }
            // What came into sight is read and drawn in this call, if all shall be.
            if settings.loading != Loading::All || self.nodes_missing() == 0 {
                break;
            }
        }
        self.stats.frame_ms = milliseconds(start);
        self.note_frame_for_rest(view, settings);
        let is_final = self.stats.complete && self.stats.nodes_appearing == 0;
        self.last = Some((*view, settings.clone(), is_final));
        Ok(&self.stats)
    }

    /// Has the next frame drawn even if the last one still holds: culling learns from it.
    pub fn draw_again(&mut self) {
        self.last = None;
    }

    /// Draws a picture of any size and brings it to memory, in parts if it is too large for one
    /// target. `distances` of the picture are empty, unless it is drawn on the CPU in one part.
    pub fn render_picture(
        &mut self,
        view: &View,
        settings: &FrameSettings,
    ) -> Result<Picture, FrameError> {
        let start = Instant::now();
        check_view(view)?;
        let picture = loop {
            self.last = None;
            match self.try_picture(view, settings) {
                Ok(picture) => break picture,
                Err(error) => self.shrink_for(error)?,
            }
        };
        self.collect_gpu_times();
        self.note_checked();
        self.stats.frame_ms = milliseconds(start);
        Ok(picture)
    }

    fn try_frame(&mut self, view: &View, settings: &FrameSettings) -> Result<(), FrameError> {
        self.begin_culling(view, settings);
        let paced = self.pace(view, settings, true)?;
        let drawing = Instant::now();
        if self.prepare(view, settings, paced.as_ref().unwrap_or(settings))? {
            self.draw(view, Tile::whole(view), settings)?;
            self.note_paced(drawing)?;
            self.stats.tiles = 1;
        } else {
            self.collect_gpu_times();
        }
        self.stats.complete =
            self.stats.nodes_requested == 0 && !self.is_held_back() && !self.is_culling_unsettled();
        Ok(())
    }

    fn try_picture(
        &mut self,
        view: &View,
        settings: &FrameSettings,
    ) -> Result<Picture, FrameError> {
        self.begin_culling(view, settings);
        let paced = self.pace(view, settings, false)?;
        let drawing = Instant::now();
        self.prepare(view, settings, paced.as_ref().unwrap_or(settings))?;
        let tiles = self.tiles(view, settings.finish.reach_px());
        self.stats.tiles = tiles.len() as u32;
        let mut whole = match tiles.len() {
            1 => None,
            _ => Some(Picture::colors_only(view.width_px, view.height_px, settings.background)),
        };
        let mut only = None;
        for tile in tiles {
            // What is done to pixels by what is around them needs that too.
            let drawn = settings.finish.widened(tile, view.width_px, view.height_px);
            self.draw(view, drawn, settings)?;
            if self.stats.tiles == 1 {
                self.note_paced(drawing)?;
            }
            let reading = Instant::now();
            let part = self.take_picture()?;
            self.note_cpu_time("read_back", reading);
            match &mut whole {
                Some(whole) => whole.paste_part(&part, drawn, tile),
                None => only = Some(part),
            }
        }
        Ok(whole.or(only).expect("a view has at least one tile"))
    }

    /// After an error for want of memory: makes the caches smaller, so that the frame can be tried
    /// again. Any other error comes back, and this one too when there is nothing left to give.
    fn shrink_for(&mut self, error: FrameError) -> Result<(), FrameError> {
        match error.is_out_of_memory() && self.shrink_caches() {
            true => Ok(()),
            false => Err(error),
        }
    }

    /// Gives up about half of the memory for nodes, on the device and beside it, for good; `false`
    /// if there is next to nothing left to give.
    pub fn shrink_caches(&mut self) -> bool {
        let gives = self.cache.shrink();
        self.streaming.shrink();
        self.plan.invalidate();
        self.last = None;
        if gives {
            let limit_bytes = self.cache.limit_bytes();
            self.note_problem(format!(
                "memory ran out: no more than {:.1} MiB of points are held from now on",
                limit_bytes as f64 / f64::from(1 << 20)
            ));
        }
        gives
    }

    /// The steps before drawing: loading, selection, table. Whether there is anything to draw that
    /// the last frame does not show.
    ///
    /// `asked` is what the caller wants; `settings` may have smaller budgets, to keep to a time.
    pub(super) fn prepare(
        &mut self,
        view: &View,
        asked: &FrameSettings,
        settings: &FrameSettings,
    ) -> Result<bool, FrameError> {
        self.stats = FrameStats::default();
        self.cache.begin_frame();
        let chosen = self.frozen_view().copied().unwrap_or(*view);
        let unfinished = self.is_held_back() || self.is_culling_unsettled();
        let changed = self.load(&chosen, settings)? || unfinished;
        let budget = settings.cut.point_budget;
        let is_other = std::mem::replace(&mut self.drawn_budget, budget) != budget
            || !matches!(&self.last, Some((last_view, last_settings, _))
                if last_view == view && last_settings == asked);
        if changed || is_other {
            let cuts = self.select_loaded(&chosen, settings);
            self.predict(&cuts, view, settings);
            self.fill_table(&cuts, view, settings);
            #[cfg(feature = "gpu")]
            match self.culling.as_ref().is_some_and(|culling| culling.has_points) {
                true => self.choose_nodes(&cuts, view, settings),
                false => self.add_alternative(view, settings),
            }
            self.choose_objects(view, settings);
            self.note_cuts(&cuts);
            self.note_held_back(asked, settings);
            cuts.into_iter().for_each(|cut| self.scratch.recycle(cut));
        } else {
            self.stats.unchanged = true;
        }
        self.stats.nodes_failed = self.failed.len() as u32;
        self.stats.nodes_evicted = self.cache.evicted();
        self.stats.node_bytes = self.cache.held_bytes();
        let bytes_read = self.bytes_read();
        self.stats.bytes_read = bytes_read - self.read_before;
        self.read_before = bytes_read;
        self.stats.stream = self.stream_stats();
        self.stats.problems = self.problems.clone();
        self.stats.complete = self.stats.nodes_requested == 0;
        Ok(changed || is_other)
    }

    fn note_cuts(&mut self, cuts: &[Cut]) {
        self.stats.points_drawn = self.table.points;
        self.stats.splat_pixels = self.table.splat_pixels;
        self.stats.point_bytes = self.table.point_bytes;
        self.stats.nodes_drawn = self.table.draws.iter().filter(|d| !d.concealed).count() as u32;
        let counters = || cuts.iter().map(|cut| &cut.counters);
        self.stats.queue_pops = counters().map(|c| c.queue_pops).sum();
        self.stats.nodes_culled = counters().map(|c| c.nodes_culled).sum();
        self.stats.nodes_fine_enough = counters().map(|c| c.nodes_fine_enough).sum();
        self.stats.nodes_over_budget = counters().map(|c| c.nodes_over_budget).sum();
        self.stats.nodes_hidden = counters().map(|c| c.nodes_concealed).sum();
        self.stats.points_hidden = counters().map(|c| c.points_concealed).sum();
        #[cfg(feature = "gpu")]
        if let Some(culling) = &mut self.culling {
            culling.budget_binds = self.stats.nodes_over_budget > 0;
        }
    }

    /// Bytes that each node of the scene has when it is ready.
    fn all_node_bytes(&self) -> impl Iterator<Item = u64> {
        let nodes = self.sources.iter().enumerate().flat_map(|(cloud, source)| {
            let count = source.octree().nodes().len() as u32;
            (0..count).map(move |node| (cloud, NodeId(node)))
        });
        nodes.map(|node| self.word_bytes(node))
    }

    fn still_holds(&self, view: &View, settings: &FrameSettings) -> bool {
        matches!(&self.last, Some((last_view, last_settings, true))
            if last_view == view && last_settings == settings)
    }

    fn bytes_read(&self) -> u64 {
        self.sources.iter().map(|source| source.bytes_read()).sum()
    }

    pub(super) fn note_problem(&mut self, problem: String) {
        if self.problems.len() < MAX_PROBLEMS {
            self.problems.push(problem);
        }
    }

    pub(super) fn note_cpu_time(&mut self, pass: &'static str, start: Instant) {
        self.note_time(pass, milliseconds(start));
    }

    pub(super) fn note_time(&mut self, pass: &'static str, pass_ms: f64) {
        self.add_time(PassTime { pass, clock: "cpu", pass_ms });
    }

    /// What was noted of a step on the CPU so far.
    pub(super) fn noted_ms(&self, pass: &'static str) -> f64 {
        let noted =
            self.stats.passes.iter().filter(|time| (time.pass, time.clock) == (pass, "cpu"));
        noted.map(|time| time.pass_ms).sum()
    }

    fn add_time(&mut self, time: PassTime) {
        let same = |known: &&mut PassTime| known.pass == time.pass && known.clock == time.clock;
        match self.stats.passes.iter_mut().find(same) {
            Some(known) => known.pass_ms += time.pass_ms,
            None => self.stats.passes.push(time),
        }
    }

    fn collect_gpu_times(&mut self) {
        #[cfg(feature = "gpu")]
        if let Device::Gpu(on_gpu) = &mut self.device {
            let times = on_gpu.timer.collect().clone();
            self.note_gpu_times(&times);
        }
    }

    #[cfg(feature = "gpu")]
    pub(super) fn note_gpu_times(&mut self, times: &[(&'static str, f64)]) {
        self.stats.passes.retain(|time| time.clock != "gpu");
        for &(pass, pass_ms) in times {
            self.stats.passes.push(PassTime { pass, clock: "gpu", pass_ms });
        }
    }
}

/// Time since then.
pub(super) fn milliseconds(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::geometry::Camera;

    #[test]
    fn numbers_that_are_not_finite_are_refused() {
        let camera =
            Camera::looking_at(DVec3::new(f64::NAN, 0.0, 0.0), DVec3::X, DVec3::Z, 1.0, 0.1);
        let view = View { camera, width_px: 4, height_px: 4 };
        let mut renderer = Renderer::on_cpu(1 << 20);
        let error = renderer.render(&view, &FrameSettings::default());
        assert!(matches!(error, Err(FrameError::View { .. })));
    }
}
