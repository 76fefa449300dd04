// The picture so far, for passes that go over all of it: colour, and depth as `near / distance`, 0
// where nothing is.

struct GpuFinish {
    gap_radius_px: u32,
    eye_dome_radius_px: u32,
    eye_dome_strength: f32,
    padding_0: u32,
}

@group(0) @binding(0) var<uniform> finish: GpuFinish;
@group(0) @binding(1) var colors: texture_2d<f32>;
@group(0) @binding(2) var depths: texture_depth_2d;

// The eight neighbours, around.
const AROUND = array<vec2<i32>, 8>(
    vec2<i32>(1, 0), vec2<i32>(1, 1), vec2<i32>(0, 1), vec2<i32>(-1, 1),
    vec2<i32>(-1, 0), vec2<i32>(-1, -1), vec2<i32>(0, -1), vec2<i32>(1, -1),
);

// Depth at a pixel; 0 outside of the picture.
fn depth_at(at: vec2<i32>) -> f32 {
    let size = vec2<i32>(textureDimensions(depths));
    if any(at < vec2<i32>(0)) || any(at >= size) {
        return 0.0;
    }
    return textureLoad(depths, at, 0);
}

// Colour at a pixel of the picture, as bytes.
fn color_at(at: vec2<i32>) -> vec4<u32> {
    return vec4<u32>(textureLoad(colors, at, 0) * 255.0 + 0.5);
}

// One triangle that covers the target.
@vertex
fn cover_target(@builtin(vertex_index) vertex: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(f32(vertex & 1u) * 4.0 - 1.0, f32(vertex >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}
