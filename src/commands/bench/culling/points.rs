//! The study *points*: a store drawn along a path with occlusion culling and without it, on the
//! device.
//!
//! The store is that of a scene sampled as points (`esker generate --subject city --origin 0,0,0`),
//! the path is the scene's own. Each way starts with nothing loaded and takes in what it wants up to
//! a quota per frame, read in the frame itself, so that counts repeat on any machine. At the end the
//! last view is drawn until nothing is missing; the bytes are those up to then. The last pictures are
//! compared: without a budget they must be the same, with one that binds what hidden nodes give
//! free makes the picture finer.

use std::fmt::Write;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context;

use super::{Extent, save_plot};
use crate::commands::bench::plot::{Panel, Scale, Series, svg};
use crate::commands::bench::{BenchArgs, open_all, write_file};
use crate::frame::{FrameSettings, FrameStats, Loading, NodeSource, RasterPath, Renderer};
use crate::geometry::View;
use crate::gpu::Gpu;
use crate::mesh::scenes::{CameraPath, SceneKind, camera_path};
use crate::passes::Picture;
use crate::select::CutSettings;
use crate::store::Store;
use crate::visibility::{Algorithm, ChcOptions, ChcPlusOptions};

/// Bytes of points taken in per frame.
const QUOTA_BYTES: u64 = 8 << 20;
/// Room for points on the device.
const ROOM_BYTES: u64 = 1 << 30;
/// Frames in which a view that stands still has all it wants.
const MOST_LAST_FRAMES: u32 = 2000;

/// One way along one path.
struct Flight {
    name: &'static str,
    frames: Vec<(FrameStats, f64)>,
    last: Picture,
    last_stats: FrameStats,
    /// Bytes read and sent in all, until nothing was missing.
    read_bytes: u64,
    sent_bytes: u64,
}

const CSV_HEAD: &str = "path,budget,culling,frame,points_drawn,points_hidden,nodes_drawn,\
    nodes_hidden,bytes_read,bytes_uploaded,node_bytes,questions,rounds,frame_ms\n";

/// Runs the study over the stores that were named.
pub(super) fn run(extent: &Extent, args: &BenchArgs) -> anyhow::Result<()> {
    let gpu = Arc::new(Gpu::open().context("this study needs an adapter")?);
    let folder = tempfile::tempdir()?;
    let scene = SceneKind::City.make(SceneKind::City.usual_size(), 1);
    let mut csv = String::from(CSV_HEAD);
    for (name, store) in open_all(args, folder.path())? {
        println!(
            "\n{name}: {} points, {} nodes; {}x{}, {} frames, on {}",
            store.octree().point_count(),
            store.octree().nodes().len(),
            extent.width,
            extent.height,
            extent.frames,
            gpu.description()
        );
        let store = Arc::new(store);
        let mut panels = Vec::new();
        for path in [CameraPath::Walk, CameraPath::Fly] {
            let view = |camera| View { camera, width_px: extent.width, height_px: extent.height };
            let views: Vec<View> =
                camera_path(&scene, path, extent.frames).into_iter().map(view).collect();
            for budget in [u64::MAX, 1_000_000] {
                let ways = [
                    Algorithm::Frustum,
                    Algorithm::Chc(ChcOptions::default()),
                    Algorithm::ChcPlus(ChcPlusOptions::default()),
                ];
                let flights = ways
                    .map(|culling| fly(&gpu, &store, &views, budget, culling))
                    .into_iter()
                    .collect::<anyhow::Result<Vec<Flight>>>()?;
                report(path, budget, &flights);
                let budget_name = budget_name(budget);
                for flight in &flights {
                    let rows = flight.csv_lines(&format!("{},{budget_name}", path.name()));
                    csv.push_str(&rows);
                }
                panels.extend(plots(&format!("{}, {budget_name}", path.name()), &flights));
            }
        }
        save_plot(args, "culling-points.svg", &svg("Points along each course", &panels, 2))?;
    }
    write_file(&args.output.join("culling-points.csv"), &csv)
}

fn budget_name(budget: u64) -> String {
    match budget {
        u64::MAX => "no budget".into(),
        points => format!("{points} points"),
    }
}

