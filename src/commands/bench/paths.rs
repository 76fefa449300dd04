//! The studies *paths* and *splats* of the suite `lod`: what the ways of drawing cost, in one run.
//!
//! *Paths* draws the points of one cut, one pixel each, by every way there is, beside a bare loop
//! over the very same points in one flat list, the least that drawing them can be. *Splats* draws
//! points of one size, from one pixel to many, by each way that splats can be drawn: one by one,
//! grown in screen space, as quads. All take turns, so that what else the machine does falls on all
//! alike; times are the least of the turns. Pictures are compared with that of the CPU.

use std::sync::Arc;
use std::time::{Duration, Instant};

use serde::Serialize;

use crate::commands::bench::bare::Bare;
use crate::commands::bench::paths_tables::{paths_table, splats_table, write_csv_row, write_plot};
use crate::commands::bench::{BenchArgs, cameras, write_file};
use crate::frame::{FrameSettings, NodeSource, RasterPath, Renderer};
use crate::geometry::View;
use crate::gpu::{Gpu, copy_bandwidth};
use crate::metrics::processor_ms;
use crate::passes::{EarlyOut, Picture};
use crate::select::{SplatDrawing, SplatSize};

/// One way of drawing one view. A row of the CSV file.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Row {
    pub(super) scan: String,
    pub(super) view: String,
    pub(super) study: &'static str,
    pub(super) path: &'static str,
    pub(super) splat_px: f64,
    pub(super) points_drawn: u64,
    pub(super) nodes_drawn: u32,
    pub(super) splat_pixels: u64,
    pub(super) dispatches: u32,
    pub(super) draw_calls: u32,
    pub(super) bytes_per_point: f64,
    /// Least time from the call to the end of the device's work.
    pub(super) frame_ms: f64,
    /// Least time that processors of this machine worked for it; 0 where that is not known.
    pub(super) processor_ms: f64,
    /// Least time of the passes over points by the device's clock; 0 where it has none, or draws on
    /// processors, where its clock does not wait for compute passes.
    pub(super) points_ms: f64,
    /// The same of growing splats.
    pub(super) grow_ms: f64,
    /// The same of the resolve.
    pub(super) resolve_ms: f64,
    /// Pixels unlike those of the CPU, and those among them at the same depth.
    pub(super) pixels_differing: usize,
    pub(super) pixels_tied: usize,
}

const CSV_HEADER: &str = "scan,view,study,path,splat_px,points_drawn,nodes_drawn,splat_pixels,\
    dispatches,draw_calls,bytes_per_point,frame_ms,processor_ms,points_ms,grow_ms,resolve_ms,pixels_differing,\
    pixels_tied";

/// What is tried.
struct Plan {
    size: (u32, u32),
    views: &'static [&'static str],
    budget: u64,
    turns: usize,
    splat_views: &'static [&'static str],
    splats_px: &'static [f64],
    copy_bytes: u64,
}

impl Plan {
    fn new(args: &BenchArgs) -> Self {
        if args.quick {
            Plan {
                size: args.size.unwrap_or((640, 360)),
                views: &["outside"],
                budget: 200_000,
                turns: 3,
                splat_views: &["outside"],
                splats_px: &[1.0, 5.0],
                copy_bytes: 16 << 20,
            }
        } else {
            Plan {
                size: args.size.unwrap_or((1280, 720)),
                views: &["outside", "oblique near", "inside low"],
                budget: 1_000_000,
                turns: 15,
                splat_views: &["oblique near"],
                splats_px: &[1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 24.0],
                copy_bytes: 128 << 20,
            }
        }
    }
}

