//! Points in occlusion culling: what is hidden is neither drawn nor counted nor read, and the
//! picture stays that of frustum culling, with points alone and with models among them.
#![cfg(feature = "gpu")]

#[path = "support/device.rs"]
mod device;
#[path = "support/memory_cloud.rs"]
mod memory_cloud;

use std::sync::Arc;

use device::gpu;
use esker::frame::{FrameSettings, FrameStats, Loading, NodeSource, RasterPath, Renderer};
use esker::geometry::View;
use esker::mesh::Model;
use esker::mesh::scenes::{CameraPath, ModelScene, SceneKind, SurfaceSampler, camera_path};
use esker::passes::{EyeDome, FinishSettings, Picture};
use esker::points::Lattice;
use esker::select::{CutSettings, SplatSettings, SplatShape, SplatSize};
use esker::visibility::{Algorithm, ChcOptions, ChcPlusOptions, CullingCosts};
use glam::UVec3;
use memory_cloud::MemoryCloud;

const WIDTH: u32 = 240;
const HEIGHT: u32 = 150;

/// The surfaces of a scene as points, every `keep`-th object of it left out.
fn sampled(scene: &ModelScene, points: u64, leaves_out: Option<usize>) -> Arc<MemoryCloud> {
    let objects = scene.model.objects.iter().enumerate();
    let kept = objects.filter(|(at, _)| leaves_out.is_none_or(|every| at % every != 0));
    let objects = kept.map(|(_, object)| *object).collect();
    let model = Model { objects, ..scene.model.clone() };
    let sampler = SurfaceSampler::new(&model, 1);
    let bounds = model.bounds();
    let bits = 14;
    let scale = bounds.size().max_element() / f64::from((1u32 << bits) - 1);
    let lattice = Lattice { offset: bounds.min, scale: glam::DVec3::splat(scale) };
    let sample = |index| {
        let point = sampler.point(index)?;
        let cell = ((point.position - bounds.min) / scale).round().as_uvec3();
        Some((
            cell.min(UVec3::splat((1 << bits) - 1)),
            0xff00_0000 | (index as u32).wrapping_mul(7919) & 0xff_ffff,
        ))
    };
    let points: Vec<(UVec3, u32)> = (0..points).filter_map(sample).collect();
    Arc::new(MemoryCloud::new(lattice, bits, 4, &points))
}

/// Every `every`-th object of a scene.
fn some_objects(scene: &ModelScene, every: usize) -> Arc<Model> {
    let objects = scene.model.objects.iter().step_by(every).copied().collect();
    Arc::new(Model { objects, ..scene.model.clone() })
}

fn views(scene: &ModelScene, path: CameraPath, frames: u32) -> Vec<View> {
    let view = |camera| View { camera, width_px: WIDTH, height_px: HEIGHT };
    camera_path(scene, path, frames).into_iter().map(view).collect()
}

fn film(
    raster: RasterPath,
    cloud: &Arc<MemoryCloud>,
    model: Option<&Arc<Model>>,
    views: &[View],
    settings: &FrameSettings,
) -> Vec<(Picture, FrameStats)> {
    let mut renderer = Renderer::on_gpu(gpu().unwrap(), raster, 1 << 28).unwrap();
    renderer.set_scene(vec![cloud.clone() as Arc<dyn NodeSource>]);
    if let Some(model) = model {
        renderer.set_model(model.clone());
    }
    let frame = |view: &View| {
        let stats = renderer.render(view, settings).unwrap().clone();
        (renderer.read_picture().unwrap().expect("a frame was drawn"), stats)
    };
    views.iter().map(frame).collect()
}

fn assert_same(expected: &[(Picture, FrameStats)], found: &[(Picture, FrameStats)], what: &str) {
    for (frame, (a, b)) in expected.iter().zip(found).enumerate() {
        let colors = a.0.colors.iter().zip(&b.0.colors).filter(|(a, b)| a != b).count();
        let depths = a.0.distances.iter().zip(&b.0.distances).filter(|(a, b)| a != b).count();
        assert_eq!((colors, depths), (0, 0), "{what}, frame {frame}");
    }
}

fn points(film: &[(Picture, FrameStats)]) -> u64 {
    film.iter().map(|(_, stats)| stats.points_drawn).sum()
}

fn plus() -> ChcPlusOptions {
    ChcPlusOptions { seed_first_frame: false, ..ChcPlusOptions::default() }
}

#[test]
fn pictures_of_points_are_those_of_everything_in_view() {
    if gpu().is_none() {
        return;
    }
    let scene = SceneKind::City.make(2, 1);
    let cloud = sampled(&scene, 120_000, None);
    let splats = [
        SplatSettings::default(),
        SplatSettings { size: SplatSize::Fixed { px: 5.0 }, ..SplatSettings::default() },
        SplatSettings { shape: SplatShape::Sphere, multiplier: 2.0, ..SplatSettings::default() },
    ];
    let algorithms = [
        Algorithm::StopAndWait,
        Algorithm::Chc(ChcOptions { geometry_queries: true, ..ChcOptions::default() }),
        Algorithm::ChcPlus(plus()),
        Algorithm::Auto(ChcPlusOptions::default(), CullingCosts::default()),
    ];
    let finished = FinishSettings { eye_dome: Some(EyeDome::default()), gap_radius_px: 3 };
    for (path, splat) in [CameraPath::Walk, CameraPath::Rotate, CameraPath::Rise].iter().zip(splats)
    {
        let views = views(&scene, *path, 6);
        let cut = CutSettings { splat, ..CutSettings::default() };
        let settings = FrameSettings { cut, finish: finished, ..FrameSettings::default() };
        for raster in [RasterPath::Compute, RasterPath::Compute32] {
            let expected = film(raster, &cloud, None, &views, &settings);
            for culling in algorithms {
                let settings = FrameSettings { culling, ..settings.clone() };
                let found = film(raster, &cloud, None, &views, &settings);
                let what = format!("{}, {raster:?}: {culling:?}", path.name());
                assert_same(&expected, &found, &what);
                assert!(points(&found) <= points(&expected), "{what}");
            }
        }
    }
}

