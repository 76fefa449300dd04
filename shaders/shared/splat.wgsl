// From the words of a point to the square of pixels that it covers.
// In: frame (shared/frame or shared/frame_once), nodes, words (shared/scene).
// Twin: passes::splat. Test: tests/gpu_twins.rs.
// Every operation stands here in the order in which the twin does it, so that pixels agree.
#import shared/scene
#import shared/splat_shape

// Whether the nodes drawn hold three coordinates per point, else a Morton code. Fixed per pipeline,
// so that no point pays for asking.
override WIDE_NODES: bool = false;

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
    if WIDE_NODES {
        let at = node.positions_at + 3u * point;
        return vec3<u32>(words[at], words[at + 1u], words[at + 2u]);
    }
    let at = node.positions_at + 2u * point;
    return cell_of_code(words[at], words[at + 1u]);
}

// Position relative to the eye, metres, world axes.
fn eye_relative(node: GpuNode, cell: vec3<u32>) -> vec3<f32> {
    var steps = vec3<f32>(vec3<i32>(cell) - vec3<i32>(node.eye_cell));
    if WIDE_NODES {
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

// Side of a point's splat at distance `w`, whole pixels, from the deepest drawn node around it.
// All points of a node take the same number of steps and none branches: software adapters pay far
// more for branches that part than for steps that change nothing.
fn splat_px(slot: u32, node: GpuNode, cell: vec3<u32>, w: f32) -> f32 {
    var deepest = slot;
    var bit = node.local_bits;
    let steps = node.drawn_levels_below * frame.per_point_splats;
    for (var step = 0u; step < steps; step += 1u) {
        let children = nodes[deepest].drawn_children;
        let upper = (cell >> vec3<u32>(bit - 1u)) & vec3<u32>(1u);
        let octant = upper.x | (upper.y << 1u) | (upper.z << 2u);
        let is_drawn = ((children >> octant) & 1u) != 0u;
        let earlier = children & ((1u << octant) - 1u);
        let child = (children >> 8u) + countOneBits(earlier);
        deepest = select(deepest, child, is_drawn);
        bit = select(bit, bit - 1u, is_drawn);
    }
    return splat_side(nodes[deepest].splat_px_m, w);
}

// The point at a place of a node of which only a share is drawn; at least `drawn_count` where there
// is none. Of each block of successive points (which lie close together) those come first that are
// farthest apart, so a share is even, and a larger one contains the smaller.
fn point_at(node: GpuNode, place: u32) -> u32 {
    if place < node.whole_count {
        return place;
    }
    let beyond = place - node.whole_count;
    // Exact for the counts that Rust allows, and far faster than dividing integers.
    let block = u32((f32(beyond) + 0.5) * node.kept_inverse);
    let rank = beyond - block * node.kept_of_block;
    let scattered = reverseBits(rank) >> (32u - SHARE_BLOCK_BITS);
    return node.whole_count + (block << SHARE_BLOCK_BITS) + scattered;
}

// First column and row of the square of `size` pixels a side around a point.
// Without a branch: lavapipe compiles a shader anew for other values of the frame's first words
// once a branch, or the end of a loop, follows from uniforms alone.
fn splat_corner(center: vec2<f32>, size: f32) -> vec2<i32> {
    let by_place = floor(center - vec2<f32>(0.5 * size - 0.5));
    let by_pixel = floor(center) - vec2<f32>(floor(0.5 * size - 0.5));
    return vec2<i32>(select(by_place, by_pixel, frame.nested_splats != 0u));
}
