//! The study *options* of the suite `lod`: what each way to show points costs and changes.
//!
//! The views are drawn with one option at a time: what it costs, and how far the picture is from
//! the reference. Eye-dome lighting changes colours on purpose, so of its row only cost and holes
//! mean anything. What changes from picture to picture is in `steps`.

use std::fmt::Write;
use std::sync::Arc;
use std::time::Instant;

use serde::Serialize;

use crate::build::available_memory;
use crate::commands::bench::lod::pixels;
use crate::commands::bench::lod_tables::{count, percent};
use crate::commands::bench::{BenchArgs, cameras, steps, write_file};
use crate::frame::{ColorMode, FrameSettings, NodeSource, RasterPath, Renderer, reference_picture};
use crate::geometry::View;
use crate::metrics::{PictureError, compare};
use crate::passes::{EyeDome, Picture};
use crate::select::{SplatShape, SplatSize};

/// One option at one view. A row of the CSV file.
#[derive(Clone, Debug, Serialize)]
struct Row {
    view: String,
    option: &'static str,
    points_drawn: u64,
    splat_pixels: u64,
    passes: u32,
    frame_ms: f64,
    error: PictureError,
}

/// What an option changes.
pub(super) type Change = fn(&mut FrameSettings);

/// The options, the default first.
const OPTIONS: [(&str, Change); 16] = [
    ("default", |_| {}),
    ("fixed 1 px", |s| s.cut.splat.size = SplatSize::Fixed { px: 1.0 }),
    ("fixed 2 px", |s| s.cut.splat.size = SplatSize::Fixed { px: 2.0 }),
    ("fixed 3 px", |s| s.cut.splat.size = SplatSize::Fixed { px: 3.0 }),
    ("attenuated", |s| s.cut.splat.size = SplatSize::Attenuated { length: 0.0 }),
    ("attenuated x2", |s| {
        s.cut.splat.size = SplatSize::Attenuated { length: 0.0 };
        s.cut.splat.multiplier = 2.0;
    }),
    ("round", |s| s.cut.splat.shape = SplatShape::Round),
    ("sphere", |s| s.cut.splat.shape = SplatShape::Sphere),
    ("gaps 2", |s| s.finish.gap_radius_px = 2),
    ("1 px, gaps 1", |s| gaps_of_single_pixels(s, 1)),
    ("1 px, gaps 2", |s| gaps_of_single_pixels(s, 2)),
    ("1 px, gaps 3", |s| gaps_of_single_pixels(s, 3)),
    ("eye-dome", |s| s.finish.eye_dome = Some(EyeDome::default())),
    ("continuous", |s| s.cut.continuous = true),
    ("continuous, 1 px", |s| {
        s.cut.continuous = true;
        s.cut.splat.size = SplatSize::Fixed { px: 1.0 };
    }),
    ("off axis", |s| s.cut.rule.off_axis = true),
];

fn gaps_of_single_pixels(settings: &mut FrameSettings, radius_px: u32) {
    settings.cut.splat.size = SplatSize::Fixed { px: 1.0 };
    settings.finish.gap_radius_px = radius_px;
}

/// Runs the study and those of steps for one scan and writes their files.
pub fn run(args: &BenchArgs, name: &str, source: Arc<dyn NodeSource>) -> anyhow::Result<()> {
    let default_size = if args.quick { (640, 360) } else { (1280, 720) };
    let size = args.size.unwrap_or(default_size);
    let mut renderer = best_renderer();
    renderer.set_scene(vec![Arc::clone(&source)]);
    let views = cameras::views_of(source.as_ref(), size)?;
    let mut rows = Vec::new();
    for (view_name, view) in views.iter().step_by(if args.quick { 3 } else { 1 }) {
        rows.extend(options_of(&mut renderer, source.as_ref(), view_name, view)?);
    }
    print!("{}", options_table(&rows, renderer.path()));
    let mut csv = String::from(
        "view,option,points_drawn,splat_pixels,passes,frame_ms,hole_fraction,excess_fraction,\
         rmse,ssim\n",
    );
    for row in &rows {
        let error = &row.error;
        let _ = writeln!(
            csv,
            "\"{}\",\"{}\",{},{},{},{:.3},{:.8},{:.8},{:.4},{:.6}",
            row.view,
            row.option,
            row.points_drawn,
            row.splat_pixels,
            row.passes,
            row.frame_ms,
            error.hole_fraction,
            error.excess_fraction,
            error.rmse,
            error.ssim
        );
    }
    write_file(&args.output.join(format!("lod-options-{name}.csv")), &csv)?;
    if let Some((_, view)) = views.first() {
        steps::run(args, name, &mut renderer, source.as_ref(), view)?;
    }
    Ok(())
}

