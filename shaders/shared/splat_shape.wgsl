// Size and shape of one splat, from the frame alone.
// In: frame. Twin: passes::splat. Test: tests/gpu_twins.rs.

// What splats look like (gpu::layout). Fixed per pipeline, so that squares pay for nothing.
override SPLAT_SHAPE: u32 = 0u;

// Side of a splat of so many pixels at 1 m, seen from `w`: whole pixels.
fn splat_side(splat_px_m: f32, w: f32) -> f32 {
    let side = ceil(clamp(splat_px_m / w, frame.min_splat_px, frame.max_splat_px));
    if SPLAT_SHAPE == ROUND {
        // Discs lie within larger ones only if they have the same middle. Without a branch, as in
        // `splat_corner`.
        return select(side, side + 1.0 - (side % 2.0), frame.nested_splats != 0u);
    }
    return side;
}

// Square of a pixel's distance from the middle of the splat, of that of the rim: above 1 is
// outside. `offset` counts pixels from the first of the square.
fn splat_reach(offset: vec2<i32>, side: f32) -> f32 {
    let from_middle = vec2<f32>(offset) + vec2<f32>(0.5 - 0.5 * side);
    return (from_middle.x * from_middle.x + from_middle.y * from_middle.y) / (0.25 * side * side);
}

// Height of a ball above its rim where `splat_reach` is `reach`, of its radius.
fn ball_height(reach: f32) -> f32 {
    return sqrt(1.0 - reach);
}

// Distance of the ball's surface there.
fn ball_distance(w: f32, side: f32, height: f32) -> f32 {
    return max(w * (1.0 - height * (0.5 * side * frame.pixel_m)), frame.near);
}

// A colour as bright as a ball is there: lit from the eye.
fn ball_color(color: u32, height: f32) -> u32 {
    let light = 0.35 + 0.65 * height;
    let r = u32(f32(color & 0xffu) * light + 0.5);
    let g = u32(f32((color >> 8u) & 0xffu) * light + 0.5);
    let b = u32(f32((color >> 16u) & 0xffu) * light + 0.5);
    return r | (g << 8u) | (b << 16u) | (color & 0xff000000u);
}
