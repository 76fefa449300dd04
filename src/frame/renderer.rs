//! One view of a scene: its frames, and what is kept between them.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;
use rayon::prelude::*;

use crate::frame::color::{Coloring, elevation_range, shows_elevation};
use crate::frame::node_cache::{NodeCache, SceneNode, Storage, Words};
use crate::frame::{ColorMode, FrameStats, NodeSource, PassTime};
use crate::geometry::{Aabb, View};
use crate::gpu::layout::position_words;
#[cfg(feature = "gpu")]
use crate::gpu::{Gpu, GpuError, PassTimer, WordArena};
use crate::ids::NodeId;
use crate::passes::{CloudDraw, DrawTable, NodePlace, NodeWords, Picture, PointsCpu, Tile};
#[cfg(feature = "gpu")]
use crate::passes::{DrawCounts, PointDrawing, PointsCompute, PointsRaster, Targets};
use crate::select::{Availability, Cut, CutScratch, CutSettings, Residency, select_scene};

/// Why a frame was not drawn.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FrameError {
    /// The view cannot be drawn.
    #[error("the view cannot be drawn: {reason}")]
    View {
        /// What is wrong with it.
        reason: String,
    },
    /// The device failed.
    #[cfg(feature = "gpu")]
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

/// How points are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RasterPath {
    /// Compute shaders with 64-bit atomics.
    Compute,
    /// The rasterizer.
    Raster,
    /// All cores of the CPU.
    Cpu,
}

impl RasterPath {
    /// The path in one word, for options and reports.
    pub fn name(self) -> &'static str {
        match self {
            RasterPath::Compute => "compute",
            RasterPath::Raster => "raster",
            RasterPath::Cpu => "cpu",
        }
    }
}

/// How much a frame loads before it draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loading {
    /// Everything that the view wants.
    All,
    /// Nodes up to about that many bytes; until all is there parents are drawn instead.
    Quota {
        /// Bytes of words per frame; at least one node is loaded.
        bytes: u64,
    },
}

/// What a frame shall be.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameSettings {
    /// What may be drawn and how exact it shall be.
    pub cut: CutSettings,
    /// What points are coloured by.
    pub color: ColorMode,
    /// RGBA8 word of pixels without a point. Default: a dark grey.
    pub background: u32,
    /// How much is loaded before drawing. Default: all.
    pub loading: Loading,
}

impl Default for FrameSettings {
    fn default() -> Self {
        FrameSettings {
            cut: CutSettings::default(),
            color: ColorMode::default(),
            background: 0xff20_1c1a,
            loading: Loading::All,
        }
    }
}

/// Draws a scene from changing views.
pub struct Renderer {
    device: Device,
    sources: Vec<Arc<dyn NodeSource>>,
    coloring: Vec<Coloring>,
    colored_by: Option<ColorMode>,
    /// How the scene was coloured that this one takes the place of.
    former: Option<(ColorMode, Vec<Coloring>)>,
    cache: NodeCache,
    failed: HashSet<SceneNode>,
    problems: Vec<String>,
    scratch: CutScratch,
    table: DrawTable,
    last: Option<(View, FrameSettings, bool)>,
    stats: FrameStats,
}

enum Device {
    Cpu {
        pass: PointsCpu,
        picture: Option<Picture>,
    },
    #[cfg(feature = "gpu")]
    Gpu(Box<OnGpu>),
}

#[cfg(feature = "gpu")]
struct OnGpu {
    gpu: Arc<Gpu>,
    pass: GpuPass,
    timer: PassTimer,
    targets: Option<Targets>,
}

#[cfg(feature = "gpu")]
enum GpuPass {
    Compute(PointsCompute),
    Raster(PointsRaster),
}

/// Bytes of nodes read at a time, so that what waits for its upload stays bounded.
const READ_AHEAD_BYTES: u64 = 64 << 20;
/// Most pixels of one part of a picture on the CPU.
const CPU_TILE_PIXELS: u64 = 16 << 20;
/// Problems that are kept in words.
const MAX_PROBLEMS: usize = 8;

impl Renderer {
    /// A renderer without a device; it holds at most `limit_bytes` of points.
    pub fn on_cpu(limit_bytes: u64) -> Self {
        let device = Device::Cpu { pass: PointsCpu::default(), picture: None };
        Renderer::new(device, Storage::Memory { limit_bytes })
    }

