//! The farthest depths of a picture's regions, on the device.
//!
//! Level 0 is the picture's depth texture itself; each further level has half the size, rounded up,
//! and holds the farthest depth of what it covers. Four levels are made by one dispatch. Shader:
//! `depth_pyramid.wgsl`. Twin: [`DepthPyramidCpu`](crate::passes::DepthPyramidCpu).

use crate::gpu::layout::GpuPyramid;
use crate::gpu::{Gpu, GpuError, GrowingBuffer, read_buffer, shader};
use crate::passes::bindings::{bind, compute_pipeline, part, pipeline_layout};

/// Levels that one dispatch makes.
const LEVELS_A_STEP: u32 = 4;
/// Pixels along each side that one workgroup of the first step reads; levels for later ones.
const TILE: u32 = 1 << LEVELS_A_STEP;

/// The pyramid over one picture after the other.
#[derive(Debug)]
pub struct DepthPyramid {
    build_layout: wgpu::BindGroupLayout,
    test_layout: wgpu::BindGroupLayout,
    /// One for each step.
    steps: Vec<wgpu::ComputePipeline>,
    described: GrowingBuffer,
    levels: GrowingBuffer,
    shape: GpuPyramid,
    bound: Option<Bound>,
}

/// Groups over one picture's depth.
#[derive(Debug)]
struct Bound {
    depth: wgpu::TextureView,
    build: wgpu::BindGroup,
    test: wgpu::BindGroup,
}

impl DepthPyramid {
    /// Compiles the pass; holds no levels yet.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let module = shader::module(gpu, "depth_pyramid")?;
        gpu.checked("build the depth pyramid", || {
            let build_layout = pyramid_layout(gpu, false);
            let pipelines = pipeline_layout(gpu, "depth pyramid", &[Some(&build_layout)]);
            let step = |from: u32| {
                let entry = if from == 0 { "reduce_picture" } else { "reduce_level" };
                let constants = [("FROM_LEVEL", f64::from(from))];
                compute_pipeline(gpu, &pipelines, &module, entry, &constants)
            };
            DepthPyramid {
                steps: (0..GpuPyramid::MOST_LEVELS)
                    .step_by(LEVELS_A_STEP as usize)
                    .map(step)
                    .collect(),
                test_layout: pyramid_layout(gpu, true),
                build_layout,
                described: GrowingBuffer::new("depth pyramid", wgpu::BufferUsages::UNIFORM),
                levels: GrowingBuffer::new(
                    "farthest depths",
                    wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
                ),
                shape: bytemuck::Zeroable::zeroed(),
                bound: None,
            }
        })
    }

    /// The group that `shared/pyramid_test.wgsl` reads.
    pub fn test_layout(&self) -> &wgpu::BindGroupLayout {
        &self.test_layout
    }

    /// Gets ready for a picture's depth of that width and height; `false` if it has none. Costs
    /// nothing while it stays the same.
    pub fn prepare(
        &mut self,
        gpu: &Gpu,
        depth: Option<&wgpu::TextureView>,
        (width_px, height_px): (u32, u32),
    ) -> Result<bool, GpuError> {
        let Some(depth) = depth else { return Ok(false) };
        if self.bound.as_ref().is_some_and(|bound| bound.depth == *depth) {
            return Ok(true);
        }
        self.shape = GpuPyramid::over(width_px, height_px);
        let bytes = 4 * u64::from(self.shape.texel_count().max(1));
        self.described.write(gpu, &[self.shape])?;
        self.levels.reserve(gpu, bytes)?;
        let (described, levels) = (self.described.get(), self.levels.get());
        let (Some(described), Some(levels)) = (described, levels) else { return Ok(false) };
        let group = |layout: &wgpu::BindGroupLayout| {
            let described = part(described, 0, size_of::<GpuPyramid>() as u64);
            let depth = wgpu::BindingResource::TextureView(depth);
            bind(gpu, layout, &[described, part(levels, 0, bytes), depth])
        };
        self.bound = Some(gpu.checked("bind the depth pyramid", || Bound {
            depth: depth.clone(),
            build: group(&self.build_layout),
            test: group(&self.test_layout),
        })?);
        Ok(true)
    }

    /// Adds the dispatches that take the picture's depth as it then is; how many.
    ///
    /// [`prepare`](Self::prepare) comes before.
    pub fn record(&self, pass: &mut wgpu::ComputePass) -> u32 {
        let Some(bound) = &self.bound else { return 0 };
        pass.set_bind_group(0, &bound.build, &[]);
        let mut dispatches = 0;
        for (pipeline, from) in self.steps.iter().zip((0..).step_by(LEVELS_A_STEP as usize)) {
            if from + 1 >= self.shape.level_count {
                break;
            }
            let [width, height] = self.shape.size_of(from);
            pass.set_pipeline(pipeline);
            pass.dispatch_workgroups(width.div_ceil(TILE), height.div_ceil(TILE), 1);
            dispatches += 1;
        }
        dispatches
    }

    /// The group that tests read; made by [`prepare`](Self::prepare).
    pub fn test_group(&self) -> Option<&wgpu::BindGroup> {
        self.bound.as_ref().map(|bound| &bound.test)
    }

    /// Reads the levels after the picture back, the largest first; waits for the device.
    pub fn read_levels(&self, gpu: &Gpu) -> Result<Vec<Vec<f32>>, GpuError> {
        let Some(levels) = self.levels.get() else { return Ok(Vec::new()) };
        let words = self.shape.texel_count();
        if words == 0 {
            return Ok(Vec::new());
        }
        let bytes = read_buffer(gpu, levels, 0, 4 * u64::from(words))?;
        let depths: Vec<f32> = bytemuck::pod_collect_to_vec(&bytes);
        let level = |level: u32| {
            let [width, height] = self.shape.size_of(level);
            depths[self.shape.offset_of(level) as usize..][..(width * height) as usize].to_vec()
        };
        Ok((1..self.shape.level_count).map(level).collect())
    }

    /// Bytes held on the device.
    pub fn held_bytes(&self) -> u64 {
        self.described.held_bytes() + self.levels.held_bytes()
    }
}

fn pyramid_layout(gpu: &Gpu, read_only: bool) -> wgpu::BindGroupLayout {
    let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty,
        count: None,
    };
    let buffer =
        |ty| wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None };
    gpu.device().create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("depth pyramid"),
        entries: &[
            entry(0, buffer(wgpu::BufferBindingType::Uniform)),
            entry(1, buffer(wgpu::BufferBindingType::Storage { read_only })),
            entry(
                2,
                wgpu::BindingType::Texture {
                    sample_type: wgpu::TextureSampleType::Depth,
                    view_dimension: wgpu::TextureViewDimension::D2,
                    multisampled: false,
                },
            ),
        ],
    })
}
