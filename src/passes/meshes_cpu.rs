//! Models drawn by all cores: the twin of `meshes.wgsl`, for machines without an adapter and for
//! the tests that hold both sides together.
//!
//! The same tables, the same f32 arithmetic for corners and colours, the same order of drawing.
//! Pixels differ only where roundings of the device's interpolation show. Corners are projected
//! object by object; then each band of rows goes through the triangles that reach into it, in
//! order, so the picture does not depend on the number of threads.

use std::sync::Arc;

use glam::{DAffine3, Vec2, Vec3, Vec4};
use rayon::prelude::*;

use crate::geometry::View;
use crate::gpu::layout::{GpuFrame, GpuMaterial, GpuMeshObject};
use crate::ids::ObjectId;
use crate::mesh::{Mesh, Model};
use crate::passes::mesh_list::{DrawOrder, MeshCounts, draws_of};
use crate::passes::mesh_tables::{MaterialTables, MeshVertex, Surface, object_row, vertices_of};
use crate::passes::rasterize::ScreenTriangle;
use crate::passes::{ClipVertex, Fragment, Picture, RasterTarget, rasterize};

/// A model in memory.
#[derive(Debug)]
pub struct MeshesCpu {
    model: Arc<Model>,
    places: Vec<DAffine3>,
    shapes: Vec<Shape>,
    tables: MaterialTables,
}

#[derive(Debug)]
struct Shape {
    vertices: Vec<MeshVertex>,
    triangles: Vec<[u32; 3]>,
}

/// A corner before the camera.
#[derive(Clone, Copy)]
struct Corner {
    clip: ClipVertex,
    normal: Vec3,
    uv: Vec2,
    color: Vec4,
}

/// An object of a frame.
struct Seen {
    object: ObjectId,
    surface: Surface,
    corners: Vec<Corner>,
}

/// Triangles that are projected before they are drawn; bounds the memory of a frame.
const BATCH_TRIANGLES: usize = 1 << 18;
/// Rows that are drawn by one core at a time.
const BAND_ROWS: usize = 16;

impl MeshesCpu {
    /// Prepares a model.
    pub fn new(model: Arc<Model>) -> Self {
        let shape = |mesh: &Mesh| {
            let shaded = mesh.with_normals();
            Shape { vertices: vertices_of(&shaded), triangles: shaded.triangles }
        };
        MeshesCpu {
            shapes: model.meshes.par_iter().map(shape).collect(),
            tables: MaterialTables::new(&model, u32::MAX.into()),
            places: model.objects.iter().map(|object| object.world_from_mesh).collect(),
            model,
        }
    }

    /// Moves an object.
    pub fn place(&mut self, object: ObjectId, world_from_mesh: DAffine3) {
        self.places[object.index()] = world_from_mesh;
    }

    /// Draws objects into a picture with distances; whatever is nearer shows.
    pub fn draw(
        &self,
        view: &View,
        frame: &GpuFrame,
        objects: &[ObjectId],
        picture: &mut Picture,
    ) -> MeshCounts {
        let surface = |object: ObjectId| {
            let material = self.model.objects[object.index()].material;
            Surface::of(&self.model.materials[material.index()], &self.places[object.index()])
        };
        let key =
            |object: ObjectId| (surface(object), 0, self.model.objects[object.index()].mesh.0);
        let triangles_of = |shape: u32| self.shapes[shape as usize].triangles.len() as u32;
        let mut sorted = objects.to_vec();
        sorted.sort_by_cached_key(|&object| (key(object), object));
        let draws = draws_of(&sorted, DrawOrder::Grouped, key, triangles_of);
        let ordered: Vec<u32> = sorted.into_iter().map(|object| object.0).collect();
        let mut counts = MeshCounts::default();
        for draw in &draws {
            let objects = draw.instances.end - draw.instances.start;
            counts.objects += objects;
            counts.triangles += u64::from(objects) * u64::from(draw.triangles);
        }
        let mut depths: Vec<f32> =
            picture.distances.par_iter().map(|distance| frame.near / distance).collect();
        let mut rest = &ordered[..];
        while !rest.is_empty() {
            let mut triangles = 0;
            let batch = rest.iter().take_while(|&&object| {
                let before = triangles;
                triangles += self.shape(ObjectId(object)).triangles.len();
                before == 0 || triangles <= BATCH_TRIANGLES
            });
            let (batch, after) = rest.split_at(batch.count());
            let seen: Vec<Seen> = batch
                .par_iter()
                .map(|&object| {
                    let object = ObjectId(object);
                    Seen {
                        object,
                        surface: surface(object),
                        corners: self.corners(object, view, frame),
                    }
                })
                .collect();
            self.draw_batch(frame, &seen, picture, &mut depths);
            rest = after;
        }
        let distances = picture.distances.par_iter_mut().zip(&depths);
        distances.filter(|(_, depth)| **depth > 0.0).for_each(|(distance, depth)| {
            *distance = frame.near / depth;
        });
        counts
    }

