// Draws points into a buffer of pixels: of each pixel stay the inverted distance and the inverted
// colour of the nearest point (ties: the smallest colour word), whatever the order of the threads;
// a zeroed buffer is empty. How a pixel is held is in `pixels` (variants/pixels_64, pixels_32).
// In: frame, nodes, words, batches (gpu::layout). Out: pixels.
// Twin: passes::PointsCpu. Test: tests/gpu_twins.rs. Not run when no node is drawn.
#import shared/frame_once
#import shared/splat
#import pixels

// Whether no splat of the nodes drawn exceeds a pixel. Fixed per pipeline.
override SINGLE_PIXELS: bool = false;
// Whether of some nodes only a share of the points is drawn. Fixed per pipeline.
override PARTLY: bool = false;

// Lanes that run side by side: as many as the workgroup has on a GPU, which wants their points side
// by side; as many as a vector of the processor on software adapters, which run them to their end
// one vector after the other and want all points of one close together. Fixed per pipeline.
override LANE_GROUP: u32 = WORKGROUP_SIZE;

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
    frame = bound_frame;
    let batch = batches[batch_index];
    let node = nodes[batch.node_slot];
    // Groups of lanes take successive points, and each group a run of its own.
    let rounds = (batch.end_point - batch.first_point + WORKGROUP_SIZE - 1u) / WORKGROUP_SIZE;
    let group = lane / LANE_GROUP;
    let first = batch.first_point + group * (LANE_GROUP * rounds) + lane % LANE_GROUP;
    let end = min(batch.end_point, batch.first_point + (group + 1u) * (LANE_GROUP * rounds));
    for (var place = first; place < end; place += LANE_GROUP) {
        var point = place;
        if PARTLY {
            point = point_at(node, place);
            if point >= node.drawn_count {
                continue;
            }
        }
        let cell = local_cell(node, point);
        let screen = screen_of(eye_relative(node, cell));
        let center = screen.xy * (1.0 / screen.z) + frame.center_px;
        if SINGLE_PIXELS {
            draw_pixel(floor(center), screen.z, node.colors_at + point);
            continue;
        }
        let size = splat_px(batch.node_slot, node, cell, screen.z);
        // Written so that NaN fails too; a pixel more than a splat reaches.
        let reach = vec2<f32>(0.5 * size + 0.5 + f32(frame.nested_splats));
        let inside = all(center > -reach) && all(center < vec2<f32>(frame.target_px) + reach);
        if screen.z >= frame.near && inside {
            draw_splat(splat_corner(center, size), size, screen.z, node.colors_at + point);
        }
    }
}

fn draw_pixel(at: vec2<f32>, distance: f32, color_at: u32) {
    // Where splats are grown, the target begins before the picture.
    let first = vec2<f32>(-f32(frame.grow_margin_px));
    // Written so that NaN fails too.
    let inside = all(at >= first) && all(at < vec2<f32>(frame.target_px) + first);
    if distance >= frame.near && inside {
        let place = vec2<u32>(at - first);
        let pixel = place.y * frame.target_px.x + place.x;
        let nearness = ~bitcast<u32>(distance);
        if !is_hidden(pixel, nearness) {
            put_word(pixel, nearness, needed_color(color_at));
        }
    }
}

fn draw_splat(corner: vec2<i32>, size: f32, distance: f32, color_at: u32) {
    let first = max(corner, vec2<i32>(0));
    let last = min(corner + i32(size), vec2<i32>(frame.target_px));
    let nearness = ~bitcast<u32>(distance);
    // Single pixels have none.
    let has_shape = (SPLAT_SHAPE == ROUND || SPLAT_SHAPE == SPHERE) && size > 1.0;
    // Who looks first may need no colour; who does not reads it once.
    var color = 0u;
    if !LOOKS_FIRST {
        color = needed_color(color_at);
    }
    for (var y = first.y; y < last.y; y += 1) {
        for (var x = first.x; x < last.x; x += 1) {
            let pixel = u32(y) * frame.target_px.x + u32(x);
            var nearer = nearness;
            var height = 0.0;
            if has_shape {
                let reach = splat_reach(vec2<i32>(x, y) - corner, size);
                if reach > 1.0 {
                    continue;
                }
                if SPLAT_SHAPE == SPHERE {
                    height = ball_height(reach);
                    nearer = ~bitcast<u32>(ball_distance(distance, size, height));
                }
            }
            if is_hidden(pixel, nearer) {
                continue;
            }
            if LOOKS_FIRST {
                color = needed_color(color_at);
            }
            if SPLAT_SHAPE == SPHERE && has_shape {
                put_word(pixel, nearer, ball_color(color, height));
            } else {
                put_word(pixel, nearer, color);
            }
        }
    }
}
