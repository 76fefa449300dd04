//! The depth pyramid: its texels are the farthest depths of what they cover, whatever the size of the
//! picture; a box that it calls hidden is hidden in every pixel by the exact item buffer; the device
//! and its twin say the same; and culling by its answers leaves the picture as it is.
#![cfg(feature = "gpu")]

#[path = "support/device.rs"]
mod device;
#[path = "support/occlusion_stage.rs"]
mod stage;

use std::sync::Arc;

use device::gpu;
use esker::frame::{CullingAnswers, FrameSettings, RasterPath, Renderer};
use esker::geometry::{Aabb, View};
use esker::gpu::{Gpu, read_texture};
use esker::ids::TreeNodeId;
use esker::mesh::Model;
use esker::mesh::scenes::{CameraPath, SceneKind};
use esker::passes::{DepthPyramid, DepthPyramidCpu, OcclusionQueries, Picture, Targets};
use esker::visibility::{
    Algorithm, ChcOptions, ChcPlusOptions, Drawables, ItemBuffer, ModelLeaves, Proxies,
    meets_near_plane,
};
use glam::Vec3;
use stage::{Stage, frame_of, leaves_of, tree_over, views};

/// Fills a depth target with numbers that follow from the pixel, some of them 0.
const SCATTER: &str = "
@vertex
fn cover(@builtin(vertex_index) vertex: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(f32(vertex & 1u) * 4.0 - 1.0, f32(vertex >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}
@fragment
fn scatter(@builtin(position) position: vec4<f32>) -> @builtin(frag_depth) f32 {
    let at = vec2<u32>(position.xy);
    var bits = (at.x * 7919u + at.y * 104729u) * 2654435769u;
    bits = (bits ^ (bits >> 15u)) * 2246822519u;
    return f32(bits >> 9u) / 8388608.0;
}
";

fn scattered(gpu: &Gpu, width: u32, height: u32) -> Targets {
    let targets = Targets::new(gpu, width, height).unwrap();
    let module = gpu.device().create_shader_module(wgpu::ShaderModuleDescriptor {
        label: None,
        source: wgpu::ShaderSource::Wgsl(SCATTER.into()),
    });
    let pipeline = gpu.device().create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: None,
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("cover"),
            compilation_options: Default::default(),
            buffers: &[],
        },
        primitive: Default::default(),
        depth_stencil: Some(Targets::depth_state(wgpu::CompareFunction::Always)),
        multisample: Default::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("scatter"),
            compilation_options: Default::default(),
            targets: &[],
        }),
        multiview_mask: None,
        cache: None,
    });
    let mut encoder = gpu.device().create_command_encoder(&Default::default());
    {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            color_attachments: &[],
            depth_stencil_attachment: targets.cleared(0).1,
            ..Default::default()
        });
        pass.set_pipeline(&pipeline);
        pass.draw(0..3, 0..1);
    }
    gpu.queue().submit([encoder.finish()]);
    targets
}

fn depths(gpu: &Gpu, targets: &Targets) -> Vec<f32> {
    let texture = targets.depth_view().expect("it has depth").texture().clone();
    bytemuck::pod_collect_to_vec(&read_texture(gpu, &texture).unwrap())
}

