// Draws points through the rasterizer, for adapters without atomics: as a point list where no splat
// of the node exceeds a pixel, as two triangles per point elsewhere.
// In: frame, nodes, words (gpu::layout); the instance is the node's slot. Out: colour, depth.
// Covers the same pixels as points_compute: corners are whole pixels, so fixed-function rounding
// has no say. Twin: passes::PointsCpu. Test: tests/gpu_twins.rs. Not run when no node is drawn.
#import shared/splat

// Whether of some nodes only a share of the points is drawn. Fixed per pipeline.
override PARTLY: bool = false;

struct Vertex {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat, either) color: u32,
    // First pixel of the square and its side.
    @location(1) @interpolate(flat, either) square: vec3<i32>,
    @location(2) @interpolate(flat, either) distance: f32,
}

fn vertex_at(pixel: vec2<f32>, square: vec3<i32>, distance: f32, color: u32) -> Vertex {
    let ndc = pixel / vec2<f32>(frame.target_px) * 2.0 - 1.0;
    let position = vec4<f32>(ndc.x, -ndc.y, frame.near / distance, 1.0);
    return Vertex(position, color, square, distance);
}

// Outside of every clip plane: the primitive vanishes.
fn nowhere() -> Vertex {
    return Vertex(vec4<f32>(2.0, 2.0, 2.0, 1.0), 0u, vec3<i32>(0), 1.0);
}

// Whether a point at that distance is seen at all; beyond these margins no splat reaches in.
fn is_seen(center: vec2<f32>, distance: f32) -> bool {
    let reach = vec2<f32>(0.5 * frame.max_splat_px + 2.0);
    // Written so that NaN fails too.
    return distance >= frame.near && all(center > -reach)
        && all(center < vec2<f32>(frame.target_px) + reach);
}

fn drawn_point(node: GpuNode, place: u32) -> u32 {
    if PARTLY {
        return point_at(node, place);
    }
    return place;
}

@vertex
fn pixel_vertex(@builtin(vertex_index) place: u32, @builtin(instance_index) slot: u32) -> Vertex {
    let node = nodes[slot];
    let point = drawn_point(node, place);
    if point >= node.drawn_count {
        return nowhere();
    }
    let screen = screen_of(eye_relative(node, local_cell(node, point)));
    let center = screen.xy * (1.0 / screen.z) + frame.center_px;
    if !is_seen(center, screen.z) {
        return nowhere();
    }
    let corner = splat_corner(center, 1.0);
    let middle = vec2<f32>(corner) + 0.5;
    return vertex_at(middle, vec3<i32>(corner, 1), screen.z, words[node.colors_at + point]);
}

@vertex
fn square_vertex(@builtin(vertex_index) vertex: u32, @builtin(instance_index) slot: u32) -> Vertex {
    let node = nodes[slot];
    let point = drawn_point(node, vertex / 6u);
    if point >= node.drawn_count {
        return nowhere();
    }
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
    let first = splat_corner(center, size);
    let square = vec3<i32>(first, i32(size));
    return vertex_at(vec2<f32>(first) + offset, square, screen.z, words[node.colors_at + point]);
}

@fragment
fn point_color(vertex: Vertex) -> @location(0) vec4<f32> {
    return unpack4x8unorm(vertex.color);
}

fn reach_of(vertex: Vertex) -> f32 {
    return splat_reach(vec2<i32>(vertex.position.xy) - vertex.square.xy, f32(vertex.square.z));
}

@fragment
fn disc_color(vertex: Vertex) -> @location(0) vec4<f32> {
    if reach_of(vertex) > 1.0 {
        discard;
    }
    return unpack4x8unorm(vertex.color);
}

struct Ball {
    @location(0) color: vec4<f32>,
    @builtin(frag_depth) depth: f32,
}

@fragment
fn ball_color_and_depth(vertex: Vertex) -> Ball {
    if vertex.square.z == 1 {
        return Ball(unpack4x8unorm(vertex.color), frame.near / vertex.distance);
    }
    let reach = reach_of(vertex);
    if reach > 1.0 {
        discard;
    }
    let height = ball_height(reach);
    let distance = ball_distance(vertex.distance, f32(vertex.square.z), height);
    return Ball(unpack4x8unorm(ball_color(vertex.color, height)), frame.near / distance);
}
