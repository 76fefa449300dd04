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

fn vertex_at(pixel: vec2<f32>, splat: Splat, color: u32) -> Vertex {
    let ndc = pixel / vec2<f32>(frame.target_px) * 2.0 - 1.0;
    let depth = frame.near / splat.distance;
    return Vertex(vec4<f32>(ndc.x, -ndc.y, depth, 1.0), color);
}

// Outside of every clip plane: the primitive vanishes.
fn nowhere() -> Vertex {
    return Vertex(vec4<f32>(2.0, 2.0, 2.0, 1.0), 0u);
}

@vertex
fn pixel_vertex(@builtin(vertex_index) point: u32, @builtin(instance_index) slot: u32) -> Vertex {
    let node = nodes[slot];
    let splat = splat_of(slot, node, point);
    if splat.size_px == 0 {
        return nowhere();
    }
    return vertex_at(vec2<f32>(splat.corner) + 0.5, splat, words[node.colors_at + point]);
}

@vertex
fn square_vertex(@builtin(vertex_index) vertex: u32, @builtin(instance_index) slot: u32) -> Vertex {
    let point = vertex / 6u;
    let node = nodes[slot];
    let splat = splat_of(slot, node, point);
    if splat.size_px == 0 {
        return nowhere();
    }
    // Corners 0 1 2, 2 1 3 of the square: bit 0 is right, bit 1 is down.
    let corner = array<u32, 6>(0u, 1u, 2u, 2u, 1u, 3u)[vertex % 6u];
    let offset = vec2<i32>(i32(corner & 1u), i32(corner >> 1u)) * splat.size_px;
    return vertex_at(vec2<f32>(splat.corner + offset), splat, words[node.colors_at + point]);
}

@fragment
fn point_color(vertex: Vertex) -> @location(0) vec4<f32> {
    return unpack4x8unorm(vertex.color);
}
