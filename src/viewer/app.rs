//! What the window does, apart from being a window: files, camera, settings, and when to draw.
//!
//! The point frame is drawn only when view, settings or scene changed, or nodes are still coming;
//! painting the window for any other reason shows the picture that is there. Runs wherever egui
//! does: tests drive it without a window or a device.

use std::mem;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use egui::{Color32, Event, Key, Pos2, Rect, Sense, Ui};
use glam::DVec3;

use crate::frame::{FrameError, FrameSettings, FrameStats, Loading, NodeSource, Renderer};
use crate::geometry::{Aabb, Camera, View, ViewPreset};
use crate::gpu::GpuError;
use crate::store::Store;
use crate::viewer::CameraControl;
use crate::viewer::canvas::Canvas;
use crate::viewer::culling_panel::{self, CullingAction};
use crate::viewer::culling_view::CullingView;
use crate::viewer::keys::{self, KeyCommand};
use crate::viewer::models::{self, OpenedModel};
use crate::viewer::opening::{Advance, KeptIn, Opened, OpenedFile, Opening, OpeningOptions, Sign};
use crate::viewer::panels::{self, FileAction, Notice};
use crate::viewer::statistics::{Milestone, Statistics};
use crate::viewer::statistics_box;

/// What the viewer is told at its start.
#[derive(Clone, Debug)]
pub struct ViewerOptions {
    /// How the first frame is drawn.
    pub frame: FrameSettings,
    /// The first view.
    pub view: ViewPreset,
    /// The first camera, if not a preset's; its field of view is the window's own.
    pub start: Option<Camera>,
    /// Whether boxes of what is culled are shown from the start.
    pub shows_boxes: bool,
    /// Whether the second camera is gone to once the first one's culling is at rest.
    pub second_camera: bool,
    /// How files are opened.
    pub opening: OpeningOptions,
    /// When the program began.
    pub began: Option<Instant>,
    /// Where statistics are written.
    pub stats: Option<PathBuf>,
    /// What draws, in words.
    pub adapter: String,
    /// Most bytes of points that the renderer holds.
    pub node_limit_bytes: u64,
    /// Time between two looks at how far a conversion is: each paints the whole window, which
    /// takes from the conversion where processors paint.
    pub progress_every: Duration,
}

impl Default for ViewerOptions {
    fn default() -> Self {
        ViewerOptions {
            frame: FrameSettings::default(),
            view: ViewPreset::default(),
            start: None,
            shows_boxes: false,
            second_camera: false,
            opening: OpeningOptions::default(),
            began: None,
            stats: None,
            adapter: String::new(),
            node_limit_bytes: 0,
            progress_every: PROGRESS_EVERY,
        }
    }
}

/// The viewer: all state of the window.
pub struct Viewer {
    pub(super) renderer: Renderer,
    pub(super) canvas: Canvas,
    pub(super) options: ViewerOptions,
    pub(super) settings: FrameSettings,
    pub(super) control: CameraControl,
    /// View to go to as soon as the size of the picture is known.
    pub(super) asked_view: Option<ViewPreset>,
    /// What of the scene that view is to show, if not all.
    pub(super) asked_part: Option<Aabb>,
    /// Whether the camera was moved since the scene was last framed.
    pub(super) was_moved: bool,
    pub(super) files: Vec<OpenedFile>,
    pub(super) models: Vec<OpenedModel>,
    pub(super) opening: Option<Opening>,
    /// The preview on view of what is being opened.
    pub(super) preview: Option<Arc<Store>>,
    /// Whether the next frame is the first of another scene at the same place, which shall not be
    /// coarser than the last one.
    pub(super) takes_over: bool,
    /// Whether the next frame is the first of a scene.
    pub(super) is_new_scene: bool,
    pub(super) milestones: Vec<Milestone>,
    /// The next file to arrive takes the place of those on view.
    pub(super) replaces: bool,
    pub(super) add_dropped: bool,
    pub(super) notices: Vec<Notice>,
    pub(super) zoom_anchor: Option<(Pos2, Option<DVec3>)>,
    pub(super) size_px: (u32, u32),
    /// The view of the last frame that was asked for.
    last_view: Option<View>,
    /// View and settings that could not be drawn, so that they are not tried again.
    pub(super) refused: Option<(View, FrameSettings)>,
    pub(super) device_lost: Option<String>,
    pub(super) drawn: FrameStats,
    pub(super) frames_drawn: u64,
    pub(super) frames_skipped: u64,
    /// Times the window was painted.
    paints: u64,
    pub(super) bytes_read: u64,
    pub(super) bytes_uploaded: u64,
    pub(super) shows_panel: bool,
    pub(super) shows_statistics: bool,
    pub(super) shows_help: bool,
    pub(super) culling_view: CullingView,
}

