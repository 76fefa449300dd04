// Answers questions of culling from a depth pyramid: would any of these boxes show?
// In: frame, pyramid, boxes (with the number of their question). Out: answers, 1 for yes.
// Twin: passes::DepthPyramidCpu. Test: tests/depth_pyramid.rs. Not run unless something is asked.
#import shared/structs
#import shared/pyramid_test

@group(2) @binding(0) var<storage, read> boxes: array<GpuBox>;
@group(2) @binding(1) var<storage, read_write> answers: array<atomic<u32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn answer_questions(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let at = id.y * groups.x * WORKGROUP_SIZE + id.x;
    if at >= arrayLength(&boxes) {
        return;
    }
    let asked = boxes[at];
    if may_show(asked.low, asked.high) {
        atomicMax(&answers[asked.item], 1u);
    }
}
