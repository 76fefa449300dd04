// Structs shared with Rust: gpu::layout, field for field. Test: tests/shader_layout.rs.

struct GpuFrame {
    screen_from_world_x: vec4<f32>,
    screen_from_world_y: vec4<f32>,
    screen_from_world_z: vec4<f32>,
    center_px: vec2<f32>,
    target_px: vec2<u32>,
    near: f32,
    max_splat_px: f32,
    per_point_splats: u32,
    background: u32,
    min_splat_px: f32,
    nested_splats: u32,
    splat_shape: u32,
    pixel_m: f32,
    shared_splat_px_m: f32,
    grow_margin_px: u32,
    padding_0: u32,
    padding_1: u32,
}

struct GpuNode {
    eye_cell: vec3<u32>,
    positions_at: u32,
    eye_fraction: vec3<f32>,
    colors_at: u32,
    scale: vec3<f32>,
    splat_px_m: f32,
    local_bits: u32,
    drawn_count: u32,
    drawn_children: u32,
    drawn_levels_below: u32,
    whole_count: u32,
    kept_of_block: u32,
    kept_inverse: f32,
    padding_0: u32,
}

struct GpuBatch {
    node_slot: u32,
    first_point: u32,
    end_point: u32,
}

struct GpuCheckpoint {
    first_stamp: u32,
    last_stamp: u32,
    alternative_count: u32,
    dispatch_count: u32,
    allowed_low: u32,
    allowed_high: u32,
}

struct GpuDispatch {
    alternative: u32,
    x: u32,
    y: u32,
    z: u32,
}

struct GpuMeshObject {
    screen_from_mesh_x: vec4<f32>,
    screen_from_mesh_y: vec4<f32>,
    screen_from_mesh_z: vec4<f32>,
    eye_high: vec3<f32>,
    material: u32,
    eye_low: vec3<f32>,
    padding_0: u32,
    normal_x: vec4<f32>,
    normal_y: vec4<f32>,
    normal_z: vec4<f32>,
}

struct GpuMaterial {
    color: u32,
    alpha_cutoff: f32,
    texture_at: u32,
    texture_width: u32,
    texture_height: u32,
    texture_levels: u32,
    padding_0: u32,
    padding_1: u32,
}

struct GpuBox {
    low: vec3<f32>,
    item: u32,
    high: vec3<f32>,
    untested: u32,
}

struct GpuPyramid {
    size_px: vec2<u32>,
    level_count: u32,
    padding_0: u32,
    offsets: array<vec4<u32>, 4>,
}
