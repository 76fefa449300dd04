// Draws points into a buffer of 64-bit pixels: the distance in the high word, the colour in the
// low one, both inverted, so that a zeroed buffer is empty and the greatest value is the nearest
// point (ties: the smallest colour word), whatever the order of the threads.
// In: frame, nodes, words, batches (gpu::layout). Out: pixels.
// Twin: passes::PointsCpu. Test: tests/gpu_twins.rs. Not run when no node is drawn.
#import shared/splat
#import nearest_so_far

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
    let end = min(batch.first_point + BATCH_POINTS, node.drawn_count);
    for (var point = batch.first_point + lane; point < end; point += WORKGROUP_SIZE) {
        let splat = splat_of(batch.node_slot, node, point);
        let first = max(splat.corner, vec2<i32>(0));
        let last = min(splat.corner + splat.size_px, vec2<i32>(frame.target_px));
        let nearness = ~bitcast<u32>(splat.distance);
        for (var y = first.y; y < last.y; y += 1) {
            for (var x = first.x; x < last.x; x += 1) {
                let pixel = u32(y) * frame.target_px.x + u32(x);
                // Most points are hidden: they pay neither for a colour nor for an atomic.
                if nearest_so_far(pixel) <= nearness {
                    let color = words[node.colors_at + point];
                    atomicMax(&pixels[pixel], (u64(nearness) << 32u) | u64(~color));
                }
            }
        }
    }
}
