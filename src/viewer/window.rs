//! The window itself: device, event loop, title, and how it ends.
//!
//! The window's device is opened with what the frame can use of the adapter, so that points are
//! drawn and shown on one device without a copy. Software adapters will do.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use egui::{ColorImage, ViewportBuilder, ViewportCommand};

use crate::build;
use crate::frame::{RasterPath, Renderer};
use crate::gpu::{Gpu, adapter_preference, wanted_features, wanted_limits};
use crate::stream::StreamSettings;
use crate::viewer::app::{Viewer, ViewerOptions, wake_for};
use crate::viewer::canvas::Canvas;
use crate::viewer::opening::Opening;

/// What `esker view` asks for.
#[derive(Clone, Debug, Default)]
pub struct WindowOptions {
    /// Files to open; none shows an empty window to drop one on.
    pub files: Vec<PathBuf>,
    /// How points are drawn; the best that the adapter can, if not told.
    pub path: Option<RasterPath>,
    /// Most bytes of points held; a share of the machine's memory, if not told.
    pub node_limit_bytes: Option<u64>,
    /// Most bytes of main memory for nodes that wait or may return; by default a quarter of what
    /// there is.
    pub cache_bytes: Option<u64>,
    /// Most points drawn, if told.
    pub point_budget: Option<u64>,
    /// Size of the window, points.
    pub size: (u32, u32),
    /// Close after that time.
    pub exit_after: Option<Duration>,
    /// Write a picture of the whole window before closing after `exit_after`.
    pub screenshot: Option<PathBuf>,
    /// Everything else.
    pub viewer: ViewerOptions,
}

/// Budget where a program on the CPU draws, so that the view still follows the hand.
const SOFTWARE_POINT_BUDGET: u64 = 2_000_000;

/// Looks at how far a conversion is where a program on the CPU paints: a window of a million pixels
/// takes it some hundredths of a second on all cores.
const SOFTWARE_PROGRESS_EVERY: Duration = Duration::from_secs(1);

/// Shows the window until it is closed. `interrupted` is what a signal sets; it closes the window.
pub fn run(mut options: WindowOptions, interrupted: Arc<AtomicBool>) -> anyhow::Result<()> {
    let outcome = Arc::new(Mutex::new(None));
    let (width, height) = options.size;
    // Files are opened while the window and its device come up.
    let files = std::mem::take(&mut options.files);
    let painter: Arc<OnceLock<egui::Context>> = Arc::default();
    let opening = match files.is_empty() {
        true => None,
        false => {
            let painter = Arc::clone(&painter);
            let wake = Arc::new(move |sign| {
                // Before there is a window it needs no waking: it asks when it is there.
                if let Some(ctx) = painter.get() {
                    wake_for(ctx, sign);
                }
            });
            let opening = Opening::start(files, options.viewer.opening.clone(), wake);
            Some(opening.context("cannot start a thread")?)
        }
    };
    let native = eframe::NativeOptions {
        viewport: ViewportBuilder::default()
            .with_inner_size([width as f32, height as f32])
            .with_app_id("esker")
            .with_drag_and_drop(true),
        renderer: eframe::Renderer::Wgpu,
        wgpu_options: wgpu_configuration(),
        // Points are shown as they were drawn.
        dithering: false,
        ..Default::default()
    };
    let told = Arc::clone(&outcome);
    let ended = eframe::run_native(
        "Esker",
        native,
        Box::new(move |created| {
            let mut window = Window::new(created, options, told, interrupted)?;
            // The context is set once, here.
            let _ = painter.set(created.egui_ctx.clone());
            if let Some(opening) = opening {
                window.viewer.follow(opening);
            }
            Ok(Box::new(window))
        }),
    );
    if let Some(error) = take(&outcome) {
        return Err(error);
    }
    ended.map_err(explained)
}

type Outcome = Arc<Mutex<Option<anyhow::Error>>>;

fn take(outcome: &Outcome) -> Option<anyhow::Error> {
    outcome.lock().unwrap_or_else(PoisonError::into_inner).take()
}

fn wgpu_configuration() -> egui_wgpu::WgpuConfiguration {
    let mut setup = egui_wgpu::WgpuSetupCreateNew::without_display_handle();
    setup.native_adapter_selector = Some(Arc::new(select_adapter));
    setup.device_descriptor = Arc::new(|adapter| wgpu::DeviceDescriptor {
        label: Some("esker"),
        required_features: wanted_features(adapter),
        required_limits: wanted_limits(adapter),
        ..Default::default()
    });
    egui_wgpu::WgpuConfiguration { wgpu_setup: setup.into(), ..Default::default() }
}