/// Runs both studies for one scan and writes their files; says so where there is no adapter.
pub fn run(args: &BenchArgs, name: &str, source: Arc<dyn NodeSource>) -> anyhow::Result<()> {
    let gpu = match Gpu::open() {
        Ok(gpu) => Arc::new(gpu),
        Err(error) => {
            println!("paths, splats: not measured, {error}\n");
            return Ok(());
        }
    };
    let plan = Plan::new(args);
    let mut rows = Vec::new();
    println!("Ways of drawing on {}, at most {} points a frame", gpu.description(), plan.budget);
    let copy_gb_s = 1e-9 * copy_bandwidth(&gpu, plan.copy_bytes)?;
    println!("copying from buffer to buffer: {copy_gb_s:.1} GB/s read\n");
    for (view_name, view) in cameras::views_of(source.as_ref(), plan.size)? {
        if plan.views.contains(&view_name.as_str()) {
            let mut settings = FrameSettings::default();
            settings.cut.point_budget = plan.budget;
            settings.cut.fill = true;
            settings.cut.error_px = 0.5;
            settings.cut.splat.max_px = 1.0;
            let ways = Way::all(&gpu, &source, settings)?;
            let found = measure(&gpu, ways, Some(&source), &view, plan.turns)?;
            print!("{}", paths_table(&view_name, &found, copy_gb_s));
            rows.extend(found.into_iter().map(|row| row.of(name, &view_name, "paths")));
        }
        if plan.splat_views.contains(&view_name.as_str()) {
            let mut all = Vec::new();
            for &px in plan.splats_px {
                let mut settings = FrameSettings::default();
                settings.cut.point_budget = plan.budget;
                settings.cut.fill = true;
                settings.cut.splat.size = SplatSize::Fixed { px };
                let ways = Way::of_splats(&gpu, &source, &settings)?;
                let turns = (plan.turns / 4).max(2);
                let found = measure(&gpu, ways, None, &view, turns)?;
                all.extend(found.into_iter().map(|row| row.of(name, &view_name, "splats")));
            }
            print!("{}", splats_table(&view_name, &all));
            rows.extend(all);
        }
    }
    let mut csv = format!("{CSV_HEADER}\n");
    rows.iter().for_each(|row| write_csv_row(&mut csv, row));
    write_file(&args.output.join(format!("lod-paths-{name}.csv")), &csv)?;
    write_plot(&args.output, name, &rows)
}

/// A way of drawing.
struct Way {
    name: &'static str,
    renderer: Renderer,
    settings: FrameSettings,
}

impl Way {
    fn new(
        name: &'static str,
        mut renderer: Renderer,
        source: &Arc<dyn NodeSource>,
        settings: &FrameSettings,
    ) -> Self {
        renderer.set_scene(vec![Arc::clone(source)]);
        Way { name, renderer, settings: settings.clone() }
    }

    /// All ways to draw points of one pixel; the CPU last.
    fn all(
        gpu: &Arc<Gpu>,
        source: &Arc<dyn NodeSource>,
        settings: FrameSettings,
    ) -> anyhow::Result<Vec<Way>> {
        let mut ways = Vec::new();
        for path in RasterPath::offered_by(gpu) {
            let renderer = Renderer::on_gpu(Arc::clone(gpu), path, LIMIT_BYTES)?;
            ways.push(Way::new(path.name(), renderer, source, &settings));
        }
        if gpu.draws_by_raster() {
            let renderer = Renderer::with_point_list(Arc::clone(gpu), LIMIT_BYTES)?;
            ways.push(Way::new("point list", renderer, source, &settings));
        }
        if gpu.draws_by_compute() {
            for (name, early_out) in
                [("looking first", EarlyOut::Always), ("not looking", EarlyOut::Never)]
            {
                let renderer = Renderer::with_early_out(Arc::clone(gpu), early_out, LIMIT_BYTES)?;
                ways.push(Way::new(name, renderer, source, &settings));
            }
        }
        ways.push(Way::new("cpu", Renderer::on_cpu(LIMIT_BYTES), source, &settings));
        Ok(ways)
    }

