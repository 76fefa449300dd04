//! From mouse and keys to a camera: orbit, pan, zoom, look around, fly.
//!
//! Pure arithmetic, without a window: what lies under the cursor comes in as a point, or as
//! "nothing", and then the pivot of the last movement answers. A drag is computed from where it
//! began, never from the step before, so that nothing drifts.
//!
//! World space, f64, z up; the horizon stays level whatever is done. Pixels are of the picture, x
//! right, y down, the first one covering 0..1; angles are radians.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DVec2, DVec3};

use crate::geometry::{Aabb, Camera, View, ViewPreset};

/// What a drag does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DragKind {
    /// Turns the camera around the point under the cursor.
    Orbit,
    /// Moves the camera so that the point under the cursor stays there.
    Pan,
    /// Turns the camera where it stands.
    Look,
}

/// Where the eye is and where it looks. Level by construction: there is no roll.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pose {
    eye: DVec3,
    /// Compass direction: 0 is +y, growing towards +x.
    yaw_rad: f64,
    /// Above the horizon, -pi/2..=pi/2.
    pitch_rad: f64,
}

/// A drag in progress.
#[derive(Clone, Copy, Debug)]
struct Drag {
    kind: DragKind,
    /// The pose when it began.
    from: Pose,
    /// Where it began, pixels.
    cursor: DVec2,
    /// The point held.
    held: DVec3,
}

/// A camera that is moved by hand.
#[derive(Clone, Debug)]
pub struct CameraControl {
    pose: Pose,
    near: f64,
    bounds: Aabb,
    pivot: DVec3,
    drag: Option<Drag>,
    fly_factor: f64,
}

/// Vertical field of view.
const FOV_Y_RAD: f64 = PI / 3.0;
/// What a notch of the wheel leaves of the distance.
const ZOOM_PER_NOTCH: f64 = 0.82;
/// What a notch of the wheel does to the speed of flight.
const SPEED_PER_NOTCH: f64 = 1.25;
/// Flight across the scene's diagonal takes as many seconds.
const FLIGHT_SECONDS: f64 = 12.0;
/// Farthest that zooming takes the eye from the middle of the scene, in diagonals.
const FARTHEST_DIAGONALS: f64 = 50.0;

impl Pose {
    fn of(camera: &Camera) -> Pose {
        let forward = camera.forward;
        // Looking straight up or down, the top of the screen tells the compass direction.
        let level = if forward.z.abs() > 1.0 - 1e-12 { camera.up } else { forward };
        Pose {
            eye: camera.eye,
            yaw_rad: level.x.atan2(level.y),
            pitch_rad: forward.z.clamp(-1.0, 1.0).asin(),
        }
    }

    /// Unit directions: right, forward, up.
    fn axes(&self) -> [DVec3; 3] {
        let (sin_yaw, cos_yaw) = self.yaw_rad.sin_cos();
        let (sin_pitch, cos_pitch) = self.pitch_rad.sin_cos();
        let right = DVec3::new(cos_yaw, -sin_yaw, 0.0);
        let forward = DVec3::new(cos_pitch * sin_yaw, cos_pitch * cos_yaw, sin_pitch);
        [right, forward, right.cross(forward)]
    }

    fn turned(&self, yaw_rad: f64, pitch_rad: f64) -> Pose {
        Pose {
            eye: self.eye,
            yaw_rad: (self.yaw_rad + yaw_rad).rem_euclid(2.0 * PI),
            pitch_rad: (self.pitch_rad + pitch_rad).clamp(-FRAC_PI_2, FRAC_PI_2),
        }
    }

    /// Turned as a rigid body around a point, which therefore keeps its place on screen.
    fn turned_around(&self, pivot: DVec3, yaw_rad: f64, pitch_rad: f64) -> Pose {
        let turned = self.turned(yaw_rad, pitch_rad);
        let offset = self.eye - pivot;
        let [from, to] = [self.axes(), turned.axes()];
        let eye = pivot + (0..3).map(|i| to[i] * from[i].dot(offset)).sum::<DVec3>();
        Pose { eye, ..turned }
    }
}

