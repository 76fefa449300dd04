//! The studies *options* and *steps* of the suite `lod`: what each way to show points changes.
//!
//! *Options* draws the views with one option at a time: what it costs, and how far the picture is
//! from the reference. Eye-dome lighting changes colours on purpose, so of its row only cost and
//! holes mean anything. *Steps* moves the camera towards the cloud in small steps and compares each
//! picture with the one before: levels that come at once show as steps with a larger change than
//! the others. All points drawn are the measure of what the motion alone changes.

use std::fmt::Write;
use std::sync::Arc;
use std::time::Instant;

use serde::Serialize;

use crate::build::available_memory;
use crate::commands::bench::lod::{count, percent, pixels};
use crate::commands::bench::plot::{Panel, Scale, Series, svg};
use crate::commands::bench::{BenchArgs, cameras, write_file};
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

type Change = fn(&mut FrameSettings);

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

/// Steps of the camera, and how much nearer each is.
const STEPS: usize = 48;
const QUICK_STEPS: usize = 12;
const STEP: f64 = 0.985;

/// Runs both studies for one scan and writes their files.
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
        steps(args, name, &mut renderer, source.as_ref(), view)?;
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
fn drawn(
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

/// Pictures of a camera that moves towards the cloud: how much each differs from the one before.
fn steps(
    args: &BenchArgs,
    name: &str,
    renderer: &mut Renderer,
    source: &dyn NodeSource,
    start: &View,
) -> anyhow::Result<()> {
    let count_of = if args.quick { QUICK_STEPS } else { STEPS };
    let size = args.size.unwrap_or((640, 360));
    let center = source.bounds().center();
    let views: Vec<View> = (0..count_of)
        .map(|step| {
            let mut view = View { width_px: size.0, height_px: size.1, ..*start };
            view.camera.eye = center + (view.camera.eye - center) * STEP.powi(step as i32);
            view
        })
        .collect();
    let ways: [(&str, Change); 4] = [
        ("plain", |_| {}),
        ("continuous", |s| s.cut.continuous = true),
        ("all points", |s| {
            s.cut.error_px = 0.0;
            s.cut.point_budget = u64::MAX;
            s.cut.splat.size = SplatSize::Fixed { px: 1.0 };
        }),
        ("plain, 0.5 px", |s| s.cut.error_px = 0.5),
    ];
    let mut out = format!(
        "Steps: the camera goes {:.1} % nearer {} times; change of colours from picture to \
         picture (RMSE)\n{:<16}{:>9}{:>12}{:>12}{:>12}{:>14}{:>12}\n",
        100.0 * (1.0 - STEP),
        count_of - 1,
        "levels",
        "points",
        "mean change",
        "largest",
        "sudden",
        "points, step",
        "error"
    );
    let mut series = Vec::new();
    for (way, change) in ways {
        let mut settings = FrameSettings { color: ColorMode::Auto, ..FrameSettings::default() };
        change(&mut settings);
        let (mut changes, mut points, mut errors) = (Vec::new(), Vec::new(), Vec::new());
        let mut before: Option<Picture> = None;
        for (step, view) in views.iter().enumerate() {
            let (picture, _) = drawn(renderer, view, &settings, 0)?;
            points.push(renderer.stats().points_drawn as f64);
            if let Some(before) = &before {
                changes.push(compare(pixels(before), pixels(&picture)).rmse);
            }
            if step % 6 == 0 {
                let reference =
                    reference_picture(source, view, &settings.color, settings.background)?;
                errors.push(compare(pixels(&reference), pixels(&picture)).rmse);
            }
            before = Some(picture);
        }
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let largest = changes.iter().copied().fold(0.0, f64::max);
        // How far a change stands out from those beside it.
        let sudden = changes
            .windows(3)
            .map(|three| three[1] - 0.5 * (three[0] + three[2]))
            .fold(0.0, f64::max);
        let step = points.windows(2).map(|two| (two[1] / two[0] - 1.0).abs()).fold(0.0, f64::max);
        let _ = writeln!(
            out,
            "{way:<16}{:>9}{:>12.2}{largest:>12.2}{sudden:>12.2}{:>14}{:>12.2}",
            count(mean(&points)),
            mean(&changes),
            format!("{:.1} %", 100.0 * step),
            mean(&errors)
        );
        let places = changes.iter().enumerate().map(|(step, &change)| (step as f64, change));
        series.push(Series { name: way.to_owned(), points: places.collect() });
    }
    println!("{out}");
    let panel = Panel {
        title: "change from picture to picture".into(),
        x_label: "step".into(),
        y_label: "colour RMSE (0-255)".into(),
        x_scale: Scale::Linear,
        y_scale: Scale::Linear,
        series,
    };
    let heading = format!("{name}: a camera that moves in steps of {:.1} %", 100.0 * (1.0 - STEP));
    write_file(&args.output.join(format!("lod-steps-{name}.svg")), &svg(&heading, &[panel], 1))
}
