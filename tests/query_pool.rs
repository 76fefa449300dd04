//! The pool of questions: more than a pass can hold, answers older than a frame, a device that is lost;
//! with occlusion queries and with a depth pyramid.
#![cfg(feature = "gpu")]

#[path = "support/device.rs"]
mod device;
#[path = "support/occlusion_stage.rs"]
mod stage;

use std::sync::Arc;

use device::gpu;
use esker::frame::{FrameError, FrameSettings, RasterPath, Renderer};
use esker::geometry::Aabb;
use esker::gpu::Gpu;
use esker::mesh::scenes::{CameraPath, SceneKind};
use esker::passes::OcclusionQueries;
use esker::visibility::{Algorithm, Answer, ChcPlusOptions, OcclusionDevice};
use stage::{Stage, leaves_of, views};

fn pools(gpu: &Gpu) -> [OcclusionQueries; 2] {
    [OcclusionQueries::new(gpu).unwrap(), OcclusionQueries::by_pyramid(gpu).unwrap()]
}

/// More questions than one pass of queries, or one piece of memory for answers, can hold.
#[test]
fn thousands_of_questions_in_one_round_are_answered_each() {
    let Some(gpu) = gpu() else { return };
    let scene = SceneKind::Window.make(20, 1);
    let view = views(&scene, CameraPath::Still, 1, (160, 100))[0];
    let mut stage = Stage::new(&gpu, &scene, view);
    let leaves = leaves_of(&stage.tree);
    let camera = view.camera;
    // Thin boxes right before the eye show, those far behind the ground and wall beside do not:
    // beside the picture nothing shows.
    let at = |ahead: f64, right: f64| {
        let middle = camera.eye + camera.forward * ahead + camera.right() * right;
        vec![Aabb::new(middle - 0.01, middle + 0.01)]
    };
    let shows = |number: usize| number % 7 == 3;
    let asked: Vec<Vec<Aabb>> = (0..20_000)
        .map(|number| if shows(number) { at(0.5, 0.0) } else { at(5.0, 500.0) })
        .collect();
    for mut queries in
        [OcclusionQueries::new(&gpu).unwrap(), OcclusionQueries::by_pyramid(&gpu).unwrap()]
    {
        let answers = stage.ask(&mut queries, &leaves, &asked);
        let wrong = answers.iter().enumerate().filter(|(number, seen)| **seen != shows(*number));
        assert_eq!(wrong.count(), 0, "by pyramid: {}", queries.is_by_pyramid());
    }
}

/// Answers are kept until the end of the next frame and forgotten then; what was asked and never
/// waited for arrives in the next frame by itself.
#[test]
fn answers_older_than_a_frame_are_forgotten() {
    let Some(gpu) = gpu() else { return };
    let scene = SceneKind::Window.make(20, 1);
    let view = views(&scene, CameraPath::Still, 1, (64, 40))[0];
    let mut stage = Stage::new(&gpu, &scene, view);
    let ahead = view.camera.eye + view.camera.forward * 0.5;
    let bounds = Aabb::new(ahead - 0.01, ahead + 0.01);
    for mut queries in pools(&gpu) {
        let by_pyramid = queries.is_by_pyramid();
        let mut device = stage.device(&mut queries);
        let first = device.query(&[bounds]);
        assert_eq!(device.answer(first), Answer::Unknown);
        device.end_frame();
        device.finish().unwrap();
        gpu.wait().unwrap();
        let mut device = stage.device(&mut queries);
        // Another test's thread may be about to hand it in.
        device.wait(first);
        assert_eq!(device.answer(first), Answer::Samples(1), "by pyramid: {by_pyramid}");
        let second = device.query(&[bounds]);
        assert_ne!(first, second);
        device.end_frame();
        device.finish().unwrap();
        let mut device = stage.device(&mut queries);
        assert_eq!(device.answer(first), Answer::Unknown, "by pyramid: {by_pyramid}");
        device.wait(second);
        assert_eq!(device.answer(second), Answer::Samples(1), "by pyramid: {by_pyramid}");
        device.end_frame();
        device.finish().unwrap();
    }
}

/// A device that goes away in the middle of a frame leaves questions without an answer, which count
/// as visible, and an error; nothing hangs.
#[test]
fn a_lost_device_is_an_error() {
    if gpu().is_none() {
        return;
    }
    let scene = SceneKind::Window.make(20, 1);
    let view = views(&scene, CameraPath::Still, 1, (64, 40))[0];
    for at in 0..2 {
        let own = Arc::new(Gpu::open().unwrap());
        let mut stage = Stage::new(&own, &scene, view);
        let leaves = leaves_of(&stage.tree);
        let mut queries = pools(&own).into_iter().nth(at).expect("there are two");
        let mut device = stage.device(&mut queries);
        leaves.iter().for_each(|&leaf| device.draw(leaf));
        let asked = device.query(&[Aabb::new(view.camera.eye, view.camera.eye + 1.0)]);
        own.device().destroy();
        device.wait(asked);
        assert_eq!(device.answer(asked), Answer::Unknown);
        device.end_frame();
        assert!(device.finish().is_err());
    }
    for culling in [Algorithm::ChcPlus(ChcPlusOptions::default()), Algorithm::TwoPass] {
        let own = Arc::new(Gpu::open().unwrap());
        let mut renderer = Renderer::on_gpu(own.clone(), RasterPath::Compute, 1 << 28).unwrap();
        renderer.set_model(Arc::new(scene.model.clone()));
        let settings = FrameSettings { culling, ..FrameSettings::default() };
        renderer.render(&view, &settings).unwrap();
        own.device().destroy();
        let other = FrameSettings { background: 1, ..settings };
        let after = renderer.render(&view, &other);
        assert!(matches!(after, Err(FrameError::Gpu(_))), "{}", culling.name());
    }
}