impl CameraControl {
    /// A camera that sees all of a scene.
    pub fn new(bounds: &Aabb, preset: ViewPreset, aspect: f64) -> Self {
        let camera = Camera::framing(bounds, preset, FOV_Y_RAD, aspect);
        let center = if bounds.is_empty() { DVec3::ZERO } else { bounds.center() };
        CameraControl {
            pose: Pose::of(&camera),
            near: camera.near,
            bounds: *bounds,
            pivot: center,
            drag: None,
            fly_factor: 1.0,
        }
    }

    /// Goes to a preset's view of the whole scene.
    pub fn show(&mut self, preset: ViewPreset, aspect: f64) {
        self.show_part(&self.bounds.clone(), preset, aspect);
    }

    /// Goes to a preset's view of a part of the scene.
    pub fn show_part(&mut self, part: &Aabb, preset: ViewPreset, aspect: f64) {
        let shown = CameraControl::new(part, preset, aspect);
        self.pose = shown.pose;
        self.pivot = shown.pivot;
        self.drag = None;
    }

    /// Goes to where a camera stands, as far as it is level; what it looks at is turned around.
    pub fn go_to(&mut self, camera: &Camera, target: DVec3) {
        self.pose = Pose::of(camera);
        self.pivot = target;
        self.drag = None;
    }

    /// Takes another scene's size; the camera stays where it is.
    pub fn set_bounds(&mut self, bounds: &Aabb) {
        self.bounds = *bounds;
        self.near = Camera::near_for(bounds);
    }

    /// The camera.
    pub fn camera(&self) -> Camera {
        let [_, forward, up] = self.pose.axes();
        Camera { eye: self.pose.eye, forward, up, fov_y_rad: FOV_Y_RAD, near: self.near }
    }

    /// The camera with its picture.
    pub fn view(&self, width_px: u32, height_px: u32) -> View {
        View { camera: self.camera(), width_px, height_px }
    }

    /// The point that orbiting turns around where nothing is under the cursor.
    pub fn pivot(&self) -> DVec3 {
        self.pivot
    }

    /// Speed of flight, world units per second.
    pub fn speed(&self) -> f64 {
        let diagonal = self.bounds.diagonal();
        self.fly_factor * if diagonal > 0.0 { diagonal } else { 1.0 } / FLIGHT_SECONDS
    }

    /// Whether a drag is going on.
    pub fn is_dragging(&self) -> bool {
        self.drag.is_some()
    }

    /// Begins a drag at a place of the picture, with the scene's point that was found there.
    pub fn begin_drag(
        &mut self,
        kind: DragKind,
        cursor: DVec2,
        under_cursor: Option<DVec3>,
        view: &View,
    ) {
        let held = match kind {
            // Off the scene it turns around what it turned around before.
            DragKind::Orbit => under_cursor
                .or_else(|| self.is_in_front(self.pivot).then_some(self.pivot))
                .unwrap_or_else(|| {
                    self.supposed_point(
                        DVec2::new(0.5 * f64::from(view.width_px), 0.5 * f64::from(view.height_px)),
                        view,
                    )
                }),
            DragKind::Pan => under_cursor.unwrap_or_else(|| self.supposed_point(cursor, view)),
            DragKind::Look => self.pivot,
        };
        self.pivot = held;
        self.drag = Some(Drag { kind, from: self.pose, cursor, held });
    }

    /// Goes on with the drag to a place of the picture; nothing without a drag.
    pub fn drag_to(&mut self, cursor: DVec2, view: &View) {
        let Some(drag) = self.drag else { return };
        let moved = cursor - drag.cursor;
        match drag.kind {
            DragKind::Orbit => {
                let turn = moved * (PI / f64::from(view.height_px));
                self.pose = drag.from.turned_around(drag.held, turn.x, -turn.y);
            }
            DragKind::Pan => {
                self.pose = drag.from;
                let distance = self.distance_of(drag.held);
                let view = View { camera: self.camera(), ..*view };
                let there = view.unproject(cursor.x, cursor.y, distance);
                self.pose.eye = drag.from.eye + (drag.held - there);
            }
            DragKind::Look => {
                let turn = moved / view.focal_px();
                self.pose = drag.from.turned(turn.x, -turn.y);
            }
        }
    }

    /// Ends the drag.
    pub fn end_drag(&mut self) {
        self.drag = None;
    }

