// Turns the 64-bit pixels of the point pass into colour and reversed-z depth.
// In: frame, pixels (low word: inverted colour, high word: inverted distance; 0: empty).
// Out: colour target, depth target (near / distance; 0: empty).
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

@fragment
fn resolve(@builtin(position) position: vec4<f32>) -> Resolved {
    let at = vec2<u32>(position.xy);
    let pixel = pixels[at.y * frame.target_px.x + at.x];
    if pixel.y == 0u {
        return Resolved(unpack4x8unorm(frame.background), 0.0);
    }
    return Resolved(unpack4x8unorm(~pixel.x), frame.near / bitcast<f32>(~pixel.y));
}
