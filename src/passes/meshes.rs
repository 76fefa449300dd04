//! Models drawn by the rasterizer into the depth buffer of the points.
//!
//! Shapes share vertex and index buffers (few, as large as the device allows); objects are rows of a
//! table, written when the camera or an object moved. What is drawn is a [`MeshList`]: any objects,
//! recorded into any render pass, as often per frame as one likes. Objects that share a shape are
//! instances of one draw; draws that share a pipeline are one call where the device takes arguments
//! from a buffer. Shader: `meshes.wgsl`. Twin: [`MeshesCpu`](crate::passes::MeshesCpu).
//!
//! Which objects are drawn is decided elsewhere. Nothing is sorted by depth and nothing blended.

use std::ops::Range;
use std::sync::Arc;

use glam::DAffine3;
use rayon::prelude::*;

use crate::geometry::View;
use crate::gpu::layout::{GpuFrame, GpuMaterial, GpuMeshObject};
use crate::gpu::{Gpu, GpuError, GrowingBuffer, HeldBuffer, shader};
use crate::ids::ObjectId;
use crate::mesh::{Mesh, Model};
use crate::passes::Targets;
use crate::passes::bindings::{bind, layout, part, pipeline_layout, whole};
use crate::passes::mesh_list::{DrawOrder, MeshCounts, MeshDraw, draws_of};
use crate::passes::mesh_tables::{MaterialTables, MeshVertex, Surface, object_row, vertices_of};
use crate::passes::mesh_upload::{ShapeRange, Shelf, stock};

/// What a recording writes, and which fragments it keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeshOutput {
    /// What happens to the pass's colours.
    pub color: MeshColor,
    /// Which fragments are kept; depth is reversed.
    pub depth_compare: wgpu::CompareFunction,
    /// Whether these write their depth.
    pub writes_depth: bool,
}

/// What a recording does to the colours of a render pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshColor {
    /// The pass has a target of [`Targets::COLOR_FORMAT`] and gets colours.
    Written,
    /// The pass has that target, which stays as it is.
    Kept,
    /// The pass has depth alone.
    Absent,
}

impl MeshOutput {
    /// Colour and depth; the nearest fragment wins, of equal ones the first.
    pub const COLOR: MeshOutput = MeshOutput {
        color: MeshColor::Written,
        depth_compare: wgpu::CompareFunction::Greater,
        writes_depth: true,
    };
    /// Depth alone, in a pass without colours.
    pub const DEPTH: MeshOutput = MeshOutput { color: MeshColor::Absent, ..MeshOutput::COLOR };
    /// Colour where the depth is there already, so that each pixel is shaded once.
    pub const SHADE: MeshOutput = MeshOutput {
        color: MeshColor::Written,
        depth_compare: wgpu::CompareFunction::Equal,
        writes_depth: false,
    };
}

/// Objects to draw, in memory of the device.
#[derive(Debug)]
pub struct MeshList {
    draws: Vec<MeshDraw>,
    drawn: wgpu::BindGroup,
    /// Arguments of the draws, and where they begin.
    arguments: Option<(Arc<HeldBuffer>, u64)>,
}

impl MeshList {
    /// How many draws it has: one per object if it keeps the order.
    pub fn draw_count(&self) -> usize {
        self.draws.len()
    }

    /// A list whose objects and arguments the device fills in.
    pub(super) fn of_buffers(
        draws: Vec<MeshDraw>,
        drawn: wgpu::BindGroup,
        arguments: Arc<HeldBuffer>,
        offset: u64,
    ) -> Self {
        MeshList { draws, drawn, arguments: Some((arguments, offset)) }
    }
}

/// Objects in the order of their draws, and the draws.
#[derive(Debug, Default)]
pub(super) struct DrawsInView {
    pub objects: Vec<ObjectId>,
    pub draws: Vec<MeshDraw>,
}