    /// Zooms by notches of the wheel, in if positive, towards the point under the cursor, which
    /// stays there. Ends just before the point, and far outside of the scene.
    pub fn zoom(&mut self, notches: f64, cursor: DVec2, under_cursor: Option<DVec3>, view: &View) {
        let target = under_cursor.unwrap_or_else(|| self.supposed_point(cursor, view));
        let offset = self.pose.eye - target;
        let distance = offset.length();
        let closest = 10.0 * self.near;
        let mut factor = ZOOM_PER_NOTCH.powf(notches);
        if factor < 1.0 {
            if distance <= closest {
                return;
            }
            factor = factor.max(closest / distance);
        }
        let eye = target + offset * factor;
        let middle = self.middle();
        let away = eye.distance(middle);
        let farthest = FARTHEST_DIAGONALS * self.bounds.diagonal().max(self.near);
        if factor > 1.0 && away > farthest && away > self.pose.eye.distance(middle) {
            return;
        }
        self.pose.eye = eye;
        self.pivot = target;
        // A drag that goes on holds what it held, from here.
        if let Some(drag) = &mut self.drag {
            *drag = Drag { from: self.pose, cursor, ..*drag };
        }
    }

    /// Flies for a time. `direction` counts right, forward and up, each -1..=1; forward is where
    /// the camera looks, up is the world's.
    pub fn fly(&mut self, direction: DVec3, boost: f64, seconds: f64) {
        let [right, forward, _] = self.pose.axes();
        let way = right * direction.x + forward * direction.y + DVec3::Z * direction.z;
        let step = way.clamp_length_max(1.0) * (self.speed() * boost * seconds);
        self.pose.eye += step;
        if let Some(drag) = &mut self.drag {
            drag.from.eye += step;
        }
    }

    /// Flies faster by notches of the wheel, slower if negative.
    pub fn change_speed(&mut self, notches: f64) {
        self.fly_factor = (self.fly_factor * SPEED_PER_NOTCH.powf(notches)).clamp(1e-3, 1e3);
    }

    fn middle(&self) -> DVec3 {
        if self.bounds.is_empty() { DVec3::ZERO } else { self.bounds.center() }
    }

    /// Distance along the viewing direction.
    fn distance_of(&self, point: DVec3) -> f64 {
        let [_, forward, _] = self.pose.axes();
        forward.dot(point - self.pose.eye)
    }

    fn is_in_front(&self, point: DVec3) -> bool {
        self.distance_of(point) > 2.0 * self.near
    }

