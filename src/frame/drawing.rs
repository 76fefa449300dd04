//! Drawing what is ready: the draw table, the pass, and its picture.

use std::time::Instant;

#[cfg(feature = "gpu")]
use crate::frame::culling::draws_by_node;
use crate::frame::device::Device;
#[cfg(feature = "gpu")]
use crate::frame::device::{ModelDrawing, SceneDrawing};
#[cfg(feature = "gpu")]
use crate::frame::node_cache::Storage;
use crate::frame::node_cache::Words;
use crate::frame::renderer::milliseconds;
use crate::frame::{FrameError, FrameSettings, Renderer};
use crate::geometry::View;
use crate::ids::NodeId;
use crate::passes::{CloudDraw, MeshesCpu, NodePlace, NodeWords, Picture, Tile, finish};
use crate::select::{Cut, SplatSettings, SplatSize};
use crate::stream::SceneNode;
#[cfg(feature = "gpu")]
use crate::visibility::Algorithm;

/// Most pixels of one part of a picture on the CPU.
const CPU_TILE_PIXELS: u64 = 16 << 20;

impl Renderer {
    pub(super) fn fill_table(&mut self, cuts: &[Cut], view: &View, settings: &FrameSettings) {
        let splat = self.splat_settings(settings);
        self.begin_appearing(cuts, settings);
        let cache = &self.cache;
        let place_of = |node: SceneNode| {
            // Concealed nodes need not be.
            let Some(ready) = cache.get(node) else { return NodePlace::default() };
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
        let appearance = &self.appearance;
        let shares: Vec<_> = (0..self.sources.len())
            .map(|cloud| move |node: NodeId| appearance.share((cloud, node)))
            .collect();
        let appears = !settings.appear.is_zero();
        let clouds: Vec<_> = self
            .sources
            .iter()
            .zip(cuts)
            .zip(places.iter().zip(&shares))
            .map(|((source, cut), (place, share))| CloudDraw {
                octree: source.octree(),
                cut,
                place,
                appeared: appears.then_some(share as &dyn Fn(NodeId) -> f32),
            })
            .collect();
        self.table.fill(&clouds, view, &splat);
    }

    /// The settings of splats with what they leave to the scene.
    fn splat_settings(&self, settings: &FrameSettings) -> SplatSettings {
        let mut splat = settings.cut.splat;
        if let SplatSize::Attenuated { length } = &mut splat.size
            && *length <= 0.0
            && self.mean_spacing.is_finite()
        {
            *length = self.mean_spacing;
        }
        splat
    }

    fn begin_appearing(&mut self, cuts: &[Cut], settings: &FrameSettings) {
        let cloud_nodes = |(cloud, cut)| {
            let cut: &Cut = cut;
            cut.shown().map(move |drawn| (cloud, drawn.node))
        };
        let drawn = cuts.iter().enumerate().flat_map(cloud_nodes);
        let stands_alone = |(cloud, node): SceneNode| {
            let parent = self.sources[cloud].octree().node(node).parent;
            parent.is_none_or(|parent| {
                cuts[cloud].table.binary_search_by_key(&parent, |row| row.node).is_err()
            })
        };
        let is_held = |node| self.cache.contains(node);
        self.stats.nodes_appearing =
            self.appearance.begin_frame(settings.appear, drawn, stands_alone, is_held);
    }

    pub(super) fn draw(
        &mut self,
        view: &View,
        tile: Tile,
        settings: &FrameSettings,
    ) -> Result<(), FrameError> {
        let start = Instant::now();
        let mut cpu_times = [("points", 0.0); 3];
        let frame = tile.gpu_frame(view, &self.splat_settings(settings), settings.background);
        match &mut self.device {
            Device::Cpu { pass, meshes, picture } => {
                let mut words =
                    vec![NodeWords { positions: &[], colors: &[] }; self.table.nodes.len()];
                for draw in &self.table.draws {
                    let ready = self.cache.get((draw.cloud, draw.node));
                    if let Some(ready) = ready
                        && let Words::Memory(all) = &ready.words
                    {
                        let (positions, colors) = all.words.split_at(ready.position_words as usize);
                        words[draw.slot as usize] = NodeWords { positions, colors };
                    }
                }
                if self.table.draws.is_empty() {
                    *picture =
                        Some(Picture::empty(tile.width_px, tile.height_px, settings.background));
                } else {
                    let started = Instant::now();
                    pass.draw(&frame, &self.table, &words);
                    let points_ms = milliseconds(started);
                    let resolving = Instant::now();
                    let mut drawn = pass.resolve(&frame);
                    finish(&mut drawn, frame.near, &settings.finish);
                    *picture = Some(drawn);
                    cpu_times[..2].copy_from_slice(&[
                        ("points", points_ms),
                        ("resolve", milliseconds(resolving)),
                    ]);
                }
                if let Some(models) = &self.models
                    && !models.visible.is_empty()
                {
                    let started = Instant::now();
                    let meshes = meshes
                        .get_or_insert_with(|| Box::new(MeshesCpu::new(models.model.clone())));
                    let drawn = picture.as_mut().expect("it was just drawn");
                    let counts = meshes.draw(view, &frame, &models.visible, drawn);
                    self.stats.objects_drawn += counts.objects;
                    self.stats.triangles_drawn += counts.triangles;
                    cpu_times[2] = ("meshes", milliseconds(started));
                }
            }
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => {
                let Storage::Device(arena) = self.cache.storage() else {
                    unreachable!("a renderer on a device stores there")
                };
                let is_frozen = self.frozen.is_some();
                let models = self.models.as_ref().map(|models| ModelDrawing {
                    model: &models.model,
                    visible: &models.visible,
                    bounds: (!is_frozen).then_some(&models.bounds[..]),
                });
                // What is frozen is drawn as it was chosen; nothing is asked.
                let mut culling = self.culling.as_deref_mut().filter(|_| !is_frozen);
                let culls_points =
                    culling.as_ref().is_some_and(|c| c.draws_points(&self.sources, view));
                let (draws, ready) = match culls_points {
                    true => draws_by_node(&self.table, |node| self.cache.contains(node)),
                    false => Default::default(),
                };
                let (counts, meshes, culled) = on_gpu.draw(SceneDrawing {
                    view,
                    frame: &frame,
                    table: &self.table,
                    arena,
                    settings,
                    models,
                    culling: culling.as_deref_mut(),
                    sources: &self.sources,
                    culls_points,
                    draw_of: &|cloud, node| draws.get(&(cloud, node)).copied(),
                    ready: &ready,
                })?;
                if let Some(culling) = culling {
                    let counters = self.stats.culling.get_or_insert_default();
                    counters.add(culling.culler.counters());
                    self.stats.culling_costs = culling.meter.stats();
                    culling.note(&self.sources, culled.as_ref());
                }
                if let Some(culled) = &culled {
                    // Rounds have another price than the cut that was expected.
                    if let Some(pacer) = &mut self.pacer {
                        pacer.next = None;
                    }
                    let draws = || culled.draws.iter().map(|&at| &self.table.draws[at as usize]);
                    self.stats.points_drawn = draws().map(|draw| self.table.points_of(draw)).sum();
                    self.stats.nodes_drawn = culled.draws.len() as u32;
                }
                if let Some(two_pass) = &on_gpu.two_pass
                    && settings.culling == Algorithm::TwoPass
                {
                    self.stats.culling.get_or_insert_default().add(&two_pass.counts().counters());
                }
                self.stats.objects_drawn += meshes.objects;
                self.stats.triangles_drawn += meshes.triangles;
                self.stats.draw_calls += counts.draw_calls;
                self.stats.dispatches += counts.dispatches;
                self.stats.bytes_uploaded += counts.uploaded_bytes;
                let times: Vec<_> = on_gpu.timer.collect().clone();
                self.note_gpu_times(&times);
            }
        }
        for (pass, pass_ms) in cpu_times.into_iter().filter(|(_, ms)| *ms > 0.0) {
            self.note_time(pass, pass_ms);
        }
        self.note_cpu_time("draw", start);
        Ok(())
    }

    /// Brings the tile that was just drawn to memory.
    pub(super) fn take_picture(&mut self) -> Result<Picture, FrameError> {
        match &mut self.device {
            Device::Cpu { picture, .. } => Ok(picture.take().expect("it was just drawn")),
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => {
                let (colors, _) = on_gpu.finished().expect("it was just drawn");
                Ok(colors.read_colors(&on_gpu.gpu)?)
            }
        }
    }

    pub(super) fn distances_of_rows(
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

    /// Parts that cover a view, each of which can be drawn with `reach_px` around it.
    pub(super) fn tiles(&self, view: &View, reach_px: u32) -> Vec<Tile> {
        match &self.device {
            Device::Cpu { .. } => {
                // Rows of the CPU's picture can be as long as they like.
                let _ = reach_px;
                Tile::cover(view, u32::MAX, CPU_TILE_PIXELS)
            }
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => {
                let side = on_gpu.gpu.device().limits().max_texture_dimension_2d;
                let side = match view.width_px.max(view.height_px) > side {
                    true => side.saturating_sub(2 * reach_px).max(1),
                    false => side,
                };
                Tile::cover(view, side, on_gpu.max_pixels())
            }
        }
    }
}