fn select_adapter(
    adapters: &[wgpu::Adapter],
    surface: Option<&wgpu::Surface<'_>>,
) -> Result<wgpu::Adapter, String> {
    let shows = |adapter: &&wgpu::Adapter| {
        surface.is_none_or(|surface| adapter.is_surface_supported(surface))
    };
    let best = adapters.iter().filter(shows).min_by_key(|adapter| adapter_preference(adapter));
    best.cloned().ok_or_else(|| match adapters.len() {
        0 => "no GPU and no software driver answers".to_owned(),
        count => format!("none of {count} adapters can show a window here"),
    })
}

/// What failed, and what helps.
fn explained(error: eframe::Error) -> anyhow::Error {
    match error {
        eframe::Error::Wgpu(error) => anyhow!(
            "no graphics adapter for a window: {error}. A Vulkan driver is needed: on Debian or \
             Ubuntu install libvulkan1 and mesa-vulkan-drivers (the latter draws without a GPU \
             too). `esker render` makes pictures without any"
        ),
        eframe::Error::WinitEventLoop(error) => {
            // Before the reason stands a place in somebody else's source.
            let text = error.to_string();
            let reason = text.rsplit(": ").next().unwrap_or(&text).trim_end_matches('.');
            anyhow!(
                "no display to open a window on: {reason}. `esker render` makes pictures without \
                 one"
            )
        }
        eframe::Error::AppCreation(error) => anyhow!("{error}"),
        other => anyhow!("cannot open a window: {other}"),
    }
}

struct Window {
    viewer: Viewer,
    outcome: Outcome,
    interrupted: Arc<AtomicBool>,
    device_errors: Arc<Mutex<Vec<String>>>,
    started: Instant,
    exit_after: Option<Duration>,
    screenshot: Screenshot,
    title: String,
}

/// The picture of the whole window that is made before it closes.
enum Screenshot {
    NotAsked,
    Wanted(PathBuf),
    Coming(PathBuf, Arc<Mutex<Option<Arc<ColorImage>>>>),
}

impl Window {
    fn new(
        created: &eframe::CreationContext<'_>,
        mut options: WindowOptions,
        outcome: Outcome,
        interrupted: Arc<AtomicBool>,
    ) -> anyhow::Result<Window> {
        let state = created.wgpu_render_state.clone().context("the window has no device")?;
        let gpu = Gpu::from_device(&state.adapter, state.device.clone(), state.queue.clone());
        let device_errors: Arc<Mutex<Vec<String>>> = Arc::default();
        let errors = Arc::clone(&device_errors);
        // Without a handler an error that nobody waits for would end the program.
        state.device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            errors.lock().unwrap_or_else(PoisonError::into_inner).push(error.to_string());
        }));
        let gpu = Arc::new(gpu);
        let memory_bytes = build::available_memory();
        let limit_bytes = options.node_limit_bytes.unwrap_or(match gpu.is_software() {
            true => memory_bytes / 4,
            false => (2 << 30).min(memory_bytes / 2),
        });
        options.viewer.node_limit_bytes = limit_bytes;
        options.viewer.adapter = gpu.description();
        let budget = options.point_budget.or(gpu.is_software().then_some(SOFTWARE_POINT_BUDGET));
        if let Some(point_budget) = budget {
            options.viewer.frame.cut.point_budget = point_budget;
        }
        if gpu.is_software() {
            options.viewer.progress_every = SOFTWARE_PROGRESS_EVERY;
            // Whatever fades in paints all of the window again and again.
            created.egui_ctx.all_styles_mut(|style| style.animation_time = 0.0);
        }
        let (mut renderer, problems) = open_renderer(&gpu, options.path, limit_bytes)?;
        let memory_bytes = options.cache_bytes.unwrap_or(memory_bytes / 4);
        renderer.set_streaming(StreamSettings { memory_bytes, ..StreamSettings::default() });
        let ctx = created.egui_ctx.clone();
        renderer.set_wake(Arc::new(move || ctx.request_repaint()));
        let mut viewer = Viewer::new(renderer, Canvas::of_window(state), options.viewer);
        problems.into_iter().for_each(|problem| viewer.note(problem, true));
        wake_on_interrupt(created.egui_ctx.clone(), Arc::clone(&interrupted));
        Ok(Window {
            viewer,
            outcome,
            interrupted,
            device_errors,
            started: Instant::now(),
            exit_after: options.exit_after,
            screenshot: options.screenshot.map_or(Screenshot::NotAsked, Screenshot::Wanted),
            title: String::new(),
        })
    }

    fn fail(&mut self, ctx: &egui::Context, error: anyhow::Error) {
        let mut outcome = self.outcome.lock().unwrap_or_else(PoisonError::into_inner);
        outcome.get_or_insert(error);
        ctx.send_viewport_cmd(ViewportCommand::Close);
    }

    /// Closes when the time has come, after the picture of the window.
    fn end_in_time(&mut self, ctx: &egui::Context) {
        let Some(exit_after) = self.exit_after else { return };
        let left = exit_after.saturating_sub(self.started.elapsed());
        if !left.is_zero() {
            ctx.request_repaint_after(left);
            return;
        }
        match &self.screenshot {
            Screenshot::NotAsked => ctx.send_viewport_cmd(ViewportCommand::Close),
            Screenshot::Wanted(path) => {
                let image: Arc<Mutex<Option<_>>> = Arc::default();
                let (slot, waker) = (Arc::clone(&image), ctx.clone());
                ctx.request_screenshot(move |taken| {
                    *slot.lock().unwrap_or_else(PoisonError::into_inner) = Some(taken);
                    waker.request_repaint();
                });
                self.screenshot = Screenshot::Coming(path.clone(), image);
                ctx.request_repaint();
            }
            Screenshot::Coming(path, slot) => {
                let taken = slot.lock().unwrap_or_else(PoisonError::into_inner).take();
                let Some(image) = taken else {
                    ctx.request_repaint_after(Duration::from_millis(50));
                    return;
                };
                let saved = save(&image, path);
                self.screenshot = Screenshot::NotAsked;
                match saved {
                    Ok(()) => ctx.send_viewport_cmd(ViewportCommand::Close),
                    Err(error) => self.fail(ctx, error),
                }
            }
        }
    }
}