    /// All ways to draw splats that share a size; the CPU last.
    fn of_splats(
        gpu: &Arc<Gpu>,
        source: &Arc<dyn NodeSource>,
        settings: &FrameSettings,
    ) -> anyhow::Result<Vec<Way>> {
        let mut ways = Vec::new();
        let best = RasterPath::offered_by(gpu).into_iter().find(|path| *path != RasterPath::Raster);
        let drawings = [
            ("one by one", SplatDrawing::OneByOne),
            ("grown", SplatDrawing::Grown),
            ("chosen", SplatDrawing::Auto),
        ];
        for (name, drawing) in drawings.into_iter().filter(|_| best.is_some()) {
            let path = best.expect("there is one");
            let renderer = Renderer::on_gpu(Arc::clone(gpu), path, LIMIT_BYTES)?;
            let mut settings = settings.clone();
            settings.cut.splat.drawing = drawing;
            ways.push(Way::new(name, renderer, source, &settings));
        }
        if gpu.draws_by_raster() {
            let renderer = Renderer::with_point_list(Arc::clone(gpu), LIMIT_BYTES)?;
            ways.push(Way::new("quads", renderer, source, settings));
        }
        ways.push(Way::new("cpu", Renderer::on_cpu(LIMIT_BYTES), source, settings));
        Ok(ways)
    }
}

/// Memory for the points of each way.
const LIMIT_BYTES: u64 = 1 << 30;

/// What one way took.
pub(super) struct Found {
    pub(super) row: Row,
}

impl Found {
    fn of(self, scan: &str, view: &str, study: &'static str) -> Row {
        let scan = scan.replace([',', '"', '\n'], "_");
        Row { scan, view: view.to_owned(), study, ..self.row }
    }
}

/// Draws a view by all ways in turns, a bare loop first if there is a source to make it from.
fn measure(
    gpu: &Arc<Gpu>,
    mut ways: Vec<Way>,
    bare_of: Option<&Arc<dyn NodeSource>>,
    view: &View,
    turns: usize,
) -> anyhow::Result<Vec<Found>> {
    let settings = ways[0].settings.clone();
    let mut bare = match bare_of {
        Some(source) if gpu.draws_by_compute() => {
            Some(Bare::new(gpu, source.as_ref(), view, &settings)?)
        }
        _ => None,
    };
    let mut bare_row = empty_row("bare loop");
    let mut rows: Vec<Row> = ways.iter().map(|way| empty_row(way.name)).collect();
    let mut pictures: Vec<Option<Picture>> = ways.iter().map(|_| None).collect();
    // The first turn loads and warms up.
    for turn in 0..=turns {
        // A picture that still holds is not drawn: the camera moves by what no pixel shows.
        let mut moved = *view;
        moved.camera.near *= 1.0 + 1e-9 * turn as f64;
        if let Some(bare) = &mut bare {
            let taken = Taken::by(|| bare.draw(gpu, &moved))?;
            if turn > 0 {
                taken.note(&mut bare_row);
                bare_row.points_ms = bare_row.points_ms.min(bare.pass_ms());
                bare_row.points_drawn = bare.count.into();
                bare_row.bytes_per_point = 12.0;
            }
        }
        for (i, way) in ways.iter_mut().enumerate() {
            let waits = way.renderer.path() != RasterPath::Cpu;
            let taken = Taken::by(|| {
                way.renderer.render(&moved, &way.settings)?;
                if waits {
                    gpu.wait()?;
                }
                Ok(())
            })?;
            if turn > 0 {
                taken.note(&mut rows[i]);
                // Another look, at a picture that holds, brings the device's clock.
                note(&mut rows[i], way, &moved)?;
            }
            if turn == turns {
                pictures[i] = way.renderer.read_picture()?;
            }
        }
    }
    // The CPU comes last.
    let expected = pictures.pop().flatten();
    for (row, picture) in rows.iter_mut().zip(&pictures) {
        if let (Some(expected), Some(picture)) = (&expected, picture) {
            (row.pixels_differing, row.pixels_tied) = differences(expected, picture);
        }
    }
    let mut rows: Vec<Row> = bare.is_some().then_some(bare_row).into_iter().chain(rows).collect();
    if gpu.is_software() {
        rows.iter_mut().for_each(|row| row.points_ms = 0.0);
    }
    Ok(rows.into_iter().map(|row| Found { row: finite(row) }).collect())
}

