// Turns the 64-bit pixels of the point pass into colour and reversed-z depth.
// In: frame, pixels (low word: inverted colour, high word: inverted distance; 0: empty).
// Out: colour target and, where something needs it, depth target (near / distance; 0: empty).
// Twin: passes::PointsCpu::resolve. Test: tests/gpu_twins.rs. Not run when no node is drawn.
#import shared/structs

@group(0) @binding(0) var<uniform> frame: GpuFrame;
@group(2) @binding(0) var<storage, read> pixels: array<vec2<u32>>;

struct Resolved {
    @location(0) color: vec4<f32>,
    @builtin(frag_depth) depth: f32,
}

// One triangle that covers the target.
@vertex
fn cover_target(@builtin(vertex_index) vertex: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(f32(vertex & 1u) * 4.0 - 1.0, f32(vertex >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

fn pixel_at(position: vec4<f32>) -> vec2<u32> {
    let at = vec2<u32>(position.xy);
    return pixels[at.y * frame.target_px.x + at.x];
}

// Without branches: software adapters run both sides of them for eight pixels at a time.
fn color_of(pixel: vec2<u32>) -> vec4<f32> {
    return unpack4x8unorm(select(~pixel.x, frame.background, pixel.y == 0u));
}

@fragment
fn resolve(@builtin(position) position: vec4<f32>) -> Resolved {
    let pixel = pixel_at(position);
    let depth = select(frame.near / bitcast<f32>(~pixel.y), 0.0, pixel.y == 0u);
    return Resolved(color_of(pixel), depth);
}

// For targets that hold depth of other things too; of each pixel the nearest stays.
@fragment
fn resolve_depth(@builtin(position) position: vec4<f32>) -> @builtin(frag_depth) f32 {
    let pixel = pixel_at(position);
    return select(frame.near / bitcast<f32>(~pixel.y), 0.0, pixel.y == 0u);
}

@fragment
fn resolve_color(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    return color_of(pixel_at(position));
}
