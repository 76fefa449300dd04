// Draws points through the rasterizer, for adapters without 64-bit atomics: as a point list where
// no splat of the node exceeds a pixel, as two triangles per point elsewhere.
// In: frame, nodes, words (gpu::layout); the instance is the node's slot. Out: colour, depth.
// Covers the same pixels as points_compute: corners are whole pixels, so fixed-function rounding
// has no say. Twin: passes::PointsCpu. Test: tests/gpu_twins.rs. Not run when no node is drawn.
#import shared/splat

struct Vertex {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat, either) color: u32,
}

fn vertex_at(pixel: vec2<f32>, distance: f32, color: u32) -> Vertex {
    let ndc = pixel / vec2<f32>(frame.target_px) * 2.0 - 1.0;
    return Vertex(vec4<f32>(ndc.x, -ndc.y, frame.near / distance, 1.0), color);
}

// Outside of every clip plane: the primitive vanishes.
fn nowhere() -> Vertex {
    return Vertex(vec4<f32>(2.0, 2.0, 2.0, 1.0), 0u);
}

// Whether a point at that distance is seen at all; beyond these margins no splat reaches in.
fn is_seen(center: vec2<f32>, distance: f32) -> bool {
    let reach = vec2<f32>(0.5 * frame.max_splat_px + 1.0);
    // Written so that NaN fails too.
    return distance >= frame.near && all(center > -reach)
        && all(center < vec2<f32>(frame.target_px) + reach);
}

@vertex
fn pixel_vertex(@builtin(vertex_index) point: u32, @builtin(instance_index) slot: u32) -> Vertex {
    let node = nodes[slot];
    let screen = screen_of(eye_relative(node, local_cell(node, point)));
    let center = screen.xy * (1.0 / screen.z) + frame.center_px;
    if !is_seen(center, screen.z) {
        return nowhere();
    }
    let middle = vec2<f32>(splat_corner(center, 1.0)) + 0.5;
    return vertex_at(middle, screen.z, words[node.colors_at + point]);
}

@vertex
fn square_vertex(@builtin(vertex_index) vertex: u32, @builtin(instance_index) slot: u32) -> Vertex {
    let point = vertex / 6u;
    let node = nodes[slot];
    let cell = local_cell(node, point);
    let screen = screen_of(eye_relative(node, cell));
    let center = screen.xy * (1.0 / screen.z) + frame.center_px;
    if !is_seen(center, screen.z) {
        return nowhere();
    }
    let size = splat_px(slot, node, cell, screen.z);
    // Corners 0 1 2, 2 1 3 of the square: bit 0 is right, bit 1 is down.
    let corner = array<u32, 6>(0u, 1u, 2u, 2u, 1u, 3u)[vertex % 6u];
    let offset = vec2<f32>(f32(corner & 1u), f32(corner >> 1u)) * size;
    let pixel = vec2<f32>(splat_corner(center, size)) + offset;
    return vertex_at(pixel, screen.z, words[node.colors_at + point]);
}

@fragment
fn point_color(vertex: Vertex) -> @location(0) vec4<f32> {
    return unpack4x8unorm(vertex.color);
}
