//! A frame drawn in rounds as culling wants it: points and models, each hiding the other.
//!
//! Models alone are drawn with their colours over the picture at once. Where points take part, the
//! rounds fill a depth buffer of their own from both: the picture of the points is finished by what
//! is around each pixel, so models can only be drawn over it at the end.

use std::ops::Range;
use std::time::Instant;

use crate::geometry::{Aabb, View};
use crate::gpu::layout::{GpuBox, GpuFrame};
use crate::gpu::{Gpu, GpuError};
use crate::hierarchy::{BoundingHierarchy, Bvh, Forest, Joined, Side};
use crate::ids::{NodeId, ObjectId, TreeNodeId};
use crate::passes::bindings::{bind, part};
use crate::passes::occlusion::{ANSWER_BYTES, CALLBACK_LIMIT, SET_SIZE};
use crate::passes::{
    DepthTarget, DrawOrder, MeshCounts, MeshOutput, Meshes, OcclusionQueries, PointDrawing,
    PointsCompute, Targets,
};
use crate::visibility::{Answer, OcclusionDevice, Proxies, QueryId};

/// What culling walks: the objects of models, and octrees of points.
pub type SceneTree<'a> = Joined<&'a Bvh, Forest<'a>>;

/// A scene that is drawn as culling wants it.
pub struct CulledScene<'a> {
    /// The device.
    pub gpu: &'a Gpu,
    /// The questions of this view.
    pub queries: &'a mut OcclusionQueries,
    /// The tree that is walked.
    pub tree: SceneTree<'a>,
    /// The models, if there are any; their recordings for this view were begun.
    pub meshes: Option<&'a mut Meshes>,
    /// The points, if they take part; their rounds were begun.
    pub points: Option<CulledPoints<'a>>,
    /// What all draws share.
    pub frame: &'a GpuFrame,
    /// What is drawn to.
    pub output: CulledOutput<'a>,
    /// What is recorded and drawn so far.
    pub recording: CulledRecording,
}

/// What rounds draw to.
#[derive(Clone, Copy)]
pub enum CulledOutput<'a> {
    /// Over a picture: models alone.
    Over {
        /// The targets with the colours.
        colors: &'a Targets,
        /// The targets with the depths.
        depths: &'a Targets,
        /// Whether depth alone is drawn in the rounds, and colours when all of it is there.
        shades_after: bool,
    },
    /// To depth alone; what was drawn is listed.
    Depth(&'a DepthTarget),
}

/// Points that are drawn as culling wants it.
pub struct CulledPoints<'a> {
    /// The pass.
    pub pass: &'a mut PointsCompute,
    /// What it draws.
    pub drawing: PointDrawing<'a>,
    /// The index of a node among the table's draws; none for nodes that are only asked about.
    pub draw_of: &'a dyn Fn(usize, NodeId) -> Option<u32>,
    /// Whether each draw's points are there.
    pub ready: &'a [bool],
    /// Points of nodes that were concealed which may be drawn.
    pub spare_points: u64,
}

/// What waits for the next submission, and what all before it did.
#[derive(Default)]
pub struct CulledRecording {
    drawn: Vec<ObjectId>,
    points: Vec<u32>,
    /// Objects that are drawn inside of a question, as ranges of `asked_objects`.
    asked: Vec<(QueryId, Range<usize>)>,
    asked_objects: Vec<ObjectId>,
    /// Questions, as ranges of `boxes`.
    queries: Vec<(QueryId, Range<u32>)>,
    boxes: Vec<GpuBox>,
    eye: glam::DVec3,
    proxies: Option<Proxies>,
    rounds: u64,
    switches: u64,
    failure: Option<GpuError>,
    done: CulledDraws,
}

/// What was drawn in a frame.
#[derive(Debug, Default)]
pub struct CulledDraws {
    /// What was drawn of models.
    pub meshes: MeshCounts,
    /// The objects, in the order in which they were drawn.
    pub objects: Vec<ObjectId>,
    /// Indices of draws of the table of points.
    pub draws: Vec<u32>,
    /// Nodes of points that came into sight and are not loaded.
    pub nodes_missing: u32,
    /// Nodes of points that came into sight beyond the budget.
    pub nodes_over_budget: u32,
    /// Compute dispatches.
    pub dispatches: u32,
    /// Bytes of tables sent for points.
    pub uploaded_bytes: u64,
}