fn fly(
    gpu: &Arc<Gpu>,
    store: &Arc<Store>,
    views: &[View],
    point_budget: u64,
    culling: Algorithm,
) -> anyhow::Result<Flight> {
    let path = if gpu.draws_by_compute() { RasterPath::Compute } else { RasterPath::Compute32 };
    let mut renderer = Renderer::on_gpu(gpu.clone(), path, ROOM_BYTES)?;
    renderer.set_scene(vec![store.clone() as Arc<dyn NodeSource>]);
    let cut = CutSettings { point_budget, ..CutSettings::default() };
    let loading = Loading::Quota { bytes: QUOTA_BYTES };
    let settings = FrameSettings { cut, loading, culling, depth: true, ..Default::default() };
    let mut frames = Vec::new();
    for view in views {
        let start = Instant::now();
        renderer.render(view, &settings)?;
        gpu.wait()?;
        frames.push((renderer.stats().clone(), start.elapsed().as_secs_f64() * 1e3));
    }
    let sum = |of: fn(&FrameStats) -> u64| frames.iter().map(|(stats, _)| of(stats)).sum();
    let (mut read_bytes, mut sent_bytes): (u64, u64) =
        (sum(|stats| stats.bytes_read), sum(|stats| stats.bytes_uploaded));
    let mut last_stats = renderer.stats().clone();
    let view = views.last().context("a path has frames")?;
    for _ in 0..MOST_LAST_FRAMES {
        renderer.render(view, &settings)?;
        if renderer.stats().unchanged && renderer.stats().complete {
            break;
        }
        last_stats = renderer.stats().clone();
        read_bytes += last_stats.bytes_read;
        sent_bytes += last_stats.bytes_uploaded;
    }
    let last = renderer.read_picture()?.context("a frame was drawn")?;
    Ok(Flight { name: culling.name(), frames, last, last_stats, read_bytes, sent_bytes })
}

impl Flight {
    fn mean(&self, of: impl Fn(&FrameStats) -> u64) -> f64 {
        let sum: u64 = self.frames.iter().map(|(stats, _)| of(stats)).sum();
        sum as f64 / self.frames.len().max(1) as f64
    }

    fn median_ms(&self) -> f64 {
        let mut times: Vec<f64> = self.frames.iter().map(|(_, ms)| *ms).collect();
        times.sort_by(f64::total_cmp);
        times.get(times.len() / 2).copied().unwrap_or(0.0)
    }

    fn csv_lines(&self, head: &str) -> String {
        let mut out = String::new();
        for (frame, (stats, ms)) in self.frames.iter().enumerate() {
            let culling = stats.culling.unwrap_or_default();
            let _ = writeln!(
                out,
                "{head},{},{frame},{},{},{},{},{},{},{},{},{},{ms:.2}",
                self.name,
                stats.points_drawn,
                stats.points_hidden,
                stats.nodes_drawn,
                stats.nodes_hidden,
                stats.bytes_read,
                stats.bytes_uploaded,
                stats.node_bytes,
                culling.queries_issued,
                culling.rounds,
            );
        }
        out
    }
}

fn report(path: CameraPath, budget: u64, flights: &[Flight]) {
    println!("\n{}, {}", path.name(), budget_name(budget));
    println!(
        "{:<10}{:>12}{:>10}{:>10}{:>11}{:>11}{:>10}{:>8}{:>10}{:>12}{:>8}",
        "culling",
        "points",
        "nodes",
        "read MiB",
        "sent MiB",
        "held MiB",
        "questions",
        "rounds",
        "ms",
        "end points",
        "differ"
    );
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    for flight in flights {
        let held = flight.last_stats.node_bytes;
        let pixels = flight.last.colors.iter().zip(&flights[0].last.colors);
        let depths = flight.last.distances.iter().zip(&flights[0].last.distances);
        let wrong = pixels.zip(depths).filter(|((a, b), (c, d))| a != b || c != d).count();
        let questions = flight.mean(|s| s.culling.unwrap_or_default().queries_issued);
        println!(
            "{:<10}{:>12.0}{:>10.0}{:>10.1}{:>11.1}{:>11.1}{:>10.1}{:>8.1}{:>10.1}{:>12}{:>8}",
            flight.name,
            flight.mean(|s| s.points_drawn),
            flight.mean(|s| s.nodes_drawn.into()),
            mib(flight.read_bytes),
            mib(flight.sent_bytes),
            mib(held),
            questions,
            flight.mean(|s| s.culling.unwrap_or_default().rounds),
            flight.median_ms(),
            flight.last_stats.points_drawn,
            wrong
        );
    }
}

fn plots(title: &str, flights: &[Flight]) -> [Panel; 2] {
    let panel = |what: &str, of: &dyn Fn(&Flight) -> Vec<f64>| Panel {
        title: title.into(),
        x_label: "frame".into(),
        y_label: what.into(),
        x_scale: Scale::Linear,
        y_scale: Scale::Linear,
        series: flights
            .iter()
            .map(|flight| Series {
                name: flight.name.into(),
                points: of(flight).into_iter().zip(0u32..).map(|(y, x)| (x.into(), y)).collect(),
            })
            .collect(),
    };
    let drawn = |flight: &Flight| -> Vec<f64> {
        flight.frames.iter().map(|(stats, _)| stats.points_drawn as f64 / 1e6).collect()
    };
    let sent = |flight: &Flight| -> Vec<f64> {
        let mut sum = 0.0;
        let add = |(stats, _): &(FrameStats, f64)| {
            sum += stats.bytes_read as f64 / f64::from(1 << 20);
            sum
        };
        flight.frames.iter().map(add).collect()
    };
    [panel("million points drawn", &drawn), panel("MiB read so far", &sent)]
}