/// Bytes of points loaded per frame: about a twentieth of a second of reading and unpacking.
const QUOTA_BYTES: u64 = 8 << 20;
/// Longest time between two looks at whether nodes have come.
const LONGEST_WAIT: Duration = Duration::from_millis(30);
/// See [`ViewerOptions::progress_every`].
const PROGRESS_EVERY: Duration = Duration::from_millis(250);
/// As good as at once, but painted once: what is asked for at once egui paints twice.
const SOON: Duration = Duration::from_millis(1);
/// Most notices kept.
const MAX_NOTICES: usize = 8;
/// Most milestones kept.
const MAX_MILESTONES: usize = 16;

/// Settings of a window's first frame: as a picture's, but nodes come a share per frame, so that
/// the window answers while they do.
pub fn first_settings() -> FrameSettings {
    FrameSettings { loading: Loading::Quota { bytes: QUOTA_BYTES }, ..FrameSettings::default() }
}

impl Viewer {
    /// A viewer without files.
    pub fn new(renderer: Renderer, canvas: Canvas, options: ViewerOptions) -> Self {
        Viewer {
            control: CameraControl::new(&renderer.bounds(), options.view, 1.0),
            settings: options.frame.clone(),
            renderer,
            canvas,
            asked_view: Some(options.view),
            asked_part: None,
            was_moved: false,
            files: Vec::new(),
            models: Vec::new(),
            opening: None,
            preview: None,
            takes_over: false,
            is_new_scene: false,
            milestones: Vec::new(),
            replaces: false,
            add_dropped: false,
            notices: Vec::new(),
            zoom_anchor: None,
            size_px: (0, 0),
            last_view: None,
            refused: None,
            device_lost: None,
            drawn: FrameStats::default(),
            frames_drawn: 0,
            frames_skipped: 0,
            paints: 0,
            bytes_read: 0,
            bytes_uploaded: 0,
            shows_panel: true,
            shows_statistics: true,
            shows_help: false,
            culling_view: CullingView::new(options.shows_boxes),
            options,
        }
    }

    /// Starts to open files; those on view stay until the first of them is there. Ends what was
    /// being opened before.
    pub fn open(&mut self, ctx: &egui::Context, files: Vec<PathBuf>) {
        if files.is_empty() {
            return;
        }
        // The old request ends before the new one begins, so both never write one store.
        self.opening = None;
        let ctx = ctx.clone();
        let wake = Arc::new(move |sign| wake_for(&ctx, sign));
        match Opening::start(files, self.options.opening.clone(), wake) {
            Ok(opening) => self.follow(opening),
            Err(error) => self.note(format!("cannot start a thread: {error}"), true),
        }
    }

    /// Shows the files of a request that was started elsewhere.
    pub fn follow(&mut self, opening: Opening) {
        self.replaces = !self.add_dropped;
        self.preview = None;
        self.opening = Some(opening);
    }

    /// Takes in what happened beside the window. Call before [`ui`](Self::ui).
    pub fn logic(&mut self, ctx: &egui::Context) {
        let Some(opening) = self.opening.take() else { return };
        let is_finished = opening.is_finished();
        while let Some(news) = opening.next() {
            match news {
                Opened::Files(files) => self.show_files(files),
                Opened::Model(model) => self.show_model(model),
                Opened::Preview(file) => {
                    let store = file.store.clone();
                    self.show_files(vec![file]);
                    self.preview = Some(store);
                }
                Opened::Warning(text) => self.note(text, false),
                Opened::Failed(text) => self.note(text, true),
            }
        }
        if !is_finished {
            // The bar moves between the news.
            ctx.request_repaint_after(self.options.progress_every);
            self.opening = Some(opening);
        }
    }

    /// Shows everything and draws the points if they have to be drawn.
    pub fn ui(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        if self.milestones.is_empty() {
            self.reach("window");
        }
        if ctx.current_pass_index() == 0 {
            self.paints += 1;
            self.take_dropped_files(&ctx);
            self.take_keys(&ctx);
        }
        if self.shows_panel {
            let before = ui.available_rect_before_wrap();
            let ground = ui.painter().add(egui::Shape::Noop);
            let frame = egui::Frame::side_top_panel(ui.style()).fill(Color32::TRANSPARENT);
            egui::Panel::left("panel").frame(frame).default_size(300.0).show(ui, |ui| {
                egui::ScrollArea::vertical().show(ui, |ui| self.panel(ui));
            });
            let right = ui.available_rect_before_wrap().left();
            let area = Rect::from_min_max(before.min, Pos2::new(right, before.bottom()));
            let color = ui.visuals().panel_fill;
            ui.painter().set(ground, self.canvas.plain(area, color));
        }
        egui::CentralPanel::no_frame().show(ui, |ui| self.picture(ui));
    }

