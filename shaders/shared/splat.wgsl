// From the words of a point to the square of pixels that it covers.
// In: nodes, words (shared/scene). Twin: passes::splat. Test: tests/gpu_twins.rs.
// Every operation stands here in the order in which the twin does it, so that pixels agree.
#import shared/scene

// The square of pixels of one point; size_px 0: nothing is drawn.
struct Splat {
    corner: vec2<i32>,
    size_px: i32,
    distance: f32,
}

// Every third bit of a word, from the lowest: 11 bits.
fn gather(word: u32) -> u32 {
    var x = word & 0x49249249u;
    x = (x ^ (x >> 2u)) & 0xc30c30c3u;
    x = (x ^ (x >> 4u)) & 0x0f00f00fu;
    x = (x ^ (x >> 8u)) & 0xff0000ffu;
    return (x ^ (x >> 16u)) & 0x7ffu;
}

// Local coordinates from the low and high word of a 63-bit Morton code.
fn cell_of_code(low: u32, high: u32) -> vec3<u32> {
    return vec3<u32>(
        gather(low) | (gather(high >> 1u) << 11u),
        gather(low >> 1u) | (gather(high >> 2u) << 11u),
        gather(low >> 2u) | (gather(high) << 10u),
    );
}

// Local coordinates of a point.
fn local_cell(node: GpuNode, point: u32) -> vec3<u32> {
    if node.local_bits <= NARROW_BITS {
        let at = node.positions_at + 2u * point;
        return cell_of_code(words[at], words[at + 1u]);
    }
    let at = node.positions_at + 3u * point;
    return vec3<u32>(words[at], words[at + 1u], words[at + 2u]);
}

// Position relative to the eye, metres, world axes.
fn eye_relative(node: GpuNode, cell: vec3<u32>) -> vec3<f32> {
    var steps: vec3<f32>;
    if node.local_bits <= NARROW_BITS {
        steps = vec3<f32>(vec3<i32>(cell) - vec3<i32>(node.eye_cell));
    } else {
        // The difference of 32-bit coordinates needs a 33rd bit: the sign stands apart.
        let ahead = vec3<f32>(cell - node.eye_cell);
        let behind = -vec3<f32>(node.eye_cell - cell);
        steps = select(behind, ahead, cell >= node.eye_cell);
    }
    return (steps - node.eye_fraction) * node.scale;
}

// (x w, y w, w): pixels from the middle of the picture and the distance along the view.
fn screen_of(p: vec3<f32>) -> vec3<f32> {
    return frame.screen_from_world_x.xyz * p.x + frame.screen_from_world_y.xyz * p.y
        + frame.screen_from_world_z.xyz * p.z;
}

// Splat size at 1 m of the deepest drawn node around a point of the node in `slot`.
fn finest_splat_px_m(slot: u32, cell: vec3<u32>) -> f32 {
    var deepest = slot;
    var bit = nodes[slot].local_bits;
    loop {
        let mask = nodes[deepest].drawn_child_mask;
        if mask == 0u || bit == 0u {
            break;
        }
        bit -= 1u;
        let upper = (cell >> vec3<u32>(bit)) & vec3<u32>(1u);
        let octant = upper.x | (upper.y << 1u) | (upper.z << 2u);
        if ((mask >> octant) & 1u) == 0u {
            break;
        }
        let earlier = mask & ((1u << octant) - 1u);
        deepest = nodes[deepest].first_child_slot + countOneBits(earlier);
    }
    return nodes[deepest].splat_px_m;
}

// The square of a point: centred on it, its side rounded up to whole pixels.
fn splat_of(slot: u32, node: GpuNode, point: u32) -> Splat {
    let cell = local_cell(node, point);
    let screen = screen_of(eye_relative(node, cell));
    let w = screen.z;
    let center = screen.xy * (1.0 / w) + frame.center_px;
    // Written so that NaN fails too.
    let margin = vec2<f32>(0.5 * frame.max_splat_px + 1.0);
    let inside = all(center > -margin) && all(center < vec2<f32>(frame.target_px) + margin);
    if !(w >= frame.near) || !inside {
        return Splat(vec2<i32>(0), 0, w);
    }
    var size = 1.0;
    // A parent's size bounds the size of what lies below it: no look-up for splats of one pixel.
    if node.splat_px_m > w {
        var px_m = node.splat_px_m;
        if frame.per_point_splats != 0u {
            px_m = finest_splat_px_m(slot, cell);
        }
        size = ceil(clamp(px_m / w, 1.0, frame.max_splat_px));
    }
    let corner = floor(center - vec2<f32>(0.5 * size - 0.5));
    return Splat(vec2<i32>(corner), i32(size), w);
}
