// Draws triangles of models: position, colour, texture, light; or their depth alone.
// In: frame, objects, materials, texels (RGBA8, each texture with its levels), drawn (the object of
// each instance). Out: colour, depth.
// Twin: passes::MeshesCpu. Test: tests/mesh_draw.rs. Not run in scenes without models.
#import shared/structs

@group(0) @binding(0) var<uniform> frame: GpuFrame;
@group(1) @binding(0) var<storage, read> objects: array<GpuMeshObject>;
@group(1) @binding(1) var<storage, read> materials: array<GpuMaterial>;
@group(1) @binding(2) var<storage, read> texels: array<u32>;
@group(2) @binding(0) var<storage, read> drawn: array<u32>;

struct Corner {
    @location(0) position: vec3<f32>,
    @location(1) normal: vec4<f32>,
    @location(2) uv: vec2<f32>,
    @location(3) color: vec4<f32>,
}

struct Vertex {
    @builtin(position) @invariant position: vec4<f32>,
    @location(0) normal: vec3<f32>,
    @location(1) uv: vec2<f32>,
    @location(2) color: vec4<f32>,
    @location(3) @interpolate(flat, either) material: u32,
}

// Clip space of a corner of an object.
fn clip_position(object: GpuMeshObject, corner: vec3<f32>) -> vec4<f32> {
    let q = (corner - object.eye_high) - object.eye_low;
    let offset =
        vec3<f32>(object.screen_from_mesh_x.w, object.screen_from_mesh_y.w, object.screen_from_mesh_z.w);
    let screen = object.screen_from_mesh_x.xyz * q.x + object.screen_from_mesh_y.xyz * q.y
        + object.screen_from_mesh_z.xyz * q.z + offset;
    let w = screen.z;
    let px = screen.xy + frame.center_px * w;
    let size = vec2<f32>(frame.target_px);
    return vec4<f32>(2.0 * px.x / size.x - w, w - 2.0 * px.y / size.y, frame.near, w);
}

@vertex
fn mesh_vertex(corner: Corner, @builtin(instance_index) instance: u32) -> Vertex {
    let object = objects[drawn[instance]];
    let normal = object.normal_x.xyz * corner.normal.x + object.normal_y.xyz * corner.normal.y
        + object.normal_z.xyz * corner.normal.z;
    let position = clip_position(object, corner.position);
    return Vertex(position, normalize(normal), corner.uv, corner.color, object.material);
}

@vertex
fn depth_vertex(
    @location(0) corner: vec3<f32>,
    @builtin(instance_index) instance: u32,
) -> @invariant @builtin(position) vec4<f32> {
    return clip_position(objects[drawn[instance]], corner);
}

fn texel(first: u32, width: u32, height: u32, at: vec2<i32>) -> vec4<f32> {
    // One step beyond an edge at most.
    let size = vec2<i32>(i32(width), i32(height));
    let x = select(at.x, at.x + size.x, at.x < 0);
    let y = select(at.y, at.y + size.y, at.y < 0);
    let column = u32(select(x, x - size.x, x >= size.x));
    let row = u32(select(y, y - size.y, y >= size.y));
    return unpack4x8unorm(texels[first + row * width + column]);
}

// The texture at a place, from the level whose texels are about as large as a pixel; textures
// repeat. `along_x` and `along_y`: how far the place moves from pixel to pixel.
fn texture_color(
    material: GpuMaterial,
    uv: vec2<f32>,
    along_x: vec2<f32>,
    along_y: vec2<f32>,
) -> vec4<f32> {
    var first = material.texture_at;
    var width = material.texture_width;
    var height = material.texture_height;
    let size = vec2<f32>(f32(width), f32(height));
    let x = along_x * size;
    let y = along_y * size;
    // Square of the texels per pixel; a level is left when its texels are smaller than 0.7 pixels.
    var texels_px = max(x.x * x.x + x.y * x.y, y.x * y.x + y.y * y.y);
    for (var level = 1u; level < material.texture_levels && texels_px > 2.0; level += 1u) {
        first += width * height;
        width = max(width / 2u, 1u);
        height = max(height / 2u, 1u);
        texels_px *= 0.25;
    }
    let at = (uv - floor(uv)) * vec2<f32>(f32(width), f32(height)) - 0.5;
    let corner = floor(at);
    let share = at - corner;
    let i = vec2<i32>(corner);
    let above = texel(first, width, height, i) * (1.0 - share.x)
        + texel(first, width, height, i + vec2<i32>(1, 0)) * share.x;
    let below = texel(first, width, height, i + vec2<i32>(0, 1)) * (1.0 - share.x)
        + texel(first, width, height, i + vec2<i32>(1, 1)) * share.x;
    return above * (1.0 - share.y) + below * share.y;
}

// Colour and opacity before light.
fn surface_color(vertex: Vertex) -> vec4<f32> {
    let along_x = dpdxFine(vertex.uv);
    let along_y = dpdyFine(vertex.uv);
    let material = materials[vertex.material];
    var color = unpack4x8unorm(material.color) * vertex.color;
    if material.texture_levels > 0u {
        color *= texture_color(material, vertex.uv, along_x, along_y);
    }
    return color;
}

// Light from above, a little from one side, and from the eye; never dark.
fn lit(color: vec4<f32>, vertex: Vertex, is_front: bool) -> vec4<f32> {
    let normal = normalize(vertex.normal) * select(-1.0, 1.0, is_front);
    let to_eye =
        -vec3<f32>(frame.screen_from_world_x.z, frame.screen_from_world_y.z, frame.screen_from_world_z.z);
    let sun = dot(normal, SUN);
    let light = 0.55 + 0.2 * sun + 0.25 * max(dot(normal, to_eye), 0.0);
    let bytes = vec3<u32>(color.xyz * light * 255.0 + 0.5);
    return unpack4x8unorm(bytes.x | (bytes.y << 8u) | (bytes.z << 16u) | 0xff000000u);
}

// How often each pixel is shaded, with the same result; more than once only to measure what dear
// shading changes.
override SHADING_REPEATS: u32 = 1u;

fn shade(color: vec4<f32>, vertex: Vertex, is_front: bool) -> vec4<f32> {
    var result = lit(color, vertex, is_front);
    for (var at = 1u; at < SHADING_REPEATS; at += 1u) {
        var again = vertex;
        // Nothing is added, which is not known before the shader runs.
        again.normal += result.xyz * f32(frame.padding_0);
        result = lit(color + result * f32(frame.padding_0), again, is_front);
    }
    return result;
}

// Towards the light: unit, world axes.
const SUN: vec3<f32> = vec3<f32>(-0.36, -0.48, 0.8);

@fragment
fn mesh_color(vertex: Vertex, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    return shade(surface_color(vertex), vertex, is_front);
}

@fragment
fn cut_out_color(vertex: Vertex, @builtin(front_facing) is_front: bool) -> @location(0) vec4<f32> {
    let color = surface_color(vertex);
    if color.w < materials[vertex.material].alpha_cutoff {
        discard;
    }
    return shade(color, vertex, is_front);
}

@fragment
fn cut_out_depth(vertex: Vertex) {
    let color = surface_color(vertex);
    if color.w < materials[vertex.material].alpha_cutoff {
        discard;
    }
}

// For passes with colours that stay as they are.
@fragment
fn no_color() -> @location(0) vec4<f32> {
    return vec4<f32>(0.0);
}
