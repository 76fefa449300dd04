// The least that drawing points by compute can be: every thread one point of one flat list, the
// same decoding, projection, depth test and atomic as shaders/points_compute.wgsl, but no batch,
// no node table, no splat size.
// In: frame, nodes (one row), words. Out: pixels. The suites measure passes against it.
#import shared/frame
#import shared/splat
#import pixels

@compute @workgroup_size(128)
fn draw_bare(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let node = nodes[0];
    let point = (workgroup.y * workgroups.x + workgroup.x) * 128u + lane;
    if point >= node.drawn_count {
        return;
    }
    let cell = cell_of_code(words[2u * point], words[2u * point + 1u]);
    let screen = screen_of(eye_relative(node, cell));
    let center = screen.xy * (1.0 / screen.z) + frame.center_px;
    let inside = all(center >= vec2<f32>(0.0)) && all(center < vec2<f32>(frame.target_px));
    if !(screen.z >= frame.near) || !inside {
        return;
    }
    let at = vec2<u32>(center);
    let pixel = at.y * frame.target_px.x + at.x;
    let nearness = ~bitcast<u32>(screen.z);
    if !is_hidden(pixel, nearness) {
        put_word(pixel, nearness, needed_color(node.colors_at + point));
    }
}
