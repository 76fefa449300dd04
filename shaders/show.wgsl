// Shows a picture in the window, texel by texel where both have as many pixels.
// In: shown. Out: the part of the window that is the viewport, all of it.
// Egui would do the same, but its own shader looks at four texels and wraps their coordinates with
// divisions whatever is asked of it; where processors paint that takes a large part of their time.
// Seen by: tests/viewer_show.rs.

// Whether the window's format takes linear values and encodes them itself; pictures are encoded.
override IS_LINEAR: bool = false;

@group(0) @binding(0) var shown: texture_2d<f32>;

struct Corner {
    @builtin(position) clip: vec4<f32>,
    @location(0) across: vec2<f32>,
}

// One triangle over everything.
@vertex
fn corner(@builtin(vertex_index) index: u32) -> Corner {
    let across = vec2<f32>(f32((index << 1u) & 2u), f32(index & 2u));
    return Corner(vec4<f32>(across * vec2<f32>(2.0, -2.0) + vec2<f32>(-1.0, 1.0), 0.0, 1.0), across);
}

fn linear(encoded: vec3<f32>) -> vec3<f32> {
    let low = encoded / 12.92;
    let high = pow((encoded + vec3<f32>(0.055)) / 1.055, vec3<f32>(2.4));
    return select(high, low, encoded <= vec3<f32>(0.04045));
}

@fragment
fn show(in: Corner) -> @location(0) vec4<f32> {
    let size = textureDimensions(shown);
    let texel = min(vec2<u32>(in.across * vec2<f32>(size)), size - vec2<u32>(1u));
    let color = textureLoad(shown, texel, 0);
    if IS_LINEAR {
        return vec4<f32>(linear(color.rgb), color.a);
    }
    return color;
}
