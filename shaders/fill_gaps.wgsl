// Fills gaps in surfaces: pixels that are empty, or show what lies behind, amid nearer points.
// In each of eight directions the first pixel that is clearly nearer counts, within the radius; of
// those the front ones, if they surround the pixel (no gap between successive directions is half a
// turn or more), give it their mean colour and depth, near ones more.
// In: finish, colours, depths. Out: colour target, depth target.
// Twin: passes::fill_gaps. Test: tests/gpu_twins.rs. Not run unless asked for.
#import shared/pictures

// Clearly nearer: by this share of the distance.
const BEHIND: f32 = 0.02;
// One surface: within this share of the distance.
const TOGETHER: f32 = 0.05;

struct Filled {
    @location(0) color: vec4<f32>,
    @builtin(frag_depth) depth: f32,
}

@fragment
fn fill_gaps(@builtin(position) position: vec4<f32>) -> Filled {
    let at = vec2<i32>(position.xy);
    let own = depth_at(at);
    let kept = Filled(textureLoad(colors, at, 0), own);
    var depth: array<f32, 8>;
    var step: array<i32, 8>;
    var front = 0.0;
    for (var i = 0; i < 8; i += 1) {
        depth[i] = 0.0;
        step[i] = 0;
        for (var s = 1; s <= i32(finish.gap_radius_px); s += 1) {
            let there = depth_at(at + AROUND[i] * s);
            if there > own * (1.0 + BEHIND) {
                depth[i] = there;
                step[i] = s;
                break;
            }
        }
        front = max(front, depth[i]);
    }
    if front == 0.0 {
        return kept;
    }
    // Directions without a front pixel: three in a row leave half a turn open.
    var open = 0u;
    for (var i = 0; i < 8; i += 1) {
        if depth[i] < front * (1.0 - TOGETHER) {
            open |= 257u << u32(i);
        }
    }
    if (open & (open >> 1u) & (open >> 2u) & 255u) != 0u {
        return kept;
    }
    var color = vec4<u32>(0u);
    var weights = 0u;
    var depth_sum = 0.0;
    for (var i = 0; i < 8; i += 1) {
        if (open & (1u << u32(i))) == 0u {
            // By the inverse square of the distance; diagonals are twice as far.
            let weight = (3600u >> u32(i & 1)) / u32(step[i] * step[i]);
            color += color_at(at + AROUND[i] * step[i]) * weight;
            weights += weight;
            depth_sum += depth[i] * f32(weight);
        }
    }
    color = (color + weights / 2u) / weights;
    let packed = color.x | (color.y << 8u) | (color.z << 16u) | (color.w << 24u);
    return Filled(unpack4x8unorm(packed), depth_sum / f32(weights));
}
