//! `esker view`: the interactive window.

use std::process::ExitCode;

use clap::Args;

/// Arguments of `esker view`.
#[cfg(feature = "viewer")]
#[derive(Debug, Args)]
pub struct ViewArgs {
    /// Stores, scans, models (glTF, GLB, OBJ, STL, PLY with faces), folders of these. Scans are shown at once by some of their points and
    /// converted, to NAME.esker beside them if nothing has that name and the folder can be written,
    /// else to a temporary store; those of a folder become one store beside it. Without files: an
    /// empty window to drop them on
    files: Vec<std::path::PathBuf>,
    /// The first view: top, front, left, iso, or a JSON file with a camera as `esker render` takes
    /// it; of that eye and target count
    #[arg(long, default_value = "iso", value_name = "PRESET|CAMERA.json")]
    view: String,
    /// Most points drawn, such as 2M [default: 5M, 2M without a GPU]
    #[arg(long, value_parser = crate::commands::quantities::parse_count)]
    budget: Option<u64>,
    /// Largest spacing of points on screen, pixels
    #[arg(long, default_value_t = 1.0, value_parser = crate::commands::render::parse_error_px)]
    error_px: f64,
    /// Frames per second to keep to: fewer points are drawn where more would take longer
    #[arg(long, value_name = "N", value_parser = crate::commands::render::parse_fps)]
    fps: Option<f64>,
    /// What points are coloured by: auto, rgb, elevation, intensity, class, or any attribute
    #[arg(long, default_value = "auto")]
    color: String,
    #[command(flatten)]
    picture: crate::commands::picture_options::PictureOptions,
    #[command(flatten)]
    models: crate::commands::models::ModelArgs,
    /// How points are drawn
    #[arg(long, value_enum, default_value = "auto")]
    renderer: crate::commands::render::RendererChoice,
    /// Most memory for points ready to be drawn, such as 2GiB
    #[arg(long, value_parser = crate::commands::quantities::parse_bytes)]
    point_memory: Option<u64>,
    /// Most main memory for points on their way or kept for their return, such as 2GiB; used only
    /// if the files do not fit --point-memory [default: a quarter of what there is]
    #[arg(long, value_parser = crate::commands::quantities::parse_bytes)]
    cache_memory: Option<u64>,
    /// Size of the window
    #[arg(long, default_value = "1280x800",
        value_parser = crate::commands::quantities::parse_picture_size)]
    size: (u32, u32),
    /// Convert scans to temporary stores, never beside them
    #[arg(long)]
    temporary: bool,
    /// Points of the first preview of scans that have no store yet; 0 for no previews
    #[arg(long, value_name = "POINTS", default_value = "250k", hide_short_help = true,
        value_parser = crate::commands::quantities::parse_count)]
    preview: u64,
    /// Counters as JSON, written at the end and whenever F5 is pressed
    #[arg(long, value_name = "FILE.json")]
    stats: Option<std::path::PathBuf>,
    /// Close after that many seconds (for tests)
    #[arg(long, value_name = "SECONDS", hide_short_help = true)]
    exit_after: Option<f64>,
    /// With --exit-after: write a picture of the window before closing
    #[arg(long, value_name = "FILE.png", hide_short_help = true, requires = "exit_after")]
    screenshot: Option<std::path::PathBuf>,
}

/// Runs the command.
#[cfg(feature = "viewer")]
pub fn run(args: ViewArgs) -> anyhow::Result<ExitCode> {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::{Duration, Instant};

    use crate::commands::inputs;
    use crate::viewer::{self, OpeningOptions, ViewerOptions, WindowOptions};

    let began = Instant::now();
    let mut frame = viewer::first_settings();
    frame.color = match args.color.parse() {
        Ok(mode) => mode,
        Err(never) => match never {},
    };
    frame.cut.error_px = args.error_px;
    frame.target_ms = args.fps.map(|fps| 1e3 / fps);
    args.picture.apply(&mut frame);
    let preset = args.view.parse();
    let start = match &preset {
        Ok(_) => None,
        Err(_) => Some(super::render::camera_in(args.view.as_ref())?),
    };
    let show = args.picture.show_culling();
    let exit_after = match args.exit_after.map(Duration::try_from_secs_f64) {
        None => None,
        Some(Ok(time)) => Some(time),
        Some(Err(error)) => anyhow::bail!("--exit-after: {error}"),
    };
    let options = WindowOptions {
        files: inputs::expand_files(&args.files)?,
        path: args.renderer.path(),
        node_limit_bytes: args.point_memory,
        cache_bytes: args.cache_memory,
        point_budget: args.budget,
        size: args.size,
        exit_after,
        screenshot: args.screenshot,
        viewer: ViewerOptions {
            frame,
            view: preset.unwrap_or_default(),
            start,
            shows_boxes: show.is_some(),
            second_camera: show == Some(super::picture_options::CullingShow::Above),
            opening: OpeningOptions {
                temporary: args.temporary,
                preview_points: Some(args.preview),
                list_folder: Some(inputs::expand_folder_with_models),
                models: args.models.options(),
                ..OpeningOptions::default()
            },
            began: Some(began),
            stats: args.stats,
            ..ViewerOptions::default()
        },
    };
    let interrupted = Arc::new(AtomicBool::new(false));
    viewer::run(options, Arc::clone(&interrupted))?;
    Ok(if interrupted.load(Ordering::Relaxed) { ExitCode::from(130) } else { ExitCode::SUCCESS })
}

/// Arguments of `esker view` in a program that has no window.
#[cfg(not(feature = "viewer"))]
#[derive(Debug, Args)]
pub struct ViewArgs {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    _any: Vec<std::ffi::OsString>,
}

/// Says that there is no window.
#[cfg(not(feature = "viewer"))]
pub fn run(_: ViewArgs) -> anyhow::Result<ExitCode> {
    anyhow::bail!(
        "this program was built without a window; build it with the feature viewer, or make \
         pictures with `esker render`"
    )
}