    /// A renderer on a device; it holds at most `limit_bytes` of points there.
    #[cfg(feature = "gpu")]
    pub fn on_gpu(gpu: Arc<Gpu>, path: RasterPath, limit_bytes: u64) -> Result<Self, FrameError> {
        let pass = match path {
            RasterPath::Compute => GpuPass::Compute(PointsCompute::new(&gpu)?),
            RasterPath::Raster => GpuPass::Raster(PointsRaster::new(&gpu)?),
            RasterPath::Cpu => return Ok(Renderer::on_cpu(limit_bytes)),
        };
        let timer = PassTimer::new(&gpu)?;
        let storage = Storage::Device(WordArena::new(&gpu, limit_bytes));
        let device = Device::Gpu(Box::new(OnGpu { gpu, pass, timer, targets: None }));
        Ok(Renderer::new(device, storage))
    }

    fn new(device: Device, storage: Storage) -> Self {
        Renderer {
            device,
            sources: Vec::new(),
            coloring: Vec::new(),
            colored_by: None,
            former: None,
            cache: NodeCache::new(storage),
            failed: HashSet::new(),
            problems: Vec::new(),
            scratch: CutScratch::default(),
            table: DrawTable::default(),
            last: None,
            stats: FrameStats::default(),
        }
    }

    /// How points are drawn.
    pub fn path(&self) -> RasterPath {
        match &self.device {
            Device::Cpu { .. } => RasterPath::Cpu,
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => match on_gpu.pass {
                GpuPass::Compute(_) => RasterPath::Compute,
                GpuPass::Raster(_) => RasterPath::Raster,
            },
        }
    }

    /// Replaces the scene; what was loaded of the old one is dropped.
    pub fn set_scene(&mut self, sources: Vec<Arc<dyn NodeSource>>) {
        self.sources = sources;
        self.colored_by = None;
        self.former = None;
        self.failed.clear();
        self.problems.clear();
        self.cache.clear();
        self.last = None;
    }

    /// Replaces the scene by one that shows the same more exactly: where ranges of colours are
    /// nearly those that are shown, they stay as they are.
    pub fn replace_scene(&mut self, sources: Vec<Arc<dyn NodeSource>>) {
        let shown = self.colored_by.take().zip(Some(std::mem::take(&mut self.coloring)));
        let former = shown.or(self.former.take());
        self.set_scene(sources);
        self.former = former;
    }

