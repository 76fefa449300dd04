// Draws boxes in place of what they hold, to ask whether any of it would show; nothing is written.
// In: frame, boxes (instances). Out: nothing but the count of an occlusion query.
// Twin: visibility::ItemBuffer::count_box. Test: tests/occlusion_queries.rs. Not run without culling.
#import shared/structs

@group(0) @binding(0) var<uniform> frame: GpuFrame;
@group(1) @binding(0) var<storage, read> boxes: array<GpuBox>;

// Corners of the twelve triangles, three bits each: x, y, z.
const CORNERS = array<u32, 36>(
    0u, 2u, 3u, 0u, 3u, 1u,
    4u, 5u, 7u, 4u, 7u, 6u,
    0u, 1u, 5u, 0u, 5u, 4u,
    2u, 6u, 7u, 2u, 7u, 3u,
    0u, 4u, 6u, 0u, 6u, 2u,
    1u, 3u, 7u, 1u, 7u, 5u,
);

@vertex
fn box_corner(
    @builtin(vertex_index) vertex: u32,
    @builtin(instance_index) instance: u32,
) -> @builtin(position) vec4<f32> {
    let bounds = boxes[instance];
    var corners = CORNERS;
    let corner = corners[vertex];
    let upper = vec3<bool>((corner & 1u) != 0u, (corner & 2u) != 0u, (corner & 4u) != 0u);
    let p = select(bounds.low, bounds.high, upper);
    let screen = frame.screen_from_world_x.xyz * p.x + frame.screen_from_world_y.xyz * p.y
        + frame.screen_from_world_z.xyz * p.z;
    let w = screen.z;
    let px = screen.xy + frame.center_px * w;
    let size = vec2<f32>(frame.target_px);
    return vec4<f32>(2.0 * px.x / size.x - w, w - 2.0 * px.y / size.y, frame.near, w);
}

// For passes with colours, which stay as they are.
@fragment
fn no_color() -> @location(0) vec4<f32> {
    return vec4<f32>(0.0);
}
