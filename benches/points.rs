//! Frames of points by each path, beside a bare compute pass over the very same points.
//!
//! Run: `cargo bench --bench points`. The cloud is seeded: two bumpy sheets, 4 M points. Sizes
//! differ by the error in pixels; times are of whole frames (selection, tables, points, resolve,
//! waiting for the device), minimum and median over repeats from slightly turning views, the paths
//! taking turns. The bare
//! pass has the points of the same frame as one flat list.

#[path = "../tests/support/memory_cloud.rs"]
mod memory_cloud;

use std::sync::Arc;
use std::time::Instant;

use esker::frame::{FrameSettings, NodeSource, RasterPath, Renderer};
use esker::geometry::{Camera, MortonKey, View};
use esker::gpu::layout::{GpuFrame, GpuNode, position_words};
use esker::gpu::{Gpu, shader};
use esker::octree::Octree;
use esker::passes::Tile;
use esker::passes::splat::local_cell;
use esker::points::Lattice;
use esker::select::{AllResident, CutScratch, SplatSettings, select_nodes};
use glam::{DVec3, UVec3};
use memory_cloud::MemoryCloud;

const POINTS: usize = 4_000_000;
const BITS: u32 = 16;
const REPEATS: usize = 30;
/// As in `points_bare.wgsl`.
const BARE_WORKGROUP_SIZE: u32 = 128;

fn main() {
    let cloud = Arc::new(seeded_cloud());
    let gpu = match Gpu::open() {
        Ok(gpu) => Arc::new(gpu),
        Err(error) => {
            println!("no bench: {error}");
            return;
        }
    };
    println!("{}, {} threads", gpu.description(), rayon::current_num_threads());
    println!(
        "{:>24} {:>10} {:>6} {:>9} {:>9} {:>7}",
        "path", "points", "nodes", "min ms", "med ms", "/ bare"
    );
    for (name, error_px) in [("2 M points", 0.9), ("0.5 M points", 1.8)] {
        let mut settings = FrameSettings::default();
        settings.cut.error_px = error_px;
        let bare = BarePass::new(&gpu, &cloud, &settings);
        let mut renderers =
            [RasterPath::Compute, RasterPath::Cpu, RasterPath::Raster].map(|path| {
                let mut renderer = match path {
                    RasterPath::Cpu => Renderer::on_cpu(1 << 30),
                    path => {
                        Renderer::on_gpu(gpu.clone(), path, 1 << 30).expect("the path is there")
                    }
                };
                renderer.set_scene(vec![cloud.clone() as Arc<dyn NodeSource>]);
                renderer
            });
        let mut times = [const { Vec::new() }; 4];
        // In turns, so that what else the machine does falls on all alike.
        for turn in 0..REPEATS + 3 {
            let view = view(turn);
            times[0].push(milliseconds(|| bare.draw(&gpu, &view)));
            for (renderer, times) in renderers.iter_mut().zip(&mut times[1..]) {
                times.push(milliseconds(|| {
                    renderer.render(&view, &settings).expect("the frame is drawn");
                    gpu.wait().expect("the device lives");
                }));
            }
        }
        let [bare_times, times @ ..] = times;
        let bare_ms = report(&format!("{name}, bare"), None, bare_times, None);
        for (renderer, times) in renderers.iter().zip(times) {
            let stats = renderer.stats();
            let drawn = Some((stats.points_drawn, stats.nodes_drawn));
            report(&format!("{name}, {}", renderer.path().name()), drawn, times, Some(bare_ms));
            for time in &stats.passes {
                println!("{:>24} {:>27.2} ({})", time.pass, time.pass_ms, time.clock);
            }
        }
    }
}

fn milliseconds(work: impl FnOnce()) -> f64 {
    let start = Instant::now();
    work();
    start.elapsed().as_secs_f64() * 1e3
}

/// Prints a row and returns the median; the first three times are warming up.
fn report(name: &str, drawn: Option<(u64, u32)>, mut times: Vec<f64>, bare_ms: Option<f64>) -> f64 {
    times.drain(..3);
    times.sort_by(f64::total_cmp);
    let median = times[times.len() / 2];
    let (points, nodes) = drawn.unwrap_or_default();
    let ratio = bare_ms.map_or(String::new(), |bare| format!("{:.2}", median / bare));
    println!("{name:>24} {points:>10} {nodes:>6} {:>9.2} {median:>9.2} {ratio:>7}", times[0]);
    median
}

fn view(turn: usize) -> View {
    let angle = 0.002 * turn as f64;
    let eye = DVec3::new(5.0 - 11.0 * angle.sin(), 5.0 - 11.0 * angle.cos(), 9.0);
    let target = DVec3::new(5.0, 5.0, 4.0);
    let camera = Camera::looking_at(eye, target, DVec3::Z, 60f64.to_radians(), 0.01);
    View { camera, width_px: 1280, height_px: 720 }
}

fn seeded_cloud() -> MemoryCloud {
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    let mut next = || {
        state ^= state >> 12;
        state ^= state << 25;
        state ^= state >> 27;
        (state.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 32) as u32
    };
    let edge = f64::from(1u32 << BITS);
    let points: Vec<(UVec3, u32)> = (0..POINTS)
        .map(|_| {
            let (x, y) = (f64::from(next()) / 2f64.powi(32), f64::from(next()) / 2f64.powi(32));
            let sheet = f64::from(next() % 2);
            let z = 0.2 + 0.3 * sheet + 0.1 * (9.0 * x).sin() * (7.0 * y).cos();
            (UVec3::from([x, y, z].map(|v| (v * edge) as u32)), 0xff00_0000 | next() & 0xff_ffff)
        })
        .collect();
    let lattice = Lattice { scale: DVec3::splat(10.0 / edge), offset: DVec3::ZERO };
    MemoryCloud::new(lattice, BITS, 7, &points)
}

