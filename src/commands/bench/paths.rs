//! The studies *paths* and *splats* of the suite `lod`: what the ways of drawing cost, in one run.
//!
//! *Paths* draws the points of one cut, one pixel each, by every way there is, beside a bare loop
//! over the very same points in one flat list, the least that drawing them can be. *Splats* draws
//! points of one size, from one pixel to many, by each way that splats can be drawn: one by one,
//! grown in screen space, as quads. All take turns, so that what else the machine does falls on all
//! alike; times are the least of the turns. Pictures are compared with that of the CPU.

use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytemuck::Zeroable;
use glam::{DVec3, UVec3};
use serde::Serialize;

use crate::commands::bench::plot::{Panel, Scale, Series, svg};
use crate::commands::bench::{BenchArgs, cameras, write_file};
use crate::frame::{FrameSettings, NodeSource, RasterPath, Renderer};
use crate::geometry::{MortonKey, View};
use crate::gpu::layout::GpuNode;
use crate::gpu::{Gpu, PassTimer, copy_bandwidth};
use crate::metrics::processor_ms;
use crate::passes::splat::local_cell;
use crate::passes::{EarlyOut, Picture, PointsBare, Tile};
use crate::select::{
    AllResident, CutScratch, SplatDrawing, SplatSettings, SplatSize, select_nodes,
};

/// One way of drawing one view. A row of the CSV file.
#[derive(Clone, Debug, Serialize)]
struct Row {
    scan: String,
    view: String,
    study: &'static str,
    path: &'static str,
    splat_px: f64,
    points_drawn: u64,
    nodes_drawn: u32,
    splat_pixels: u64,
    dispatches: u32,
    draw_calls: u32,
    bytes_per_point: f64,
    /// Least time from the call to the end of the device's work.
    frame_ms: f64,
    /// Least time that processors of this machine worked for it; 0 where that is not known.
    processor_ms: f64,
    /// Least time of the passes over points by the device's clock; 0 where it has none, or draws on
    /// processors, where its clock does not wait for compute passes.
    points_ms: f64,
    /// The same of growing splats.
    grow_ms: f64,
    /// The same of the resolve.
    resolve_ms: f64,
    /// Pixels unlike those of the CPU, and those among them at the same depth.
    pixels_differing: usize,
    pixels_tied: usize,
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
            let name = if path == RasterPath::Raster { "point list" } else { path.name() };
            ways.push(Way::new(name, renderer, source, &settings));
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
            let renderer = Renderer::on_gpu(Arc::clone(gpu), RasterPath::Raster, LIMIT_BYTES)?;
            ways.push(Way::new("quads", renderer, source, settings));
        }
        ways.push(Way::new("cpu", Renderer::on_cpu(LIMIT_BYTES), source, settings));
        Ok(ways)
    }
}

/// Memory for the points of each way.
const LIMIT_BYTES: u64 = 1 << 30;

