//! Points drawn by all cores: the twin of `points_compute` and `resolve`, for machines without an
//! adapter and for the tests that hold both sides together.
//!
//! The same f32 arithmetic, the same winner at each pixel (nearest, then the smaller colour word),
//! whatever the number of threads.

use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use crate::gpu::layout::{GpuBatch, GpuFrame, ROUND, SQUARE};
use crate::passes::splat::{
    ball_color, ball_distance, ball_height, local_cell, point_at, splat_of, splat_reach,
};
use crate::passes::{Batches, DrawTable, Picture};

/// The words of one drawn node in memory.
#[derive(Clone, Copy, Debug)]
pub struct NodeWords<'a> {
    /// Two or three words per point.
    pub positions: &'a [u32],
    /// One RGBA8 word per point.
    pub colors: &'a [u32],
}

/// Points are opaque.
const OPAQUE: u32 = 0xff00_0000;
/// Points that a core draws at a time.
const BATCH_POINTS: u32 = 4096;

/// The pass and its pixels, kept from frame to frame.
#[derive(Debug, Default)]
pub struct PointsCpu {
    /// Inverted distance in the high word, inverted colour under a byte of ones in the low one; 0 is
    /// empty.
    pixels: Vec<AtomicU64>,
    batches: Batches,
}

impl PointsCpu {
    /// Draws a table; `words` holds the words of each of its rows.
    pub fn draw(&mut self, frame: &GpuFrame, table: &DrawTable, words: &[NodeWords]) {
        assert_eq!(words.len(), table.nodes.len(), "one entry per row");
        let count = frame.target_px[0] as usize * frame.target_px[1] as usize;
        self.pixels.clear();
        self.pixels.resize_with(count, AtomicU64::default);
        table.batches(BATCH_POINTS, 1, &mut self.batches);
        let pixels = &self.pixels[..];
        self.batches
            .list
            .par_iter()
            .for_each(|&batch| draw_batch(frame, table, words, batch, pixels));
    }

    /// The picture that was drawn.
    pub fn resolve(&self, frame: &GpuFrame) -> Picture {
        let [width_px, height_px] = frame.target_px;
        let (colors, distances) = self
            .pixels
            .par_iter()
            .map(|pixel| match pixel.load(Ordering::Relaxed) {
                0 => (frame.background, f32::INFINITY),
                value => (!(value as u32) | OPAQUE, f32::from_bits(!((value >> 32) as u32))),
            })
            .unzip();
        Picture { width_px, height_px, colors, distances }
    }

    /// Bytes held for pixels.
    pub fn held_bytes(&self) -> u64 {
        8 * self.pixels.capacity() as u64
    }
}

fn draw_batch(
    frame: &GpuFrame,
    table: &DrawTable,
    words: &[NodeWords],
    batch: GpuBatch,
    pixels: &[AtomicU64],
) {
    let slot = batch.node_slot as usize;
    let node = &table.nodes[slot];
    let NodeWords { positions, colors } = words[slot];
    let [width, height] = frame.target_px.map(|side| side as i32);
    let (first, end) = (batch.first_point as usize, batch.end_point as usize);
    let put = |at: usize, nearness: u32, color: u32| {
        let pixel = &pixels[at];
        // Most points are hidden: they pay for no atomic operation.
        if (pixel.load(Ordering::Relaxed) >> 32) as u32 <= nearness {
            pixel.fetch_max(
                u64::from(nearness) << 32 | u64::from(!color | OPAQUE),
                Ordering::Relaxed,
            );
        }
    };
    for place in first..end {
        let Some(point) = point_at(node, place as u32).map(|point| point as usize) else {
            continue;
        };
        let color = colors[point];
        let cell = local_cell(node, positions, point);
        let Some(splat) = splat_of(frame, &table.nodes, slot, cell) else { continue };
        let nearness = !splat.distance.to_bits();
        let side = splat.size_px as f32;
        let columns = splat.corner[0].max(0)..(splat.corner[0] + splat.size_px).min(width);
        for y in splat.corner[1].max(0)..(splat.corner[1] + splat.size_px).min(height) {
            for x in columns.clone() {
                let at = y as usize * width as usize + x as usize;
                if frame.splat_shape == SQUARE || splat.size_px == 1 {
                    put(at, nearness, color);
                    continue;
                }
                let reach = splat_reach([x - splat.corner[0], y - splat.corner[1]], side);
                if reach <= 1.0 && frame.splat_shape == ROUND {
                    put(at, nearness, color);
                } else if reach <= 1.0 {
                    let height = ball_height(reach);
                    let distance = ball_distance(frame, splat.distance, side, height);
                    put(at, !distance.to_bits(), ball_color(color, height));
                }
            }
        }
    }
}
