//! Camera paths through a scene: walking, flying, rising above the roofs, turning, jumping.

use glam::{DQuat, DVec3};

use super::ModelScene;
use crate::geometry::Camera;
use crate::sampling::Random;

/// How the camera moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum CameraPath {
    /// Along the scene's walk at eye height, looking ahead, with a glance to the sides.
    Walk,
    /// High over everything, looking down at a slant.
    Fly,
    /// From the walk's middle straight up above the roofs.
    Rise,
    /// Standing in the walk's middle, turning 60 degrees left and right.
    Rotate,
    /// Another place and direction in every frame.
    Teleport,
    /// Standing still.
    Still,
}

impl CameraPath {
    /// All paths.
    pub const ALL: [CameraPath; 6] = [
        CameraPath::Walk,
        CameraPath::Fly,
        CameraPath::Rise,
        CameraPath::Rotate,
        CameraPath::Teleport,
        CameraPath::Still,
    ];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            CameraPath::Walk => "walk",
            CameraPath::Fly => "fly",
            CameraPath::Rise => "rise",
            CameraPath::Rotate => "rotate",
            CameraPath::Teleport => "teleport",
            CameraPath::Still => "still",
        }
    }
}

/// The place a share (0..1) along a line of places, by length.
fn along(places: &[DVec3], share: f64) -> DVec3 {
    let lengths: Vec<f64> = places.windows(2).map(|pair| pair[0].distance(pair[1])).collect();
    let mut left = share.clamp(0.0, 1.0) * lengths.iter().sum::<f64>();
    for (pair, length) in places.windows(2).zip(&lengths) {
        if left <= *length {
            return pair[0].lerp(pair[1], if *length > 0.0 { left / length } else { 0.0 });
        }
        left -= length;
    }
    places.last().copied().unwrap_or(DVec3::ZERO)
}

/// The camera of every frame, 60 degrees high.
pub fn camera_path(scene: &ModelScene, path: CameraPath, frames: u32) -> Vec<Camera> {
    let bounds = scene.model.bounds();
    let size = bounds.diagonal().max(1e-3);
    let fov = 60f64.to_radians();
    let near = 1e-4 * size.clamp(1.0, 1000.0) + 0.05;
    let looking = |eye: DVec3, target: DVec3| Camera::looking_at(eye, target, DVec3::Z, fov, near);
    let length: f64 = scene.walk.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
    let ahead = (0.02 * size / length.max(1e-9)).min(0.1);
    let walking = |share: f64, turn: f64| {
        let eye = along(&scene.walk, share);
        let back = along(&scene.walk, (share - ahead).max(0.0));
        let forth = along(&scene.walk, (share + ahead).min(1.0));
        let forward = (forth - back).try_normalize().unwrap_or(DVec3::Y);
        looking(eye, eye + DQuat::from_rotation_z(turn) * forward)
    };
    let share = |frame: u32| f64::from(frame) / f64::from(frames.saturating_sub(1).max(1));
    let one = |frame: u32| -> Camera {
        let t = share(frame);
        match path {
            CameraPath::Walk => walking(t, 0.5 * (t * 9.0).sin()),
            CameraPath::Fly => {
                let low = bounds.min.truncate().extend(scene.roof + 0.05 * size);
                let high = bounds.max.truncate().extend(scene.roof + 0.05 * size);
                let eye = low.lerp(high, 0.1 + 0.6 * t);
                looking(eye, eye + (high - low).normalize_or(DVec3::X) - DVec3::Z * 0.7)
            }
            CameraPath::Rise => {
                let start = walking(0.4, 0.0);
                let above = scene.roof + 0.15 * size - start.eye.z;
                let eye = start.eye + DVec3::Z * above * t * t;
                looking(eye, eye + start.forward - DVec3::Z * 0.9 * t)
            }
            CameraPath::Rotate => {
                let turn = 60f64.to_radians() * (t * 4.0 * std::f64::consts::TAU).sin();
                walking(0.5, turn)
            }
            CameraPath::Teleport => {
                let mut random = Random::new(0x7e1e, u64::from(frame));
                walking(random.unit(), random.between(-3.0, 3.0))
            }
            CameraPath::Still => walking(0.3, 0.0),
        }
    };
    (0..frames).map(one).collect()
}