/// A model on the device.
#[derive(Debug)]
pub struct Meshes {
    shelves: Vec<Shelf>,
    shapes: Vec<ShapeRange>,
    /// Shape, material and place of each object.
    objects: Vec<ObjectPlace>,
    scene_layout: wgpu::BindGroupLayout,
    frame_layout: wgpu::BindGroupLayout,
    drawn_layout: wgpu::BindGroupLayout,
    pipeline_layout: wgpu::PipelineLayout,
    shader: wgpu::ShaderModule,
    pipelines: Vec<(Variant, wgpu::RenderPipeline)>,
    frame: GrowingBuffer,
    rows: GrowingBuffer,
    row_list: Vec<GpuMeshObject>,
    materials: GrowingBuffer,
    texels: GrowingBuffer,
    bound: Option<[wgpu::BindGroup; 2]>,
    /// The camera that rows were written for; none if they are out of date.
    seen_from: Option<View>,
    texel_bytes: u64,
    lists: Lists,
    /// Place of each object among all in the order of drawing; empty if out of date.
    ranks: Vec<u32>,
    draws_indirectly: bool,
    shading_repeats: u32,
    reduced_textures: u32,
    uploaded_bytes: u64,
}

#[derive(Clone, Copy, Debug)]
struct ObjectPlace {
    shape: u32,
    material: u32,
    surface: Surface,
    place: DAffine3,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Variant {
    surface: Surface,
    output: MeshOutput,
}

/// Bytes of the arguments of a draw.
const ARGUMENT_BYTES: u64 = 20;

impl Meshes {
    /// Puts a model on the device.
    pub fn new(gpu: &Gpu, model: &Model) -> Result<Self, GpuError> {
        if !gpu.draws_meshes() {
            return Err(gpu.unsupported("meshes", "no storage buffers in shaders that draw"));
        }
        let shader = shader::module(gpu, "meshes")?;
        let shaded: Vec<Mesh> = model.meshes.par_iter().map(Mesh::with_normals).collect();
        let (shelves, shapes) = stock(gpu, &shaded, vertices_of)?;
        drop(shaded);
        let limits = gpu.device().limits();
        let most_bytes = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        let most_objects = most_bytes / size_of::<GpuMeshObject>() as u64;
        if model.objects.len() as u64 > most_objects {
            let reason = format!("{} objects, it takes {most_objects}", model.objects.len());
            return Err(GpuError::Refused { doing: "hold the objects of models", reason });
        }
        let mut tables = MaterialTables::new(model, most_bytes / 4);
        // Bindings are never empty.
        tables.materials.push(GpuMaterial { color: u32::MAX, ..bytemuck::Zeroable::zeroed() });
        if tables.texels.is_empty() {
            tables.texels.push(0);
        }
        let object = |object: &crate::mesh::Object| ObjectPlace {
            shape: object.mesh.0,
            material: object.material.0,
            surface: Surface::of(
                &model.materials[object.material.index()],
                &object.world_from_mesh,
            ),
            place: object.world_from_mesh,
        };
        let storage = wgpu::BufferUsages::STORAGE;
        let mut materials = GrowingBuffer::new("materials", storage);
        let mut texels = GrowingBuffer::new("texels", storage);
        materials.write(gpu, &tables.materials)?;
        texels.write(gpu, &tables.texels)?;
        let uploaded_bytes = shelves.iter().map(Shelf::bytes).sum::<u64>()
            + size_of_val(&tables.materials[..]) as u64
            + size_of_val(&tables.texels[..]) as u64;
        gpu.checked("build the mesh pass", || {
            let (vertex, fragment) = (wgpu::ShaderStages::VERTEX, wgpu::ShaderStages::FRAGMENT);
            let read_only = wgpu::BufferBindingType::Storage { read_only: true };
            let uniform = wgpu::BufferBindingType::Uniform;
            let frame_layout = layout(gpu, "frame", &[(vertex | fragment, uniform)]);
            let scene_layout = layout(
                gpu,
                "objects, materials, texels",
                &[(vertex, read_only), (fragment, read_only), (fragment, read_only)],
            );
            let drawn_layout = layout(gpu, "drawn objects", &[(vertex, read_only)]);
            let groups = [Some(&frame_layout), Some(&scene_layout), Some(&drawn_layout)];
            let pipeline_layout = pipeline_layout(gpu, "meshes", &groups);
            Meshes {
                shelves,
                shapes,
                objects: model.objects.iter().map(object).collect(),
                scene_layout,
                frame_layout,
                drawn_layout,
                pipeline_layout,
                shader,
                pipelines: Vec::new(),
                frame: GrowingBuffer::new("frame", wgpu::BufferUsages::UNIFORM),
                rows: GrowingBuffer::new("objects", storage),
                row_list: Vec::new(),
                materials,
                texels,
                bound: None,
                seen_from: None,
                texel_bytes: size_of_val(&tables.texels[..]) as u64,
                lists: Lists::default(),
                ranks: Vec::new(),
                draws_indirectly: gpu
                    .device()
                    .features()
                    .contains(wgpu::Features::INDIRECT_FIRST_INSTANCE),
                shading_repeats: 1,
                reduced_textures: tables.reduced_textures,
                uploaded_bytes,
            }
        })
    }

