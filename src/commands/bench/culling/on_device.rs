//! The methods on the running adapter: what a frame takes there, as a ratio to frustum culling.
//!
//! Every method has a renderer of its own on the same device. Frame by frame all of them draw the
//! same view, one after the other and in turns, so that drifts of the machine meet all alike; a
//! frame's time runs from the call to the idle device. Pictures are compared with that of frustum
//! culling to the bit.

use std::fmt::Write;
use std::sync::Arc;
use std::time::Instant;

use crate::commands::bench::{BenchArgs, write_file};
use crate::frame::{CullingAnswers, FrameSettings, RasterPath, Renderer};
use crate::geometry::View;
use crate::gpu::Gpu;
use crate::mesh::scenes::{CameraPath, SceneKind};
use crate::passes::Picture;
use crate::visibility::{Algorithm, ChcOptions, ChcPlusOptions, CullingCosts, LateAnswers};

use super::race::{Result as Raced, cameras};
use super::{Extent, courses, shading};

/// Frames at the start that are left out of medians: methods learn in them.
const LEARNING: usize = 4;

/// What a method did along a course.
struct Tried {
    name: &'static str,
    settings: FrameSettings,
    renderer: Renderer,
    frames: Vec<Frame>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Frame {
    frame_ms: f64,
    triangles: u64,
    objects: u32,
    queries: u64,
    rounds: u64,
    waits: u64,
    wrong_pixels: u64,
}

/// The three ways to deal with late answers, their relatives, and what they are measured by.
fn methods() -> Vec<(&'static str, FrameSettings)> {
    let with = |culling| FrameSettings { culling, ..FrameSettings::default() };
    let by_pyramid = |culling| FrameSettings { answers: CullingAnswers::Pyramid, ..with(culling) };
    let (chc, plus) = (ChcOptions::default(), ChcPlusOptions::default());
    let (late, few) = (LateAnswers::NextFrame, LateAnswers::Rounds(4));
    vec![
        ("frustum", with(Algorithm::Frustum)),
        ("stop-and-wait", with(Algorithm::StopAndWait)),
        ("a frame late", with(Algorithm::Chc(ChcOptions { late, ..chc }))),
        ("chc", with(Algorithm::Chc(chc))),
        ("chc++", with(Algorithm::ChcPlus(plus))),
        ("chc++, fixed", with(Algorithm::ChcPlus(ChcPlusOptions { in_vain: None, ..plus }))),
        ("chc++, 4 rounds", with(Algorithm::ChcPlus(ChcPlusOptions { late: few, ..plus }))),
        ("chc++, pyramid", by_pyramid(Algorithm::ChcPlus(plus))),
        ("two-pass", with(Algorithm::TwoPass)),
        ("auto", with(Algorithm::Auto(plus, CullingCosts::default()))),
    ]
}

/// Runs the studies on the adapter that is there; says so where there is none.
pub(super) fn run(
    extent: &Extent,
    args: &BenchArgs,
    races: bool,
    shades: bool,
) -> anyhow::Result<()> {
    let gpu = match Gpu::open() {
        Ok(gpu) => Arc::new(gpu),
        Err(error) => {
            println!("\nnot measured on a device: {error}");
            return Ok(());
        }
    };
    println!("\non {}", gpu.description());
    if shades {
        let mut csv = String::from(
            "course,depth_first,repeats,frustum_ms,optimum_ms,chc_plus_ms,difference_ms\n",
        );
        let course = (SceneKind::City, CameraPath::Walk);
        shading::run(&gpu, extent, course, &mut csv)?;
        write_file(&args.output.join("culling-shading.csv"), &csv)?;
    }
    if !races {
        return Ok(());
    }
    let mut csv = String::from(
        "course,method,frames,queries,rounds,waits,objects,triangles,wrong_pixels,frame_ms,\
         median_ratio,total_ratio\n",
    );
    for (kind, path) in courses(args) {
        course(&gpu, extent, kind, path, &mut csv)?;
    }
    write_file(&args.output.join("culling-device.csv"), &csv)
}

fn course(
    gpu: &Arc<Gpu>,
    extent: &Extent,
    kind: SceneKind,
    path: CameraPath,
    csv: &mut String,
) -> anyhow::Result<()> {
    let scene = kind.make(extent.scene_size(kind), 1);
    let model = Arc::new(scene.model.clone());
    let mut tried = Vec::new();
    for (name, settings) in methods() {
        let mut renderer = Renderer::on_gpu(gpu.clone(), RasterPath::Compute, 1 << 28)?;
        renderer.set_model(model.clone());
        tried.push(Tried { name, settings, renderer, frames: Vec::new() });
    }
    for (number, camera) in cameras(&scene, path, extent.frames).into_iter().enumerate() {
        let view = View { camera, width_px: extent.width, height_px: extent.height };
        for turn in 0..tried.len() {
            let at = (turn + number) % tried.len();
            tried[at].frame(gpu, &view, number)?;
        }
        let truth = tried[0].picture()?;
        for tried in &mut tried {
            let picture = tried.picture()?;
            if let Some(frame) = tried.frames.last_mut() {
                frame.wrong_pixels = differing(&truth, &picture);
            }
        }
    }
    println!("\n{} {}: {} objects", kind.name(), path.name(), model.objects.len());
    println!(
        "{:<20} {:>8} {:>7} {:>6} {:>9} {:>10} {:>9} {:>9} {:>8} {:>8}",
        "method",
        "queries",
        "rounds",
        "waits",
        "objects",
        "triangles",
        "wrong px",
        "ms",
        "median",
        "total"
    );
    let (first, rest) = tried.split_first().expect("frustum culling is the first");
    for tried in std::iter::once(first).chain(rest) {
        let line = tried.summary(first);
        println!("{}", line.table_line(tried.name));
        let course = format!("{} {}", kind.name(), path.name());
        let _ = writeln!(csv, "{course},\"{}\",{}", tried.name, line.csv_fields());
    }
    Ok(())
}

fn differing(truth: &Picture, picture: &Picture) -> u64 {
    let colors = truth.colors.iter().zip(&picture.colors);
    let depths = truth.distances.iter().zip(&picture.distances);
    colors.zip(depths).filter(|((a, b), (c, d))| a != b || c != d).count() as u64
}

impl Tried {
    fn frame(&mut self, gpu: &Gpu, view: &View, number: usize) -> anyhow::Result<()> {
        // A picture that is there already is not drawn again; another background makes it another.
        let background = self.settings.background & !1 | (number as u32 & 1);
        self.settings.background = background;
        let start = Instant::now();
        let stats = self.renderer.render(view, &self.settings)?;
        gpu.wait()?;
        let frame_ms = 1e3 * start.elapsed().as_secs_f64();
        let counters = stats.culling.unwrap_or_default();
        let frame = Frame {
            frame_ms,
            triangles: stats.triangles_drawn,
            objects: stats.objects_drawn,
            queries: counters.queries_issued,
            rounds: counters.rounds,
            waits: counters.blocking_waits,
            wrong_pixels: 0,
        };
        if self.settings.culling == Algorithm::TwoPass
            && let Some(last) = self.frames.last_mut()
        {
            // Its counts are those of the frame before, since the device was idle in between.
            let Frame { frame_ms, wrong_pixels, .. } = *last;
            *last = Frame { frame_ms, wrong_pixels, ..frame };
        }
        self.frames.push(frame);
        Ok(())
    }

