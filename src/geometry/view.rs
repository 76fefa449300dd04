//! A camera and its target: what every decision and every pass is told about the picture.
//!
//! World space is right-handed, f64. Camera space looks along -z with +y up. Clip space is
//! wgpu's (x right, y up, depth 0..w) with reversed z and the far plane at infinity: depth is
//! `near / distance`, 1 at the near plane and 0 far away.

use glam::{DMat3, DMat4, DVec3, DVec4};

/// A perspective camera in the world.
///
/// `forward` and `up` are unit and perpendicular; [`Camera::looking_at`] sees to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Where the eye is.
    pub eye: DVec3,
    /// Unit viewing direction.
    pub forward: DVec3,
    /// Unit direction that is up on screen.
    pub up: DVec3,
    /// Vertical field of view, radians, in (0, pi).
    pub fov_y_rad: f64,
    /// Distance of the near plane, above 0.
    pub near: f64,
}

impl Camera {
    /// A camera at `eye` that looks at `target`.
    ///
    /// If the direction is undefined (`eye` equals `target`) it looks along +y; if `up` is parallel
    /// to the direction another axis takes its place.
    pub fn looking_at(eye: DVec3, target: DVec3, up: DVec3, fov_y_rad: f64, near: f64) -> Self {
        let forward = (target - eye).try_normalize().unwrap_or(DVec3::Y);
        let side = [up, DVec3::Y, DVec3::X]
            .into_iter()
            .map(|candidate| forward.cross(candidate))
            .find(|side| side.length_squared() > 1e-12)
            .unwrap_or(DVec3::X)
            .normalize();
        Camera { eye, forward, up: side.cross(forward), fov_y_rad, near }
    }

    /// Unit direction that is right on screen.
    pub fn right(&self) -> DVec3 {
        self.forward.cross(self.up)
    }

    /// Rotation from world directions to camera directions (x right, y up, z backwards).
    pub fn camera_from_world_rotation(&self) -> DMat3 {
        DMat3::from_cols(self.right(), self.up, -self.forward).transpose()
    }
}

/// A camera and the size of its picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// The camera.
    pub camera: Camera,
    /// Width of the picture, pixels, at least 1.
    pub width_px: u32,
    /// Height of the picture, pixels, at least 1.
    pub height_px: u32,
}

impl View {
    /// Pixels that a length spans at as many lengths' distance on the image axis.
    pub fn focal_px(&self) -> f64 {
        f64::from(self.height_px) / (2.0 * (0.5 * self.camera.fov_y_rad).tan())
    }

    /// Width over height.
    pub fn aspect(&self) -> f64 {
        f64::from(self.width_px) / f64::from(self.height_px)
    }

    /// Clip space from camera space: reversed z, far plane at infinity.
    pub fn clip_from_camera(&self) -> DMat4 {
        let f = 1.0 / (0.5 * self.camera.fov_y_rad).tan();
        DMat4::from_cols(
            DVec4::new(f / self.aspect(), 0.0, 0.0, 0.0),
            DVec4::new(0.0, f, 0.0, 0.0),
            DVec4::new(0.0, 0.0, 0.0, -1.0),
            DVec4::new(0.0, 0.0, self.camera.near, 0.0),
        )
    }

    /// Clip space from positions relative to the eye, in world axes.
    pub fn clip_from_eye_relative(&self) -> DMat4 {
        self.clip_from_camera() * DMat4::from_mat3(self.camera.camera_from_world_rotation())
    }

    /// Clip space from the world. Exact enough for decisions in f64; drawing goes through
    /// eye-relative positions instead.
    pub fn clip_from_world(&self) -> DMat4 {
        self.clip_from_eye_relative() * DMat4::from_translation(-self.camera.eye)
    }

    /// Pixel (x right, y down; the first pixel covers 0..1) and distance along the viewing
    /// direction of a world position; `None` if it lies before the near plane.
    pub fn project(&self, world: DVec3) -> Option<(f64, f64, f64)> {
        let clip = self.clip_from_eye_relative() * (world - self.camera.eye).extend(1.0);
        (clip.w >= self.camera.near).then(|| {
            let x = (clip.x / clip.w * 0.5 + 0.5) * f64::from(self.width_px);
            let y = (0.5 - clip.y / clip.w * 0.5) * f64::from(self.height_px);
            (x, y, clip.w)
        })
    }

    /// World position at a place of the picture and a distance along the viewing direction; the
    /// inverse of [`project`](Self::project).
    pub fn unproject(&self, x_px: f64, y_px: f64, distance: f64) -> DVec3 {
        let camera = &self.camera;
        let right = (x_px - 0.5 * f64::from(self.width_px)) / self.focal_px();
        let up = (0.5 * f64::from(self.height_px) - y_px) / self.focal_px();
        camera.eye + (camera.forward + camera.right() * right + camera.up * up) * distance
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> View {
        let camera = Camera::looking_at(
            DVec3::new(10.0, 20.0, 30.0),
            DVec3::new(10.0, 120.0, 30.0),
            DVec3::Z,
            60f64.to_radians(),
            0.1,
        );
        View { camera, width_px: 640, height_px: 480 }
    }

    #[test]
    fn the_image_axis_meets_the_middle_of_the_picture() {
        let (x, y, w) = view().project(DVec3::new(10.0, 70.0, 30.0)).expect("in front");
        assert!((x - 320.0).abs() < 1e-9 && (y - 240.0).abs() < 1e-9 && (w - 50.0).abs() < 1e-9);
    }

    #[test]
    fn a_length_spans_focal_px_over_distance() {
        let v = view();
        let (x, _, _) = v.project(DVec3::new(11.0, 70.0, 30.0)).expect("in front");
        assert!((x - 320.0 - v.focal_px() / 50.0).abs() < 1e-9, "right is +x here");
        let (_, y, _) = v.project(DVec3::new(10.0, 70.0, 31.0)).expect("in front");
        assert!((240.0 - y - v.focal_px() / 50.0).abs() < 1e-9, "up is up");
    }

    #[test]
    fn unprojecting_undoes_projecting() {
        let v = view();
        let world = DVec3::new(13.0, 71.0, 25.0);
        let (x, y, distance) = v.project(world).expect("in front");
        assert!((v.unproject(x, y, distance) - world).length() < 1e-9);
    }

    #[test]
    fn depth_is_reversed() {
        let v = view();
        let at = |d: f64| {
            let clip = v.clip_from_world() * DVec4::new(10.0, 20.0 + d, 30.0, 1.0);
            clip.z / clip.w
        };
        assert!((at(0.1) - 1.0).abs() < 1e-9 && (at(100.0) - 0.001).abs() < 1e-9);
    }

    #[test]
    fn parallel_up_and_equal_target_still_give_a_frame() {
        for (target, up) in [(DVec3::Z, DVec3::Z), (DVec3::ZERO, DVec3::Z)] {
            let c = Camera::looking_at(DVec3::ZERO, target, up, 1.0, 0.1);
            assert!((c.forward.length() - 1.0).abs() < 1e-12 && c.up.dot(c.forward).abs() < 1e-12);
            assert!((c.up.length() - 1.0).abs() < 1e-12);
        }
    }
}
