//! The work of a frame counted instead of timed, for machines whose clock tells more of their
//! neighbours than of the frame.

use rayon::prelude::*;

use crate::frame::node_cache::Words;
use crate::frame::{FrameSettings, Renderer};
use crate::geometry::View;
use crate::passes::Tile;
use crate::passes::splat::{local_cell, point_at, splat_of};

/// What drawing the last frame's points takes, the same on every machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CountedWork {
    /// Points decoded and projected.
    pub points: u64,
    /// Of these, points with a splat in the picture.
    pub points_in_sight: u64,
    /// Pixels of the picture that are tested for splats.
    pub pixels: u64,
}

impl CountedWork {
    /// One number: in units of a point that is decoded and projected, and with prices as software
    /// rasterizers have them. Only ratios within one run mean anything.
    pub fn units(&self) -> f64 {
        self.points as f64 + 0.5 * self.points_in_sight as f64 + 0.25 * self.pixels as f64
    }
}

impl Renderer {
    /// Counts the work of the last frame; only on the CPU path, which has the points at hand.
    pub fn count_work(&self, view: &View, settings: &FrameSettings) -> Option<CountedWork> {
        let frame = Tile::whole(view).gpu_frame(view, &settings.cut.splat, settings.background);
        let [width, height] = frame.target_px.map(|side| side as i32);
        let nodes = &self.table.nodes;
        let mut counted = CountedWork::default();
        for draw in &self.table.draws {
            let ready = self.cache.get((draw.cloud, draw.node))?;
            let words: &[u32] = match &ready.words {
                Words::Memory(all) => &all.words,
                #[cfg(feature = "gpu")]
                Words::Device(_) => return None,
            };
            let positions = &words[..ready.position_words as usize];
            let slot = draw.slot as usize;
            let of_point = |place: u32| {
                let Some(point) = point_at(&nodes[slot], place) else { return (0, 0) };
                let cell = local_cell(&nodes[slot], positions, point as usize);
                let Some(splat) = splat_of(&frame, nodes, slot, cell) else { return (0, 0) };
                let side = |axis: usize, limit: i32| {
                    let first = splat.corner[axis].max(0);
                    (splat.corner[axis] + splat.size_px).min(limit).saturating_sub(first).max(0)
                };
                let pixels = side(0, width) as u64 * side(1, height) as u64;
                (u64::from(pixels > 0), pixels)
            };
            let (seen, pixels) = (0..draw.count)
                .into_par_iter()
                .map(of_point)
                .reduce(|| (0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
            counted.points += u64::from(draw.count);
            counted.points_in_sight += seen;
            counted.pixels += pixels;
        }
        Some(counted)
    }
}