/// A renderer by the best path there is.
fn best_renderer() -> Renderer {
    let limit_bytes = available_memory() / 2;
    #[cfg(feature = "gpu")]
    if let Ok(gpu) = crate::gpu::Gpu::open() {
        let gpu = Arc::new(gpu);
        let path = RasterPath::offered_by(&gpu).into_iter().next();
        let renderer =
            path.and_then(|path| Renderer::on_gpu(Arc::clone(&gpu), path, limit_bytes).ok());
        if let Some(renderer) = renderer {
            return renderer;
        }
    }
    Renderer::on_cpu(limit_bytes)
}

fn options_of(
    renderer: &mut Renderer,
    source: &dyn NodeSource,
    view_name: &str,
    view: &View,
) -> anyhow::Result<Vec<Row>> {
    let base = FrameSettings { color: ColorMode::Auto, ..FrameSettings::default() };
    let reference = reference_picture(source, view, &base.color, base.background)?;
    if reference.covered() == 0 {
        return Ok(Vec::new());
    }
    let mut rows = Vec::new();
    for (option, change) in OPTIONS {
        let mut settings = base.clone();
        change(&mut settings);
        let (picture, frame_ms) = drawn(renderer, view, &settings, 3)?;
        let stats = renderer.stats();
        rows.push(Row {
            view: view_name.to_owned(),
            option,
            points_drawn: stats.points_drawn,
            splat_pixels: stats.splat_pixels,
            passes: stats.draw_calls + stats.dispatches,
            frame_ms,
            error: compare(pixels(&reference), pixels(&picture)),
        });
    }
    Ok(rows)
}

/// The picture and the least time of some frames after the first.
pub(super) fn drawn(
    renderer: &mut Renderer,
    view: &View,
    settings: &FrameSettings,
    times: usize,
) -> anyhow::Result<(Picture, f64)> {
    let mut least_ms = f64::INFINITY;
    for turn in 0..=times {
        // A picture that still holds is not drawn: the camera moves by what no pixel shows.
        let mut moved = *view;
        moved.camera.near *= 1.0 + 1e-9 * turn as f64;
        let start = Instant::now();
        renderer.render(&moved, settings)?;
        // Picking waits for the device, as short as any reading back is.
        renderer.pick(0, 0, 0)?;
        if turn > 0 {
            least_ms = least_ms.min(start.elapsed().as_secs_f64() * 1e3);
        }
    }
    if let Some(problem) = renderer.stats().problems.first() {
        anyhow::bail!("{problem}");
    }
    let picture = renderer.read_picture()?;
    Ok((picture.ok_or_else(|| anyhow::anyhow!("nothing was drawn"))?, least_ms))
}

fn options_table(rows: &[Row], path: RasterPath) -> String {
    let mut out = format!(
        "Options at 1 px, at most 5 M points, drawn by {}: means over the views\n{:<20}{:>9}{:>11}\
         {:>8}{:>10}{:>11}{:>11}{:>11}{:>8}{:>8}\n",
        path.name(),
        "option",
        "points",
        "splat px",
        "passes",
        "frame ms",
        "holes",
        "most holes",
        "excess",
        "RMSE",
        "SSIM"
    );
    for (option, _) in OPTIONS {
        let of: Vec<&Row> = rows.iter().filter(|row| row.option == option).collect();
        let mean = |value: &dyn Fn(&Row) -> f64| {
            of.iter().map(|row| value(row)).sum::<f64>() / of.len().max(1) as f64
        };
        let most = of.iter().map(|row| row.error.hole_fraction).fold(0.0, f64::max);
        let _ = writeln!(
            out,
            "{option:<20}{:>9}{:>11}{:>8.1}{:>10.1}{:>11}{:>11}{:>11}{:>8.2}{:>8.4}",
            count(mean(&|row| row.points_drawn as f64)),
            count(mean(&|row| row.splat_pixels as f64)),
            mean(&|row| f64::from(row.passes)),
            mean(&|row| row.frame_ms),
            percent(mean(&|row| row.error.hole_fraction)),
            percent(most),
            percent(mean(&|row| row.error.excess_fraction)),
            mean(&|row| row.error.rmse),
            mean(&|row| row.error.ssim),
        );
    }
    out.push('\n');
    out
}
