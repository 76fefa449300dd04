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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Camera, MortonKey};
    use crate::octree::{LevelIndex, Node, RootCube};
    use crate::points::Lattice;
    use glam::{I64Vec3, UVec3};
    use std::convert::Infallible;

    /// One node at UTM coordinates, millimetre steps, with these local cells and colours.
    fn picture(points: &[([u32; 3], u32)]) -> (Octree, View, Picture) {
        let lattice = Lattice { scale: DVec3::splat(0.001), offset: DVec3::new(5e5, 5e6, 500.0) };
        let node = Node {
            depth: 0,
            cell: UVec3::ZERO,
            parent: None,
            first_child: NodeId(1),
            child_mask: 0,
            levels: LevelIndex::new(vec![1, points.len() as u32]).expect("valid"),
            tight_min: UVec3::ZERO,
            tight_max: UVec3::splat(1 << 14),
        };
        let root = RootCube { min: I64Vec3::new(-700, 40, 9), bits: 15 };
        let octree = Octree::new(lattice, root, 1, vec![node]).expect("valid");
        let eye = lattice.world(root.min + I64Vec3::new(8000, -20_000, 8000));
        let camera = Camera::looking_at(eye, eye + DVec3::Y, DVec3::Z, 1.0, 0.01);
        let view = View { camera, width_px: 64, height_px: 48 };
        let read = |_, positions: &mut Vec<u32>, colors: &mut Vec<u32>| {
            let codes = points.iter().map(|point| u64::encode(point.0));
            *positions = codes.flat_map(|code| [code as u32, (code >> 32) as u32]).collect();
            *colors = points.iter().map(|point| point.1).collect();
            Ok::<(), Infallible>(())
        };
        let picture = reference_picture(&octree, &view, 7, read).expect("reading cannot fail");
        (octree, view, picture)
    }

    #[test]
    fn each_point_stands_where_the_view_projects_it() {
        let cells = [[8000, 0, 8000], [1000, 5, 3000], [15_000, 16_000, 9000], [30_000, 0, 8000]];
        let points: Vec<_> = cells.iter().zip(1..).map(|(&cell, color)| (cell, color)).collect();
        let (octree, view, picture) = picture(&points);
        let mut seen = 0;
        for &(cell, color) in &points {
            let place = octree.root_cube().min + UVec3::from_array(cell).as_i64vec3();
            let (x, y, w) = view.project(octree.lattice().world(place)).expect("in front");
            if (0.0..64.0).contains(&x) && (0.0..48.0).contains(&y) {
                let pixel = y as usize * 64 + x as usize;
                assert_eq!(picture.colors[pixel], color);
                assert!((f64::from(picture.distances[pixel]) - w).abs() < 1e-5);
                seen += 1;
            }
        }
        assert_eq!((seen, picture.covered()), (3, 3), "the last one is off screen");
        assert_eq!(picture.colors.iter().filter(|&&color| color == 7).count(), 64 * 48 - 3);
    }

    #[test]
    fn the_nearest_wins_then_the_smaller_colour() {
        let (_, _, picture) =
            picture(&[([8000, 9000, 8000], 1), ([8000, 10, 8000], 9), ([8000, 10, 8000], 5)]);
        assert_eq!(picture.covered(), 1);
        assert_eq!(picture.colors.iter().find(|&&color| color != 7), Some(&5));
    }
}
