//! From the words of a point to the square of pixels that it covers: the twin of
//! `shaders/shared/splat.wgsl` and `splat_shape.wgsl`, operation by operation, so that pixels agree.
//!
//! f32 relative to the eye; pixels of the target, y down. No culling of nodes here.

use crate::gpu::layout::{GpuFrame, GpuNode, NARROW_BITS, ROUND, SHARE_BLOCK_BITS};

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
    if splat_px_m <= w && frame.min_splat_px <= 1.0 {
        return 1.0;
    }
    let px_m = match frame.per_point_splats {
        0 => splat_px_m,
        _ => finest_splat_px_m(nodes, slot, cell),
    };
    splat_side(frame, px_m, w)
}

/// Side of a splat of so many pixels at 1 m, seen from `w`: whole pixels.
#[inline]
pub fn splat_side(frame: &GpuFrame, splat_px_m: f32, w: f32) -> f32 {
    let side = (splat_px_m / w).max(frame.min_splat_px).min(frame.max_splat_px).ceil();
    if frame.splat_shape == ROUND && frame.nested_splats != 0 {
        // Discs lie within larger ones only if they have the same middle.
        return side + 1.0 - side % 2.0;
    }
    side
}

/// The point at a place of a node of which only a share is drawn; `None` if there is none.
#[inline]
pub fn point_at(node: &GpuNode, place: u32) -> Option<u32> {
    if place < node.whole_count {
        return Some(place);
    }
    let beyond = place - node.whole_count;
    let block = ((beyond as f32 + 0.5) * node.kept_inverse) as u32;
    let rank = beyond.wrapping_sub(block.wrapping_mul(node.kept_of_block));
    let scattered = rank.reverse_bits() >> (32 - SHARE_BLOCK_BITS);
    let point = node.whole_count + (block << SHARE_BLOCK_BITS) + scattered;
    (point < node.drawn_count).then_some(point)
}

/// Square of a pixel's distance from the middle of the splat, of that of the rim: above 1 is
/// outside. `offset` counts pixels from the first of the square.
#[inline]
pub fn splat_reach(offset: [i32; 2], side: f32) -> f32 {
    let [x, y] = offset.map(|offset| offset as f32 + (0.5 - 0.5 * side));
    (x * x + y * y) / (0.25 * side * side)
}

/// Height of a ball above its rim where [`splat_reach`] is `reach`, of its radius.
#[inline]
pub fn ball_height(reach: f32) -> f32 {
    (1.0 - reach).sqrt()
}

/// Distance of the ball's surface there.
#[inline]
pub fn ball_distance(frame: &GpuFrame, w: f32, side: f32, height: f32) -> f32 {
    (w * (1.0 - height * (0.5 * side * frame.pixel_m))).max(frame.near)
}

/// A colour as bright as a ball is there: lit from the eye.
#[inline]
pub fn ball_color(color: u32, height: f32) -> u32 {
    let light = 0.35 + 0.65 * height;
    let lit = |shift: u32| ((((color >> shift) & 0xff) as f32 * light + 0.5) as u32) << shift;
    lit(0) | lit(8) | lit(16) | color & 0xff00_0000
}

/// The square of a point: around it, its side rounded up to whole pixels. `None` if it lies before
/// the near plane or outside of the target.
#[inline]
pub fn splat_of(frame: &GpuFrame, nodes: &[GpuNode], slot: usize, cell: [u32; 3]) -> Option<Splat> {
    let [xw, yw, w] = screen_of(frame, eye_relative(&nodes[slot], cell));
    let inverse = 1.0 / w;
    let center = [xw * inverse + frame.center_px[0], yw * inverse + frame.center_px[1]];
    let margin = 0.5 * frame.max_splat_px + 2.0;
    // Written so that NaN fails too.
    let inside = |axis: usize| {
        center[axis] > -margin && center[axis] < frame.target_px[axis] as f32 + margin
    };
    if !(w >= frame.near && inside(0) && inside(1)) {
        return None;
    }
    let size = splat_px(frame, nodes, slot, cell, w);
    let corner = match frame.nested_splats {
        0 => center.map(|c| (c - (0.5 * size - 0.5)).floor() as i32),
        _ => center.map(|c| (c.floor() - (0.5 * size - 0.5).floor()) as i32),
    };
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
