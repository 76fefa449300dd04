//! Occlusion culling on the device: whatever is asked, the picture stays that of frustum culling,
//! with models alone and with points before them; and hidden objects are not drawn.
#![cfg(feature = "gpu")]

#[path = "support/device.rs"]
mod device;
#[path = "support/film.rs"]
mod film;
#[path = "support/memory_cloud.rs"]
mod memory_cloud;

use std::sync::Arc;

use device::gpu;
use esker::frame::{FrameSettings, FrameStats, RasterPath, Renderer};
use esker::geometry::View;
use esker::mesh::Model;
use esker::mesh::scenes::{CameraPath, ModelScene, SceneKind};
use esker::passes::Picture;
use esker::points::Lattice;
use esker::visibility::{Algorithm, ChcOptions, ChcPlusOptions, CullingCosts, LateAnswers};
use film::{assert_same, film};
use glam::{DVec3, UVec3};
use memory_cloud::MemoryCloud;

const WIDTH: u32 = 320;
const HEIGHT: u32 = 200;

fn views(scene: &ModelScene, path: CameraPath, frames: u32) -> Vec<View> {
    film::views(scene, path, frames, (WIDTH, HEIGHT))
}

fn algorithms() -> Vec<Algorithm> {
    let plus = ChcPlusOptions { seed_first_frame: false, ..ChcPlusOptions::default() };
    vec![
        Algorithm::StopAndWait,
        Algorithm::Chc(ChcOptions { seed_first_frame: false, ..ChcOptions::default() }),
        Algorithm::Chc(ChcOptions { geometry_queries: true, ..ChcOptions::default() }),
        Algorithm::ChcPlus(plus),
        Algorithm::ChcPlus(ChcPlusOptions { late: LateAnswers::Rounds(1), ..plus }),
        Algorithm::Auto(plus, CullingCosts::default()),
    ]
}

#[test]
fn culled_pictures_are_those_of_everything_in_view() {
    if gpu().is_none() {
        return;
    }
    for (kind, size) in [(SceneKind::City, 2), (SceneKind::Rooms, 3), (SceneKind::Window, 60)] {
        let scene = kind.make(size, 1);
        let model = Arc::new(scene.model.clone());
        for path in [CameraPath::Walk, CameraPath::Teleport] {
            let views = views(&scene, path, 5);
            let expected = film(&model, None, &views, Algorithm::Frustum);
            for algorithm in algorithms() {
                let found = film(&model, None, &views, algorithm);
                let what = format!("{} {}: {algorithm:?}", kind.name(), path.name());
                assert_same(&expected, &found, &what);
            }
        }
    }
}

/// Row A7 on the device: hidden objects are not drawn, and answers are waited for seldom.
#[test]
fn hidden_objects_are_not_drawn() {
    if gpu().is_none() {
        return;
    }
    let scene = SceneKind::City.make(4, 1);
    let model = Arc::new(scene.model.clone());
    let views: Vec<View> = views(&scene, CameraPath::Walk, 600)[200..212].to_vec();
    let frustum = film(&model, None, &views, Algorithm::Frustum);
    let plus = Algorithm::ChcPlus(ChcPlusOptions::default());
    let culled = film(&model, None, &views, plus);
    assert_same(&frustum, &culled, "city");
    let triangles = |film: &[(Picture, FrameStats)]| -> u64 {
        film[4..].iter().map(|(_, stats)| stats.triangles_drawn).sum()
    };
    assert!(3 * triangles(&culled) < triangles(&frustum));
    for (_, stats) in &culled[4..] {
        let counters = stats.culling.expect("culling was at work");
        assert_eq!(counters.triangles_drawn, stats.triangles_drawn);
        assert!(counters.queries_issued > 0 && counters.blocking_waits <= 5, "{counters:?}");
    }
    assert!(frustum.iter().all(|(_, stats)| stats.culling.is_none()));
}

/// Objects behind points are not drawn.
#[test]
fn points_hide_objects() {
    if gpu().is_none() {
        return;
    }
    let scene = SceneKind::Window.make(60, 1);
    // The boxes without their wall.
    let model = Model { objects: scene.model.objects[1..].to_vec(), ..scene.model.clone() };
    let model = Arc::new(model);
    // A dense wall of points where the wall was.
    let step = 0.02;
    let lattice = Lattice { offset: DVec3::new(-30.0, -0.1, -5.0), scale: DVec3::splat(step) };
    let wall = (0..3000u32).flat_map(|x| (0..1500u32).map(move |z| (UVec3::new(x, 0, z), 0)));
    let cloud = Arc::new(MemoryCloud::new(lattice, 12, 3, &wall.collect::<Vec<_>>()));
    // A little nearer in each frame: what does not change is not drawn again.
    let still = views(&scene, CameraPath::Still, 1)[0];
    let views: Vec<View> = (0..12)
        .map(|frame| {
            let mut view = still;
            view.camera.eye += view.camera.forward * 0.01 * f64::from(frame);
            view
        })
        .collect();
    let expected = film(&model, Some(&cloud), &views, Algorithm::Frustum);
    let chc = Algorithm::ChcPlus(ChcPlusOptions { seed_first_frame: false, ..Default::default() });
    let found = film(&model, Some(&cloud), &views, chc);
    assert_same(&expected, &found, "boxes behind points");
    // The first frame knows nothing and has rounds for the upper nodes only; what it drew unasked is
    // asked about within some frames.
    let (of_all, of_culled) = (expected[11].1.objects_drawn, found[11].1.objects_drawn);
    assert!(of_all >= 10 && 4 * of_culled < of_all, "{of_culled} of {of_all} objects");
}

