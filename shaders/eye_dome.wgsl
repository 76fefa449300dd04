// Eye-dome lighting: pixels darken by how far nearer their neighbours are, in logarithms of the
// distance, so that edges and folds show at any scale without normals.
// In: finish, colours, depths. Out: colour target.
// Twin: passes::light_eye_dome. Test: tests/gpu_twins.rs. Not run unless asked for.
// After: C. Boucheny, "Interactive scientific visualization of large datasets", 2009.
#import shared/pictures

// Logarithm to base 2 of a positive number, from its bits: within 0.01, without a step or a bend
// where the exponent changes, and the same on every machine.
fn log2_of(x: f32) -> f32 {
    let bits = bitcast<u32>(x);
    let m = f32(bits & 0x7fffffu) * 0x1p-23;
    return f32(bits >> 23u) + m + m * (1.0 - m) * (1.0 / 3.0);
}

@fragment
fn light_eye_dome(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    let at = vec2<i32>(position.xy);
    let own = depth_at(at);
    let color = textureLoad(colors, at, 0);
    if own == 0.0 {
        return color;
    }
    let own_log = log2_of(own);
    var nearer = 0.0;
    for (var i = 0; i < 8; i += 1) {
        let there = depth_at(at + AROUND[i] * i32(finish.eye_dome_radius_px));
        if there > own {
            nearer += log2_of(there) - own_log;
        }
    }
    // A stand-in for the exponential function that is the same on every machine.
    let x = finish.eye_dome_strength * nearer;
    let light = 1.0 / (1.0 + x + x * x * 0.5);
    let bytes = vec4<u32>(color * 255.0 + 0.5);
    let lit = vec3<u32>(vec3<f32>(bytes.xyz) * light + 0.5);
    let packed = lit.x | (lit.y << 8u) | (lit.z << 16u) | (bytes.w << 24u);
    return unpack4x8unorm(packed);
}
