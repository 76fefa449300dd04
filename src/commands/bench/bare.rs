//! The points of a cut as one flat list, drawn by the least that drawing can be: what the study
//! *paths* measures the ways of drawing against.

use bytemuck::Zeroable;
use glam::{DVec3, UVec3};

use crate::frame::{FrameSettings, NodeSource};
use crate::geometry::{MortonKey, View};
use crate::gpu::layout::GpuNode;
use crate::gpu::{Gpu, PassTimer};
use crate::passes::splat::local_cell;
use crate::passes::{PointsBare, Tile};
use crate::select::{AllResident, CutScratch, SplatSettings, select_nodes};

/// The bare loop over the points that a frame draws.
pub(super) struct Bare {
    pass: PointsBare,
    timer: PassTimer,
    node: GpuNode,
    pub(super) count: u32,
    lattice_eye: Box<dyn Fn(&View) -> DVec3>,
}

impl Bare {
    pub(super) fn new(
        gpu: &Gpu,
        source: &dyn NodeSource,
        view: &View,
        settings: &FrameSettings,
    ) -> anyhow::Result<Self> {
        let octree = source.octree();
        let scratch = &mut CutScratch::default();
        let cut = select_nodes(octree, view, &settings.cut, &AllResident, scratch);
        // Coordinates in the root cube, less fine where they would not fit a code.
        let bits = octree.root_cube().bits;
        let shift = bits.saturating_sub(21);
        let (mut words, mut colors) = (Vec::new(), Vec::new());
        let (mut node_words, mut node_colors) = (Vec::new(), Vec::new());
        for drawn in &cut.draw {
            source.read_positions(drawn.node, &mut node_words)?;
            match source.has_colors() {
                true => source.read_colors(drawn.node, &mut node_colors)?,
                false => node_colors.resize(drawn.count as usize, 0xff80_8080),
            }
            let local_bits = octree.local_bits(drawn.node);
            let shape = GpuNode { local_bits, ..GpuNode::zeroed() };
            let base = octree.cell_min(drawn.node) - octree.root_cube().min;
            for point in 0..drawn.count as usize {
                let cell = UVec3::from(local_cell(&shape, &node_words, point)).as_i64vec3() + base;
                let code = u64::encode((cell >> i64::from(shift)).as_uvec3().to_array());
                words.extend([code as u32, (code >> 32) as u32]);
            }
            colors.extend_from_slice(&node_colors[..drawn.count as usize]);
        }
        let count = colors.len() as u32;
        words.extend(colors);
        let pass = PointsBare::new(gpu, &words, count, [view.width_px, view.height_px])?;
        let step = octree.lattice().scale * f64::from(1u32 << shift);
        let node = GpuNode {
            scale: step.as_vec3().to_array(),
            local_bits: bits - shift,
            ..GpuNode::zeroed()
        };
        let (lattice, root) = (*octree.lattice(), octree.root_cube().min.as_dvec3());
        let steps = f64::from(1u32 << shift);
        let lattice_eye =
            Box::new(move |view: &View| (lattice.lattice(view.camera.eye) - root) / steps);
        Ok(Bare { pass, timer: PassTimer::new(gpu)?, node, count, lattice_eye })
    }

    pub(super) fn draw(&mut self, gpu: &Gpu, view: &View) -> anyhow::Result<()> {
        let frame = Tile::whole(view).gpu_frame(view, &SplatSettings::default(), 0);
        let eye = (self.lattice_eye)(view);
        let last = f64::from(self.node.local_bits).exp2() - 1.0;
        let cell = eye.floor().clamp(DVec3::ZERO, DVec3::splat(last));
        let node = GpuNode {
            eye_cell: cell.as_uvec3().to_array(),
            eye_fraction: (eye - cell).as_vec3().to_array(),
            ..self.node
        };
        Ok(self.pass.draw(gpu, &mut self.timer, &frame, &node)?)
    }

    pub(super) fn pass_ms(&mut self) -> f64 {
        self.timer.collect().first().map_or(f64::INFINITY, |(_, ms)| *ms)
    }
}