    fn picture(&mut self) -> anyhow::Result<Picture> {
        let picture = self.renderer.read_picture()?;
        picture.ok_or_else(|| anyhow::anyhow!("{}: no frame was drawn", self.name))
    }

    fn summary(&self, frustum: &Tried) -> Summary {
        let from = LEARNING.min(self.frames.len() - 1);
        let (mine, theirs) = (&self.frames[from..], &frustum.frames[from..]);
        let mean = |of: fn(&Frame) -> f64| mine.iter().map(of).sum::<f64>() / mine.len() as f64;
        let times: Vec<f64> = mine.iter().map(|frame| frame.frame_ms).collect();
        let ratios: Vec<f64> =
            mine.iter().zip(theirs).map(|(a, b)| a.frame_ms / b.frame_ms).collect();
        let total = |frames: &[Frame]| frames.iter().map(|frame| frame.frame_ms).sum::<f64>();
        Summary {
            frames: self.frames.len(),
            queries: mean(|frame| frame.queries as f64),
            rounds: mean(|frame| frame.rounds as f64),
            waits: mean(|frame| frame.waits as f64),
            objects: mean(|frame| f64::from(frame.objects)),
            triangles: mean(|frame| frame.triangles as f64),
            wrong_pixels: self.frames.iter().map(|frame| frame.wrong_pixels).sum(),
            frame_ms: Raced::median(&times),
            median_ratio: Raced::median(&ratios),
            total_ratio: total(&self.frames) / total(&frustum.frames),
        }
    }
}

/// A method on one course: means over the frames after the first ones, times as medians.
struct Summary {
    frames: usize,
    queries: f64,
    rounds: f64,
    waits: f64,
    objects: f64,
    triangles: f64,
    wrong_pixels: u64,
    frame_ms: f64,
    median_ratio: f64,
    total_ratio: f64,
}

impl Summary {
    fn table_line(&self, name: &str) -> String {
        format!(
            "{name:<20} {:>8.1} {:>7.2} {:>6.2} {:>9.1} {:>10.0} {:>9} {:>9.2} {:>8.3} {:>8.3}",
            self.queries,
            self.rounds,
            self.waits,
            self.objects,
            self.triangles,
            self.wrong_pixels,
            self.frame_ms,
            self.median_ratio,
            self.total_ratio,
        )
    }

    fn csv_fields(&self) -> String {
        format!(
            "{},{:.2},{:.3},{:.3},{:.1},{:.0},{},{:.4},{:.4},{:.4}",
            self.frames,
            self.queries,
            self.rounds,
            self.waits,
            self.objects,
            self.triangles,
            self.wrong_pixels,
            self.frame_ms,
            self.median_ratio,
            self.total_ratio,
        )
    }
}
