// Grows points of one pixel to splats in screen space: each pixel takes the nearest point whose
// splat covers it. Exactly what drawing the splats one by one gives, because a splat's size and
// place follow from its distance and pixel alone and never grow with the distance: a point hidden
// at its own pixel has a splat within that of the point that hides it.
// In: frame, grown_from (pixels of the picture and a margin around it). Out: grown.
// Squares take two passes, along the rows (into pixels as wide as the picture and as high as the
// input) and then along the columns: of the points of a row that cover a column the nearest also
// reaches farthest up and down. Discs take one over all of a square.
// Twin: passes::PointsCpu draws splats one by one. Test: tests/gpu_twins.rs. Not run unless all
// splats share a size and drawing them one by one would take longer.
#import shared/frame_once
#import shared/splat_shape

@group(2) @binding(0) var<storage, read> grown_from: array<vec2<u32>>;
@group(2) @binding(1) var<storage, read_write> grown: array<vec2<u32>>;

// Pixels around the picture that points_compute drew too. `frame` is that of the picture. `zero`
// is not known before the shader runs: lavapipe compiles one anew for each value that a loop ends
// by if that follows from uniforms alone.
fn margin(zero: u32) -> i32 {
    return i32(frame.grow_margin_px + zero);
}

fn is_greater(a: vec2<u32>, b: vec2<u32>) -> bool {
    return a.y > b.y || (a.y == b.y && a.x > b.x);
}

// Side of the splat of a pixel that is not empty.
fn side_of(pixel: vec2<u32>) -> f32 {
    return splat_side(frame.shared_splat_px_m, bitcast<f32>(~pixel.y));
}

// Whether a splat of that side reaches a pixel `offset` from its own, along one axis.
fn reaches(offset: i32, side: i32) -> bool {
    return offset >= -((side - 1) / 2) && offset <= side / 2;
}

// The nearest of the pixels of a line whose splat reaches its middle.
fn nearest_along(middle: i32, stride: i32, margin: i32) -> vec2<u32> {
    var best = vec2<u32>(0u);
    for (var offset = -margin; offset <= margin; offset += 1) {
        let pixel = grown_from[middle - offset * stride];
        if is_greater(pixel, best) && reaches(offset, i32(side_of(pixel))) {
            best = pixel;
        }
    }
    return best;
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn grow_rows(@builtin(global_invocation_id) id: vec3<u32>) {
    frame = bound_frame;
    let at = vec2<i32>(id.xy);
    let width = i32(frame.target_px.x);
    if at.x >= width {
        return;
    }
    let margin = margin(id.z);
    let middle = at.y * (width + 2 * margin) + at.x + margin;
    grown[at.y * width + at.x] = nearest_along(middle, 1, margin);
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn grow_columns(@builtin(global_invocation_id) id: vec3<u32>) {
    frame = bound_frame;
    let at = vec2<i32>(id.xy);
    let width = i32(frame.target_px.x);
    if at.x >= width {
        return;
    }
    let margin = margin(id.z);
    let middle = (at.y + margin) * width + at.x;
    grown[at.y * width + at.x] = nearest_along(middle, width, margin);
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn grow_discs(@builtin(global_invocation_id) id: vec3<u32>) {
    frame = bound_frame;
    let x = i32(id.x);
    let y = i32(id.y);
    let width = i32(frame.target_px.x);
    if x >= width {
        return;
    }
    let margin = margin(id.z);
    var best = vec2<u32>(0u);
    for (var down = -margin; down <= margin; down += 1) {
        let row = (y + margin - down) * (width + 2 * margin) + x + margin;
        for (var right = -margin; right <= margin; right += 1) {
            let pixel = grown_from[row - right];
            if is_greater(pixel, best) {
                let side = side_of(pixel);
                let half = (i32(side) - 1) / 2;
                let offset = vec2<i32>(right, down) + half;
                if max(abs(right), abs(down)) <= half && splat_reach(offset, side) <= 1.0 {
                    best = pixel;
                }
            }
        }
    }
    grown[y * width + x] = best;
}