/// What one way took.
struct Found {
    row: Row,
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

/// The bare loop over the points that a frame draws.
struct Bare {
    pass: PointsBare,
    timer: PassTimer,
    node: GpuNode,
    count: u32,
    lattice_eye: Box<dyn Fn(&View) -> DVec3>,
}

impl Bare {
    fn new(
        gpu: &Gpu,
        source: &dyn NodeSource,
        view: &View,
        settings: &FrameSettings,
    ) -> anyhow::Result<Self> {
        let octree = source.octree();
        let scratch = &mut CutScratch::default();
        let cut = select_nodes(octree, view, &settings.cut, &AllResident, scratch);
        // Coordinates in the root cube, less fine where they would not fit a code.
        let bits = octree.root_cube().bits;
        let shift = bits.saturating_sub(21);
        let (mut words, mut colors) = (Vec::new(), Vec::new());
        let (mut node_words, mut node_colors) = (Vec::new(), Vec::new());
        for drawn in &cut.draw {
            source.read_positions(drawn.node, &mut node_words)?;
            match source.has_colors() {
                true => source.read_colors(drawn.node, &mut node_colors)?,
                false => node_colors.resize(drawn.count as usize, 0xff80_8080),
            }
            let local_bits = octree.local_bits(drawn.node);
            let shape = GpuNode { local_bits, ..GpuNode::zeroed() };
            let base = octree.cell_min(drawn.node) - octree.root_cube().min;
            for point in 0..drawn.count as usize {
                let cell = UVec3::from(local_cell(&shape, &node_words, point)).as_i64vec3() + base;
                let code = u64::encode((cell >> i64::from(shift)).as_uvec3().to_array());
                words.extend([code as u32, (code >> 32) as u32]);
            }
            colors.extend_from_slice(&node_colors[..drawn.count as usize]);
        }
        let count = colors.len() as u32;
        words.extend(colors);
        let pass = PointsBare::new(gpu, &words, count, [view.width_px, view.height_px])?;
        let step = octree.lattice().scale * f64::from(1u32 << shift);
        let node = GpuNode {
            scale: step.as_vec3().to_array(),
            local_bits: bits - shift,
            ..GpuNode::zeroed()
        };
        let (lattice, root) = (*octree.lattice(), octree.root_cube().min.as_dvec3());
        let steps = f64::from(1u32 << shift);
        let lattice_eye =
            Box::new(move |view: &View| (lattice.lattice(view.camera.eye) - root) / steps);
        Ok(Bare { pass, timer: PassTimer::new(gpu)?, node, count, lattice_eye })
    }

    fn draw(&mut self, gpu: &Gpu, view: &View) -> anyhow::Result<()> {
        let frame = Tile::whole(view).gpu_frame(view, &SplatSettings::default(), 0);
        let eye = (self.lattice_eye)(view);
        let last = f64::from(self.node.local_bits).exp2() - 1.0;
        let cell = eye.floor().clamp(DVec3::ZERO, DVec3::splat(last));
        let node = GpuNode {
            eye_cell: cell.as_uvec3().to_array(),
            eye_fraction: (eye - cell).as_vec3().to_array(),
            ..self.node
        };
        Ok(self.pass.draw(gpu, &mut self.timer, &frame, &node)?)
    }