impl eframe::App for Window {
    fn logic(&mut self, ctx: &egui::Context, _: &mut eframe::Frame) {
        if self.interrupted.load(Ordering::Relaxed) {
            ctx.send_viewport_cmd(ViewportCommand::Close);
        }
        let errors =
            std::mem::take(&mut *self.device_errors.lock().unwrap_or_else(PoisonError::into_inner));
        for error in errors {
            self.viewer.note(format!("the graphics device refused work: {error}"), true);
        }
        self.viewer.logic(ctx);
        if let Some(reason) = self.viewer.device_lost() {
            // The window is on the same device, so no line in it could tell.
            self.fail(ctx, anyhow!("the graphics device was lost: {reason}"));
        }
        let title = self.viewer.title();
        if title != self.title {
            ctx.send_viewport_cmd(ViewportCommand::Title(title.clone()));
            self.title = title;
        }
        self.end_in_time(ctx);
    }

    fn ui(&mut self, ui: &mut egui::Ui, _: &mut eframe::Frame) {
        self.viewer.ui(ui);
        if self.viewer.device_lost().is_some() {
            ui.ctx().request_repaint();
        }
    }

    fn on_exit(&mut self) {
        if let Err(error) = self.viewer.finish() {
            let mut outcome = self.outcome.lock().unwrap_or_else(PoisonError::into_inner);
            outcome.get_or_insert(error);
        }
    }
}

/// A renderer for the wanted path, or for the best there is, and why others were not taken.
fn open_renderer(
    gpu: &Arc<Gpu>,
    path: Option<RasterPath>,
    limit_bytes: u64,
) -> anyhow::Result<(Renderer, Vec<String>)> {
    if let Some(path) = path {
        return Ok((Renderer::on_gpu(Arc::clone(gpu), path, limit_bytes)?, Vec::new()));
    }
    let mut problems = Vec::new();
    for path in RasterPath::offered_by(gpu) {
        match Renderer::on_gpu(Arc::clone(gpu), path, limit_bytes) {
            Ok(renderer) => return Ok((renderer, problems)),
            Err(error) => problems.push(format!("{error}; another way of drawing is used")),
        }
    }
    Ok((Renderer::on_cpu(limit_bytes), problems))
}

/// Paints the window once a signal has come, so that it sees it.
fn wake_on_interrupt(ctx: egui::Context, interrupted: Arc<AtomicBool>) {
    let wake = move || {
        interrupted.store(true, Ordering::Relaxed);
        ctx.request_repaint();
    };
    // Fails only if there is a handler already, and then the signal ends the program as ever.
    let _ = ctrlc::set_handler(wake);
}

fn save(image: &ColorImage, path: &std::path::Path) -> anyhow::Result<()> {
    let [width, height] = image.size;
    let bytes: Vec<u8> = image.pixels.iter().flat_map(|pixel| pixel.to_array()).collect();
    image::save_buffer_with_format(
        path,
        &bytes,
        width as u32,
        height as u32,
        image::ExtendedColorType::Rgba8,
        image::ImageFormat::Png,
    )
    .with_context(|| format!("{}: cannot write", path.display()))
}