    /// What was done so far.
    pub fn statistics(&self) -> Statistics {
        let camera = self.control.camera();
        let octrees = || self.files.iter().map(|file| file.store.octree());
        Statistics {
            adapter: self.options.adapter.clone(),
            renderer: self.renderer.path().name(),
            files: self.files.iter().map(|file| file.path.clone()).collect(),
            models: self.models.iter().map(|model| model.path.clone()).collect(),
            triangles: self.models.iter().map(|model| model.model.triangle_count()).sum(),
            objects: self.models.iter().map(|model| model.model.objects.len() as u64).sum(),
            stores: self.files.iter().map(|file| file.kept_in.clone()).collect(),
            points: octrees().map(|octree| octree.point_count()).sum(),
            nodes: octrees().map(|octree| octree.nodes().len() as u64).sum(),
            frames_drawn: self.frames_drawn,
            frames_skipped: self.frames_skipped,
            paints: self.paints,
            width_px: self.size_px.0,
            height_px: self.size_px.1,
            color: self.settings.color.to_string(),
            point_budget: self.settings.cut.point_budget,
            error_px: self.settings.cut.error_px,
            splat: self.settings.cut.splat.policy.name(),
            rule: self.settings.cut.rule.name(),
            eye: camera.eye.to_array(),
            forward: camera.forward.to_array(),
            bytes_read: self.bytes_read,
            bytes_uploaded: self.bytes_uploaded,
            node_limit_bytes: self.options.node_limit_bytes,
            is_opening: self.opening.is_some(),
            milestones: self.milestones.clone(),
            frame: self.drawn.clone(),
            culling: self.settings.culling.name(),
            culling_view: self.culling_view.statistics(),
            notices: self.notices.iter().map(|notice| notice.text.clone()).collect(),
        }
    }

    /// The conversion that is going on.
    pub fn conversion(&self) -> Option<Advance> {
        self.opening.as_ref().and_then(Opening::advance)
    }

    /// Why the device is gone; nothing can be drawn any more.
    pub fn device_lost(&self) -> Option<&str> {
        self.device_lost.as_deref()
    }

    /// The name of what is on view, for the title.
    pub fn title(&self) -> String {
        let files = self.files.iter().map(|file| &file.path);
        let paths: Vec<_> = files.chain(self.models.iter().map(|model| &model.path)).collect();
        match paths.as_slice() {
            [] => "Esker".to_owned(),
            [path, more @ ..] => {
                let name = path.file_name().unwrap_or_default().to_string_lossy();
                match more.len() {
                    0 => format!("{name} - Esker"),
                    more => format!("{name} and {more} more - Esker"),
                }
            }
        }
    }

    /// Adds a line about something that happened outside.
    pub fn note(&mut self, text: String, is_error: bool) {
        // Drivers answer in several lines.
        let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
        let notice = Notice { text, is_error };
        if !self.notices.contains(&notice) {
            self.notices.push(notice);
        }
        let surplus = self.notices.len().saturating_sub(MAX_NOTICES);
        self.notices.drain(..surplus);
    }

    /// Ends what goes on beside the window and writes the statistics.
    pub fn finish(&mut self) -> anyhow::Result<()> {
        self.opening = None;
        match &self.options.stats {
            Some(path) => self.statistics().write(path),
            None => Ok(()),
        }
    }

    fn take_dropped_files(&mut self, ctx: &egui::Context) {
        let dropped = ctx.input(|input| input.raw.dropped_files.clone());
        let paths = dropped.iter().map(|file| file.path().to_owned()).collect();
        self.open(ctx, paths);
    }

    fn take_keys(&mut self, ctx: &egui::Context) {
        if ctx.egui_wants_keyboard_input() {
            return;
        }
        let pressed: Vec<Key> = ctx.input(|input| {
            let events = input.events.iter().filter_map(|event| match event {
                Event::Key { key, pressed: true, repeat: false, modifiers, .. }
                    if !modifiers.command && !modifiers.alt =>
                {
                    Some(*key)
                }
                _ => None,
            });
            events.collect()
        });
        for command in pressed.into_iter().filter_map(keys::command) {
            match command {
                KeyCommand::Show(preset) => self.ask_view(preset),
                KeyCommand::Help => self.shows_help = !self.shows_help,
                KeyCommand::Statistics => self.shows_statistics = !self.shows_statistics,
                KeyCommand::Panel => self.shows_panel = !self.shows_panel,
                KeyCommand::WriteStatistics => self.write_statistics(),
                KeyCommand::Boxes => self.show_boxes(!self.culling_view.shows_boxes),
                KeyCommand::SecondCamera => {
                    self.show_second_camera(!self.culling_view.is_second_camera());
                }
            }
        }
    }