/// What a piece of work took.
struct Taken {
    wall_ms: f64,
    processor_ms: Option<f64>,
}

impl Taken {
    fn by(work: impl FnOnce() -> anyhow::Result<()>) -> anyhow::Result<Self> {
        // Threads of the piece before look for more for a while.
        std::thread::sleep(Duration::from_millis(5));
        let (start, before) = (Instant::now(), processor_ms());
        work()?;
        let wall_ms = start.elapsed().as_secs_f64() * 1e3;
        let processor_ms = processor_ms().zip(before).map(|(after, before)| after - before);
        Ok(Taken { wall_ms, processor_ms })
    }

    fn note(&self, row: &mut Row) {
        row.frame_ms = row.frame_ms.min(self.wall_ms);
        row.processor_ms = row.processor_ms.min(self.processor_ms.unwrap_or(f64::INFINITY));
    }
}

fn note(row: &mut Row, way: &mut Way, view: &View) -> anyhow::Result<()> {
    let stats = way.renderer.stats();
    row.points_drawn = stats.points_drawn;
    row.nodes_drawn = stats.nodes_drawn;
    row.splat_pixels = stats.splat_pixels;
    row.dispatches = stats.dispatches;
    row.draw_calls = stats.draw_calls;
    row.bytes_per_point = stats.point_bytes as f64 / stats.points_drawn.max(1) as f64;
    let stats = way.renderer.render(view, &way.settings)?;
    let of = |pass: &str| {
        let is_it = |time: &&crate::frame::PassTime| time.pass == pass && time.clock == "gpu";
        stats.passes.iter().find(is_it).map(|time| time.pass_ms)
    };
    row.points_ms = row.points_ms.min(of("points").unwrap_or(f64::INFINITY));
    row.grow_ms = row.grow_ms.min(of("grow").unwrap_or(f64::INFINITY));
    row.resolve_ms = row.resolve_ms.min(of("resolve").unwrap_or(f64::INFINITY));
    Ok(())
}

fn empty_row(path: &'static str) -> Row {
    Row {
        scan: String::new(),
        view: String::new(),
        study: "",
        path,
        splat_px: 1.0,
        points_drawn: 0,
        nodes_drawn: 0,
        splat_pixels: 0,
        dispatches: 0,
        draw_calls: 0,
        bytes_per_point: 0.0,
        frame_ms: f64::INFINITY,
        processor_ms: f64::INFINITY,
        points_ms: f64::INFINITY,
        grow_ms: f64::INFINITY,
        resolve_ms: f64::INFINITY,
        pixels_differing: 0,
        pixels_tied: 0,
    }
}

/// Times that were never taken are 0.
fn finite(mut row: Row) -> Row {
    let times = [&mut row.points_ms, &mut row.grow_ms, &mut row.resolve_ms, &mut row.frame_ms];
    for time in times.into_iter().chain([&mut row.processor_ms]) {
        *time = if time.is_finite() { *time } else { 0.0 };
    }
    row.splat_px = (row.splat_pixels as f64 / row.points_drawn.max(1) as f64).sqrt();
    row
}

/// Pixels whose colours differ, and how many of them show the same distance.
fn differences(expected: &Picture, picture: &Picture) -> (usize, usize) {
    let differing = (0..expected.colors.len()).filter(|&i| expected.colors[i] != picture.colors[i]);
    let is_tied = |&i: &usize| {
        let (a, b) = (expected.distances[i], picture.distances[i]);
        a == b || (a / b - 1.0).abs() < 1e-6
    };
    let differing: Vec<usize> = differing.collect();
    (differing.len(), differing.iter().filter(|i| is_tied(i)).count())
}
