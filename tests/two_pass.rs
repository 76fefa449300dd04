//! Culling without read-back: the picture stays that of frustum culling to the bit, nothing is waited
//! for, hidden objects are not drawn, and what is drawn second is what newly shows.
#![cfg(feature = "gpu")]

#[path = "support/device.rs"]
mod device;
#[path = "support/film.rs"]
mod film;
#[path = "support/memory_cloud.rs"]
mod memory_cloud;

use std::sync::Arc;

use device::gpu;
use esker::frame::{CullingAnswers, FrameSettings, RasterPath, Renderer};
use esker::geometry::View;
use esker::gpu::Gpu;
use esker::ids::ObjectId;
use esker::mesh::Model;
use esker::mesh::scenes::{CameraPath, SceneKind};
use esker::points::Lattice;
use esker::visibility::{Algorithm, ChcOptions, ChcPlusOptions, ItemBuffer};
use film::{assert_same, film, renderer, settings, shoot, views};
use glam::{DAffine3, DVec3, UVec3};
use memory_cloud::MemoryCloud;

#[test]
fn pictures_are_those_of_everything_in_view() {
    if gpu().is_none() {
        return;
    }
    for (kind, size) in [
        (SceneKind::City, 2),
        (SceneKind::Rooms, 3),
        (SceneKind::Window, 60),
        (SceneKind::Pipes, 3),
        (SceneKind::Shells, 5),
        (SceneKind::Terrain, 2),
    ] {
        let scene = kind.make(size, 1);
        let model = Arc::new(scene.model.clone());
        for (path, picture) in [
            (CameraPath::Walk, (320, 200)),
            (CameraPath::Teleport, (333, 97)),
            (CameraPath::Rotate, (1, 1)),
        ] {
            let views = views(&scene, path, 5, picture);
            let expected = film(&model, None, &views, Algorithm::Frustum);
            let found = film(&model, None, &views, Algorithm::TwoPass);
            assert_same(&expected, &found, &format!("{} {}", kind.name(), path.name()));
            for (_, stats) in &found {
                let counters = stats.culling.unwrap_or_default();
                assert_eq!((counters.blocking_waits, counters.rounds <= 1), (0, true));
            }
        }
    }
}

/// Of a steady walk little more is drawn than what is seen, and objects that stay hidden never are.
#[test]
fn hidden_objects_are_not_drawn_and_nothing_is_waited_for() {
    if gpu().is_none() {
        return;
    }
    let scene = SceneKind::City.make(4, 1);
    let model = Arc::new(scene.model.clone());
    let views = views(&scene, CameraPath::Walk, 600, (320, 200))[200..212].to_vec();
    let frustum = film(&model, None, &views, Algorithm::Frustum);
    let culled = film(&model, None, &views, Algorithm::TwoPass);
    assert_same(&frustum, &culled, "city");
    // Counts are those of the frame before: a picture was read back in between.
    for (frame, (a, b)) in frustum.iter().zip(&culled[1..]).enumerate().skip(2) {
        let (all, drawn) = (a.1.triangles_drawn, b.1.triangles_drawn);
        assert!(drawn > 0 && 3 * drawn < all, "frame {frame}: {drawn} of {all} triangles");
        let counters = b.1.culling.expect("culling was at work");
        assert_eq!(counters.triangles_drawn, drawn);
        assert!(counters.queries_issued > counters.leaves_drawn);
        assert!(counters.pulled_down < 40, "{} of a steady walk newly show", counters.pulled_down);
    }
    // A frame waits for nothing of its own.
    let own = Arc::new(Gpu::open().unwrap());
    let mut renderer = Renderer::on_gpu(own.clone(), RasterPath::Compute, 1 << 28).unwrap();
    renderer.set_model(model.clone());
    let before = own.waits();
    for view in &views {
        renderer.render(view, &settings(Algorithm::TwoPass)).unwrap();
    }
    assert_eq!(own.waits(), before);
}

/// The first frame draws nothing first and everything that nothing hides second; in a still view all
/// that was drawn is tested, so after two frames what is drawn is what shows.
#[test]
fn a_still_view_settles_to_what_shows() {
    if gpu().is_none() {
        return;
    }
    let scene = SceneKind::Boxes.make(3000, 1);
    let model = Arc::new(scene.model.clone());
    let view = views(&scene, CameraPath::Still, 1, (320, 200))[0];
    let mut renderer = renderer(&model, None);
    let mut counts = Vec::new();
    for frame in 0..5u32 {
        // Another background makes it another picture.
        let settings =
            FrameSettings { background: 0xff00_0000 | frame, ..settings(Algorithm::TwoPass) };
        let stats = renderer.render(&view, &settings).unwrap().clone();
        renderer.read_picture().unwrap();
        counts.push(stats.culling.expect("culling was at work"));
    }
    let objects: Vec<(u64, u64)> =
        counts[1..].iter().map(|frame| (frame.leaves_drawn, frame.pulled_down)).collect();
    let in_view = renderer.render(&view, &settings(Algorithm::Frustum)).unwrap().objects_drawn;
    let (first, settled) = (objects[0], objects[3]);
    // Boxes in the frustum may lie beside the picture, but nothing hides anything at first.
    assert!(first.0 <= u64::from(in_view) && 20 * first.0 > 19 * u64::from(in_view));
    assert_eq!(settled.1, 0, "nothing newly shows in a still view");
    assert_eq!(objects[2], settled);
    // The exact item buffer sees no object that was not drawn, and few were drawn that it does not
    // see: those whose boxes do.
    let mut truth = ItemBuffer::new(&view);
    for (object, id) in model.objects.iter().zip(0..) {
        let mesh = model.mesh(object);
        let place =
            |p: &[f32; 3]| object.world_from_mesh.transform_point3(glam::Vec3::from(*p).as_dvec3());
        truth.triangles(id, mesh.positions.iter().map(place), &mesh.triangles);
    }
    let seen = truth.visible_items().len() as u64;
    assert!(settled.0 >= seen && settled.0 < first.0, "{seen} seen: {objects:?}");
    assert!(settled.0 <= 2 * seen, "{seen} seen: {objects:?}");
}