    fn ask_view(&mut self, preset: ViewPreset) {
        self.asked_view = Some(preset);
        self.options.start = None;
    }

    fn write_statistics(&mut self) {
        let Some(path) = &self.options.stats else {
            self.note("no file for statistics: start with --stats FILE.json".into(), false);
            return;
        };
        if let Err(error) = self.statistics().write(path) {
            self.note(format!("{error:#}"), true);
        }
    }

    fn panel(&mut self, ui: &mut Ui) {
        ui.add_space(4.0);
        if let Some(preset) = panels::views(ui) {
            self.ask_view(preset);
        }
        ui.separator();
        let clouds = self.files.iter().map(|file| file.store.as_ref() as &dyn NodeSource);
        let colors = panels::offered_colors(clouds);
        panels::settings(ui, &mut self.settings, &colors);
        ui.separator();
        let (boxes, second) = (self.culling_view.shows_boxes, self.culling_view.is_second_camera());
        match culling_panel::culling(ui, &mut self.settings.culling, boxes, second) {
            Some(CullingAction::Boxes(shows)) => self.show_boxes(shows),
            Some(CullingAction::SecondCamera(shows)) => self.show_second_camera(shows),
            None => {}
        }
        ui.separator();
        match panels::files(ui, &self.files) {
            Some(FileAction::Show(index)) => {
                self.asked_view = Some(self.options.view);
                self.asked_part = Some(self.files[index].store.metadata().bounds());
            }
            Some(FileAction::Close(index)) => {
                let closed = self.files.remove(index);
                if closed.kept_in == KeptIn::Preview
                    && let Some(opening) = &self.opening
                {
                    opening.cancel();
                }
                self.take_scene(false);
            }
            None => {}
        }
        match models::list(ui, &self.models) {
            Some(FileAction::Show(index)) => {
                self.asked_view = Some(self.options.view);
                self.asked_part = Some(self.models[index].bounds);
            }
            Some(FileAction::Close(index)) => {
                self.models.remove(index);
                self.take_models();
            }
            None => {}
        }
        ui.checkbox(&mut self.add_dropped, "dropped files are added to these");
        ui.separator();
        ui.checkbox(&mut self.shows_statistics, "Statistics (F2)");
        ui.checkbox(&mut self.shows_help, "Mouse and keys (F1)");
        ui.weak("F3 hides this panel");
        ui.separator();
        ui.weak(format!("{}, {}", self.renderer.path().name(), self.options.adapter));
    }

    fn picture(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        let (rect, size_px) = whole_pixels(ui.available_rect_before_wrap(), ctx.pixels_per_point());
        self.size_px = size_px;
        if size_px.0 == 0 || size_px.1 == 0 {
            return;
        }
        let response = ui.allocate_rect(rect, Sense::drag());
        // The picture covers it.
        if !self.canvas.has_picture() || self.files.is_empty() && self.models.is_empty() {
            ui.painter().add(self.canvas.plain(rect, background(&self.settings)));
        }
        if self.files.is_empty() && self.models.is_empty() {
            if self.opening.is_none() {
                panels::hint(ui, rect, "Drop a store, a scan or a model here");
            }
        } else {
            self.move_camera(&ctx, &response);
            self.draw(&ctx);
            self.canvas.paint(ui.painter(), rect);
            self.paint_culling(ui, rect);
            self.go_to_asked_second_camera(&ctx);
            if self.shows_statistics {
                statistics_box::show(&ctx, rect, &self.statistics());
            }
        }
        if ctx.input(|input| !input.raw.hovered_files.is_empty()) {
            panels::hint(ui, rect, "Let go to open");
        }
        let advance = self.conversion();
        let is_opening = self.opening.is_some();
        let notices = &mut self.notices;
        if panels::progress_and_notices(&ctx, rect, is_opening, advance.as_ref(), notices)
            && let Some(opening) = &self.opening
        {
            opening.cancel();
        }
        if self.shows_help {
            panels::help(&ctx, rect);
        }
    }

