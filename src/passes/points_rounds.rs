//! The compute pass in rounds: points are added to a frame as culling finds that they show, and
//! after each round what is there so far becomes depth that can be asked about.
//!
//! Whatever the rounds, the pixels end up the same: of each the nearest point stays. Splats are
//! drawn one by one, since growing them takes all points at once.

use crate::gpu::layout::GpuFrame;
use crate::gpu::shader;
use crate::gpu::{Gpu, GpuError, PassTimer};
use crate::passes::bindings::{bind, part, pipeline_layout};
use crate::passes::points_compute::{
    FrameKind, PIXEL_BYTES, PointBindings, PointWork, color_passes, dispatch, nodes_bytes,
    padded_to_256,
};
use crate::passes::{DrawCounts, DrawnNode, PointDrawing, PointsCompute, Targets};

impl PointsCompute {
    /// Begins a frame without points. The table must not change until
    /// [`end_rounds`](Self::end_rounds).
    pub fn begin_rounds(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        drawing: &PointDrawing,
    ) -> Result<DrawCounts, GpuError> {
        self.target_px = drawing.frame.target_px;
        self.grew = false;
        let frame = GpuFrame { grow_margin_px: 0, ..*drawing.frame };
        self.frame.write(gpu, &padded_to_256(bytemuck::bytes_of(&frame)))?;
        self.nodes.write(gpu, &drawing.table.nodes)?;
        let bytes = pixel_bytes(&frame);
        let pixels = self.pixels.reserve(gpu, bytes)?;
        encoder.clear_buffer(pixels, 0, Some(bytes));
        let uploaded_bytes = size_of::<GpuFrame>() as u64 + nodes_bytes(drawing.table);
        Ok(DrawCounts { uploaded_bytes, ..DrawCounts::default() })
    }

    /// Adds the commands that draw some of the table's draws, by their indices.
    pub fn add_round(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        drawing: &PointDrawing,
        draws: &[u32],
    ) -> Result<DrawCounts, GpuError> {
        self.run(gpu, encoder, drawing, draws, color_passes(self.atomics)[0])
    }

    /// Adds the commands that put what was drawn into a depth target, where it is nearer than what
    /// is there.
    pub fn add_depth(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        frame: &GpuFrame,
        depth: &wgpu::TextureView,
    ) -> Result<(), GpuError> {
        if self.depth_resolve.is_none() {
            self.depth_resolve = Some(self.depth_pipeline(gpu)?);
        }
        let (Some(pipeline), Some(groups)) = (&self.depth_resolve, self.resolve_groups(gpu, frame))
        else {
            return Ok(());
        };
        let keep = wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("depth of points"),
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: depth,
                depth_ops: Some(keep),
                stencil_ops: None,
            }),
            ..Default::default()
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &groups[0], &[]);
        pass.set_bind_group(2, &groups[1], &[]);
        pass.draw(0..3, 0..1);
        Ok(())
    }

    /// Adds the commands that make a picture of all that was drawn: `draws` of all rounds together.
    pub fn end_rounds(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut PassTimer,
        drawing: &PointDrawing,
        draws: &[u32],
    ) -> Result<DrawCounts, GpuError> {
        let mut counts = DrawCounts { draw_calls: 1, ..DrawCounts::default() };
        for &color_pass in &color_passes(self.atomics)[1..] {
            let colors = self.run(gpu, encoder, drawing, draws, color_pass)?;
            counts.dispatches += colors.dispatches;
            counts.uploaded_bytes += colors.uploaded_bytes;
        }
        if let Some([frame, pixels]) = self.resolve_groups(gpu, drawing.frame) {
            self.resolve_into(encoder, timer, drawing, &frame, &pixels);
        }
        Ok(counts)
    }

    fn run(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        drawing: &PointDrawing,
        draws: &[u32],
        color_pass: bool,
    ) -> Result<DrawCounts, GpuError> {
        if draws.is_empty() {
            return Ok(DrawCounts::default());
        }
        let table = drawing.table;
        let draws: Vec<&DrawnNode> = draws.iter().map(|&at| &table.draws[at as usize]).collect();
        let alignment = u64::from(gpu.device().limits().min_storage_buffer_offset_alignment);
        let align = (alignment / 4).max(1) as usize;
        table.batches_of(&draws, self.batch_points, align, &mut self.batch_list);
        let looks_first = self.looks_first(drawing, 0);
        let kind = FrameKind { shape: drawing.frame.splat_shape, looks_first };
        self.compile(gpu, kind)?;
        self.batches.write(gpu, &self.batch_list.list)?;
        let work = self.bind_work(gpu, nodes_bytes(table), drawing.arena)?;
        let work: Vec<&PointWork> = work.iter().collect();
        let (Some(frame), Some(pixels)) = (self.frame.get(), self.pixels.get()) else {
            return Ok(DrawCounts::default());
        };
        let frame_bytes = size_of::<GpuFrame>() as u64;
        let frame = bind(gpu, &self.frame_layout, &[part(frame, 0, frame_bytes)]);
        let pixels = [part(pixels, 0, pixel_bytes(drawing.frame))];
        let pixels = bind(gpu, &self.draw_pixels_layout, &pixels);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("points of a round"),
            timestamp_writes: None,
        });
        PointBindings { frame: &frame, pixels: &pixels }.set(&mut pass);
        let dispatches = dispatch(&self.pipelines, &mut pass, &work, (kind, color_pass), None);
        let uploaded_bytes = size_of_val(&self.batch_list.list[..]) as u64;
        Ok(DrawCounts { dispatches, draw_calls: 0, uploaded_bytes })
    }

    /// The frame and the pixels as resolving reads them.
    fn resolve_groups(&self, gpu: &Gpu, frame: &GpuFrame) -> Option<[wgpu::BindGroup; 2]> {
        let (buffer, pixels) = (self.frame.get()?, self.pixels.get()?);
        let frame_part = part(buffer, 0, size_of::<GpuFrame>() as u64);
        let pixels = part(pixels, 0, pixel_bytes(frame));
        Some([
            bind(gpu, &self.frame_layout, &[frame_part]),
            bind(gpu, &self.resolve_pixels_layout, &[pixels]),
        ])
    }

    fn depth_pipeline(&self, gpu: &Gpu) -> Result<wgpu::RenderPipeline, GpuError> {
        let module = shader::module(gpu, "resolve")?;
        gpu.checked("build the depth of points", || {
            let groups = [Some(&self.frame_layout), None, Some(&self.resolve_pixels_layout)];
            let layout = pipeline_layout(gpu, "depth of points", &groups);
            gpu.device().create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some("depth of points"),
                layout: Some(&layout),
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some("cover_target"),
                    compilation_options: Default::default(),
                    buffers: &[],
                },
                primitive: wgpu::PrimitiveState::default(),
                depth_stencil: Some(Targets::depth_state(wgpu::CompareFunction::Greater)),
                multisample: wgpu::MultisampleState::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &module,
                    entry_point: Some("resolve_depth"),
                    compilation_options: Default::default(),
                    targets: &[],
                }),
                multiview_mask: None,
                cache: None,
            })
        })
    }
}

fn pixel_bytes(frame: &GpuFrame) -> u64 {
    PIXEL_BYTES * u64::from(frame.target_px[0]) * u64::from(frame.target_px[1])
}
