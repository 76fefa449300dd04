//! What dear shading changes: times as each pixel of a model is shaded once, ten and forty times, for
//! CHC++ and for the optimum, which draws what an exact walk sees and asks nothing.
//!
//! The difference of the two is what culling costs. Where depth alone is drawn first, each pixel is
//! shaded once whatever was drawn in vain, so the difference must not grow with the cost of shading.

use std::fmt::Write;
use std::sync::Arc;
use std::time::Instant;

use crate::frame::{FrameSettings, RasterPath, Renderer};
use crate::geometry::View;
use crate::gpu::Gpu;
use crate::mesh::scenes::{CameraPath, SceneKind};
use crate::visibility::{Algorithm, ChcPlusOptions};

use super::Extent;
use super::race::{Result as Raced, cameras};

/// Frames at the start that are left out of medians: methods learn in them.
const LEARNING: usize = 4;
const REPEATS: [u32; 3] = [1, 10, 40];

/// Who draws, and how.
struct Runner {
    renderer: Renderer,
    settings: FrameSettings,
    is_optimum: bool,
    times: Vec<f64>,
}

/// Runs the study on one course.
pub(super) fn run(
    gpu: &Arc<Gpu>,
    extent: &Extent,
    (kind, path): (SceneKind, CameraPath),
    csv: &mut String,
) -> anyhow::Result<()> {
    let scene = kind.make(extent.scene_size(kind), 1);
    let model = Arc::new(scene.model.clone());
    let mut runners = Vec::new();
    for depth_first in [false, true] {
        for repeats in REPEATS {
            for (is_optimum, culling) in [
                (false, Algorithm::Frustum),
                (true, Algorithm::StopAndWait),
                (false, Algorithm::ChcPlus(ChcPlusOptions::default())),
            ] {
                let mut renderer = Renderer::on_gpu(gpu.clone(), RasterPath::Compute, 1 << 28)?;
                renderer.set_model(model.clone());
                renderer.repeat_shading(repeats);
                let settings = FrameSettings { culling, depth_first, ..FrameSettings::default() };
                runners.push(Runner { renderer, settings, is_optimum, times: Vec::new() });
            }
        }
    }
    for (number, camera) in cameras(&scene, path, extent.frames).into_iter().enumerate() {
        let view = View { camera, width_px: extent.width, height_px: extent.height };
        for turn in 0..runners.len() {
            let at = (turn + number) % runners.len();
            runners[at].frame(gpu, &view)?;
        }
    }
    println!("\nshading, {} {}: median ms", kind.name(), path.name());
    println!(
        "{:<14} {:>8} {:>9} {:>9} {:>9} {:>14}",
        "depth first", "shading", "frustum", "optimum", "chc++", "chc++ - optimum"
    );
    for (row, cells) in runners.chunks(3).enumerate() {
        let [frustum, optimum, plus] = [0, 1, 2]
            .map(|at| Raced::median(&cells[at].times[LEARNING.min(cells[at].times.len() - 1)..]));
        let repeats = REPEATS[row % REPEATS.len()];
        let depth_first = cells[0].settings.depth_first;
        let more = plus - optimum;
        println!(
            "{:<14} {:>7}x {frustum:>9.2} {optimum:>9.2} {plus:>9.2} {more:>14.2}",
            if depth_first { "yes" } else { "no" },
            repeats
        );
        let course = format!("{} {}", kind.name(), path.name());
        let _ = writeln!(
            csv,
            "{course},{depth_first},{repeats},{frustum:.4},{optimum:.4},{plus:.4},{more:.4}"
        );
    }
    Ok(())
}

impl Runner {
    fn frame(&mut self, gpu: &Gpu, view: &View) -> anyhow::Result<()> {
        if self.is_optimum {
            // What it draws is found beforehand.
            self.renderer.thaw_culling();
            self.renderer.render(view, &self.settings)?;
            self.renderer.freeze_culling(view);
            gpu.wait()?;
        }
        let start = Instant::now();
        self.renderer.render(view, &self.settings)?;
        gpu.wait()?;
        self.times.push(1e3 * start.elapsed().as_secs_f64());
        Ok(())
    }
}