/// The bare pass over the points that a frame draws.
struct BarePass {
    octree: Octree,
    count: u32,
    pipeline: wgpu::ComputePipeline,
    groups: [wgpu::BindGroup; 3],
    frame: wgpu::Buffer,
    nodes: wgpu::Buffer,
    pixels: wgpu::Buffer,
}

impl BarePass {
    fn new(gpu: &Gpu, cloud: &MemoryCloud, settings: &FrameSettings) -> Self {
        let (words, count) = flat_words(cloud, settings);
        let text = shader::source_with("bare", include_str!("points_bare.wgsl"), gpu.atomic_read());
        let module = shader::module_of(gpu, "bare", text).expect("the shader is valid");
        let device = gpu.device();
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: None,
            layout: None,
            module: &module,
            entry_point: Some("draw_bare"),
            compilation_options: Default::default(),
            cache: None,
        });
        let buffer = |size: u64, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: None,
                size,
                usage: usage | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let storage = wgpu::BufferUsages::STORAGE;
        let frame = buffer(size_of::<GpuFrame>() as u64, wgpu::BufferUsages::UNIFORM);
        let nodes = buffer(size_of::<GpuNode>() as u64, storage);
        let word_buffer = buffer(4 * words.len() as u64, storage);
        let pixels = buffer(8 * 1280 * 720, storage);
        gpu.queue().write_buffer(&word_buffer, 0, bytemuck::cast_slice(&words));
        let group = |index, buffers: &[&wgpu::Buffer]| {
            let entries: Vec<_> = buffers
                .iter()
                .zip(0..)
                .map(|(buffer, binding)| wgpu::BindGroupEntry {
                    binding,
                    resource: buffer.as_entire_binding(),
                })
                .collect();
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: None,
                layout: &pipeline.get_bind_group_layout(index),
                entries: &entries,
            })
        };
        let groups = [group(0, &[&frame]), group(1, &[&nodes, &word_buffer]), group(2, &[&pixels])];
        BarePass { octree: cloud.octree().clone(), count, pipeline, groups, frame, nodes, pixels }
    }

    fn draw(&self, gpu: &Gpu, view: &View) {
        let frame = Tile::whole(view).gpu_frame(view, &SplatSettings::default(), 0);
        let eye = self.octree.lattice().lattice(view.camera.eye);
        let last = f64::from(BITS).exp2() - 1.0;
        let eye_cell = eye.floor().clamp(DVec3::ZERO, DVec3::splat(last));
        let node = GpuNode {
            eye_cell: eye_cell.as_uvec3().to_array(),
            positions_at: 0,
            eye_fraction: (eye - eye_cell).as_vec3().to_array(),
            colors_at: 2 * self.count,
            scale: self.octree.lattice().scale.as_vec3().to_array(),
            splat_px_m: 0.0,
            local_bits: BITS,
            drawn_count: self.count,
            drawn_children: 0,
            drawn_levels_below: 0,
        };
        gpu.queue().write_buffer(&self.frame, 0, bytemuck::bytes_of(&frame));
        gpu.queue().write_buffer(&self.nodes, 0, bytemuck::bytes_of(&node));
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        encoder.clear_buffer(&self.pixels, 0, None);
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&self.pipeline);
            for (group, index) in self.groups.iter().zip(0..) {
                pass.set_bind_group(index, group, &[]);
            }
            let workgroups = self.count.div_ceil(BARE_WORKGROUP_SIZE);
            let row = workgroups.min(32_768);
            pass.dispatch_workgroups(row, workgroups.div_ceil(row), 1);
        }
        gpu.queue().submit([encoder.finish()]);
        gpu.wait().expect("the device lives");
    }
}

/// Root-local Morton words, then colours, of the points that the middle frame draws, in the order
/// in which it draws them.
fn flat_words(cloud: &MemoryCloud, settings: &FrameSettings) -> (Vec<u32>, u32) {
    let octree = cloud.octree();
    let mut scratch = CutScratch::default();
    let cut = select_nodes(octree, &view(REPEATS / 2), &settings.cut, &AllResident, &mut scratch);
    let (mut words, mut colors) = (Vec::new(), Vec::new());
    let (mut node_positions, mut node_colors) = (Vec::new(), Vec::new());
    for drawn in &cut.draw {
        cloud.read_positions(drawn.node, &mut node_positions).expect("it is in memory");
        cloud.read_colors(drawn.node, &mut node_colors).expect("it is in memory");
        let local_bits = octree.local_bits(drawn.node);
        assert_eq!(position_words(local_bits), 2, "the cloud is narrow");
        let shape = GpuNode { local_bits, ..bytemuck::Zeroable::zeroed() };
        let base = octree.cell_min(drawn.node).as_uvec3();
        for point in 0..drawn.count as usize {
            let cell = UVec3::from(local_cell(&shape, &node_positions, point)) + base;
            let code = u64::encode(cell.to_array());
            words.extend([code as u32, (code >> 32) as u32]);
        }
        colors.extend_from_slice(&node_colors[..drawn.count as usize]);
    }
    let count = colors.len() as u32;
    words.extend(colors);
    (words, count)
}
