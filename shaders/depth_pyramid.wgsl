// Reduces a picture's depth to the farthest depth of 2x2, 4x4, ... pixels, four levels a dispatch.
// In: pyramid, depth (level 0) or levels. Out: levels.
// Sizes are rounded up, so that every texel of a level covers the pixels it stands for and no others,
// at odd edges too. Depth is reversed: the farthest is the smallest.
// Twin: passes::DepthPyramidCpu. Test: tests/depth_pyramid.rs. Not run unless something is tested.
#import shared/structs

@group(0) @binding(0) var<uniform> pyramid: GpuPyramid;
@group(0) @binding(1) var<storage, read_write> levels: array<f32>;
@group(0) @binding(2) var depth: texture_depth_2d;

// The level that is reduced.
override FROM_LEVEL: u32 = 0u;

// Farther than nothing: what is not there hides no less than what is.
const NOTHING: f32 = 2.0;

var<workgroup> tile: array<f32, 64>;

fn from_picture(at: vec2<u32>) -> f32 {
    if any(at >= pyramid.size_px) {
        return NOTHING;
    }
    return textureLoad(depth, at, 0);
}

fn from_level(at: vec2<u32>) -> f32 {
    let size = level_size(FROM_LEVEL);
    if any(at >= size) {
        return NOTHING;
    }
    return levels[level_offset(FROM_LEVEL) + at.y * size.x + at.x];
}

fn level_size(level: u32) -> vec2<u32> {
    return (pyramid.size_px + ((1u << level) - 1u)) >> vec2<u32>(level);
}

fn level_offset(level: u32) -> u32 {
    return pyramid.offsets[level / 4u][level % 4u];
}

fn keep(level: u32, at: vec2<u32>, value: f32) {
    let size = level_size(level);
    if level < pyramid.level_count && all(at < size) {
        levels[level_offset(level) + at.y * size.x + at.x] = value;
    }
}

// Writes a tile of 8x8 texels of the next level, and what follows from it of three more.
fn reduce(tile_at: vec2<u32>, lane: u32, value: f32) {
    let at = vec2<u32>(lane % 8u, lane / 8u);
    keep(FROM_LEVEL + 1u, tile_at * 8u + at, value);
    tile[lane] = value;
    workgroupBarrier();
    for (var step = 1u; step < 4u; step += 1u) {
        let side = 8u >> step;
        // Texels of the last step stand this far apart.
        let apart = 1u << (step - 1u);
        let works = all(at < vec2<u32>(side));
        var farthest = NOTHING;
        if works {
            let first = (at.y * 2u * 8u + at.x * 2u) * apart;
            farthest = min(
                min(tile[first], tile[first + apart]),
                min(tile[first + 8u * apart], tile[first + 9u * apart]),
            );
            keep(FROM_LEVEL + 1u + step, tile_at * side + at, farthest);
        }
        workgroupBarrier();
        if works {
            tile[(at.y * 8u + at.x) * 2u * apart] = farthest;
        }
        workgroupBarrier();
    }
}

@compute @workgroup_size(64)
fn reduce_picture(
    @builtin(workgroup_id) tile_at: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let start = (tile_at.xy * 8u + vec2<u32>(lane % 8u, lane / 8u)) * 2u;
    let above = min(from_picture(start), from_picture(start + vec2<u32>(1u, 0u)));
    let below = min(from_picture(start + vec2<u32>(0u, 1u)), from_picture(start + vec2<u32>(1u, 1u)));
    reduce(tile_at.xy, lane, min(above, below));
}

@compute @workgroup_size(64)
fn reduce_level(
    @builtin(workgroup_id) tile_at: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let start = (tile_at.xy * 8u + vec2<u32>(lane % 8u, lane / 8u)) * 2u;
    let above = min(from_level(start), from_level(start + vec2<u32>(1u, 0u)));
    let below = min(from_level(start + vec2<u32>(0u, 1u)), from_level(start + vec2<u32>(1u, 1u)));
    reduce(tile_at.xy, lane, min(above, below));
}