    /// Draws object by object instead of from arguments in a buffer; to measure what that saves.
    pub fn without_indirect_draws(mut self) -> Self {
        self.draws_indirectly = false;
        self
    }

    /// Shades each pixel so many times, with the same result; to measure what dear shading changes.
    pub fn repeat_shading(&mut self, times: u32) {
        if self.shading_repeats != times {
            self.shading_repeats = times;
            self.pipelines.clear();
        }
    }

    /// Number of objects.
    pub fn object_count(&self) -> usize {
        self.objects.len()
    }

    /// Textures that are coarser than their files, for want of room.
    pub fn reduced_textures(&self) -> u32 {
        self.reduced_textures
    }

    /// Moves an object.
    pub fn place(&mut self, object: ObjectId, world_from_mesh: DAffine3) {
        let row = &mut self.objects[object.index()];
        row.place = world_from_mesh;
        let mirrored = world_from_mesh.matrix3.determinant() < 0.0;
        if row.surface.mirrored != mirrored {
            row.surface.mirrored = mirrored;
            self.ranks.clear();
        }
        self.seen_from = None;
    }

    /// Begins the recordings for a view (a frame, or a part of one). Tables are written only if the
    /// camera or an object moved. Lists made before must not be used any more.
    pub fn begin(&mut self, gpu: &Gpu, view: &View, frame: &GpuFrame) -> Result<(), GpuError> {
        self.lists.begin();
        self.frame.write(gpu, &[*frame])?;
        self.uploaded_bytes += size_of::<GpuFrame>() as u64;
        if self.seen_from != Some(*view) {
            let row = |object: &ObjectPlace| object_row(&object.place, object.material, view);
            self.objects.par_iter().map(row).collect_into_vec(&mut self.row_list);
            if self.row_list.is_empty() {
                self.row_list.push(bytemuck::Zeroable::zeroed());
            }
            self.rows.write(gpu, &self.row_list)?;
            self.uploaded_bytes += size_of_val(&self.row_list[..]) as u64;
            self.seen_from = Some(*view);
            self.bound = None;
        }
        if self.bound.is_none() {
            let [rows, materials, texels, frame] =
                [&self.rows, &self.materials, &self.texels, &self.frame]
                    .map(|buffer| buffer.get().expect("it was written"));
            // Buffers have room to spare, which may be more than a binding can have.
            let row_bytes = size_of_val(&self.row_list[..]) as u64;
            let buffers =
                [part(rows, 0, row_bytes), whole(materials), part(texels, 0, self.texel_bytes)];
            self.bound = Some([
                bind(gpu, &self.frame_layout, &[part(frame, 0, size_of::<GpuFrame>() as u64)]),
                bind(gpu, &self.scene_layout, &buffers),
            ]);
        }
        Ok(())
    }