impl CulledScene<'_> {
    /// What was drawn.
    ///
    /// # Errors
    /// The first refusal of the device; from then on nothing was drawn or asked.
    pub fn finish(self) -> Result<CulledDraws, GpuError> {
        match self.recording.failure {
            Some(error) => Err(error),
            None => Ok(self.recording.done),
        }
    }

    fn submit(&mut self) {
        let recording = &self.recording;
        let draws = !recording.drawn.is_empty()
            || !recording.asked.is_empty()
            || !recording.points.is_empty();
        let asks = !recording.queries.is_empty();
        if !(draws || asks) || recording.failure.is_some() {
            return;
        }
        let mut work = std::mem::take(&mut self.recording);
        work.rounds += 1;
        // From the last round's questions back to drawing, and on to asking.
        work.switches += u64::from(draws && work.rounds > 1) + u64::from(draws && asks);
        let gpu = self.gpu;
        let submitted = gpu.checked("draw a round of culling", || self.round(&mut work));
        work.failure = submitted.and_then(|round| round).err();
        work.done.objects.append(&mut work.drawn);
        work.done.objects.append(&mut work.asked_objects);
        work.done.draws.append(&mut work.points);
        work.asked.clear();
        work.queries.clear();
        work.boxes.clear();
        self.recording = work;
    }

    fn round(&mut self, work: &mut CulledRecording) -> Result<(), GpuError> {
        let gpu = self.gpu;
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        if let (Some(points), CulledOutput::Depth(depth)) = (&mut self.points, self.output)
            && !work.points.is_empty()
        {
            let counts = points.pass.add_round(gpu, &mut encoder, &points.drawing, &work.points)?;
            points.pass.add_depth(gpu, &mut encoder, self.frame, depth.view())?;
            work.done.dispatches += counts.dispatches;
            work.done.uploaded_bytes += counts.uploaded_bytes;
        }
        let lists = match &mut self.meshes {
            Some(meshes) => Some((
                meshes.list(gpu, &work.drawn, DrawOrder::Grouped)?,
                meshes.list(gpu, &work.asked_objects, DrawOrder::Kept)?,
            )),
            None => None,
        };
        let none = [GpuBox { low: [0.0; 3], item: 0, high: [0.0; 3], untested: 0 }];
        let boxes = if work.boxes.is_empty() { &none } else { &work.boxes[..] };
        self.queries.boxes.write(gpu, boxes)?;
        self.queries.frame.write(gpu, &[*self.frame])?;
        let (bound_boxes, frame) = (self.queries.boxes.get(), self.queries.frame.get());
        let (Some(bound_boxes), Some(frame)) = (bound_boxes, frame) else { return Ok(()) };
        let box_bytes = size_of_val(boxes) as u64;
        let groups = [
            bind(gpu, &self.queries.frame_layout, &[part(frame, 0, size_of::<GpuFrame>() as u64)]),
            bind(gpu, &self.queries.box_layout, &[part(bound_boxes, 0, box_bytes)]),
        ];
        let has_colors = matches!(self.output, CulledOutput::Over { shades_after: false, .. });
        let output = if has_colors { MeshOutput::COLOR } else { MeshOutput::DEPTH };
        let mut parts = Vec::new();
        // Draws inside of questions take the first slots.
        let slots = work.asked.len() + work.queries.len();
        if self.queries.is_by_pyramid() {
            if let (Some(meshes), Some((list, _))) = (&mut self.meshes, &lists) {
                let mut pass = begin_pass(&mut encoder, self.output, &self.queries.set);
                work.done.meshes += meshes.record(gpu, &mut pass, list, output)?;
            }
            parts = self.ask_pyramid(&mut encoder, work)?;
            gpu.queue().submit([encoder.finish()]);
            let ids: Vec<QueryId> = work.queries.iter().map(|(id, _)| *id).collect();
            for (buffer, slots) in parts {
                self.queries.read_back(buffer, &ids[slots], size_of::<u32>());
            }
            return Ok(());
        }
        let mut from = 0;
        loop {
            let to = slots.min(from + SET_SIZE as usize);
            {
                let mut pass = begin_pass(&mut encoder, self.output, &self.queries.set);
                if let (Some(meshes), Some((list, asked))) = (&mut self.meshes, &lists) {
                    if from == 0 {
                        work.done.meshes += meshes.record(gpu, &mut pass, list, output)?;
                    }
                    for slot in from..to.min(work.asked.len()) {
                        pass.begin_occlusion_query((slot - from) as u32);
                        let objects = work.asked[slot].1.clone();
                        work.done.meshes +=
                            meshes.record_part(gpu, &mut pass, asked, objects, output)?;
                        pass.end_occlusion_query();
                    }
                }
                pass.set_pipeline(&self.queries.pipelines[usize::from(!has_colors)]);
                pass.set_bind_group(0, &groups[0], &[]);
                pass.set_bind_group(1, &groups[1], &[]);
                for slot in from.max(work.asked.len())..to {
                    pass.begin_occlusion_query((slot - from) as u32);
                    pass.draw(0..36, work.queries[slot - work.asked.len()].1.clone());
                    pass.end_occlusion_query();
                }
            }
            if to > from {
                let count = (to - from) as u32;
                let buffer = self.queries.memory(gpu);
                encoder.resolve_query_set(&self.queries.set, 0..count, &self.queries.resolved, 0);
                let bytes = u64::from(count) * ANSWER_BYTES;
                encoder.copy_buffer_to_buffer(&self.queries.resolved, 0, &buffer, 0, bytes);
                parts.push((buffer, from..to));
            }
            from = to;
            if from == slots {
                break;
            }
        }
        gpu.queue().submit([encoder.finish()]);
        // Questions are numbered in the order in which they were put, which is not that of slots.
        let asked = work.asked.iter().map(|(id, _)| *id);
        let ids: Vec<QueryId> = asked.chain(work.queries.iter().map(|(id, _)| *id)).collect();
        for (buffer, slots) in parts {
            self.queries.read_back(buffer, &ids[slots], ANSWER_BYTES as usize);
        }
        Ok(())
    }

    /// Adds the commands by which a depth pyramid answers, and copies of the answers to be read: each
    /// with the questions it answers.
    fn ask_pyramid(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        work: &CulledRecording,
    ) -> Result<Vec<(wgpu::Buffer, Range<usize>)>, GpuError> {
        let mut parts = Vec::new();
        if work.queries.is_empty() {
            return Ok(parts);
        }
        let depth = match self.output {
            CulledOutput::Over { depths, .. } => (depths.depth_view(), depths.size_px()),
            CulledOutput::Depth(depth) => (Some(depth.view()), depth.size_px().into()),
        };
        let Some(mut pyramid) = self.queries.pyramid.take() else { return Ok(parts) };
        let count = work.queries.len() as u32;
        let answered = match self.queries.boxes.get() {
            Some(boxes) => {
                let asked = (boxes, work.boxes.len() as u32);
                pyramid.record(self.gpu, encoder, self.frame, depth, asked, count)
            }
            None => Ok(None),
        };
        if let Ok(Some(answers)) = &answered {
            let most = (u64::from(SET_SIZE) * ANSWER_BYTES / 4) as usize;
            for from in (0..work.queries.len()).step_by(most) {
                let to = work.queries.len().min(from + most);
                let buffer = self.queries.memory(self.gpu);
                let bytes = 4 * (to - from) as u64;
                encoder.copy_buffer_to_buffer(answers, 4 * from as u64, &buffer, 0, bytes);
                parts.push((buffer, from..to));
            }
        }
        let failure = answered.err();
        self.queries.pyramid = Some(pyramid);
        failure.map_or(Ok(parts), Err)
    }

    /// Gives the objects of all rounds their colours.
    fn shade(&mut self) -> Result<(), GpuError> {
        let CulledOutput::Over { colors, depths, .. } = self.output else { return Ok(()) };
        let Some(meshes) = &mut self.meshes else { return Ok(()) };
        let gpu = self.gpu;
        let list = meshes.list(gpu, &self.recording.done.objects, DrawOrder::Grouped)?;
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        let output = CulledOutput::Over { colors, depths, shades_after: false };
        let mut pass = begin_pass(&mut encoder, output, &self.queries.set);
        let counts = meshes.record(gpu, &mut pass, &list, MeshOutput::SHADE)?;
        drop(pass);
        gpu.queue().submit([encoder.finish()]);
        self.recording.done.meshes.draw_calls += counts.draw_calls;
        Ok(())
    }

    fn draw_points(&mut self, cloud: usize, node: NodeId) {
        let Some(points) = &mut self.points else { return };
        let done = &mut self.recording.done;
        // What shows and is not there yet was asked for.
        let Some(at) = (points.draw_of)(cloud, node) else { return };
        if !points.ready[at as usize] {
            done.nodes_missing += 1;
            return;
        }
        let table = points.drawing.table;
        let draw = &table.draws[at as usize];
        if draw.concealed {
            let count = table.points_of(draw);
            match points.spare_points.checked_sub(count) {
                Some(left) => points.spare_points = left,
                None => {
                    done.nodes_over_budget += 1;
                    return;
                }
            }
        }
        self.recording.points.push(at);
    }

    /// Whether a part of the tree holds objects alone.
    fn has_objects_alone(&self, node: TreeNodeId) -> bool {
        matches!(self.tree.side(node), Side::First(_)) || self.points.is_none()
    }
}

