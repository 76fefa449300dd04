//! `esker render`: pictures of stores and scans without a window.

use std::fs;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use glam::DVec3;
use image::ImageEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use serde::Deserialize;
use serde_json::{Value, json};

use crate::build::{self, ConvertOptions};
use crate::commands::convert::cancelled_by_signal;
use crate::commands::info::is_store;
use crate::commands::inputs;
use crate::commands::models::{self, ModelArgs};
use crate::commands::picture_options::{PictureOptions, parse_in_range};
use crate::commands::progress::{ProgressKind, listener};
use crate::commands::quantities::{parse_count, parse_picture_size, show_bytes};
use crate::commands::show_culling;
use crate::frame::{ColorMode, FrameError, FrameSettings, NodeSource, Renderer};
use crate::geometry::{Aabb, Camera, View, ViewPreset};
#[cfg(feature = "gpu")]
use crate::gpu::Gpu;
use crate::input::Cancel;
use crate::mesh::Model;
use crate::metrics::peak_rss_bytes;
use crate::passes::Picture;
use crate::select::LevelRule;
use crate::store::Store;

/// Arguments of `esker render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// Models (glTF, GLB, OBJ, STL, PLY with faces), stores, scans, and folders of models and scans,
    /// in one picture; scans are converted to a temporary store first
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// The picture to write; a camera path gives OUT-0000.png, OUT-0001.png, ...
    #[arg(short, long, value_name = "OUT.png")]
    output: PathBuf,
    /// Size of the picture, pixels
    #[arg(long, default_value = "1280x720", value_parser = parse_picture_size)]
    size: (u32, u32),
    /// top, front, left, iso, or a JSON file with a camera or a list of cameras: {"eye": [x, y, z],
    /// "target": [x, y, z], "up": [x, y, z], "fov_y_degrees": 60, "near": 0.1}, the last three
    /// optional
    #[arg(long, default_value = "iso", value_name = "PRESET|CAMERA.json")]
    view: String,
    /// Most points drawn, such as 2M
    #[arg(long, default_value = "5M", value_parser = parse_count)]
    budget: u64,
    /// Largest spacing of points on screen, pixels
    #[arg(long, default_value_t = 1.0, value_parser = parse_error_px)]
    error_px: f64,
    /// Time that a frame may take once its points are loaded, milliseconds: as many points as fit
    /// are drawn, at most --budget. Measures the machine first, which takes about a second
    #[arg(long, value_name = "T", value_parser = parse_time_ms)]
    time_ms: Option<f64>,
    /// Which cell's spacing counts
    #[arg(long, value_enum, default_value = "parent-edge")]
    rule: RuleChoice,
    /// What points are coloured by: auto, rgb, elevation, intensity, class, or any attribute
    #[arg(long, default_value = "auto")]
    color: String,
    /// How points are drawn
    #[arg(long, value_enum, default_value = "auto")]
    renderer: RendererChoice,
    #[command(flatten)]
    picture: PictureOptions,
    #[command(flatten)]
    models: ModelArgs,
    /// Colour of pixels without a point: #rrggbb, black, white or none (transparent)
    #[arg(long, default_value = "#1a1c20", value_parser = parse_background)]
    background: u32,
    /// Counters and times as JSON
    #[arg(long, value_name = "FILE.json")]
    stats: Option<PathBuf>,
    /// Folder of the temporary store [default: the system's]
    #[arg(long)]
    temp_dir: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum RendererChoice {
    /// The first of these that the adapter can
    Auto,
    /// Compute shaders with 64-bit atomics
    Compute,
    /// Compute shaders with 32-bit atomics, in two passes
    Compute32,
    /// The rasterizer
    Raster,
    /// All cores, no adapter
    Cpu,
}