    /// Makes a list of objects to record.
    pub fn list(
        &mut self,
        gpu: &Gpu,
        objects: &[ObjectId],
        order: DrawOrder,
    ) -> Result<MeshList, GpuError> {
        let mut objects = objects.to_vec();
        if order == DrawOrder::Grouped {
            self.sort(&mut objects);
        }
        let draws = self.draws_of(&objects, order);
        let ids: &[ObjectId] = if objects.is_empty() { &[ObjectId(0)] } else { &objects };
        let ids: Vec<u32> = ids.iter().map(|id| id.0).collect();
        let (buffer, offset) = self.lists.ids.write(gpu, bytemuck::cast_slice(&ids))?;
        let drawn = bind(gpu, &self.drawn_layout, &[part(&buffer, offset, 4 * ids.len() as u64)]);
        self.uploaded_bytes += 4 * ids.len() as u64;
        let arguments = if self.draws_indirectly && order == DrawOrder::Grouped && draws.len() > 1 {
            let words: Vec<[u32; 5]> = draws.iter().map(|draw| self.arguments_of(draw)).collect();
            self.uploaded_bytes += size_of_val(&words[..]) as u64;
            Some(self.lists.arguments.write(gpu, bytemuck::cast_slice(&words))?)
        } else {
            None
        };
        Ok(MeshList { draws, drawn, arguments })
    }

    /// Objects in the order of drawing, whose draws are as few as there are shapes among them.
    pub(super) fn draws_in_view(&mut self, objects: &[ObjectId]) -> DrawsInView {
        let mut objects = objects.to_vec();
        self.sort(&mut objects);
        let draws = self.draws_of(&objects, DrawOrder::Grouped);
        DrawsInView { objects, draws }
    }

    fn draws_of(&self, objects: &[ObjectId], order: DrawOrder) -> Vec<MeshDraw> {
        let key = |object: ObjectId| {
            let row = &self.objects[object.index()];
            (row.surface, self.shapes[row.shape as usize].shelf, row.shape)
        };
        draws_of(objects, order, key, |shape| self.shapes[shape as usize].index_count / 3)
    }

    /// Brings objects into the order of drawing: by surface, shape and number.
    fn sort(&mut self, objects: &mut Vec<ObjectId>) {
        if self.ranks.len() != self.objects.len() {
            let mut order: Vec<u32> = (0..self.objects.len() as u32).collect();
            let key = |&object: &u32| {
                let row = &self.objects[object as usize];
                (row.surface, self.shapes[row.shape as usize].shelf, row.shape, object)
            };
            order.sort_by_cached_key(key);
            self.ranks = vec![0; order.len()];
            order.iter().zip(0..).for_each(|(&object, rank)| self.ranks[object as usize] = rank);
        }
        let mut ranked: Vec<(u32, ObjectId)> =
            objects.iter().map(|&object| (self.ranks[object.index()], object)).collect();
        ranked.sort_unstable();
        objects.clear();
        objects.extend(ranked.into_iter().map(|(_, object)| object));
    }

    /// The arguments of a draw.
    pub(super) fn arguments_of(&self, draw: &MeshDraw) -> [u32; 5] {
        let shape = &self.shapes[draw.shape as usize];
        let instances = draw.instances.end - draw.instances.start;
        let base_vertex = shape.base_vertex as u32;
        [shape.index_count, instances, shape.first_index, base_vertex, draw.instances.start]
    }

    /// Binds a buffer of objects that are drawn.
    pub(super) fn bind_drawn(&self, gpu: &Gpu, ids: wgpu::BindingResource) -> wgpu::BindGroup {
        bind(gpu, &self.drawn_layout, &[ids])
    }

    /// Records all of a list.
    pub fn record(
        &mut self,
        gpu: &Gpu,
        pass: &mut wgpu::RenderPass,
        list: &MeshList,
        output: MeshOutput,
    ) -> Result<MeshCounts, GpuError> {
        self.record_part(gpu, pass, list, 0..list.draws.len(), output)
    }

