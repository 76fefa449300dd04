// Whether boxes show before a depth pyramid. Twin: passes::DepthPyramidCpu::may_show, step by step.

@group(0) @binding(0) var<uniform> frame: GpuFrame;
@group(1) @binding(0) var<uniform> pyramid: GpuPyramid;
@group(1) @binding(1) var<storage, read> levels: array<f32>;
@group(1) @binding(2) var depth: texture_depth_2d;

// Room for the rounding of places on screen, pixels, and of depths, relative.
const PLACE_MARGIN: f32 = 0.0625;
const DEPTH_MARGIN: f32 = 1.00001;
// Farther than any depth can be near.
const ENDLESS: f32 = 1e30;
// A plane through the eye lies as far on the side where it is not entered.
const TINY: f32 = 1e-20;

// Farthest depth of a texel.
fn farthest_depth(level: u32, at: vec2<u32>) -> f32 {
    if level == 0u {
        return textureLoad(depth, at, 0);
    }
    let width = (pyramid.size_px.x + ((1u << level) - 1u)) >> level;
    return levels[pyramid.offsets[level / 4u][level % 4u] + at.y * width + at.x];
}

// Whether any of a box may show. The box is relative to the eye, in world axes, and wholly behind
// the near plane.
//
// The rays through a pixel enter a box where they have crossed the nearer plane of each axis, and
// leave it at the first of the farther planes. Over the picture the depth of each plane is linear,
// so its bounds over a texel are exact: a texel hides the box if its farthest depth is nearer than
// the box can be there, or if the box misses it.
fn may_show(low: vec3<f32>, high: vec3<f32>) -> bool {
    // Where on screen, and how near.
    var first_px = vec2<f32>(ENDLESS);
    var last_px = vec2<f32>(-ENDLESS);
    var nearest = ENDLESS;
    for (var corner = 0u; corner < 8u; corner += 1u) {
        let upper = vec3<bool>((corner & 1u) != 0u, (corner & 2u) != 0u, (corner & 4u) != 0u);
        let p = select(low, high, upper);
        let screen = frame.screen_from_world_x.xyz * p.x + frame.screen_from_world_y.xyz * p.y
            + frame.screen_from_world_z.xyz * p.z;
        let px = screen.xy / screen.z + frame.center_px;
        first_px = min(first_px, px);
        last_px = max(last_px, px);
        nearest = min(nearest, screen.z);
    }
    if !(nearest > 0.0) {
        return true;
    }
    let size = vec2<f32>(pyramid.size_px);
    first_px = max(first_px - PLACE_MARGIN, vec2<f32>(0.0));
    last_px = min(last_px + PLACE_MARGIN, size);
    if any(first_px >= last_px) {
        return false;
    }
    let first = vec2<u32>(first_px);
    let last = min(vec2<u32>(last_px), pyramid.size_px - 1u);

    // Inverse distances of the planes: those where rays enter (0 where an axis has none), and those
    // where they leave, of which an axis that the eye lies between has two.
    let below = low > vec3<f32>(0.0);
    let above = high < vec3<f32>(0.0);
    let to_low = 1.0 / select(min(low, vec3<f32>(-TINY)), max(low, vec3<f32>(TINY)), below);
    let to_high = 1.0 / select(max(high, vec3<f32>(TINY)), min(high, vec3<f32>(-TINY)), above);
    let enter = select(select(vec3<f32>(0.0), to_high, above), to_low, below);
    let leave = select(to_high, to_low, above);
    let leave_too = select(to_low, leave, below | above);
    // Coordinates of the ray through a place on screen, which are linear too.
    let scale = frame.pixel_m * frame.pixel_m;
    let along_x = vec3<f32>(
        frame.screen_from_world_x.x, frame.screen_from_world_y.x, frame.screen_from_world_z.x) * scale;
    let along_y = vec3<f32>(
        frame.screen_from_world_x.y, frame.screen_from_world_y.y, frame.screen_from_world_z.y) * scale;
    let forward = vec3<f32>(
        frame.screen_from_world_x.z, frame.screen_from_world_y.z, frame.screen_from_world_z.z);
    let cap = 1.0 / nearest;

    // From where the box covers four texels at most, to where it covers more than sixty-four.
    var level = 0u;
    while any((last >> vec2<u32>(level)) - (first >> vec2<u32>(level)) > vec2<u32>(1u)) {
        level += 1u;
    }
    loop {
        let start = first >> vec2<u32>(level);
        let to = last >> vec2<u32>(level);
        if any(to - start >= vec2<u32>(MOST_TEXELS)) {
            return true;
        }
        let half = 0.5 * f32(1u << level) + PLACE_MARGIN;
        var shows = false;
        for (var y = start.y; y <= to.y && !shows; y += 1u) {
            for (var x = start.x; x <= to.x && !shows; x += 1u) {
                let middle =
                    (vec2<f32>(f32(x), f32(y)) + 0.5) * f32(1u << level) - frame.center_px;
                let ray = forward + along_x * middle.x + along_y * middle.y;
                let reach = (abs(along_x) + abs(along_y)) * half;
                // The nearest that the box can be over the texel.
                let entered = select(
                    ray * enter + reach * abs(enter), vec3<f32>(cap), enter == vec3<f32>(0.0));
                let near = min(min(entered.x, entered.y), min(entered.z, cap));
                if frame.near * near * DEPTH_MARGIN < farthest_depth(level, vec2<u32>(x, y)) {
                    continue;
                }
                shows = !(misses(ray, along_x, along_y, half, enter.x, 0u, leave, leave_too)
                    || misses(ray, along_x, along_y, half, enter.y, 1u, leave, leave_too)
                    || misses(ray, along_x, along_y, half, enter.z, 2u, leave, leave_too));
            }
        }
        if !shows {
            return false;
        }
        if level == 0u {
            return true;
        }
        level -= 1u;
    }
    return true;
}

// Whether all rays through a texel have left the box before they cross the plane where they would
// enter along one axis.
fn misses(
    ray: vec3<f32>,
    along_x: vec3<f32>,
    along_y: vec3<f32>,
    half: f32,
    enter: f32,
    axis: u32,
    leave: vec3<f32>,
    leave_too: vec3<f32>,
) -> bool {
    if enter == 0.0 {
        return false;
    }
    let most = lead(ray, along_x, along_y, half, enter, axis, leave);
    let most_too = lead(ray, along_x, along_y, half, enter, axis, leave_too);
    return any(most < vec3<f32>(0.0)) || any(most_too < vec3<f32>(0.0));
}

// The most, over a texel, by which entering comes before leaving, for each leaving plane.
fn lead(
    ray: vec3<f32>,
    along_x: vec3<f32>,
    along_y: vec3<f32>,
    half: f32,
    enter: f32,
    axis: u32,
    leave: vec3<f32>,
) -> vec3<f32> {
    let entered = ray[axis] * enter;
    let left = ray * leave;
    let slope_x = abs(along_x[axis] * enter - along_x * leave);
    let slope_y = abs(along_y[axis] * enter - along_y * leave);
    let rounding = 1e-6 * (abs(entered) + abs(left));
    return entered - left + (slope_x + slope_y) * half + rounding;
}