#[test]
fn texels_are_the_farthest_depths_of_what_they_cover() {
    let Some(gpu) = gpu() else { return };
    let mut pyramid = DepthPyramid::new(&gpu).unwrap();
    let sizes =
        [(1, 1), (2, 1), (1, 7), (3, 5), (16, 16), (17, 33), (100, 1), (255, 129), (641, 361)];
    for (width, height) in sizes {
        let targets = scattered(&gpu, width, height);
        let picture = depths(&gpu, &targets);
        assert!(pyramid.prepare(&gpu, targets.depth_view(), targets.size_px()).unwrap());
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        let dispatches = pyramid
            .record(&mut encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()));
        gpu.queue().submit([encoder.finish()]);
        let longest = width.max(height);
        assert_eq!(dispatches, longest.next_power_of_two().ilog2().div_ceil(4));
        let levels = pyramid.read_levels(&gpu).unwrap();
        let twin = DepthPyramidCpu::new(width, height, picture.clone());
        assert_eq!(levels[..], twin.levels()[1..], "{width}x{height}");
        for (level, texels) in (1..).zip(&levels) {
            let side = 1usize << level;
            let across = (width as usize).div_ceil(side);
            assert_eq!(texels.len(), across * (height as usize).div_ceil(side));
            for (at, texel) in texels.iter().enumerate() {
                let (x, y) = (at % across * side, at / across * side);
                let rows = y..(y + side).min(height as usize);
                let pixels = rows.flat_map(|row| {
                    let from = row * width as usize;
                    &picture[from + x..from + (x + side).min(width as usize)]
                });
                let farthest = pixels.fold(f32::INFINITY, |least, depth| least.min(*depth));
                assert_eq!(*texel, farthest, "{width}x{height}, level {level}, texel {at}");
            }
        }
        assert_eq!(levels.last().map_or(1, Vec::len), 1, "the last level is one texel");
    }
}

/// Corners relative to the eye, as the device gets them.
fn relative(view: &View, bounds: &Aabb) -> [Vec3; 2] {
    [bounds.min, bounds.max].map(|corner| (corner - view.camera.eye).as_vec3())
}

/// What the twin calls hidden covers no pixel that is not hidden; and much of what is hidden is found.
#[test]
fn hidden_boxes_hold_nothing_that_shows() {
    let (mut hidden, mut truly_hidden, mut tested) = (0, 0, 0);
    for (kind, size) in [
        (SceneKind::City, 3),
        (SceneKind::Rooms, 3),
        (SceneKind::Pipes, 3),
        (SceneKind::Boxes, 300),
        (SceneKind::Terrain, 2),
    ] {
        let scene = kind.make(size, 2);
        let tree = tree_over(&scene.model);
        let leaves = leaves_of(&tree);
        let drawables = ModelLeaves { model: &scene.model, tree: &tree };
        for (number, view) in views(&scene, CameraPath::Walk, 6, (161, 119)).into_iter().enumerate()
        {
            let mut picture = ItemBuffer::new(&view);
            for leaf in leaves.iter().filter(|leaf| (leaf.index() + number) % 3 != 0) {
                drawables.draw(*leaf, &mut picture);
            }
            let pyramid = DepthPyramidCpu::new(161, 119, picture.depths().to_vec());
            let (frame, proxies) = (frame_of(&view), Proxies::new(&view));
            for &leaf in leaves.iter().filter(|leaf| (leaf.index() + number) % 3 == 0) {
                let proxy = proxies.of(&tree, leaf);
                if meets_near_plane(&view, &proxy) {
                    continue;
                }
                let [low, high] = relative(&view, &proxy);
                let shows = pyramid.may_show(&frame, low, high);
                let pixels = drawables.draw(leaf, &mut picture.clone());
                assert!(shows || pixels == 0, "{}: {pixels} pixels of {leaf:?}", kind.name());
                tested += 1;
                hidden += usize::from(!shows);
                truly_hidden += usize::from(picture.count_box(&proxy) == 0);
            }
        }
    }
    assert!(hidden <= truly_hidden, "a pyramid knows no more than its pixels");
    assert!(100 * hidden >= 95 * truly_hidden, "{hidden} of {truly_hidden} of {tested} found");
    assert!(truly_hidden > 1000 && tested > truly_hidden);
}