    /// Records some draws of a list; in a list that keeps its order draws are its objects, so that
    /// something else can come between them.
    pub fn record_part(
        &mut self,
        gpu: &Gpu,
        pass: &mut wgpu::RenderPass,
        list: &MeshList,
        range: Range<usize>,
        output: MeshOutput,
    ) -> Result<MeshCounts, GpuError> {
        let mut counts = MeshCounts::default();
        let draws = &list.draws[range.clone()];
        if draws.is_empty() {
            return Ok(counts);
        }
        for draw in draws {
            self.compile(gpu, Variant { surface: draw.surface, output })?;
        }
        let [frame, scene] = self.bound.as_ref().expect("recordings were begun");
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(1, scene, &[]);
        pass.set_bind_group(2, &list.drawn, &[]);
        let mut at = 0;
        while at < draws.len() {
            let first = &draws[at];
            let same =
                |draw: &&MeshDraw| draw.surface == first.surface && draw.shelf == first.shelf;
            let count = draws[at..].iter().take_while(same).count();
            let variant = Variant { surface: first.surface, output };
            let known = self.pipelines.iter().find(|(known, _)| *known == variant);
            pass.set_pipeline(&known.expect("it was just compiled").1);
            let shelf = &self.shelves[first.shelf];
            pass.set_vertex_buffer(0, shelf.vertices.slice(..));
            pass.set_index_buffer(shelf.indices.slice(..), wgpu::IndexFormat::Uint32);
            match &list.arguments {
                Some((buffer, offset)) => {
                    let offset = offset + (range.start + at) as u64 * ARGUMENT_BYTES;
                    pass.multi_draw_indexed_indirect(buffer, offset, count as u32);
                    counts.draw_calls += 1;
                }
                None => {
                    for draw in &draws[at..at + count] {
                        let shape = &self.shapes[draw.shape as usize];
                        let indices = shape.first_index..shape.first_index + shape.index_count;
                        pass.draw_indexed(indices, shape.base_vertex, draw.instances.clone());
                    }
                    counts.draw_calls += count as u32;
                }
            }
            at += count;
        }
        for draw in draws {
            let objects = draw.instances.end - draw.instances.start;
            counts.objects += objects;
            counts.triangles += u64::from(objects) * u64::from(draw.triangles);
        }
        Ok(counts)
    }

    /// Bytes sent to the device since this was last asked.
    pub fn take_uploaded_bytes(&mut self) -> u64 {
        std::mem::take(&mut self.uploaded_bytes)
    }

    /// Bytes held on the device.
    pub fn held_bytes(&self) -> u64 {
        let buffers = [&self.frame, &self.rows, &self.materials, &self.texels];
        self.shelves.iter().map(Shelf::bytes).sum::<u64>()
            + buffers.map(GrowingBuffer::held_bytes).iter().sum::<u64>()
            + self.lists.ids.held_bytes()
            + self.lists.arguments.held_bytes()
    }

    fn compile(&mut self, gpu: &Gpu, variant: Variant) -> Result<(), GpuError> {
        if self.pipelines.iter().any(|(known, _)| *known == variant) {
            return Ok(());
        }
        let pipeline = gpu.checked("build a mesh pipeline", || self.pipeline(gpu, variant))?;
        self.pipelines.push((variant, pipeline));
        Ok(())
    }