impl RendererChoice {
    /// The path that was asked for; none leaves it to the adapter.
    #[cfg(feature = "gpu")]
    pub(super) fn path(self) -> Option<crate::frame::RasterPath> {
        use crate::frame::RasterPath;
        match self {
            RendererChoice::Auto => None,
            RendererChoice::Compute => Some(RasterPath::Compute),
            RendererChoice::Compute32 => Some(RasterPath::Compute32),
            RendererChoice::Raster => Some(RasterPath::Raster),
            RendererChoice::Cpu => Some(RasterPath::Cpu),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum RuleChoice {
    /// Edge of the node's own finest cell
    OwnEdge,
    /// Diagonal of the node's own finest cell
    OwnDiagonal,
    /// Edge of the parent's finest cell
    ParentEdge,
    /// Diagonal of the parent's finest cell
    ParentDiagonal,
}

/// Runs the command.
pub fn run(args: RenderArgs) -> anyhow::Result<ExitCode> {
    check_folder(&args.output)?;
    let (meshes, points) = models::split(inputs::expand_with_models(&args.files)?);
    let model = Arc::new(models::load(&meshes, &args.models.options())?);
    let (sources, _temporary) = open_sources(&args, points)?;
    let mut settings = frame_settings(&args, &sources)?;
    let bounds = sources.iter().fold(model.bounds(), |all, source| all.union(&source.bounds()));
    let (cameras, is_path) = cameras(&args, &bounds)?;
    // A single picture has no use for answers.
    settings.more_follow = is_path;
    let mut drawing = Drawing::new(&args, sources, model)?;
    let mut frames = Vec::new();
    for (index, camera) in cameras.into_iter().enumerate() {
        let output = if is_path { numbered(&args.output, index) } else { args.output.clone() };
        let view = View { camera, width_px: args.size.0, height_px: args.size.1 };
        let mut picture = drawing.picture(&view, &settings)?;
        let stats = drawing.renderer.stats().clone();
        let mut culled = String::new();
        if let Some(show) = args.picture.show_culling() {
            let renderer = &mut drawing.renderer;
            let counts;
            (picture, counts) = show_culling::shown(show, renderer, &view, &settings, picture)?;
            culled = format!("; boxes: {counts}");
        }
        write_png(&output, &picture)?;
        let meshes = match drawing.model.is_empty() {
            true => String::new(),
            false => {
                format!("{} triangles in {} objects, ", stats.triangles_drawn, stats.objects_drawn)
            }
        };
        println!(
            "{}: {}x{}, {meshes}{} points in {} nodes, {:.1} ms ({}, {} read){culled}",
            output.display(),
            view.width_px,
            view.height_px,
            stats.points_drawn,
            stats.nodes_drawn,
            stats.frame_ms,
            drawing.renderer.path().name(),
            show_bytes(stats.bytes_read),
        );
        let mut frame = serde_json::to_value(&stats)?;
        if let Some(object) = frame.as_object_mut() {
            object.insert("output".into(), json!(output));
        }
        frames.push(frame);
    }
    for problem in &drawing.renderer.stats().problems {
        eprintln!("esker: {problem}");
    }
    if let Some(path) = &args.stats {
        write_stats(path, &args, &settings, &drawing, frames, is_path)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// A renderer, and whether another may take its place.
struct Drawing {
    renderer: Renderer,
    sources: Vec<Arc<dyn NodeSource>>,
    model: Arc<Model>,
    adapter: Option<String>,
    limit_bytes: u64,
    may_change: bool,
}

impl Drawing {
    fn new(
        args: &RenderArgs,
        sources: Vec<Arc<dyn NodeSource>>,
        model: Arc<Model>,
    ) -> anyhow::Result<Self> {
        // Whole nodes are held for the prefixes that the budget counts.
        let limit_bytes = args.budget.saturating_mul(32).max(1 << 30);
        let (mut renderer, adapter) = open_renderer(args.renderer, limit_bytes)?;
        renderer.set_scene(sources.clone());
        renderer.set_model(model.clone());
        let may_change = args.renderer == RendererChoice::Auto;
        Ok(Drawing { renderer, sources, model, adapter, limit_bytes, may_change })
    }

    fn picture(&mut self, view: &View, settings: &FrameSettings) -> anyhow::Result<Picture> {
        match self.renderer.render_picture(view, settings) {
            Err(error) if self.may_change && !matches!(error, FrameError::View { .. }) => {
                eprintln!("esker: {error}; the CPU draws instead");
                self.may_change = false;
                self.adapter = None;
                self.renderer = Renderer::on_cpu(self.limit_bytes);
                self.renderer.set_scene(self.sources.clone());
                self.renderer.set_model(self.model.clone());
                Ok(self.renderer.render_picture(view, settings)?)
            }
            other => Ok(other?),
        }
    }
}

/// The renderer of a choice, and its adapter in words.
#[cfg(feature = "gpu")]
pub(super) fn open_renderer(
    choice: RendererChoice,
    limit_bytes: u64,
) -> anyhow::Result<(Renderer, Option<String>)> {
    use crate::frame::RasterPath;
    if choice == RendererChoice::Cpu {
        return Ok((Renderer::on_cpu(limit_bytes), None));
    }
    let opened = Gpu::open().map_err(anyhow::Error::from).and_then(|gpu| {
        let gpu = Arc::new(gpu);
        let offered = RasterPath::offered_by(&gpu);
        let best = offered.first().copied().unwrap_or(RasterPath::Raster);
        let path = choice.path().unwrap_or(best);
        let description = gpu.description();
        Ok((Renderer::on_gpu(gpu, path, limit_bytes)?, Some(description)))
    });
    match opened {
        Err(error) if choice == RendererChoice::Auto => {
            eprintln!("esker: {error}; the CPU draws instead");
            Ok((Renderer::on_cpu(limit_bytes), None))
        }
        other => other,
    }
}

/// The renderer of a choice, and its adapter in words.
#[cfg(not(feature = "gpu"))]
pub(super) fn open_renderer(
    choice: RendererChoice,
    limit_bytes: u64,
) -> anyhow::Result<(Renderer, Option<String>)> {
    match choice {
        RendererChoice::Auto | RendererChoice::Cpu => Ok((Renderer::on_cpu(limit_bytes), None)),
        _ => bail!("this program was built without the feature gpu: only --renderer cpu is there"),
    }
}

/// The sources, and the folder that holds temporary ones until it is dropped.
type Opened = (Vec<Arc<dyn NodeSource>>, Option<tempfile::TempDir>);

fn open_sources(args: &RenderArgs, files: Vec<PathBuf>) -> anyhow::Result<Opened> {
    let (stores, scans): (Vec<_>, Vec<_>) = files.into_iter().partition(|path| is_store(path));
    let mut sources: Vec<Arc<dyn NodeSource>> = Vec::new();
    for path in &stores {
        sources.push(Arc::new(Store::open(path)?));
    }
    if scans.is_empty() {
        return Ok((sources, None));
    }
    let mut builder = tempfile::Builder::new();
    builder.prefix("esker-render-");
    let folder = match &args.temp_dir {
        Some(parent) => builder.tempdir_in(parent),
        None => builder.tempdir(),
    }
    .context("cannot make a temporary folder")?;
    let start = Instant::now();
    let path = folder.path().join("scans.esker");
    let progress = listener(ProgressKind::Bar);
    let cancelled = cancelled_by_signal();
    let mut options = ConvertOptions::default();
    options.read.cancel = Cancel::when(&cancelled);
    let report = build::convert(&scans, &path, &options, &*progress, &cancelled)?;
    drop(progress);
    for warning in &report.warnings {
        eprintln!("esker: {warning}");
    }
    eprintln!(
        "esker: converted {} points to a temporary store in {:.1} s",
        report.points,
        start.elapsed().as_secs_f64()
    );
    sources.push(Arc::new(Store::open(&path)?));
    Ok((sources, Some(folder)))
}

fn frame_settings(
    args: &RenderArgs,
    sources: &[Arc<dyn NodeSource>],
) -> anyhow::Result<FrameSettings> {
    let color: ColorMode = match args.color.parse() {
        Ok(mode) => mode,
        Err(never) => match never {},
    };
    check_color(&color, sources)?;
    let mut settings =
        FrameSettings { color, background: args.background, ..FrameSettings::default() };
    settings.cut.point_budget = args.budget;
    settings.cut.error_px = args.error_px;
    settings.target_ms = args.time_ms;
    settings.cut.rule = match args.rule {
        RuleChoice::OwnEdge => LevelRule::FOUR[0],
        RuleChoice::OwnDiagonal => LevelRule::FOUR[1],
        RuleChoice::ParentEdge => LevelRule::FOUR[2],
        RuleChoice::ParentDiagonal => LevelRule::FOUR[3],
    };
    args.picture.apply(&mut settings);
    Ok(settings)
}

/// Says so if no file has what points are to be coloured by.
fn check_color(color: &ColorMode, sources: &[Arc<dyn NodeSource>]) -> anyhow::Result<()> {
    if sources.iter().all(|source| source.octree().nodes().is_empty())
        || sources.iter().any(|source| color.is_offered_by(source.as_ref()))
    {
        return Ok(());
    }
    let mut offered: Vec<&str> = sources
        .iter()
        .flat_map(|source| &source.schema().attributes)
        .map(|attribute| attribute.name.as_str())
        .collect();
    offered.sort_unstable();
    offered.dedup();
    bail!("no file has '{color}' to colour by; there are auto, elevation, {}", offered.join(", "))
}

/// A camera in a file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraFile {
    eye: [f64; 3],
    target: [f64; 3],
    #[serde(default = "z_up")]
    up: [f64; 3],
    #[serde(default = "default_fov_y_degrees")]
    fov_y_degrees: f64,
    near: Option<f64>,
}

fn z_up() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

fn default_fov_y_degrees() -> f64 {
    60.0
}

/// The camera of a file with one.
#[cfg(feature = "viewer")]
pub(super) fn camera_in(path: &Path) -> anyhow::Result<Camera> {
    let name = path.display();
    let text = fs::read_to_string(path).with_context(|| {
        format!("{name}: neither a view (top, front, left, iso) nor a camera file")
    })?;
    let file: CameraFile =
        serde_json::from_str(&text).with_context(|| format!("{name}: not a camera"))?;
    camera_of(&file, &Aabb::EMPTY).map_err(|reason| anyhow::anyhow!("{name}: {reason}"))
}

/// The cameras of the view, and whether they are a path.
fn cameras(args: &RenderArgs, bounds: &Aabb) -> anyhow::Result<(Vec<Camera>, bool)> {
    if let Ok(preset) = args.view.parse::<ViewPreset>() {
        let aspect = f64::from(args.size.0) / f64::from(args.size.1);
        let fov_y_rad = default_fov_y_degrees().to_radians();
        return Ok((vec![Camera::framing(bounds, preset, fov_y_rad, aspect)], false));
    }
    let path = Path::new(&args.view);
    let name = path.display();
    let text = fs::read_to_string(path).with_context(|| {
        format!("{name}: neither a view (top, front, left, iso) nor a camera file")
    })?;
    let value: Value =
        serde_json::from_str(&text).with_context(|| format!("{name}: not a camera"))?;
    let (values, is_path) = match value {
        Value::Array(values) => (values, true),
        value => (vec![value], false),
    };
    if values.is_empty() {
        bail!("{name}: a list without cameras");
    }
    let cameras = values.into_iter().enumerate().map(|(index, value)| {
        let place = if is_path { format!("{name}: camera {index}") } else { name.to_string() };
        let file: CameraFile =
            serde_json::from_value(value).with_context(|| format!("{place}: not a camera"))?;
        camera_of(&file, bounds).map_err(|reason| anyhow::anyhow!("{place}: {reason}"))
    });
    Ok((cameras.collect::<anyhow::Result<_>>()?, is_path))
}

fn camera_of(file: &CameraFile, bounds: &Aabb) -> Result<Camera, String> {
    let numbers = file.eye.iter().chain(&file.target).chain(&file.up);
    if numbers.chain([&file.fov_y_degrees]).any(|number| !number.is_finite()) {
        return Err("a number is not finite".into());
    }
    if file.eye == file.target {
        return Err("eye and target are the same place".into());
    }
    if !(file.fov_y_degrees > 0.0 && file.fov_y_degrees < 180.0) {
        return Err(format!("fov_y_degrees {} is not between 0 and 180", file.fov_y_degrees));
    }
    let near = file.near.unwrap_or_else(|| Camera::near_for(bounds));
    if !(near.is_finite() && near > 0.0) {
        return Err(format!("near {near} is not above 0"));
    }
    let [eye, target, up] = [file.eye, file.target, file.up].map(DVec3::from);
    Ok(Camera::looking_at(eye, target, up, file.fov_y_degrees.to_radians(), near))
}

/// `out.png` becomes `out-0007.png`.
fn numbered(output: &Path, index: usize) -> PathBuf {
    let stem = output.file_stem().unwrap_or_default().to_string_lossy();
    let suffix = output.extension().unwrap_or_default().to_string_lossy();
    let dot = if suffix.is_empty() { "" } else { "." };
    output.with_file_name(format!("{stem}-{index:04}{dot}{suffix}"))
}

fn parent_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Refuses before any work what could not be written after it.
fn check_folder(output: &Path) -> anyhow::Result<()> {
    if output.is_dir() {
        bail!("{}: is a folder, not a picture", output.display());
    }
    if !parent_of(output).is_dir() {
        bail!("{}: there is no such folder", parent_of(output).display());
    }
    Ok(())
}

fn write_png(path: &Path, picture: &Picture) -> anyhow::Result<()> {
    write_whole(path, |file| {
        let encoder = PngEncoder::new_with_quality(
            BufWriter::new(file),
            CompressionType::Fast,
            FilterType::Adaptive,
        );
        // Words have red in the lowest byte, which is the first on the little-endian machines that
        // are supported.
        let bytes: &[u8] = bytemuck::cast_slice(&picture.colors);
        let (width, height) = (picture.width_px, picture.height_px);
        Ok(encoder.write_image(bytes, width, height, image::ExtendedColorType::Rgba8)?)
    })
}

/// Writes beside the final name, and takes the name only when all is written.
fn write_whole(
    path: &Path,
    write: impl FnOnce(&mut fs::File) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let attempt = || -> anyhow::Result<()> {
        let mut builder = tempfile::Builder::new();
        builder.prefix(".esker-");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // Narrowed by the umask, as for any file.
            builder.permissions(fs::Permissions::from_mode(0o666));
        }
        let mut file = builder.tempfile_in(parent_of(path))?;
        write(file.as_file_mut())?;
        file.as_file_mut().flush()?;
        file.persist(path)?;
        Ok(())
    };
    attempt().with_context(|| format!("{}: cannot write", path.display()))
}

fn write_stats(
    path: &Path,
    args: &RenderArgs,
    settings: &FrameSettings,
    drawing: &Drawing,
    mut frames: Vec<Value>,
    is_path: bool,
) -> anyhow::Result<()> {
    let mut stats = json!({
        "renderer": drawing.renderer.path().name(),
        "adapter": drawing.adapter,
        "width_px": args.size.0,
        "height_px": args.size.1,
        "color": settings.color.to_string(),
        "point_budget": args.budget,
        "error_px": args.error_px,
        "target_ms": args.time_ms,
        "rule": settings.cut.rule.name(),
        "splat": settings.cut.splat.policy.name(),
        "size_mode": settings.cut.splat.size.name(),
        "point_shape": settings.cut.splat.shape.name(),
        "points": drawing.sources.iter().map(|s| s.octree().point_count()).sum::<u64>(),
        "triangles": drawing.model.triangle_count(),
        "objects": drawing.model.objects.len(),
        "peak_rss_bytes": peak_rss_bytes(),
    });
    let object = stats.as_object_mut().expect("it was written as an object");
    match frames.pop() {
        Some(Value::Object(frame)) if !is_path => object.extend(frame),
        last => {
            frames.extend(last);
            object.insert("frames".into(), Value::Array(frames));
        }
    }
    write_whole(path, |file| Ok(serde_json::to_writer_pretty(file, &stats)?))
}

pub(super) fn parse_error_px(text: &str) -> Result<f64, String> {
    parse_in_range(text, 0.01, 1000.0)
}

/// A time of at least 0 that is a number.
fn parse_time_ms(text: &str) -> Result<f64, String> {
    parse_in_range(text, 0.0, 1e6)
}

/// Frames per second.
#[cfg(feature = "viewer")]
pub(super) fn parse_fps(text: &str) -> Result<f64, String> {
    parse_in_range(text, 1.0, 1000.0)
}

/// A colour as an RGBA8 word.
fn parse_background(text: &str) -> Result<u32, String> {
    match text {
        "black" => return Ok(0xff00_0000),
        "white" => return Ok(0xffff_ffff),
        "none" => return Ok(0),
        _ => {}
    }
    let is_rgb =
        |digits: &&str| digits.len() == 6 && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    let digits = text.strip_prefix('#').filter(is_rgb);
    let rgb = digits.and_then(|digits| u32::from_str_radix(digits, 16).ok());
    match rgb {
        Some(rgb) => Ok(0xff00_0000 | rgb.swap_bytes() >> 8),
        None => Err(format!("'{text}' is not #rrggbb, black, white or none")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backgrounds_have_red_lowest() {
        assert_eq!(parse_background("#1a1c20"), Ok(0xff20_1c1a));
        assert_eq!(parse_background("none"), Ok(0));
        for bad in ["#12345", "#12345g", "red", "#+12345"] {
            assert!(parse_background(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn numbers_stand_before_the_suffix() {
        assert_eq!(numbered(Path::new("a/b.c.png"), 12), Path::new("a/b.c-0012.png"));
        assert_eq!(numbered(Path::new("b"), 0), Path::new("b-0000"));
    }

    #[test]
    fn cameras_that_see_nothing_are_refused() {
        let camera = |text: &str| -> Result<Camera, String> {
            let file: CameraFile = serde_json::from_str(text).map_err(|e| e.to_string())?;
            camera_of(&file, &Aabb::EMPTY)
        };
        assert!(camera(r#"{"eye": [0, 0, 1], "target": [0, 0, 0]}"#).is_ok());
        for bad in [
            r#"{"eye": [0, 0, 0], "target": [0, 0, 0]}"#,
            r#"{"eye": [0, 0, 1], "target": [0, 0, 0], "fov_y_degrees": 180}"#,
            r#"{"eye": [0, 0, 1], "target": [0, 0, 0], "near": 0}"#,
            r#"{"eye": [0, 0, 1e999], "target": [0, 0, 0]}"#,
            r#"{"eye": [0, 0, "NaN"], "target": [0, 0, 0]}"#,
            r#"{"eye": [0, 0, 1], "target": [0, 0, 0], "fov": 60}"#,
        ] {
            assert!(camera(bad).is_err(), "{bad}");
        }
    }
}
