//! The reference picture: every point of a cloud, projected in f64, one pixel each.
//!
//! What every error is stated against. Brute force on purpose: no level of detail, no culling, no
//! splats; all cores. Nodes are read one at a time per thread and dropped, so memory does not grow
//! with the cloud. The winner of a pixel is the nearest point, at equal distance (rounded to f32)
//! the smaller colour word, as in the other point passes.

use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;
use rayon::prelude::*;

use crate::geometry::View;
use crate::ids::NodeId;
use crate::octree::Octree;
use crate::passes::Picture;
use crate::passes::splat::cell_of_code;
use crate::store::NARROW_BITS;

const EMPTY: u64 = u64::MAX;

/// Draws all points of an octree. `read` replaces its arguments by the position and colour words
/// of a node; its first error ends the drawing.
pub fn reference_picture<E: Send>(
    octree: &Octree,
    view: &View,
    background: u32,
    read: impl Fn(NodeId, &mut Vec<u32>, &mut Vec<u32>) -> Result<(), E> + Sync,
) -> Result<Picture, E> {
    let count = view.width_px as usize * view.height_px as usize;
    let mut pixels = Vec::new();
    pixels.resize_with(count, || AtomicU64::new(EMPTY));
    let nodes = 0..octree.nodes().len() as u32;
    nodes.into_par_iter().map(NodeId).try_for_each_init(
        || (Vec::new(), Vec::new()),
        |(positions, colors), node| {
            read(node, positions, colors)?;
            draw_node(octree, view, node, positions, colors, &pixels);
            Ok(())
        },
    )?;
    let (colors, distances) = pixels
        .into_iter()
        .map(|pixel| match pixel.into_inner() {
            EMPTY => (background, f32::INFINITY),
            value => (value as u32, f32::from_bits((value >> 32) as u32)),
        })
        .unzip();
    Ok(Picture { width_px: view.width_px, height_px: view.height_px, colors, distances })
}

fn draw_node(
    octree: &Octree,
    view: &View,
    node: NodeId,
    positions: &[u32],
    colors: &[u32],
    pixels: &[AtomicU64],
) {
    let narrow = octree.local_bits(node) <= NARROW_BITS;
    let camera = &view.camera;
    let focal_px = view.focal_px();
    let center_px = [0.5 * f64::from(view.width_px), 0.5 * f64::from(view.height_px)];
    let (right, down) = (camera.right() * focal_px, -camera.up * focal_px);
    // Relative to the eye before anything is multiplied: exact at any distance from the origin.
    let lattice = octree.lattice();
    let eye_steps = lattice.lattice(camera.eye) - octree.cell_min(node).as_dvec3();
    for (words, &color) in positions.chunks_exact(if narrow { 2 } else { 3 }).zip(colors) {
        let cell = match *words {
            [low, high] => cell_of_code(low, high),
            _ => [words[0], words[1], words[2]],
        };
        let steps = DVec3::from_array(cell.map(f64::from)) - eye_steps;
        let relative = steps * lattice.scale;
        let distance = relative.dot(camera.forward);
        if distance.is_nan() || distance < camera.near {
            continue;
        }
        let x = relative.dot(right) / distance + center_px[0];
        let y = relative.dot(down) / distance + center_px[1];
        let seen = (0.0..f64::from(view.width_px)).contains(&x)
            && (0.0..f64::from(view.height_px)).contains(&y);
        if seen {
            let pixel = &pixels[y as usize * view.width_px as usize + x as usize];
            let value = u64::from((distance as f32).to_bits()) << 32 | u64::from(color);
            if value < pixel.load(Ordering::Relaxed) {
                pixel.fetch_min(value, Ordering::Relaxed);
            }
        }
    }
}