    /// Draws the points, or finds that the picture still holds.
    fn draw(&mut self, ctx: &egui::Context) {
        let view = self.view();
        let request = (view, self.settings.clone());
        if self.device_lost.is_some() || self.refused.as_ref() == Some(&request) {
            return;
        }
        let mut settings = self.settings.clone();
        if mem::take(&mut self.takes_over) {
            settings.loading = Loading::All;
        }
        let moved = self.last_view.replace(view) != Some(view);
        if self.settles_culling(moved) {
            self.renderer.draw_again();
            ctx.request_repaint();
        }
        match self.renderer.render(&view, &settings) {
            Ok(stats) if stats.unchanged => {
                self.frames_skipped += 1;
                self.bytes_read += stats.bytes_read;
                self.drawn.stream = stats.stream;
                self.drawn.nodes_requested = stats.nodes_requested;
                if !stats.complete {
                    // Nodes under way say when they are there; this is in case none does.
                    ctx.request_repaint_after(LONGEST_WAIT);
                }
                // The GPU's own times come after the frame that they are of.
                if stats.passes.iter().any(|time| time.clock == "gpu") {
                    self.drawn.passes.retain(|time| time.clock != "gpu");
                    self.drawn.passes.extend(stats.passes.iter().filter(|t| t.clock == "gpu"));
                }
            }
            Ok(stats) => {
                self.drawn = stats.clone();
                self.frames_drawn += 1;
                self.bytes_read += stats.bytes_read;
                self.bytes_uploaded += stats.bytes_uploaded;
                self.canvas.take(ctx, &self.renderer);
                self.follow_culling();
                if mem::take(&mut self.is_new_scene) {
                    let has_preview = self.files.iter().any(|f| f.kept_in == KeptIn::Preview);
                    self.reach(if has_preview { "preview" } else { "scene" });
                }
                if !self.drawn.complete || self.drawn.nodes_appearing > 0 {
                    ctx.request_repaint();
                }
                for problem in self.drawn.problems.clone() {
                    self.note(problem, true);
                }
            }
            Err(FrameError::Gpu(GpuError::Lost { reason })) => {
                self.note(format!("the graphics device was lost: {reason}"), true);
                self.device_lost = Some(reason);
            }
            Err(error) => {
                self.note(error.to_string(), true);
                self.refused = Some(request);
            }
        }
    }

    /// Notes when something was reached first.
    fn reach(&mut self, what: &'static str) {
        if self.milestones.len() < MAX_MILESTONES
            && let Some(began) = self.options.began
        {
            let points = self.files.iter().map(|file| file.store.metadata().points).sum();
            let seconds = began.elapsed().as_secs_f64();
            self.milestones.push(Milestone { what, points, seconds });
        }
    }

    pub(super) fn view(&self) -> View {
        self.control.view(self.size_px.0, self.size_px.1)
    }
}

/// Paints the window for a sign of the thread that opens files.
pub(super) fn wake_for(ctx: &egui::Context, sign: Sign) {
    match sign {
        // The bar shows it when it moves next.
        Sign::Begun => {}
        Sign::News => ctx.request_repaint_after(SOON),
    }
}

/// The largest part of a rectangle that ends at whole pixels, and its size in pixels.
fn whole_pixels(rect: Rect, pixels_per_point: f32) -> (Rect, (u32, u32)) {
    let min = (rect.min.to_vec2() * pixels_per_point).ceil();
    let max = (rect.max.to_vec2() * pixels_per_point).floor();
    let size = (max - min).max(egui::Vec2::ZERO);
    let rect = Rect::from_min_size((min / pixels_per_point).to_pos2(), size / pixels_per_point);
    (rect, (size.x as u32, size.y as u32))
}

fn background(settings: &FrameSettings) -> Color32 {
    let [r, g, b, _] = settings.background.to_le_bytes();
    Color32::from_rgb(r, g, b)
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    /// Painting takes from a conversion where processors paint.
    #[test]
    fn only_news_paint_the_window_and_once() {
        let ctx = egui::Context::default();
        let asked: Arc<Mutex<Vec<Duration>>> = Arc::default();
        let delays = Arc::clone(&asked);
        ctx.set_request_repaint_callback(move |info| {
            delays.lock().expect("nobody panics with it").push(info.delay);
        });
        wake_for(&ctx, Sign::Begun);
        assert!(asked.lock().expect("nobody panics with it").is_empty());
        wake_for(&ctx, Sign::News);
        // What is asked for without a delay is painted twice.
        assert_eq!(*asked.lock().expect("nobody panics with it"), [SOON]);
    }
}
