//! From the words of a point to the square of pixels that it covers: the twin of
//! `shaders/shared/splat.wgsl`, operation by operation, so that pixels agree.
//!
//! f32 relative to the eye; pixels of the target, y down. No culling of nodes here.

use crate::gpu::layout::{GpuFrame, GpuNode, NARROW_BITS};

/// The square of pixels of one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Splat {
    /// First column and row; may lie outside of the target.
    pub corner: [i32; 2],
    /// Side, pixels.
    pub size_px: i32,
    /// Distance along the viewing direction.
    pub distance: f32,
}

/// Every third bit of a word, from the lowest: 11 bits.
#[inline]
fn gather(word: u32) -> u32 {
    let mut x = word & 0x4924_9249;
    x = (x ^ x >> 2) & 0xc30c_30c3;
    x = (x ^ x >> 4) & 0x0f00_f00f;
    x = (x ^ x >> 8) & 0xff00_00ff;
    (x ^ x >> 16) & 0x7ff
}

/// Local coordinates from the low and high word of a 63-bit Morton code.
#[inline]
pub fn cell_of_code(low: u32, high: u32) -> [u32; 3] {
    [
        gather(low) | gather(high >> 1) << 11,
        gather(low >> 1) | gather(high >> 2) << 11,
        gather(low >> 2) | gather(high) << 10,
    ]
}

/// Local coordinates of point `point` of a node whose position words are `positions`.
#[inline]
pub fn local_cell(node: &GpuNode, positions: &[u32], point: usize) -> [u32; 3] {
    if node.local_bits <= NARROW_BITS {
        cell_of_code(positions[2 * point], positions[2 * point + 1])
    } else {
        [positions[3 * point], positions[3 * point + 1], positions[3 * point + 2]]
    }
}

/// Position relative to the eye, metres, world axes.
#[inline]
pub fn eye_relative(node: &GpuNode, cell: [u32; 3]) -> [f32; 3] {
    std::array::from_fn(|axis| {
        let (cell, eye) = (cell[axis], node.eye_cell[axis]);
        let steps = if node.local_bits <= NARROW_BITS {
            (cell as i32 - eye as i32) as f32
        } else if cell >= eye {
            (cell - eye) as f32
        } else {
            // The difference of 32-bit coordinates needs a 33rd bit: the sign stands apart.
            -((eye - cell) as f32)
        };
        (steps - node.eye_fraction[axis]) * node.scale[axis]
    })
}

/// `(x w, y w, w)`: pixels from the middle of the picture and the distance along the view.
#[inline]
pub fn screen_of(frame: &GpuFrame, p: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|lane| {
        frame.screen_from_world_x[lane] * p[0]
            + frame.screen_from_world_y[lane] * p[1]
            + frame.screen_from_world_z[lane] * p[2]
    })
}

/// Splat size at 1 m of the deepest drawn node around a point of the node in `slot`.
pub fn finest_splat_px_m(nodes: &[GpuNode], slot: usize, cell: [u32; 3]) -> f32 {
    let mut deepest = slot;
    let mut bit = nodes[slot].local_bits;
    for _ in 0..nodes[slot].drawn_levels_below {
        let children = nodes[deepest].drawn_children;
        bit -= 1;
        let octant = cell[0] >> bit & 1 | (cell[1] >> bit & 1) << 1 | (cell[2] >> bit & 1) << 2;
        if children >> octant & 1 == 0 {
            break;
        }
        let earlier = children & ((1 << octant) - 1);
        deepest = ((children >> 8) + earlier.count_ones()) as usize;
    }
    nodes[deepest].splat_px_m
}

/// Side of a point's splat at distance `w`, whole pixels.
#[inline]
pub fn splat_px(frame: &GpuFrame, nodes: &[GpuNode], slot: usize, cell: [u32; 3], w: f32) -> f32 {
    let splat_px_m = nodes[slot].splat_px_m;
    // A node's size bounds the sizes below it: nothing to look up for splats of one pixel.
    if splat_px_m <= w {
        return 1.0;
    }
    let px_m = match frame.per_point_splats {
        0 => splat_px_m,
        _ => finest_splat_px_m(nodes, slot, cell),
    };
    (px_m / w).clamp(1.0, frame.max_splat_px).ceil()
}

/// The square of a point: centred on it, its side rounded up to whole pixels. `None` if it lies
/// before the near plane or outside of the target.
#[inline]
pub fn splat_of(frame: &GpuFrame, nodes: &[GpuNode], slot: usize, cell: [u32; 3]) -> Option<Splat> {
    let [xw, yw, w] = screen_of(frame, eye_relative(&nodes[slot], cell));
    let inverse = 1.0 / w;
    let center = [xw * inverse + frame.center_px[0], yw * inverse + frame.center_px[1]];
    let margin = 0.5 * frame.max_splat_px + 1.0;
    // Written so that NaN fails too.
    let inside = |axis: usize| {
        center[axis] > -margin && center[axis] < frame.target_px[axis] as f32 + margin
    };
    if !(w >= frame.near && inside(0) && inside(1)) {
        return None;
    }
    let size = splat_px(frame, nodes, slot, cell, w);
    let corner = center.map(|c| (c - (0.5 * size - 0.5)).floor() as i32);
    Some(Splat { corner, size_px: size as i32, distance: w })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::MortonKey;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn words_decode_to_the_cell_that_was_coded(x in 0u32..1 << 21, y in 0u32..1 << 21, z in 0u32..1 << 21) {
            let code = u64::encode([x, y, z]);
            prop_assert_eq!(cell_of_code(code as u32, (code >> 32) as u32), [x, y, z]);
        }
    }
}