fn begin_pass<'e>(
    encoder: &'e mut wgpu::CommandEncoder,
    output: CulledOutput,
    queries: &wgpu::QuerySet,
) -> wgpu::RenderPass<'e> {
    fn keep<V>() -> wgpu::Operations<V> {
        wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store }
    }
    let (colors, depth) = match output {
        CulledOutput::Over { colors, depths, shades_after } => {
            ((!shades_after).then_some(colors.color_view()), depths.depth_view())
        }
        CulledOutput::Depth(depth) => (None, Some(depth.view())),
    };
    let colors = colors.map(|view| wgpu::RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: keep(),
    });
    let depth = depth.map(|view| wgpu::RenderPassDepthStencilAttachment {
        view,
        depth_ops: Some(keep()),
        stencil_ops: None,
    });
    let colors = colors.map(|colors| [Some(colors)]);
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("round of culling"),
        color_attachments: colors.as_ref().map_or(&[], |colors| &colors[..]),
        depth_stencil_attachment: depth,
        occlusion_query_set: Some(queries),
        ..Default::default()
    })
}

impl OcclusionDevice for CulledScene<'_> {
    fn begin_frame(&mut self, view: &View) {
        self.recording.eye = view.camera.eye;
        self.recording.proxies = Some(Proxies::new(view));
        self.queries.begin_frame(self.gpu);
    }

    fn draw(&mut self, node: TreeNodeId) {
        let (objects, points) = match self.tree.side(node) {
            Side::Root => (self.tree.first.root(), self.tree.second.root()),
            Side::First(node) => (Some(node), None),
            Side::Second(node) => (None, Some(node)),
        };
        if let Some(node) = objects {
            self.recording.drawn.extend_from_slice(self.tree.first.objects_of(node));
        }
        if let Some(node) = points {
            let mut nodes = Vec::new();
            self.tree.second.for_each_below(node, &mut |cloud, node| nodes.push((cloud, node)));
            nodes.into_iter().for_each(|(cloud, node)| self.draw_points(cloud, node));
        }
    }

    fn query(&mut self, boxes: &[Aabb]) -> QueryId {
        let id = self.queries.ask();
        let recording = &mut self.recording;
        let first = recording.boxes.len() as u32;
        let eye = recording.eye;
        let item = recording.queries.len() as u32;
        recording.boxes.extend(boxes.iter().map(|bounds| GpuBox {
            low: (bounds.min - eye).as_vec3().to_array(),
            item,
            high: (bounds.max - eye).as_vec3().to_array(),
            untested: 0,
        }));
        recording.queries.push((id, first..recording.boxes.len() as u32));
        id
    }

    fn draw_and_query(&mut self, node: TreeNodeId) -> QueryId {
        let by_draw = self.has_objects_alone(node) && !self.queries.is_by_pyramid();
        if let (false, Some(proxies)) = (by_draw, self.recording.proxies) {
            // Points are no work of the rasterizer, and a pyramid knows boxes alone: the box is asked
            // about, which is in front of what it holds.
            self.draw(node);
            return self.query(&[proxies.of(&self.tree, node)]);
        }
        let id = self.queries.ask();
        let recording = &mut self.recording;
        let first = recording.asked_objects.len();
        if let Side::First(node) = self.tree.side(node) {
            recording.asked_objects.extend_from_slice(self.tree.first.objects_of(node));
        }
        recording.asked.push((id, first..recording.asked_objects.len()));
        id
    }

    fn answer(&mut self, query: QueryId) -> Answer {
        self.queries.answer(query)
    }

    fn wait(&mut self, _query: QueryId) {
        self.submit();
        if self.recording.failure.is_some() {
            return;
        }
        if let Err(error) = self.gpu.wait() {
            self.recording.failure = Some(error);
            return;
        }
        self.queries.collect();
        // The work is done, but another thread that polls the device may be about to say so.
        let started = Instant::now();
        while !self.queries.under_way.is_empty() && started.elapsed() < CALLBACK_LIMIT {
            std::thread::yield_now();
            self.queries.collect();
        }
    }

    fn end_frame(&mut self) {
        self.submit();
        let shades_after = matches!(self.output, CulledOutput::Over { shades_after: true, .. });
        let is_empty = self.recording.done.objects.is_empty();
        if shades_after && !is_empty && self.recording.failure.is_none() {
            let gpu = self.gpu;
            let shaded = gpu.checked("shade what culling left", || self.shade());
            self.recording.failure = shaded.and_then(|shaded| shaded).err();
        }
    }

    fn state_switches(&self) -> u64 {
        self.recording.switches
    }

    fn rounds(&self) -> u64 {
        self.recording.rounds
    }
}
