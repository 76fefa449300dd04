//! The studies *steps* and *still* of the suite `lod`: what changes from picture to picture.
//!
//! *Steps* moves the camera towards the cloud in small steps and compares each picture with the one
//! before. All points drawn are the measure of what the motion alone changes, which is far more
//! than what levels change; there the number of points shows levels that come at once. *Still*
//! takes the motion away: the camera stands, and the error falls by what it falls by on screen when
//! the camera nears by a step. So the same nodes come in the same order, and whatever changes in
//! colour is popping.

use std::fmt::Write;

use crate::commands::bench::lod::pixels;
use crate::commands::bench::lod_tables::count;
use crate::commands::bench::options::{Change, drawn};
use crate::commands::bench::plot::{Panel, Scale, Series, svg};
use crate::commands::bench::{BenchArgs, write_file};
use crate::frame::{ColorMode, FrameSettings, NodeSource, Renderer, reference_picture};
use crate::geometry::View;
use crate::metrics::compare;
use crate::passes::Picture;
use crate::select::SplatSize;

/// Steps, and how much nearer each is.
const STEPS: usize = 48;
const QUICK_STEPS: usize = 12;
const STEP: f64 = 0.985;
/// One picture in so many is compared with the reference.
const COMPARED: usize = 6;

/// A way to show points, and what it changes.
type Way = (&'static str, Change);
/// View of a step, and what the error is multiplied by.
type At<'a> = &'a dyn Fn(i32) -> (View, f64);

const MOVING: [Way; 4] = [
    ("plain", |_| {}),
    ("continuous", |s| s.cut.continuous = true),
    ("all points", |s| {
        s.cut.error_px = 0.0;
        s.cut.point_budget = u64::MAX;
        s.cut.splat.size = SplatSize::Fixed { px: 1.0 };
    }),
    ("plain, 0.5 px", |s| s.cut.error_px = 0.5),
];

const STANDING: [Way; 4] = [
    ("plain", |_| {}),
    ("continuous", |s| s.cut.continuous = true),
    ("plain, 1 px", |s| s.cut.splat.size = SplatSize::Fixed { px: 1.0 }),
    ("continuous, 1 px", |s| {
        s.cut.continuous = true;
        s.cut.splat.size = SplatSize::Fixed { px: 1.0 };
    }),
];

/// Runs both studies for one scan, from a view towards its middle, and writes their plot.
pub fn run(
    args: &BenchArgs,
    name: &str,
    renderer: &mut Renderer,
    source: &dyn NodeSource,
    start: &View,
) -> anyhow::Result<()> {
    let steps = if args.quick { QUICK_STEPS } else { STEPS };
    let size = args.size.unwrap_or((640, 360));
    let start = View { width_px: size.0, height_px: size.1, ..*start };
    let center = source.bounds().center();
    let nearing = |step: i32| {
        let mut view = start;
        view.camera.eye = center + (view.camera.eye - center) * STEP.powi(step);
        (view, 1.0)
    };
    let standing = |step: i32| (start, STEP.powi(step));
    let percent = 100.0 * (1.0 - STEP);
    let mut panels = Vec::new();
    let studies: [(String, &[Way], At); 2] = [
        (format!("Steps: the camera goes {percent:.1} % nearer"), &MOVING, &nearing),
        (format!("Still: the error falls by {percent:.1} %"), &STANDING, &standing),
    ];
    for (title, ways, at) in studies {
        println!(
            "{title} {} times; change of colours from picture to picture (RMSE)\n\
             {:<18}{:>9}{:>12}{:>12}{:>12}{:>14}{:>12}",
            steps - 1,
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
            let walk = Walk::taken(renderer, source, steps, at, *change)?;
            println!("{}", walk.line(way));
            let places = walk.changes.iter().enumerate();
            let points = places.map(|(step, &change)| (step as f64, change)).collect();
            series.push(Series { name: (*way).to_owned(), points });
        }
        println!();
        panels.push(Panel {
            title,
            x_label: "step".into(),
            y_label: "change of colours, RMSE (0-255)".into(),
            x_scale: Scale::Linear,
            y_scale: Scale::Linear,
            series,
        });
    }
    let heading = format!("{name}: change from picture to picture");
    write_file(&args.output.join(format!("lod-steps-{name}.svg")), &svg(&heading, &panels, 2))
}

/// What was seen on the way.
struct Walk {
    changes: Vec<f64>,
    points: Vec<f64>,
    errors: Vec<f64>,
}

impl Walk {
    /// Draws each step.
    fn taken(
        renderer: &mut Renderer,
        source: &dyn NodeSource,
        steps: usize,
        at: At,
        change: Change,
    ) -> anyhow::Result<Walk> {
        let mut settings = FrameSettings { color: ColorMode::Auto, ..FrameSettings::default() };
        change(&mut settings);
        let error_px = settings.cut.error_px;
        let mut walk = Walk { changes: Vec::new(), points: Vec::new(), errors: Vec::new() };
        let mut before: Option<Picture> = None;
        for step in 0..steps {
            let (view, share) = at(step as i32);
            settings.cut.error_px = error_px * share;
            let (picture, _) = drawn(renderer, &view, &settings, 0)?;
            walk.points.push(renderer.stats().points_drawn as f64);
            if let Some(before) = &before {
                walk.changes.push(compare(pixels(before), pixels(&picture)).rmse);
            }
            if step % COMPARED == 0 {
                let reference =
                    reference_picture(source, &view, &settings.color, settings.background)?;
                walk.errors.push(compare(pixels(&reference), pixels(&picture)).rmse);
            }
            before = Some(picture);
        }
        Ok(walk)
    }

    fn line(&self, way: &str) -> String {
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let largest = self.changes.iter().copied().fold(0.0, f64::max);
        // How far a change stands out from those beside it.
        let sudden = self
            .changes
            .windows(3)
            .map(|three| three[1] - 0.5 * (three[0] + three[2]))
            .fold(0.0, f64::max);
        let steps = self.points.windows(2).map(|two| (two[1] / two[0] - 1.0).abs());
        let mut line = String::new();
        let _ = write!(
            line,
            "{way:<18}{:>9}{:>12.2}{largest:>12.2}{sudden:>12.2}{:>14}{:>12.2}",
            count(mean(&self.points)),
            mean(&self.changes),
            format!("{:.1} %", 100.0 * steps.fold(0.0, f64::max)),
            mean(&self.errors)
        );
        line
    }
}
