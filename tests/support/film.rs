//! Pictures of a made scene along a path, with what each frame did.

use std::sync::Arc;

use esker::frame::{FrameSettings, FrameStats, NodeSource, RasterPath, Renderer};
use esker::geometry::View;
use esker::mesh::Model;
use esker::mesh::scenes::{CameraPath, ModelScene, camera_path};
use esker::passes::Picture;
use esker::visibility::Algorithm;

use crate::device::gpu;
use crate::memory_cloud::MemoryCloud;

pub fn views(scene: &ModelScene, path: CameraPath, frames: u32, size: (u32, u32)) -> Vec<View> {
    let view = |camera| View { camera, width_px: size.0, height_px: size.1 };
    camera_path(scene, path, frames).into_iter().map(view).collect()
}

pub fn settings(culling: Algorithm) -> FrameSettings {
    FrameSettings { culling, ..FrameSettings::default() }
}

pub fn renderer(model: &Arc<Model>, cloud: Option<&Arc<MemoryCloud>>) -> Renderer {
    let gpu = gpu().expect("asked before");
    let mut renderer = Renderer::on_gpu(gpu, RasterPath::Compute, 1 << 28).unwrap();
    renderer
        .set_scene(cloud.map(|cloud| cloud.clone() as Arc<dyn NodeSource>).into_iter().collect());
    renderer.set_model(model.clone());
    renderer
}

pub fn shoot(renderer: &mut Renderer, view: &View, culling: Algorithm) -> (Picture, FrameStats) {
    let stats = renderer.render(view, &settings(culling)).unwrap().clone();
    (renderer.read_picture().unwrap().expect("a frame was drawn"), stats)
}

pub fn film(
    model: &Arc<Model>,
    cloud: Option<&Arc<MemoryCloud>>,
    views: &[View],
    culling: Algorithm,
) -> Vec<(Picture, FrameStats)> {
    let mut renderer = renderer(model, cloud);
    views.iter().map(|view| shoot(&mut renderer, view, culling)).collect()
}

/// Panics where two films differ in a colour or a depth.
pub fn assert_same(
    expected: &[(Picture, FrameStats)],
    found: &[(Picture, FrameStats)],
    what: &str,
) {
    assert_eq!(expected.len(), found.len(), "{what}");
    for (frame, (a, b)) in expected.iter().zip(found).enumerate() {
        let colors = a.0.colors.iter().zip(&b.0.colors).filter(|(a, b)| a != b).count();
        let depths = a.0.distances.iter().zip(&b.0.distances).filter(|(a, b)| a != b).count();
        assert_eq!((colors, depths), (0, 0), "{what}, frame {frame}");
    }
}
