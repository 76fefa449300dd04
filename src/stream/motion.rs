//! Where the camera will be, from where it was.
//!
//! Eye and direction are followed at the speed they have now. Only steady motion counts: after a
//! jump, a turn-about or a stop there is nothing to be foreseen.

use std::time::Duration;

use glam::{DQuat, DVec3};

use crate::geometry::{Camera, View};

/// The last views of a camera, with their times.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    last: Option<(View, Duration)>,
    /// Velocity of the eye and turn per second, of the last two steps.
    speeds: [Option<Speed>; 2],
}

#[derive(Clone, Copy, Debug)]
struct Speed {
    eye: DVec3,
    /// Axis of the turn, as long as its angle per second.
    turn: DVec3,
}

/// A time between views above which they do not belong to one motion.
const LONGEST_STEP: Duration = Duration::from_millis(500);
/// A turn in the time looked ahead above which there is nothing to be foreseen.
const LARGEST_TURN_RAD: f64 = 1.5;

impl Motion {
    /// Notes a view and its time.
    pub fn note(&mut self, view: &View, time: Duration) {
        let speed = self.last.as_ref().and_then(|(last, before)| {
            let step = time.checked_sub(*before).filter(|step| *step <= LONGEST_STEP)?;
            (!step.is_zero()).then(|| speed_between(&last.camera, &view.camera, step))
        });
        // Two views at one time say nothing about speed.
        if self.last.as_ref().is_some_and(|(_, before)| *before == time) {
            self.last = Some((*view, time));
            return;
        }
        self.speeds = [self.speeds[1], speed];
        self.last = Some((*view, time));
    }

    /// The view after `ahead`, if the camera moves steadily.
    pub fn view_after(&self, ahead: Duration) -> Option<View> {
        let (view, _) = self.last?;
        let [Some(before), Some(now)] = self.speeds else { return None };
        let eye = steady(before.eye, now.eye);
        let turn = steady(before.turn, now.turn);
        if eye == DVec3::ZERO && turn == DVec3::ZERO {
            return None;
        }
        let seconds = ahead.as_secs_f64();
        let turn = turn * seconds;
        if turn.length() > LARGEST_TURN_RAD {
            return None;
        }
        let rotation = DQuat::from_scaled_axis(turn);
        let camera = Camera {
            eye: view.camera.eye + eye * seconds,
            forward: (rotation * view.camera.forward).normalize(),
            up: (rotation * view.camera.up).normalize(),
            ..view.camera
        };
        camera.eye.is_finite().then_some(View { camera, ..view })
    }
}

fn speed_between(from: &Camera, to: &Camera, step: Duration) -> Speed {
    let seconds = step.as_secs_f64();
    // The turn that takes the one camera's axes to the other's.
    let rotation = to.camera_from_world_rotation().transpose() * from.camera_from_world_rotation();
    let turn = DQuat::from_mat3(&rotation).to_scaled_axis();
    let turn = if turn.is_finite() { turn } else { DVec3::ZERO };
    Speed { eye: (to.eye - from.eye) / seconds, turn: turn / seconds }
}

/// The shorter of two vectors that point the same way within 60 degrees and differ in length by
/// less than a factor of four; else nothing.
fn steady(before: DVec3, now: DVec3) -> DVec3 {
    let (a, b) = (before.length(), now.length());
    let is_alike = before.dot(now) > 0.5 * a * b && a < 4.0 * b && b < 4.0 * a;
    match is_alike {
        true if a < b => before,
        true => now,
        false => DVec3::ZERO,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(eye: DVec3, target: DVec3) -> View {
        let camera = Camera::looking_at(eye, target, DVec3::Z, 1.0, 0.1);
        View { camera, width_px: 640, height_px: 480 }
    }

    fn milliseconds(count: u64) -> Duration {
        Duration::from_millis(count)
    }

    #[test]
    fn a_straight_flight_goes_on() {
        let mut motion = Motion::default();
        for step in 0..4u64 {
            let eye = DVec3::new(2.0 * step as f64, 0.0, 5.0);
            motion.note(&view(eye, eye + DVec3::X), milliseconds(40 * step));
        }
        let ahead = motion.view_after(milliseconds(200)).expect("it moves");
        assert!((ahead.camera.eye - DVec3::new(16.0, 0.0, 5.0)).length() < 1e-9);
        assert!((ahead.camera.forward - DVec3::X).length() < 1e-9);
    }

    #[test]
    fn a_turn_goes_on() {
        let mut motion = Motion::default();
        for step in 0..3u64 {
            let angle = 0.05 * step as f64;
            let direction = DVec3::new(angle.cos(), angle.sin(), 0.0);
            motion.note(&view(DVec3::ZERO, direction), milliseconds(50 * step));
        }
        let ahead = motion.view_after(milliseconds(100)).expect("it turns");
        let angle: f64 = 0.2;
        let expected = DVec3::new(angle.cos(), angle.sin(), 0.0);
        assert!((ahead.camera.forward - expected).length() < 1e-9, "{:?}", ahead.camera);
        assert!((ahead.camera.up - DVec3::Z).length() < 1e-9);
    }

    #[test]
    fn jumps_stops_and_pauses_foresee_nothing() {
        let mut still = Motion::default();
        let mut jumping = Motion::default();
        let mut pausing = Motion::default();
        for step in 0..6u64 {
            still.note(&view(DVec3::ZERO, DVec3::X), milliseconds(40 * step));
            let side = if step % 2 == 0 { 1e6 } else { -1e6 };
            jumping.note(&view(DVec3::splat(side), DVec3::ZERO), milliseconds(40 * step));
            let eye = DVec3::X * step as f64;
            pausing.note(&view(eye, eye + DVec3::Y), milliseconds(2_000 * step));
        }
        for motion in [Motion::default(), still, jumping, pausing] {
            assert_eq!(motion.view_after(milliseconds(250)), None, "{motion:?}");
        }
    }
}