#[test]
fn the_device_answers_as_its_twin_and_never_less_than_queries() {
    let Some(gpu) = gpu() else { return };
    let (mut asked_all, mut hidden, mut hidden_by_queries, mut differ) = (0, 0, 0, 0);
    for (kind, size) in [(SceneKind::City, 3), (SceneKind::Pipes, 3), (SceneKind::Rooms, 3)] {
        let scene = kind.make(size, 2);
        for view in views(&scene, CameraPath::Walk, 3, (323, 201)) {
            let mut stage = Stage::new(&gpu, &scene, view);
            let leaves = leaves_of(&stage.tree);
            let is_drawn = |leaf: &&TreeNodeId| leaf.index().is_multiple_of(2);
            let drawn: Vec<_> = leaves.iter().filter(is_drawn).copied().collect();
            let proxies = Proxies::new(&view);
            let boxes: Vec<Vec<Aabb>> = leaves
                .iter()
                .filter(|leaf| !is_drawn(leaf))
                .map(|&leaf| vec![proxies.of(&stage.tree, leaf)])
                .filter(|boxes| !meets_near_plane(&view, &boxes[0]))
                .collect();
            let by_pyramid =
                stage.ask(&mut OcclusionQueries::by_pyramid(&gpu).unwrap(), &drawn, &boxes);
            let picture = depths(&gpu, &stage.targets);
            let by_query = stage.ask(&mut OcclusionQueries::new(&gpu).unwrap(), &[], &boxes);
            let twin = DepthPyramidCpu::new(view.width_px, view.height_px, picture);
            for ((boxes, found), asked) in boxes.iter().zip(&by_pyramid).zip(&by_query) {
                let [low, high] = relative(&view, &boxes[0]);
                differ += usize::from(twin.may_show(&stage.frame, low, high) != *found);
                assert!(*found || !*asked, "{}: a query sees {:?}", kind.name(), boxes[0]);
                hidden += usize::from(!found);
                hidden_by_queries += usize::from(!asked);
                asked_all += 1;
            }
        }
    }
    assert!(1000 * differ <= asked_all, "{differ} of {asked_all} answers differ from the twin's");
    assert!(10 * hidden > asked_all, "{hidden} of {asked_all} hidden");
    assert!(100 * hidden >= 95 * hidden_by_queries, "{hidden} against {hidden_by_queries}");
}

fn film(model: &Arc<Model>, views: &[View], settings: &FrameSettings) -> Vec<(Picture, u64)> {
    let gpu = gpu().expect("asked before");
    let mut renderer = Renderer::on_gpu(gpu, RasterPath::Compute, 1 << 28).unwrap();
    renderer.set_model(model.clone());
    let frame = |view: &View| {
        let triangles = renderer.render(view, settings).unwrap().triangles_drawn;
        (renderer.read_picture().unwrap().expect("a frame was drawn"), triangles)
    };
    views.iter().map(frame).collect()
}

#[test]
fn pictures_culled_by_a_pyramid_are_those_of_everything_in_view() {
    if gpu().is_none() {
        return;
    }
    let plus = ChcPlusOptions { seed_first_frame: false, ..ChcPlusOptions::default() };
    let with = |culling| {
        let answers = CullingAnswers::Pyramid;
        FrameSettings { culling, answers, ..FrameSettings::default() }
    };
    let (mut all, mut culled) = (0, 0);
    for (kind, size) in [(SceneKind::City, 2), (SceneKind::Rooms, 3), (SceneKind::Window, 60)] {
        let scene = kind.make(size, 1);
        let model = Arc::new(scene.model.clone());
        for path in [CameraPath::Walk, CameraPath::Teleport] {
            let views = views(&scene, path, 5, (320, 200));
            let expected = film(&model, &views, &FrameSettings::default());
            for algorithm in [
                Algorithm::StopAndWait,
                Algorithm::Chc(ChcOptions { geometry_queries: true, ..ChcOptions::default() }),
                Algorithm::ChcPlus(plus),
            ] {
                let found = film(&model, &views, &with(algorithm));
                for (frame, (a, b)) in expected.iter().zip(&found).enumerate() {
                    let what = format!("{} {}: {algorithm:?}", kind.name(), path.name());
                    assert!(a.0 == b.0, "{what}, frame {frame}");
                    (all, culled) = (all + a.1, culled + b.1);
                }
            }
        }
    }
    assert!(10 * culled < 9 * all, "{culled} of {all} triangles");
}