/// A single picture asks nothing with algorithms that learn from frame to frame.
#[test]
fn a_single_picture_asks_nothing_for_the_next() {
    let Some(gpu) = gpu() else { return };
    let scene = SceneKind::City.make(2, 1);
    let view = views(&scene, CameraPath::Still, 1)[0];
    let picture = |culling, more_follow| {
        let mut renderer = Renderer::on_gpu(gpu.clone(), RasterPath::Compute, 1 << 28).unwrap();
        renderer.set_model(Arc::new(scene.model.clone()));
        let settings = FrameSettings { culling, more_follow, ..FrameSettings::default() };
        let picture = renderer.render_picture(&view, &settings).unwrap();
        let asked = renderer.stats().culling.map_or(0, |counters| counters.queries_issued);
        (picture, asked)
    };
    let [auto, _, frustum, _, _, chc, plus, _] = Algorithm::usual();
    let (expected, _) = picture(frustum, true);
    for (culling, more_follow, asks) in [
        (auto, false, false),
        (chc, false, false),
        (plus, false, false),
        (auto, true, false),
        (chc, true, true),
        (plus, true, true),
    ] {
        let (found, asked) = picture(culling, more_follow);
        assert_eq!(found, expected, "{culling:?}");
        assert_eq!(asked > 0, asks, "{culling:?}: {asked}");
    }
}

/// `auto` measures what drawing and asking cost, in frames of attempts only.
#[test]
fn prices_are_measured_where_asking_is_tried() {
    let Some(gpu) = gpu() else { return };
    let scene = SceneKind::City.make(4, 1);
    let mut renderer = Renderer::on_gpu(gpu, RasterPath::Compute, 1 << 28).unwrap();
    renderer.set_model(Arc::new(scene.model.clone()));
    let [culling, ..] = Algorithm::usual();
    let settings = FrameSettings { culling, ..FrameSettings::default() };
    let views: Vec<View> = views(&scene, CameraPath::Walk, 900)[300..360].to_vec();
    for view in &views {
        renderer.render(view, &settings).unwrap();
    }
    let costs = renderer.stats().culling_costs.expect("the attempt was timed");
    println!("{costs:?}");
    assert!(costs.fits > 0 && costs.timed_frames >= 8, "{costs:?}");
    assert!(costs.timed_frames <= 25, "most frames wait for nothing: {costs:?}");
    for price in [costs.triangle_ns, costs.leaf_ns, costs.question_ns, costs.wait_ns] {
        assert!(price.is_finite() && price > 0.0, "{costs:?}");
    }
    let frustum = FrameSettings::default();
    renderer.render(&views[0], &frustum).unwrap();
    assert!(renderer.stats().culling_costs.is_none(), "the frustum alone measures nothing");
}

/// While culling is frozen another view shows what was chosen for the first, and nothing is asked.
#[test]
fn frozen_culling_asks_nothing_and_stays() {
    let Some(gpu) = gpu() else { return };
    let scene = SceneKind::City.make(3, 1);
    let mut renderer = Renderer::on_gpu(gpu, RasterPath::Compute, 1 << 28).unwrap();
    renderer.set_model(Arc::new(scene.model.clone()));
    let culling = Algorithm::ChcPlus(ChcPlusOptions::default());
    let settings = FrameSettings { culling, ..FrameSettings::default() };
    let view = views(&scene, CameraPath::Still, 1)[0];
    for _ in 0..12 {
        renderer.draw_again();
        renderer.render(&view, &settings).unwrap();
    }
    let first = renderer.stats().clone();
    let asked = first.culling.expect("culling is at work").queries_issued;
    let picture = renderer.read_picture().unwrap();
    let states = renderer.culling_states();
    let [_, _, hidden, outside] = esker::frame::count_states(&states);
    assert!(asked > 0 && hidden > 0 && outside > 0);
    renderer.freeze_culling(&view);
    let bounds = renderer.bounds();
    let above = View { camera: esker::frame::camera_above(&view.camera, &bounds).0, ..view };
    renderer.render(&above, &settings).unwrap();
    assert_eq!(renderer.stats().objects_drawn, first.objects_drawn);
    assert_eq!(renderer.stats().triangles_drawn, first.triangles_drawn);
    renderer.thaw_culling();
    renderer.render(&view, &settings).unwrap();
    let after = renderer.stats().culling.expect("culling goes on");
    assert!(after.triangles_drawn <= first.triangles_drawn + first.triangles_drawn / 10);
    assert_eq!(renderer.read_picture().unwrap(), picture);
}