    fn shape(&self, object: ObjectId) -> &Shape {
        &self.shapes[self.model.objects[object.index()].mesh.index()]
    }

    /// The corners of an object, as the vertex stage has them.
    fn corners(&self, object: ObjectId, view: &View, frame: &GpuFrame) -> Vec<Corner> {
        let material = self.model.objects[object.index()].material.0;
        let row = object_row(&self.places[object.index()], material, view);
        let vertices = &self.shape(object).vertices;
        vertices.iter().map(|vertex| corner_of(&row, frame, vertex)).collect()
    }

    fn draw_batch(
        &self,
        frame: &GpuFrame,
        seen: &[Seen],
        picture: &mut Picture,
        depths: &mut [f32],
    ) {
        let width = picture.width_px as usize;
        let bands = (picture.height_px as usize).div_ceil(BAND_ROWS);
        // Which triangles reach into each band; objects in parallel, joined in order.
        let sorted: Vec<Vec<(u32, u32)>> = seen
            .par_iter()
            .zip(0u32..seen.len() as u32)
            .map(|(seen, at)| {
                let mut reached = Vec::new();
                for (triangle, corners) in self.shape(seen.object).triangles.iter().enumerate() {
                    let clip = corners.map(|corner| seen.corners[corner as usize].clip);
                    for band in bands_of(&clip, frame, bands) {
                        reached.push((band as u32, at, triangle as u32));
                    }
                }
                reached
            })
            .fold(
                || vec![Vec::new(); bands],
                |mut lists: Vec<Vec<(u32, u32)>>, reached| {
                    for (band, at, triangle) in reached {
                        lists[band as usize].push((at, triangle));
                    }
                    lists
                },
            )
            .reduce_with(|mut first, second| {
                for (list, more) in first.iter_mut().zip(second) {
                    list.extend(more);
                }
                first
            })
            .unwrap_or_default();
        let colors = picture.colors.par_chunks_mut(width * BAND_ROWS);
        let depths = depths.par_chunks_mut(width * BAND_ROWS);
        colors.zip(depths).zip(&sorted).enumerate().for_each(|(band, ((colors, depths), list))| {
            let first = band * BAND_ROWS;
            let target = RasterTarget {
                width_px: picture.width_px,
                height_px: picture.height_px,
                rows: first as u32..(first + BAND_ROWS) as u32,
                near: frame.near,
            };
            for &(at, triangle) in list {
                let seen = &seen[at as usize];
                let shape = self.shape(seen.object);
                let corners = shape.triangles[triangle as usize].map(|v| seen.corners[v as usize]);
                let material = self.model.objects[seen.object.index()].material;
                let material = &self.tables.materials[material.index()];
                let emit = |fragment: Fragment, screen: &ScreenTriangle, is_front: bool| {
                    let is_front = is_front != seen.surface.mirrored;
                    if seen.surface.single_sided && !is_front {
                        return;
                    }
                    let pixel = (fragment.y as usize - first) * width + fragment.x as usize;
                    if fragment.depth <= depths[pixel] {
                        return;
                    }
                    let color = self.surface_color(&corners, material, screen, &fragment);
                    if seen.surface.cut_out && color.w < material.alpha_cutoff {
                        return;
                    }
                    let shares = screen.shares_at(fragment.x as i32, fragment.y as i32);
                    let normal = mix(shares, corners.map(|corner| corner.normal));
                    colors[pixel] = lit(frame, color, normal, is_front);
                    depths[pixel] = fragment.depth;
                };
                rasterize(&corners.map(|corner| corner.clip), &target, emit);
            }
        });
    }

    /// Colour and opacity before light.
    fn surface_color(
        &self,
        corners: &[Corner; 3],
        material: &GpuMaterial,
        screen: &ScreenTriangle,
        fragment: &Fragment,
    ) -> Vec4 {
        let (x, y) = (fragment.x as i32, fragment.y as i32);
        let colors = corners.map(|corner| corner.color);
        let shares = screen.shares_at(x, y);
        let mut color = unpacked(material.color)
            * (colors[0] * shares[0] + colors[1] * shares[1] + colors[2] * shares[2]);
        if material.texture_levels > 0 {
            let uv = |x: i32, y: i32| {
                let [a, b, c] = screen.shares_at(x, y);
                corners[0].uv * a + corners[1].uv * b + corners[2].uv * c
            };
            // Differences within blocks of two by two pixels, as devices take them.
            let (left, top) = (x & !1, y & !1);
            let along_x = uv(left + 1, y) - uv(left, y);
            let along_y = uv(x, top + 1) - uv(x, top);
            color *= texture_color(&self.tables.texels, material, uv(x, y), along_x, along_y);
        }
        color
    }
}

