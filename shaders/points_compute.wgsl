// Draws points into a buffer of pixels: of each pixel stay the inverted distance and the inverted
// colour of the nearest point (ties: the smallest colour word), whatever the order of the threads;
// a zeroed buffer is empty. How a pixel is held is in `pixels` (variants/pixels_64, pixels_32).
// In: frame, nodes, words, batches (gpu::layout). Out: pixels.
// Twin: passes::PointsCpu. Test: tests/gpu_twins.rs. Not run when no node is drawn.
#import shared/splat
#import pixels

// Whether no splat of the nodes drawn exceeds a pixel. Fixed per pipeline.
override SINGLE_PIXELS: bool = false;
// Whether of some nodes only a share of the points is drawn. Fixed per pipeline.
override PARTLY: bool = false;

@group(1) @binding(2) var<storage, read> batches: array<GpuBatch>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn draw_points(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let batch_index = workgroup.y * workgroups.x + workgroup.x;
    if batch_index >= arrayLength(&batches) {
        return;
    }
    let batch = batches[batch_index];
    let node = nodes[batch.node_slot];
    for (var point = batch.first_point + lane; point < batch.end_point; point += WORKGROUP_SIZE) {
        if PARTLY && !is_kept(node, point) {
            continue;
        }
        let cell = local_cell(node, point);
        let screen = screen_of(eye_relative(node, cell));
        let center = screen.xy * (1.0 / screen.z) + frame.center_px;
        var size = 1.0;
        if !SINGLE_PIXELS {
            size = splat_px(batch.node_slot, node, cell, screen.z);
        }
        // Written so that NaN fails too; a pixel more than a splat reaches.
        let reach = vec2<f32>(0.5 * size + 0.5 + f32(frame.nested_splats));
        let margin = vec2<f32>(f32(frame.grow_margin_px));
        let inside = all(center > -reach - margin)
            && all(center < vec2<f32>(frame.target_px) + reach - margin);
        if screen.z >= frame.near && inside {
            // Where splats are grown, the target begins before the picture.
            let corner = splat_corner(center, size) + i32(frame.grow_margin_px);
            if SINGLE_PIXELS || size == 1.0 {
                draw_pixel(corner, screen.z, node.colors_at + point);
            } else {
                draw_splat(corner, size, screen.z, node.colors_at + point);
            }
        }
    }
}

fn draw_pixel(at: vec2<i32>, distance: f32, color_at: u32) {
    if all(at >= vec2<i32>(0)) && all(at < vec2<i32>(frame.target_px)) {
        let pixel = u32(at.y) * frame.target_px.x + u32(at.x);
        let nearness = ~bitcast<u32>(distance);
        // Most points are hidden: they pay neither for a colour nor for an atomic.
        if !is_hidden(pixel, nearness) {
            put_point(pixel, nearness, color_at);
        }
    }
}

fn draw_splat(corner: vec2<i32>, size: f32, distance: f32, color_at: u32) {
    let first = max(corner, vec2<i32>(0));
    let last = min(corner + i32(size), vec2<i32>(frame.target_px));
    let nearness = ~bitcast<u32>(distance);
    for (var y = first.y; y < last.y; y += 1) {
        for (var x = first.x; x < last.x; x += 1) {
            let pixel = u32(y) * frame.target_px.x + u32(x);
            if SPLAT_SHAPE == SPHERE {
                let reach = splat_reach(vec2<i32>(x, y) - corner, size);
                if reach <= 1.0 {
                    let height = ball_height(reach);
                    let nearer = ~bitcast<u32>(ball_distance(distance, size, height));
                    if !is_hidden(pixel, nearer) {
                        put_ball(pixel, nearer, color_at, height);
                    }
                }
            } else if !is_hidden(pixel, nearness) {
                if SPLAT_SHAPE != ROUND || splat_reach(vec2<i32>(x, y) - corner, size) <= 1.0 {
                    put_point(pixel, nearness, color_at);
                }
            }
        }
    }
}
