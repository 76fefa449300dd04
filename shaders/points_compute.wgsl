// Draws points into a buffer of 64-bit pixels: the distance in the high word, the colour in the
// low one, both inverted, so that a zeroed buffer is empty and the greatest value is the nearest
// point (ties: the smallest colour word), whatever the order of the threads.
// In: frame, nodes, words, batches (gpu::layout). Out: pixels.
// Twin: passes::PointsCpu. Test: tests/gpu_twins.rs. Not run when no node is drawn.
#import shared/splat
#import nearest_so_far

// Whether no splat of the nodes drawn exceeds a pixel. Fixed per pipeline.
override SINGLE_PIXELS: bool = false;

@group(1) @binding(2) var<storage, read> batches: array<GpuBatch>;
@group(2) @binding(0) var<storage, read_write> pixels: array<atomic<u64>>;

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
        let cell = local_cell(node, point);
        let screen = screen_of(eye_relative(node, cell));
        let center = screen.xy * (1.0 / screen.z) + frame.center_px;
        var size = 1.0;
        if !SINGLE_PIXELS {
            size = splat_px(batch.node_slot, node, cell, screen.z);
        }
        let corner = splat_corner(center, size);
        let nearness = ~bitcast<u32>(screen.z);
        // Written so that NaN fails too; a pixel more than a splat reaches.
        let reach = vec2<f32>(0.5 * size + 0.5);
        let inside = all(center > -reach) && all(center < vec2<f32>(frame.target_px) + reach);
        if screen.z >= frame.near && inside {
            if SINGLE_PIXELS || size == 1.0 {
                draw_pixel(corner, nearness, node.colors_at + point);
            } else {
                draw_square(corner, i32(size), nearness, node.colors_at + point);
            }
        }
    }
}

fn draw_pixel(at: vec2<i32>, nearness: u32, color_at: u32) {
    if all(at >= vec2<i32>(0)) && all(at < vec2<i32>(frame.target_px)) {
        let pixel = u32(at.y) * frame.target_px.x + u32(at.x);
        // Most points are hidden: they pay neither for a colour nor for an atomic.
        if nearest_so_far(pixel) <= nearness {
            atomicMax(&pixels[pixel], (u64(nearness) << 32u) | u64(~words[color_at]));
        }
    }
}

fn draw_square(corner: vec2<i32>, size: i32, nearness: u32, color_at: u32) {
    let first = max(corner, vec2<i32>(0));
    let last = min(corner + size, vec2<i32>(frame.target_px));
    for (var y = first.y; y < last.y; y += 1) {
        for (var x = first.x; x < last.x; x += 1) {
            let pixel = u32(y) * frame.target_px.x + u32(x);
            if nearest_so_far(pixel) <= nearness {
                atomicMax(&pixels[pixel], (u64(nearness) << 32u) | u64(~words[color_at]));
            }
        }
    }
}