#[test]
fn points_and_objects_hide_each_other() {
    if gpu().is_none() {
        return;
    }
    let scene = SceneKind::City.make(4, 1);
    // Every other building and lamp is there as points, the rest as objects.
    let cloud = sampled(&scene, 150_000, Some(2));
    let model = some_objects(&scene, 2);
    let eye_dome = FinishSettings { eye_dome: Some(EyeDome::default()), gap_radius_px: 0 };
    for (path, finish) in
        [(CameraPath::Walk, FinishSettings::default()), (CameraPath::Rotate, eye_dome)]
    {
        let views = views(&scene, path, 8);
        // Depth in any case, so that distances come the same way from all frames.
        let settings = FrameSettings { finish, depth: true, ..FrameSettings::default() };
        let expected = film(RasterPath::Compute, &cloud, Some(&model), &views, &settings);
        for culling in [Algorithm::StopAndWait, Algorithm::ChcPlus(plus())] {
            let settings = FrameSettings { culling, ..settings.clone() };
            let found = film(RasterPath::Compute, &cloud, Some(&model), &views, &settings);
            assert_same(&expected, &found, &format!("{}: {culling:?}", path.name()));
            let objects = |film: &[(Picture, FrameStats)]| -> u32 {
                film.iter().map(|(_, stats)| stats.objects_drawn).sum()
            };
            let (all, culled) = (points(&expected), points(&found));
            assert!(3 * culled < 2 * all, "{culled} of {all} points");
            let (all, culled) = (objects(&expected), objects(&found));
            assert!(3 * culled < 2 * all, "{culled} of {all} objects");
        }
    }
}

/// Hidden nodes cost no points of the budget: it goes to what shows.
#[test]
fn a_budget_is_spent_on_what_shows() {
    if gpu().is_none() {
        return;
    }
    let scene = SceneKind::City.make(4, 1);
    let cloud = sampled(&scene, 600_000, None);
    let view = views(&scene, CameraPath::Walk, 40)[5];
    let all = film(RasterPath::Compute, &cloud, None, &[view], &FrameSettings::default());
    let budget = all[0].1.points_drawn * 3 / 10;
    let cut = CutSettings { point_budget: budget, ..CutSettings::default() };
    let settings = FrameSettings { cut, ..FrameSettings::default() };
    let views = vec![view; 60];
    let plain = film(RasterPath::Compute, &cloud, None, &views[..1], &settings);
    let culling = Algorithm::ChcPlus(ChcPlusOptions::default());
    let settings = FrameSettings { culling, ..settings };
    let culled = film(RasterPath::Compute, &cloud, None, &views, &settings);
    let (_, first) = &plain[0];
    // A frame that shows nothing new is not drawn again; the last one drawn is the settled one.
    let settled = culled.iter().rev().map(|(_, stats)| stats).find(|stats| !stats.unchanged);
    let settled = settled.expect("a frame was drawn");
    assert!(culled[59].1.unchanged, "the view comes to rest");
    assert!(first.nodes_over_budget > 0 && first.points_drawn <= budget);
    assert!(settled.points_drawn <= budget && settled.nodes_hidden > 0, "{settled:?}");
    // The same budget reaches nodes that are finer.
    let reached = |stats: &FrameStats| stats.points_drawn + stats.points_hidden;
    let (plain, culled) = (reached(first), reached(settled));
    assert!(5 * culled > 6 * plain, "{culled} points with culling, {plain} without");
}

/// Nodes behind others are not read: what is there already hides them before they come.
#[test]
fn hidden_nodes_are_neither_read_nor_sent() {
    if gpu().is_none() {
        return;
    }
    let scene = SceneKind::City.make(4, 1);
    let mut views: Vec<View> = views(&scene, CameraPath::Walk, 300)[100..130].to_vec();
    views.extend([views[29]; 20]);
    let flight = |culling: Algorithm| {
        let cloud = sampled(&scene, 300_000, None);
        let loading = Loading::Quota { bytes: 100_000 };
        let settings = FrameSettings { culling, loading, depth: true, ..FrameSettings::default() };
        let mut film = film(RasterPath::Compute, &cloud, None, &views, &settings);
        (cloud.bytes_read(), film.pop().expect("frames were drawn"))
    };
    let (plain_bytes, plain) = flight(Algorithm::Frustum);
    let (culled_bytes, culled) = flight(Algorithm::ChcPlus(ChcPlusOptions::default()));
    assert!(plain.1.complete && culled.1.complete, "both have all they want");
    assert_same(&[plain], &[culled], "the last frame");
    assert!(5 * culled_bytes < 4 * plain_bytes, "{culled_bytes} of {plain_bytes} bytes");
}
