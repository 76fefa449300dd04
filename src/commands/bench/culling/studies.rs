//! The studies: which methods meet on which courses, and what is plotted.

use crate::commands::bench::BenchArgs;
use crate::commands::bench::plot::{Panel, Scale, Series, svg};
use crate::mesh::scenes::{CameraPath, SceneKind};
use crate::visibility::{Algorithm, ChcOptions, ChcPlusOptions, LateAnswers, Latency};

use super::methods::{self, Method, named};
use super::race::{Race, Result};
use super::{Extent, courses, report, save_plot};

/// All methods on all courses, with the triangles of each frame on the first ones.
pub(super) fn methods(extent: &Extent, csv: &mut String, args: &BenchArgs) -> anyhow::Result<()> {
    let mut panels = Vec::new();
    for (kind, path) in courses(args) {
        let race = Race::run(extent, kind, path, Latency::Batches, &methods::all());
        let name = format!("{} {}", kind.name(), path.name());
        report(&name, &race, csv);
        let shown = ["frustum", "chc", "chc++", "auto"];
        let line = |result: &&Result| shown.contains(&result.name.as_str());
        let series = race.results().iter().filter(line).map(|result| {
            let place = |(frame, c): (usize, &crate::visibility::CullCounters)| {
                (frame as f64, c.triangles_drawn as f64 + 1.0)
            };
            Series {
                name: result.name.clone(),
                points: result.frames.iter().enumerate().map(place).collect(),
            }
        });
        panels.push(Panel {
            title: name,
            x_label: "frame".into(),
            y_label: "triangles drawn".into(),
            x_scale: Scale::Linear,
            y_scale: Scale::Log,
            series: series.collect(),
        });
    }
    save_plot(args, "culling-triangles.svg", &svg("Triangles drawn along each course", &panels, 3))
}

/// What each part of CHC++ adds, on a device that is polled as the paper's was.
pub(super) fn ablation(extent: &Extent, csv: &mut String) {
    for (kind, path) in [
        (SceneKind::City, CameraPath::Walk),
        (SceneKind::City, CameraPath::Rise),
        (SceneKind::Pipes, CameraPath::Walk),
        (SceneKind::Plates, CameraPath::Still),
    ] {
        let methods = methods::ablation();
        let race = Race::run(extent, kind, path, Latency::Commands(20), &methods);
        let heading = format!("ablation {} {}", kind.name(), path.name());
        report(&heading, &race, csv);
    }
}

/// Wrong pixels against questions, triangles and time as hidden comes to mean "at most T samples".
pub(super) fn threshold(extent: &Extent, csv: &mut String, args: &BenchArgs) -> anyhow::Result<()> {
    let thresholds = [0, 1, 5, 10, 20, 50, 100, 500];
    let mut panels = Vec::new();
    for (kind, path) in [(SceneKind::City, CameraPath::Walk), (SceneKind::Pipes, CameraPath::Walk)]
    {
        let mut methods: Vec<Method> = vec![named("frustum", Algorithm::Frustum)];
        for threshold in thresholds {
            let chc = ChcOptions { threshold, ..methods::chc() };
            methods.push(named(format!("chc, T = {threshold}"), Algorithm::Chc(chc)));
        }
        for threshold in thresholds {
            let plus = ChcPlusOptions { threshold, ..methods::plus() };
            methods.push(named(format!("chc++, T = {threshold}"), Algorithm::ChcPlus(plus)));
        }
        let race = Race::run(extent, kind, path, Latency::Batches, &methods);
        let heading = format!("threshold {} {}", kind.name(), path.name());
        report(&heading, &race, csv);
        let pixels = f64::from(extent.width) * f64::from(extent.height);
        let curve = |name: &str, results: &[Result]| Series {
            name: name.into(),
            points: results
                .iter()
                .map(|result| {
                    let wrong = result.all_wrong_pixels() as f64 / result.frames.len() as f64;
                    (100.0 * wrong / pixels, result.time_ratio)
                })
                .collect(),
        };
        let results = race.results();
        let half = 1 + thresholds.len();
        panels.push(Panel {
            title: heading,
            x_label: "wrong pixels, percent".into(),
            y_label: "time / frustum culling".into(),
            x_scale: Scale::Log,
            y_scale: Scale::Linear,
            series: vec![curve("chc", &results[1..half]), curve("chc++", &results[half..])],
        });
    }
    let plot = svg("Error against time: thresholds 0 to 500 samples", &panels, 2);
    save_plot(args, "culling-threshold.svg", &plot)
}

/// How many nodes make a batch, and how many rounds a frame may take.
pub(super) fn batches(extent: &Extent, csv: &mut String) {
    let mut methods = vec![named("frustum", Algorithm::Frustum)];
    for batch_size in [1, 10, 20, 50, 80, u32::MAX] {
        let options = ChcPlusOptions { batch_size, ..methods::plus() };
        methods.push(named(format!("chc++, b = {batch_size}"), Algorithm::ChcPlus(options)));
    }
    for rounds in 0..=6 {
        let late = LateAnswers::Rounds(rounds);
        let options = ChcPlusOptions { late, ..methods::plus() };
        methods.push(named(format!("chc++, {rounds} rounds"), Algorithm::ChcPlus(options)));
    }
    for (kind, path) in
        [(SceneKind::City, CameraPath::Walk), (SceneKind::Plates, CameraPath::Still)]
    {
        let race = Race::run(extent, kind, path, Latency::Rounds, &methods);
        let heading = format!("batches {} {}", kind.name(), path.name());
        report(&heading, &race, csv);
    }
}