    fn pass_ms(&mut self) -> f64 {
        self.timer.collect().first().map_or(f64::INFINITY, |(_, ms)| *ms)
    }
}

fn paths_table(view: &str, found: &[Found], copy_gb_s: f64) -> String {
    let rows: Vec<&Row> = found.iter().map(|found| &found.row).collect();
    let of = |path: &str| rows.iter().find(|row| row.path == path);
    let mut out = format!(
        "Paths, {view}: points of one pixel; least times of whole frames\n{:<14}{:>9}{:>7}{:>10}\
         {:>9}{:>9}{:>11}{:>9}{:>11}{:>11}{:>9}{:>9}{:>11}{:>9}\n",
        "path",
        "points",
        "nodes",
        "frame ms",
        "/ bare",
        "list /",
        "cores' ms",
        "/ bare",
        "points ms",
        "resolve ms",
        "B/point",
        "of copy",
        "differing",
        "no ties"
    );
    for row in &rows {
        let against = |of: Option<&&Row>, value: fn(&Row) -> f64| match of.map(|of| value(of)) {
            Some(other) if other > 0.0 && value(row) > 0.0 => value(row) / other,
            _ => f64::NAN,
        };
        let ratio = |ratio: f64| match ratio.is_nan() {
            true => String::new(),
            false => format!("{ratio:.2}"),
        };
        // Without a clock of the device the whole frame counts.
        let pass_ms = if row.points_ms > 0.0 { row.points_ms } else { row.frame_ms };
        let gb_s = row.points_drawn as f64 * row.bytes_per_point / pass_ms * 1e-6;
        let _ = writeln!(
            out,
            "{:<14}{:>9}{:>7}{:>10.2}{:>9}{:>9}{:>11.2}{:>9}{:>11.2}{:>11.2}{:>9.1}{:>9}{:>11}\
             {:>9}",
            row.path,
            row.points_drawn,
            row.nodes_drawn,
            row.frame_ms,
            ratio(against(of("bare loop"), |row| row.frame_ms)),
            ratio(1.0 / against(of("point list"), |row| row.frame_ms)),
            row.processor_ms,
            ratio(against(of("bare loop"), |row| row.processor_ms)),
            row.points_ms,
            row.resolve_ms,
            row.bytes_per_point,
            format!("{:.1} %", 100.0 * gb_s / copy_gb_s),
            row.pixels_differing,
            row.pixels_differing - row.pixels_tied
        );
    }
    out.push('\n');
    out
}

fn splats_table(view: &str, rows: &[Row]) -> String {
    let mut out = format!(
        "Splats, {view}: points of one size, squares; least times of whole frames, ms\n{:<12}{:>9}",
        "side", "points"
    );
    let mut paths: Vec<&str> = rows.iter().map(|row| row.path).collect();
    paths.dedup();
    let mut names: Vec<&str> = Vec::new();
    paths.into_iter().for_each(|path| {
        if !names.contains(&path) {
            names.push(path)
        }
    });
    names.iter().for_each(|name| out.push_str(&format!("{name:>12}")));
    out.push('\n');
    let mut sides: Vec<f64> = rows.iter().map(|row| row.splat_px).collect();
    sides.dedup();
    for side in sides {
        let of_side: Vec<&Row> = rows.iter().filter(|row| row.splat_px == side).collect();
        let _ = write!(out, "{:<12}{:>9}", format!("{side:.0} px"), of_side[0].points_drawn);
        for name in &names {
            let row = of_side.iter().find(|row| row.path == *name);
            out.push_str(&row.map_or(String::new(), |row| format!("{:>12.1}", row.frame_ms)));
        }
        let worst = of_side.iter().map(|row| row.pixels_differing - row.pixels_tied).max();
        let _ = writeln!(out, "   pixels unlike the CPU's but for ties: {}", worst.unwrap_or(0));
    }
    out.push('\n');
    out
}

fn write_csv_row(csv: &mut String, row: &Row) {
    let _ = writeln!(
        csv,
        "{},\"{}\",{},{},{:.2},{},{},{},{},{},{:.3},{:.3},{:.3},{:.3},{:.3},{:.3},{},{}",
        row.scan,
        row.view,
        row.study,
        row.path,
        row.splat_px,
        row.points_drawn,
        row.nodes_drawn,
        row.splat_pixels,
        row.dispatches,
        row.draw_calls,
        row.bytes_per_point,
        row.frame_ms,
        row.processor_ms,
        row.points_ms,
        row.grow_ms,
        row.resolve_ms,
        row.pixels_differing,
        row.pixels_tied
    );
}

fn write_plot(folder: &Path, name: &str, rows: &[Row]) -> anyhow::Result<()> {
    let rows: Vec<&Row> = rows.iter().filter(|row| row.study == "splats").collect();
    let mut series: Vec<Series> = Vec::new();
    for row in rows {
        let point = (row.splat_px, row.frame_ms);
        match series.iter_mut().find(|line| line.name == row.path) {
            Some(line) => line.points.push(point),
            None => series.push(Series { name: row.path.to_owned(), points: vec![point] }),
        }
    }
    let panel = Panel {
        title: "splats of one size".into(),
        x_label: "side, pixels".into(),
        y_label: "frame time, ms".into(),
        x_scale: Scale::Log,
        y_scale: Scale::Log,
        series,
    };
    let heading = format!("{name}: ways to draw splats");
    write_file(&folder.join(format!("lod-splats-{name}.svg")), &svg(&heading, &[panel], 1))
}