    fn pipeline(&self, gpu: &Gpu, variant: Variant) -> wgpu::RenderPipeline {
        let Variant { surface, output } = variant;
        let writes_color = output.color == MeshColor::Written;
        let (vertex_entry, fragment_entry) = match (writes_color, surface.cut_out) {
            (true, false) => ("mesh_vertex", Some("mesh_color")),
            (true, true) => ("mesh_vertex", Some("cut_out_color")),
            (false, true) => ("mesh_vertex", Some("cut_out_depth")),
            (false, false) => ("depth_vertex", None),
        };
        let attributes = wgpu::vertex_attr_array![
            0 => Float32x3, 1 => Snorm16x4, 2 => Float32x2, 3 => Unorm8x4
        ];
        let count = if vertex_entry == "depth_vertex" { 1 } else { attributes.len() };
        let color = match output.color {
            MeshColor::Written => Some(wgpu::ColorWrites::ALL),
            MeshColor::Kept => Some(wgpu::ColorWrites::empty()),
            MeshColor::Absent => None,
        };
        let targets: Vec<_> = color
            .into_iter()
            .map(|write_mask| {
                Some(wgpu::ColorTargetState {
                    format: Targets::COLOR_FORMAT,
                    blend: None,
                    write_mask,
                })
            })
            .collect();
        let constants = [("SHADING_REPEATS", f64::from(self.shading_repeats))];
        // A pass with colours needs a stage that could write them.
        let fragment_entry = fragment_entry.or((!targets.is_empty()).then_some("no_color"));
        gpu.device().create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("meshes"),
            layout: Some(&self.pipeline_layout),
            vertex: wgpu::VertexState {
                module: &self.shader,
                entry_point: Some(vertex_entry),
                compilation_options: Default::default(),
                buffers: &[Some(wgpu::VertexBufferLayout {
                    array_stride: size_of::<MeshVertex>() as u64,
                    step_mode: wgpu::VertexStepMode::Vertex,
                    attributes: &attributes[..count],
                })],
            },
            primitive: wgpu::PrimitiveState {
                front_face: match surface.mirrored {
                    true => wgpu::FrontFace::Cw,
                    false => wgpu::FrontFace::Ccw,
                },
                cull_mode: surface.single_sided.then_some(wgpu::Face::Back),
                ..Default::default()
            },
            depth_stencil: Some(wgpu::DepthStencilState {
                depth_write_enabled: Some(output.writes_depth),
                ..Targets::depth_state(output.depth_compare)
            }),
            multisample: wgpu::MultisampleState::default(),
            fragment: fragment_entry.map(|entry| wgpu::FragmentState {
                module: &self.shader,
                entry_point: Some(entry),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants: &constants,
                    ..Default::default()
                },
                targets: &targets,
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}

/// Memory of the lists of a frame.
#[derive(Debug)]
struct Lists {
    ids: Pages,
    arguments: Pages,
}

impl Default for Lists {
    fn default() -> Self {
        Lists {
            ids: Pages::new("drawn objects", wgpu::BufferUsages::STORAGE),
            arguments: Pages::new("draw arguments", wgpu::BufferUsages::INDIRECT),
        }
    }
}

impl Lists {
    fn begin(&mut self) {
        self.ids.begin();
        self.arguments.begin();
    }
}

/// Buffers that are filled piece by piece; a piece stays where it is until the next frame.
#[derive(Debug)]
struct Pages {
    label: &'static str,
    usage: wgpu::BufferUsages,
    pages: Vec<Arc<HeldBuffer>>,
    current: usize,
    filled: u64,
}

/// Size of the first page; also an offset that every device allows for bindings.
const PAGE_BYTES: u64 = 64 << 10;
const ALIGNMENT: u64 = 256;

impl Pages {
    fn new(label: &'static str, usage: wgpu::BufferUsages) -> Self {
        Pages { label, usage, pages: Vec::new(), current: 0, filled: 0 }
    }

    fn begin(&mut self) {
        // One large page serves the next frame as well as many small ones, with fewer bindings.
        let keep = self.pages.len().saturating_sub(1);
        self.pages.drain(..keep);
        (self.current, self.filled) = (0, 0);
    }

    fn write(&mut self, gpu: &Gpu, bytes: &[u8]) -> Result<(Arc<HeldBuffer>, u64), GpuError> {
        let length = bytes.len() as u64;
        let fits = |page: &HeldBuffer, filled: u64| page.size() - filled >= length;
        while self.pages.get(self.current).is_some_and(|page| !fits(page, self.filled)) {
            (self.current, self.filled) = (self.current + 1, 0);
        }
        if self.current == self.pages.len() {
            let held = self.held_bytes();
            let size = (2 * held).max(PAGE_BYTES).max(length.next_multiple_of(ALIGNMENT));
            let descriptor = wgpu::BufferDescriptor {
                label: Some(self.label),
                size: size.min(gpu.device().limits().max_buffer_size.max(length)),
                usage: self.usage | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            };
            self.pages.push(Arc::new(gpu.create_buffer("hold lists of objects", &descriptor)?));
        }
        let (page, offset) = (&self.pages[self.current], self.filled);
        gpu.queue().write_buffer(page, offset, bytes);
        self.filled = (offset + length).next_multiple_of(ALIGNMENT).min(page.size());
        Ok((page.clone(), offset))
    }

    fn held_bytes(&self) -> u64 {
        self.pages.iter().map(|page| page.size()).sum()
    }
}