    /// Stands for the point under the cursor where there is none: as far away as the pivot, else
    /// the middle of the scene, else a tenth of the scene's size.
    fn supposed_point(&self, cursor: DVec2, view: &View) -> DVec3 {
        let distance = [self.pivot, self.middle()]
            .into_iter()
            .find(|&point| self.is_in_front(point))
            .map_or_else(
                || (0.1 * self.bounds.diagonal()).max(10.0 * self.near),
                |point| self.distance_of(point),
            );
        View { camera: self.camera(), ..*view }.unproject(cursor.x, cursor.y, distance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const UTM: DVec3 = DVec3::new(635_577.79, 4_848_882.15, 406.14);

    fn control_at(origin: DVec3) -> CameraControl {
        let bounds = Aabb::new(origin, origin + DVec3::new(800.0, 600.0, 90.0));
        CameraControl::new(&bounds, ViewPreset::Iso, 16.0 / 9.0)
    }

    fn view_of(control: &CameraControl) -> View {
        control.view(1280, 720)
    }

    /// A point of the scene and its pixel.
    fn target(control: &CameraControl) -> (DVec3, DVec2) {
        let point = control.bounds.min + DVec3::new(512.25, 130.5, 33.125);
        let (x, y, _) = view_of(control).project(point).expect("in front");
        (point, DVec2::new(x, y))
    }

    fn pixel(control: &CameraControl, point: DVec3) -> DVec2 {
        let (x, y, _) = view_of(control).project(point).expect("in front");
        DVec2::new(x, y)
    }

    fn is_level(control: &CameraControl) -> bool {
        let camera = control.camera();
        camera.right().z.abs() < 1e-15 && camera.up.z >= -1e-15
    }

    #[test]
    fn a_grabbed_point_stays_under_the_cursor() {
        for origin in [DVec3::ZERO, UTM, DVec3::new(-2e7, 3e7, 1e6)] {
            let mut control = control_at(origin);
            let (point, start) = target(&control);
            let view = view_of(&control);
            control.begin_drag(DragKind::Pan, start, Some(point), &view);
            for to in [(700.0, 300.0), (11.0, 719.0), (640.5, 360.5)] {
                control.drag_to(to.into(), &view);
                let off = pixel(&control, point).distance(to.into());
                assert!(off < 1e-4, "{off} px off at {origin}");
            }
            control.drag_to(start, &view);
            let off = control.pose.eye.distance(control_at(origin).pose.eye);
            assert!(off < 1e-7, "there and back again is {off} away");
        }
    }

    #[test]
    fn zooming_keeps_the_point_under_the_cursor() {
        for origin in [DVec3::ZERO, UTM] {
            let mut control = control_at(origin);
            let (point, cursor) = target(&control);
            let before = control.pose.eye.distance(point);
            // Far enough that the steps of f64 at such coordinates stay under a tenth of a pixel.
            for _ in 0..40 {
                let view = view_of(&control);
                control.zoom(1.0, cursor, Some(point), &view);
                let off = pixel(&control, point).distance(cursor);
                assert!(off < 0.1, "{off} px off");
            }
            let after = control.pose.eye.distance(point);
            let wanted = before * ZOOM_PER_NOTCH.powi(40);
            assert!((after / wanted - 1.0).abs() < 1e-6, "{after} is not {wanted}");
            for _ in 0..40 {
                let view = view_of(&control);
                control.zoom(-1.0, cursor, Some(point), &view);
            }
            // A rounding of the nearest eye grows with the way out.
            assert!((control.pose.eye.distance(point) - before).abs() < 1e-8 * before);
        }
    }

    #[test]
    fn zooming_ends_before_the_point_and_far_outside() {
        let mut control = control_at(UTM);
        let (point, cursor) = target(&control);
        let view = view_of(&control);
        (0..2000).for_each(|_| control.zoom(1.0, cursor, Some(point), &view));
        let closest = control.pose.eye.distance(point);
        assert!(closest >= 9.9 * control.near && closest < 11.0 * control.near, "{closest}");
        (0..2000).for_each(|_| control.zoom(-1.0, cursor, Some(point), &view));
        let away = control.pose.eye.distance(control.middle());
        assert!(away <= FARTHEST_DIAGONALS * control.bounds.diagonal());
    }

    #[test]
    fn orbiting_keeps_the_distance_the_pixel_and_the_horizon() {
        for origin in [DVec3::ZERO, UTM] {
            let mut control = control_at(origin);
            let (point, cursor) = target(&control);
            let view = view_of(&control);
            let before = control.pose.eye.distance(point);
            control.begin_drag(DragKind::Orbit, cursor, Some(point), &view);
            for i in 0..200 {
                let by = DVec2::new(f64::from(i) * 37.0 - 900.0, f64::from(i % 17) * 80.0 - 600.0);
                control.drag_to(cursor + by, &view);
                let error = (control.pose.eye.distance(point) - before).abs();
                assert!(error < 1e-8, "{error} off");
                assert!(pixel(&control, point).distance(cursor) < 1e-4);
                assert!(is_level(&control));
            }
            assert_eq!(control.pivot(), point);
        }
    }

    #[test]
    fn orbiting_follows_the_hand() {
        // From the south: dragging right takes the eye west, dragging down takes it up.
        let mut control = control_at(DVec3::ZERO);
        control.show(ViewPreset::Front, 1.0);
        let view = view_of(&control);
        let (pivot, eye) = (control.pivot(), control.pose.eye);
        control.begin_drag(DragKind::Orbit, DVec2::new(640.0, 360.0), Some(pivot), &view);
        control.drag_to(DVec2::new(740.0, 460.0), &view);
        assert!(control.pose.eye.x < eye.x && control.pose.eye.z > eye.z);
        // Straight down is as far as it goes.
        control.drag_to(DVec2::new(640.0, 5000.0), &view);
        assert_eq!(control.pose.pitch_rad, -FRAC_PI_2);
        assert!(is_level(&control));
    }

    #[test]
    fn off_the_scene_the_last_pivot_answers() {
        let mut control = control_at(UTM);
        let (point, cursor) = target(&control);
        let view = view_of(&control);
        control.begin_drag(DragKind::Orbit, cursor, Some(point), &view);
        control.end_drag();
        control.begin_drag(DragKind::Orbit, DVec2::new(3.0, 3.0), None, &view);
        assert_eq!(control.pivot(), point);
        control.end_drag();
        // Panning takes the pivot's distance instead of its place.
        let corner = DVec2::new(3.0, 3.0);
        control.begin_drag(DragKind::Pan, corner, None, &view);
        let held = control.pivot();
        assert!((control.distance_of(held) - control.distance_of(point)).abs() < 1e-6);
        assert!(pixel(&control, held).distance(corner) < 1e-4);
        control.end_drag();
        // Behind the eye it does not count.
        control.pose = control.pose.turned(PI, 0.0);
        control.begin_drag(DragKind::Orbit, cursor, None, &view);
        assert!(control.is_in_front(control.pivot()));
    }

    #[test]
    fn flying_goes_where_one_looks_at_the_stated_speed() {
        let mut control = control_at(UTM);
        let start = control.pose.eye;
        let forward = control.camera().forward;
        control.fly(DVec3::new(0.0, 1.0, 0.0), 1.0, 0.5);
        let moved = control.pose.eye - start;
        assert!((moved - forward * control.speed() * 0.5).length() < 1e-6);
        control.fly(DVec3::new(0.0, -1.0, 0.0), 1.0, 0.5);
        control.fly(DVec3::new(0.0, 0.0, 1.0), 4.0, 1.0);
        let risen = control.pose.eye - start;
        assert!((risen - DVec3::Z * control.speed() * 4.0).length() < 1e-6);
        let (slow, scene) = (control.speed(), control.bounds.diagonal());
        assert!((slow * FLIGHT_SECONDS - scene).abs() < 1e-9 * scene);
        control.change_speed(2.0);
        assert!((control.speed() / slow - SPEED_PER_NOTCH.powi(2)).abs() < 1e-12);
        // Two keys at once are not faster than one.
        let before = control.pose.eye;
        control.fly(DVec3::new(1.0, 1.0, 0.0), 1.0, 1.0);
        assert!(control.pose.eye.distance(before) <= control.speed() * (1.0 + 1e-9));
    }

    #[test]
    fn looking_turns_on_the_spot_even_while_flying() {
        let mut control = control_at(UTM);
        let start = control.pose;
        let view = view_of(&control);
        control.begin_drag(DragKind::Look, DVec2::new(600.0, 300.0), None, &view);
        control.drag_to(DVec2::new(700.0, 300.0), &view);
        assert_eq!(control.pose.eye, start.eye);
        let turned = control.pose.yaw_rad - start.yaw_rad;
        assert!((turned - 100.0 / view.focal_px()).abs() < 1e-12, "right is right: {turned}");
        control.fly(DVec3::new(0.0, 1.0, 0.0), 1.0, 1.0);
        let flown = control.pose.eye;
        control.drag_to(DVec2::new(650.0, 200.0), &view);
        assert_eq!(control.pose.eye, flown, "the drag does not undo the flight");
        assert!(control.pose.pitch_rad > start.pitch_rad, "up is up");
    }

    #[test]
    fn a_part_of_the_scene_fills_the_picture() {
        let mut control = control_at(UTM);
        let part = Aabb::new(UTM + 50.0, UTM + 60.0);
        control.show_part(&part, ViewPreset::Top, 16.0 / 9.0);
        assert_eq!(control.pivot(), part.center());
        let corners = [part.min, part.max].map(|corner| pixel(&control, corner));
        assert!(corners.iter().all(|at| at.cmpge(DVec2::ZERO).all() && at.y < 720.0));
        assert!((corners[0].y - corners[1].y).abs() > 0.6 * 720.0, "{corners:?}");
        assert_eq!(control.near, control_at(UTM).near, "the rest stays in the scene");
    }

    #[test]
    fn presets_come_back_from_pose_and_scene() {
        let mut control = control_at(UTM);
        for preset in ViewPreset::ALL {
            control.show(preset, 16.0 / 9.0);
            let (forward, up) = preset.directions();
            let camera = control.camera();
            assert!((camera.forward - forward).length() < 1e-12, "{preset}");
            assert!(camera.up.dot(up) > 0.5 && is_level(&control), "{preset}");
        }
    }
}
