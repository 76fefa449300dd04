// Draws points through the rasterizer, for adapters without atomics: as a point list where no splat
// of the node exceeds a pixel, as two triangles per point elsewhere.
// In: frame, nodes, words (gpu::layout); the instance is the node's slot. Out: colour, depth.
// Covers the same pixels as points_compute: corners are whole pixels, so fixed-function rounding
// has no say. Twin: passes::PointsCpu. Test: tests/gpu_twins.rs. Not run when no node is drawn.
//
// Depth tests keep the first of several points at one depth; here the smallest colour is to stay,
// as on the other paths. So points are drawn twice: for the order of the nearest distance
// (`nearest_order`), then, of those that have it, for the colour, whose order stands in for depth
// (`color_of_nearest`). At last orders become the depth that everything else reads.
#import shared/frame
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

// Of the first drawing; read by the second.
@group(2) @binding(0) var nearest: texture_depth_2d;

const ONE_BITS = 0x3f800000u;
const SMALLEST_NORMAL_BITS = 0x00800000u;

// A depth that orders distances without losing any: nearer is greater, 1 at the near plane.
fn distance_order(distance: f32) -> f32 {
    let beyond = bitcast<u32>(distance) - bitcast<u32>(frame.near);
    return bitcast<f32>(ONE_BITS - min(beyond, ONE_BITS - SMALLEST_NORMAL_BITS));
}

fn distance_of_order(order: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(frame.near) + (ONE_BITS - bitcast<u32>(order)));
}

// A depth that orders colours: the smaller the word, the greater. All words are opaque.
fn color_order(color: u32) -> f32 {
    return f32(0x1000000u - (color & 0xffffffu)) * 0x1p-24;
}

// What a point puts into a pixel.
struct Mark {
    color: u32,
    distance: f32,
    is_there: bool,
}

fn mark_of(vertex: Vertex) -> Mark {
    let has_shape = (SPLAT_SHAPE == ROUND || SPLAT_SHAPE == SPHERE) && vertex.square.z > 1;
    if !has_shape {
        return Mark(vertex.color, vertex.distance, true);
    }
    let reach = reach_of(vertex);
    if SPLAT_SHAPE != SPHERE || reach > 1.0 {
        return Mark(vertex.color, vertex.distance, reach <= 1.0);
    }
    let height = ball_height(reach);
    let distance = ball_distance(vertex.distance, f32(vertex.square.z), height);
    return Mark(ball_color(vertex.color, height), distance, true);
}

@fragment
fn nearest_order(vertex: Vertex) -> @builtin(frag_depth) f32 {
    let mark = mark_of(vertex);
    if !mark.is_there {
        discard;
    }
    return distance_order(mark.distance);
}

struct ColorAndOrder {
    @location(0) color: vec4<f32>,
    @builtin(frag_depth) order: f32,
}

@fragment
fn color_of_nearest(vertex: Vertex) -> ColorAndOrder {
    let mark = mark_of(vertex);
    let order = textureLoad(nearest, vec2<i32>(vertex.position.xy), 0);
    if !mark.is_there || distance_order(mark.distance) != order {
        discard;
    }
    return ColorAndOrder(unpack4x8unorm(mark.color), color_order(mark.color));
}

// One triangle that covers the target.
@vertex
fn cover_target(@builtin(vertex_index) vertex: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(f32(vertex & 1u) * 4.0 - 1.0, f32(vertex >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn depth_of_nearest(@builtin(position) position: vec4<f32>) -> @builtin(frag_depth) f32 {
    let order = textureLoad(nearest, vec2<i32>(position.xy), 0);
    return select(frame.near / distance_of_order(order), 0.0, order == 0.0);
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