/// Points are drawn first, so they hide objects; objects move; models are replaced.
#[test]
fn scenes_may_change() {
    if gpu().is_none() {
        return;
    }
    let scene = SceneKind::Window.make(60, 1);
    let model = Model { objects: scene.model.objects[1..].to_vec(), ..scene.model.clone() };
    let model = Arc::new(model);
    // A dense wall of points where the wall was.
    let step = 0.02;
    let lattice = Lattice { offset: DVec3::new(-30.0, -0.1, -5.0), scale: DVec3::splat(step) };
    let wall = (0..3000u32).flat_map(|x| (0..1500u32).map(move |z| (UVec3::new(x, 0, z), 0)));
    let cloud = Arc::new(MemoryCloud::new(lattice, 12, 3, &wall.collect::<Vec<_>>()));
    let view = views(&scene, CameraPath::Still, 1, (320, 200))[0];
    let mut renderers = [renderer(&model, Some(&cloud)), renderer(&model, Some(&cloud))];
    let mut compare = |change: &dyn Fn(&mut Renderer), what: &str| {
        let [expected, found] = [Algorithm::Frustum, Algorithm::TwoPass];
        let [a, b] = &mut renderers;
        change(a);
        change(b);
        let pictures = [shoot(a, &view, expected), shoot(b, &view, found)];
        assert_same(&pictures[..1], &pictures[1..], what);
        (pictures[0].1.clone(), pictures[1].1.clone())
    };
    compare(&|_| {}, "boxes behind points");
    let (all, culled) = compare(&|renderer| renderer.set_model(model.clone()), "made anew");
    assert!(all.objects_drawn >= 10 && 4 * culled.objects_drawn < all.objects_drawn);
    for frame in 0..4 {
        // Half-way it also turns inside out, which is another way to draw it.
        let side = if frame < 2 { 1.0 } else { -1.0 };
        let ahead = view.camera.forward * (6.0 - f64::from(frame));
        let place = DAffine3::from_translation(view.camera.eye + ahead)
            * DAffine3::from_scale(DVec3::new(side, 1.0, 1.0));
        compare(
            &|renderer| renderer.place_object(ObjectId(7), place),
            &format!("moved before the wall, {frame}"),
        );
    }
    let other = Arc::new(SceneKind::Boxes.make(40, 3).model);
    compare(&|renderer| renderer.set_model(other.clone()), "another model");
    compare(&|renderer| renderer.set_scene(Vec::new()), "without points");
    let nothing = Arc::new(Model::default());
    compare(&|renderer| renderer.set_model(nothing.clone()), "without models");
}

/// Depth first and colours afterwards, whatever culls: the same picture, and each object in two draws.
#[test]
fn shading_after_depth_gives_the_same_picture() {
    if gpu().is_none() {
        return;
    }
    let algorithms = [
        Algorithm::Frustum,
        Algorithm::Chc(ChcOptions { geometry_queries: true, ..ChcOptions::default() }),
        Algorithm::ChcPlus(ChcPlusOptions::default()),
        Algorithm::TwoPass,
    ];
    for (kind, size) in [(SceneKind::City, 2), (SceneKind::Rooms, 3), (SceneKind::Pipes, 3)] {
        let scene = kind.make(size, 1);
        let model = Arc::new(scene.model.clone());
        let views = views(&scene, CameraPath::Walk, 5, (320, 200));
        let expected = film(&model, None, &views, Algorithm::Frustum);
        for algorithm in algorithms {
            for answers in [CullingAnswers::Queries, CullingAnswers::Pyramid] {
                let mut renderer = renderer(&model, None);
                renderer.repeat_shading(3);
                let shoot = |view: &View| {
                    let depth_first = true;
                    let settings = FrameSettings { depth_first, answers, ..settings(algorithm) };
                    let stats = renderer.render(view, &settings).unwrap().clone();
                    (renderer.read_picture().unwrap().expect("a frame was drawn"), stats)
                };
                let found: Vec<_> = views.iter().map(shoot).collect();
                let what = format!("{}, {answers:?}, {}", kind.name(), algorithm.name());
                assert_same(&expected, &found, &what);
                if algorithm == Algorithm::Frustum {
                    let (once, twice) = (&expected[0].1, &found[0].1);
                    assert_eq!(twice.draw_calls, 2 * once.draw_calls, "{what}");
                    assert_eq!(twice.triangles_drawn, once.triangles_drawn);
                }
            }
        }
    }
}
