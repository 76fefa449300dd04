// Turns the 64-bit pixels of the point pass into colour and reversed-z depth.
// In: frame, pixels (low word: inverted colour under a byte of ones, high word: inverted distance;
// both 0: empty).
// Out: colour target and, where something needs it, depth target (near / distance; 0: empty).
// Twin: passes::PointsCpu::resolve. Test: tests/gpu_twins.rs. Not run when no node is drawn.
#import shared/frame

@group(2) @binding(0) var<storage, read> pixels: array<vec2<u32>>;

struct Resolved {
    @location(0) color: vec4<f32>,
    @builtin(frag_depth) depth: f32,
}

// What the fragments need of the frame, handed on by the triangle: software adapters read a uniform
// lane by lane.
struct Cover {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat, either) width_px: u32,
    @location(1) @interpolate(flat, either) background: u32,
    @location(2) @interpolate(flat, either) near: f32,
}

// One triangle that covers the target.
@vertex
fn cover_target(@builtin(vertex_index) vertex: u32) -> Cover {
    let x = f32(vertex & 1u) * 4.0 - 1.0;
    let y = f32(vertex >> 1u) * 4.0 - 1.0;
    return Cover(vec4<f32>(x, y, 0.0, 1.0), frame.target_px.x, frame.background, frame.near);
}

fn pixel_index(cover: Cover) -> u32 {
    let at = vec2<u32>(cover.position.xy);
    return at.y * cover.width_px + at.x;
}

// Without branches: software adapters run both sides of them for eight pixels at a time. They also
// read word by word, so colours and depths alone read one.
fn color_of(word: u32, background: u32) -> vec4<f32> {
    let color = select(~word | 0xff000000u, background, word == 0u);
    // As unpack4x8unorm, but without dividing: rounding to bytes gives the same ones back.
    return vec4<f32>((vec4<u32>(color) >> vec4<u32>(0u, 8u, 16u, 24u)) & vec4<u32>(0xffu))
        * (1.0 / 255.0);
}

fn depth_of(word: u32, near: f32) -> f32 {
    return select(near / bitcast<f32>(~word), 0.0, word == 0u);
}

@fragment
fn resolve(cover: Cover) -> Resolved {
    let pixel = pixels[pixel_index(cover)];
    return Resolved(color_of(pixel.x, cover.background), depth_of(pixel.y, cover.near));
}

// For targets that hold depth of other things too; of each pixel the nearest stays.
@fragment
fn resolve_depth(cover: Cover) -> @builtin(frag_depth) f32 {
    return depth_of(pixels[pixel_index(cover)].y, cover.near);
}

@fragment
fn resolve_color(cover: Cover) -> @location(0) vec4<f32> {
    return color_of(pixels[pixel_index(cover)].x, cover.background);
}