    /// The box of all points of the scene; empty without points.
    pub fn bounds(&self) -> Aabb {
        let boxes = self.sources.iter().map(|source| source.bounds());
        boxes.fold(Aabb::EMPTY, |all, bounds| all.union(&bounds))
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
                frame_ms: milliseconds(start),
                problems: self.problems.clone(),
                ..FrameStats::default()
            };
            self.collect_gpu_times();
            return Ok(&self.stats);
        }
        self.prepare(view, settings)?;
        self.draw(view, Tile::whole(view), settings)?;
        self.stats.tiles = 1;
        self.stats.frame_ms = milliseconds(start);
        self.last = Some((*view, settings.clone(), self.stats.complete));
        Ok(&self.stats)
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
        self.last = None;
        self.prepare(view, settings)?;
        let tiles = self.tiles(view);
        self.stats.tiles = tiles.len() as u32;
        let mut whole = match tiles.len() {
            1 => None,
            _ => Some(Picture::colors_only(view.width_px, view.height_px, settings.background)),
        };
        let mut only = None;
        for tile in tiles {
            self.draw(view, tile, settings)?;
            let reading = Instant::now();
            let part = self.take_picture()?;
            self.note_cpu_time("read_back", reading);
            match &mut whole {
                Some(whole) => whole.paste(&part, tile),
                None => only = Some(part),
            }
        }
        self.collect_gpu_times();
        self.stats.frame_ms = milliseconds(start);
        Ok(whole.or(only).expect("a view has at least one tile"))
    }

    /// The colours of the last frame on the device; `None` on the CPU or before the first frame.
    #[cfg(feature = "gpu")]
    pub fn color_view(&self) -> Option<&wgpu::TextureView> {
        match &self.device {
            Device::Gpu(on_gpu) => on_gpu.targets.as_ref().map(Targets::color_view),
            Device::Cpu { .. } => None,
        }
    }

    /// The reversed-z depth of the last frame on the device.
    #[cfg(feature = "gpu")]
    pub fn depth_view(&self) -> Option<&wgpu::TextureView> {
        match &self.device {
            Device::Gpu(on_gpu) => on_gpu.targets.as_ref().map(Targets::depth_view),
            Device::Cpu { .. } => None,
        }
    }

    /// The last frame in memory, if it was drawn on the CPU.
    pub fn picture(&self) -> Option<&Picture> {
        match &self.device {
            Device::Cpu { picture, .. } => picture.as_ref(),
            #[cfg(feature = "gpu")]
            Device::Gpu(_) => None,
        }
    }

    /// The last frame with its distances, read back from wherever it is.
    pub fn read_picture(&mut self) -> Result<Option<Picture>, FrameError> {
        match &self.device {
            Device::Cpu { picture, .. } => Ok(picture.clone()),
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => match (&on_gpu.targets, &self.last) {
                (Some(targets), Some((view, ..))) => {
                    Ok(Some(targets.read(&on_gpu.gpu, view.camera.near as f32)?))
                }
                _ => Ok(None),
            },
        }
    }

    /// The drawn point that is nearest on screen to a pixel of the last frame, within `radius_px`:
    /// its place in the world (as exact as one pixel). Waits for the GPU.
    pub fn pick(&self, x_px: u32, y_px: u32, radius_px: u32) -> Result<Option<DVec3>, FrameError> {
        let Some((view, ..)) = &self.last else { return Ok(None) };
        let (width, height) = (view.width_px, view.height_px);
        if x_px >= width || y_px >= height {
            return Ok(None);
        }
        let rows = y_px.saturating_sub(radius_px)..(y_px + radius_px + 1).min(height);
        let columns = x_px.saturating_sub(radius_px)..(x_px + radius_px + 1).min(width);
        let distances = self.distances_of_rows(view, rows.clone())?;
        let mut nearest: Option<(u32, u32, u32)> = None;
        for y in rows.clone() {
            for x in columns.clone() {
                let at = ((y - rows.start) * width + x) as usize;
                let off = x.abs_diff(x_px).pow(2) + y.abs_diff(y_px).pow(2);
                let closer = nearest.is_none_or(|(_, _, best)| off < best);
                if distances.get(at).is_some_and(|d| d.is_finite()) && closer {
                    nearest = Some((x, y, off));
                }
            }
        }
        Ok(nearest.map(|(x, y, _)| {
            let distance = f64::from(distances[((y - rows.start) * width + x) as usize]);
            view.unproject(f64::from(x) + 0.5, f64::from(y) + 0.5, distance)
        }))
    }

    /// The steps before drawing: colours, selection, loading, table.
    fn prepare(&mut self, view: &View, settings: &FrameSettings) -> Result<(), FrameError> {
        let read_before = self.bytes_read();
        self.stats = FrameStats::default();
        self.cache.begin_frame();
        self.settle_colors(&settings.color);
        let cuts = self.select_and_load(view, settings)?;
        self.fill_table(&cuts, view, settings);
        self.stats.points_drawn = self.table.points;
        self.stats.nodes_drawn = self.table.draws.len() as u32;
        let counters = || cuts.iter().map(|cut| &cut.counters);
        self.stats.queue_pops = counters().map(|c| c.queue_pops).sum();
        self.stats.nodes_culled = counters().map(|c| c.nodes_culled).sum();
        self.stats.nodes_fine_enough = counters().map(|c| c.nodes_fine_enough).sum();
        self.stats.nodes_over_budget = counters().map(|c| c.nodes_over_budget).sum();
        self.stats.nodes_requested = cuts.iter().map(|cut| cut.requests.len() as u32).sum();
        self.stats.nodes_failed = self.failed.len() as u32;
        self.stats.nodes_evicted = self.cache.evicted();
        self.stats.node_bytes = self.cache.held_bytes();
        self.stats.bytes_read = self.bytes_read() - read_before;
        self.stats.problems = self.problems.clone();
        // What has no room will not come by waiting.
        self.stats.complete = self.stats.nodes_requested <= self.stats.nodes_without_room;
        cuts.into_iter().for_each(|cut| self.scratch.recycle(cut));
        Ok(())
    }

    /// Settles how each cloud is coloured; a new mode drops all loaded nodes.
    fn settle_colors(&mut self, mode: &ColorMode) {
        if self.colored_by.as_ref() == Some(mode) {
            return;
        }
        self.cache.clear();
        let mut problems = Vec::new();
        let mut noted = |result: Result<Option<(f64, f64)>, _>| {
            result.unwrap_or_else(|error: crate::store::NodeReadError| {
                problems.push(error.to_string());
                None
            })
        };
        let shown = |source: &&Arc<dyn NodeSource>| shows_elevation(mode, source.as_ref());
        let ranges = self.sources.iter().filter(shown);
        // One range for the whole scene, so that colours compare between clouds.
        let elevation = ranges
            .filter_map(|source| noted(elevation_range(source.as_ref())))
            .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        let mut coloring = Vec::new();
        for source in &self.sources {
            coloring.push(Coloring::settle(mode, source.as_ref(), elevation).unwrap_or_else(
                |error| {
                    problems.push(error.to_string());
                    Coloring::Plain
                },
            ));
        }
        if let Some((former_mode, former)) = self.former.take()
            && former_mode == *mode
        {
            for settled in &mut coloring {
                if let Some(near) = former.iter().find(|former| settled.is_near(former)) {
                    *settled = near.clone();
                }
            }
        }
        self.coloring = coloring;
        problems.into_iter().for_each(|problem| self.note_problem(problem));
        self.colored_by = Some(mode.clone());
    }

    /// Chooses what to draw and loads what is missing, until nothing more can or may be loaded.
    fn select_and_load(
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

    fn fill_table(&mut self, cuts: &[Cut], view: &View, settings: &FrameSettings) {
        let cache = &self.cache;
        let place_of = |node: SceneNode| {
            let ready = cache.get(node).expect("drawn nodes are ready");
            match &ready.words {
                Words::Memory(_) => NodePlace::default(),
                #[cfg(feature = "gpu")]
                Words::Device(range) => NodePlace {
                    shard: range.shard,
                    positions_at: range.first,
                    colors_at: range.first + ready.position_words,
                },
            }
        };
        let places: Vec<_> = (0..self.sources.len())
            .map(|cloud| move |node: NodeId| place_of((cloud, node)))
            .collect();
        let clouds: Vec<_> = self
            .sources
            .iter()
            .zip(cuts)
            .zip(&places)
            .map(|((source, cut), place)| CloudDraw { octree: source.octree(), cut, place })
            .collect();
        self.table.fill(&clouds, view, &settings.cut.splat);
    }

    fn draw(
        &mut self,
        view: &View,
        tile: Tile,
        settings: &FrameSettings,
    ) -> Result<(), FrameError> {
        let start = Instant::now();
        let frame = tile.gpu_frame(view, &settings.cut.splat, settings.background);
        match &mut self.device {
            Device::Cpu { pass, picture } => {
                let mut words =
                    vec![NodeWords { positions: &[], colors: &[] }; self.table.nodes.len()];
                for draw in &self.table.draws {
                    let ready = self.cache.get((draw.cloud, draw.node));
                    if let Some(ready) = ready
                        && let Words::Memory(all) = &ready.words
                    {
                        let (positions, colors) = all.split_at(ready.position_words as usize);
                        words[draw.slot as usize] = NodeWords { positions, colors };
                    }
                }
                if self.table.draws.is_empty() {
                    *picture =
                        Some(Picture::empty(tile.width_px, tile.height_px, settings.background));
                } else {
                    pass.draw(&frame, &self.table, &words);
                    *picture = Some(pass.resolve(&frame));
                }
            }
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => {
                let Storage::Device(arena) = self.cache.storage() else {
                    unreachable!("a renderer on a device stores there")
                };
                let counts = on_gpu.draw(&frame, &self.table, arena)?;
                self.stats.draw_calls += counts.draw_calls;
                self.stats.dispatches += counts.dispatches;
                self.stats.bytes_uploaded += counts.uploaded_bytes;
                let times: Vec<_> = on_gpu.timer.collect().clone();
                self.note_gpu_times(&times);
            }
        }
        self.note_cpu_time("draw", start);
        Ok(())
    }

    /// Brings the tile that was just drawn to memory.
    fn take_picture(&mut self) -> Result<Picture, FrameError> {
        match &mut self.device {
            Device::Cpu { picture, .. } => Ok(picture.take().expect("it was just drawn")),
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => {
                let targets = on_gpu.targets.as_ref().expect("it was just drawn");
                Ok(targets.read_colors(&on_gpu.gpu)?)
            }
        }
    }

    fn distances_of_rows(
        &self,
        view: &View,
        rows: std::ops::Range<u32>,
    ) -> Result<Vec<f32>, FrameError> {
        let width = view.width_px as usize;
        match &self.device {
            Device::Cpu { picture, .. } => Ok(picture.as_ref().map_or(Vec::new(), |picture| {
                picture.distances[rows.start as usize * width..rows.end as usize * width].to_vec()
            })),
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => Ok(on_gpu.distances_of_rows(view, rows)?),
        }
    }

    fn tiles(&self, view: &View) -> Vec<Tile> {
        match &self.device {
            Device::Cpu { .. } => Tile::cover(view, u32::MAX, CPU_TILE_PIXELS),
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => {
                let side = on_gpu.gpu.device().limits().max_texture_dimension_2d;
                Tile::cover(view, side, on_gpu.max_pixels())
            }
        }
    }

    fn still_holds(&self, view: &View, settings: &FrameSettings) -> bool {
        matches!(&self.last, Some((last_view, last_settings, true))
            if last_view == view && last_settings == settings)
    }

    fn bytes_read(&self) -> u64 {
        self.sources.iter().map(|source| source.bytes_read()).sum()
    }

    fn note_problem(&mut self, problem: String) {
        if self.problems.len() < MAX_PROBLEMS {
            self.problems.push(problem);
        }
    }

    fn note_cpu_time(&mut self, pass: &'static str, start: Instant) {
        self.note_time(pass, milliseconds(start));
    }

    fn note_time(&mut self, pass: &'static str, pass_ms: f64) {
        self.add_time(PassTime { pass, clock: "cpu", pass_ms });
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
    fn note_gpu_times(&mut self, times: &[(&'static str, f64)]) {
        self.stats.passes.retain(|time| time.clock != "gpu");
        for &(pass, pass_ms) in times {
            self.stats.passes.push(PassTime { pass, clock: "gpu", pass_ms });
        }
    }
}

#[cfg(feature = "gpu")]
impl OnGpu {
    fn draw(
        &mut self,
        frame: &crate::gpu::layout::GpuFrame,
        table: &DrawTable,
        arena: &WordArena,
    ) -> Result<DrawCounts, GpuError> {
        let [width_px, height_px] = frame.target_px;
        if !self.targets.as_ref().is_some_and(|targets| targets.fits(width_px, height_px)) {
            self.targets = None;
            self.targets = Some(Targets::new(&self.gpu, width_px, height_px)?);
        }
        let targets = self.targets.as_ref().expect("they were just made");
        self.timer.begin_frame();
        let gpu = self.gpu.clone();
        let (pass, timer) = (&mut self.pass, &mut self.timer);
        let drawing = PointDrawing { frame, table, arena, targets };
        gpu.checked("draw a frame", || {
            let mut encoder = gpu.device().create_command_encoder(&Default::default());
            let counts = match pass {
                GpuPass::Compute(pass) => pass.draw(&gpu, &mut encoder, timer, &drawing),
                GpuPass::Raster(pass) => pass.draw(&gpu, &mut encoder, timer, &drawing),
            }?;
            timer.end_frame(&mut encoder);
            gpu.queue().submit([encoder.finish()]);
            timer.after_submit();
            Ok(counts)
        })?
    }

    fn max_pixels(&self) -> u64 {
        match &self.pass {
            GpuPass::Compute(_) => PointsCompute::max_pixels(&self.gpu),
            // Reading back needs a buffer of 4 bytes per pixel.
            GpuPass::Raster(_) => self.gpu.device().limits().max_buffer_size / 8,
        }
    }

    fn distances_of_rows(
        &self,
        view: &View,
        rows: std::ops::Range<u32>,
    ) -> Result<Vec<f32>, GpuError> {
        let Some(targets) = &self.targets else { return Ok(Vec::new()) };
        match &self.pass {
            GpuPass::Compute(pass) => pass.distances_of_rows(&self.gpu, rows),
            GpuPass::Raster(_) => {
                let picture = targets.read(&self.gpu, view.camera.near as f32)?;
                let width = view.width_px as usize;
                Ok(picture.distances[rows.start as usize * width..rows.end as usize * width]
                    .to_vec())
            }
        }
    }
}

fn check_view(view: &View) -> Result<(), FrameError> {
    let camera = &view.camera;
    let wrong = |reason: &str| Err(FrameError::View { reason: reason.into() });
    let vectors = [camera.eye, camera.forward, camera.up];
    if vectors.iter().any(|v| !v.is_finite()) || !camera.near.is_finite() {
        return wrong("the camera has a number that is not finite");
    }
    if !(camera.fov_y_rad > 0.0 && camera.fov_y_rad < std::f64::consts::PI) {
        return wrong("the field of view is not between 0 and 180 degrees");
    }
    if camera.near <= 0.0 {
        return wrong("the near plane is not in front of the eye");
    }
    if view.width_px == 0 || view.height_px == 0 {
        return wrong("the picture has no pixels");
    }
    Ok(())
}

fn milliseconds(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
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