/// The bands that a triangle may reach into.
fn bands_of(clip: &[ClipVertex; 3], frame: &GpuFrame, bands: usize) -> std::ops::Range<usize> {
    let all = 0..bands;
    if clip.iter().all(|v| v.w < frame.near || v.x < -v.w)
        || clip.iter().all(|v| v.w < frame.near || v.x > v.w)
    {
        return 0..0;
    }
    if clip.iter().any(|v| v.w < frame.near) {
        return all;
    }
    let half = 0.5 * frame.target_px[1] as f32;
    let rows = clip.map(|v| half - v.y / v.w * half);
    let (min, max) = (
        rows.iter().fold(f32::MAX, |a, &b| a.min(b)),
        rows.iter().fold(f32::MIN, |a, &b| a.max(b)),
    );
    let band = |row: f32| (row / BAND_ROWS as f32).clamp(0.0, bands as f32) as usize;
    // Numbers that are none give an empty range.
    if max < 0.0 || min > 2.0 * half {
        0..0
    } else {
        band(min - 1.0)..(band(max + 1.0) + 1).min(all.end)
    }
}

fn corner_of(row: &GpuMeshObject, frame: &GpuFrame, vertex: &MeshVertex) -> Corner {
    let column = |c: [f32; 4]| Vec3::new(c[0], c[1], c[2]);
    let q = (Vec3::from(vertex.position) - Vec3::from(row.eye_high)) - Vec3::from(row.eye_low);
    let offset =
        Vec3::new(row.screen_from_mesh_x[3], row.screen_from_mesh_y[3], row.screen_from_mesh_z[3]);
    let screen = column(row.screen_from_mesh_x) * q.x
        + column(row.screen_from_mesh_y) * q.y
        + column(row.screen_from_mesh_z) * q.z
        + offset;
    let w = screen.z;
    let px = Vec2::new(screen.x, screen.y) + Vec2::from(frame.center_px) * w;
    let [width, height] = frame.target_px.map(|side| side as f32);
    let [nx, ny, nz, _] = vertex.normal.map(|lane| (f32::from(lane) / 32_767.0).max(-1.0));
    let normal = column(row.normal_x) * nx + column(row.normal_y) * ny + column(row.normal_z) * nz;
    Corner {
        clip: ClipVertex { x: 2.0 * px.x / width - w, y: w - 2.0 * px.y / height, w },
        normal: normal.normalize(),
        uv: Vec2::from(vertex.uv),
        color: unpacked(u32::from_le_bytes(vertex.color)),
    }
}

fn mix(shares: [f32; 3], values: [Vec3; 3]) -> Vec3 {
    values[0] * shares[0] + values[1] * shares[1] + values[2] * shares[2]
}

fn unpacked(word: u32) -> Vec4 {
    let [r, g, b, a] = word.to_le_bytes().map(|byte| f32::from(byte) / 255.0);
    Vec4::new(r, g, b, a)
}

fn texel(texels: &[u32], first: u32, [width, height]: [u32; 2], at: [i32; 2]) -> Vec4 {
    let wrapped = |at: i32, size: i32| match at {
        at if at < 0 => at + size,
        at if at >= size => at - size,
        at => at,
    };
    let (column, row) = (wrapped(at[0], width as i32), wrapped(at[1], height as i32));
    let place = first as usize + row as usize * width as usize + column as usize;
    unpacked(texels.get(place).copied().unwrap_or(0))
}

fn texture_color(
    texels: &[u32],
    material: &GpuMaterial,
    uv: Vec2,
    along_x: Vec2,
    along_y: Vec2,
) -> Vec4 {
    let mut first = material.texture_at;
    let mut size = [material.texture_width, material.texture_height];
    let scale = Vec2::new(size[0] as f32, size[1] as f32);
    let (x, y) = (along_x * scale, along_y * scale);
    let mut texels_px = (x.x * x.x + x.y * x.y).max(y.x * y.x + y.y * y.y);
    let mut level = 1;
    while level < material.texture_levels && texels_px > 2.0 {
        first += size[0] * size[1];
        size = size.map(|side| (side / 2).max(1));
        texels_px *= 0.25;
        level += 1;
    }
    let at = (uv - uv.floor()) * Vec2::new(size[0] as f32, size[1] as f32) - 0.5;
    let corner = at.floor();
    let share = at - corner;
    let (i, j) = (corner.x as i32, corner.y as i32);
    let row = |j: i32| {
        texel(texels, first, size, [i, j]) * (1.0 - share.x)
            + texel(texels, first, size, [i + 1, j]) * share.x
    };
    row(j) * (1.0 - share.y) + row(j + 1) * share.y
}

/// Towards the light, as in the shader.
const SUN: Vec3 = Vec3::new(-0.36, -0.48, 0.8);

fn lit(frame: &GpuFrame, color: Vec4, normal: Vec3, is_front: bool) -> u32 {
    let normal = normal.normalize() * if is_front { 1.0 } else { -1.0 };
    let to_eye = -Vec3::new(
        frame.screen_from_world_x[2],
        frame.screen_from_world_y[2],
        frame.screen_from_world_z[2],
    );
    let light = 0.55 + 0.2 * normal.dot(SUN) + 0.25 * normal.dot(to_eye).max(0.0);
    let byte = |c: f32| (c * light * 255.0 + 0.5) as u8;
    u32::from_le_bytes([byte(color.x), byte(color.y), byte(color.z), 255])
}
