//! What mouse and keys ask of the camera.

use egui::{Event, MouseWheelUnit, PointerButton, Pos2, Rect, Response};
use glam::{DVec2, DVec3};

use crate::viewer::DragKind;
use crate::viewer::app::Viewer;
use crate::viewer::keys;

/// Distance within which a point counts as under the cursor, pixels.
const PICK_RADIUS_PX: u32 = 10;
/// Points of scrolling that make a notch of the wheel.
const POINTS_PER_NOTCH: f64 = 50.0;
/// Longest step of flight, so that a slow frame does not leap.
const LONGEST_STEP_SECONDS: f64 = 0.25;

impl Viewer {
    /// Applies what mouse and keys ask of the camera.
    pub(super) fn move_camera(&mut self, ctx: &egui::Context, response: &Response) {
        if let Some(preset) = self.asked_view.take() {
            let aspect = self.view().aspect();
            match (self.asked_part.take(), self.options.start) {
                (Some(part), _) => self.control.show_part(&part, preset, aspect),
                (None, Some(camera)) => {
                    let ahead = 0.05 * self.renderer.bounds().diagonal().max(0.0);
                    self.control.go_to(&camera, camera.eye + camera.forward * ahead);
                }
                (None, None) => self.control.show(preset, aspect),
            }
            self.zoom_anchor = None;
            self.was_moved = false;
        }
        let before = self.control.camera();
        self.drag(ctx, response);
        if response.hovered() || response.dragged() {
            self.wheel(ctx, response);
        }
        self.fly(ctx);
        if self.control.camera() != before {
            self.was_moved = true;
        }
    }

    fn drag(&mut self, ctx: &egui::Context, response: &Response) {
        let Some(cursor) = response.interact_pointer_pos() else {
            self.control.end_drag();
            return;
        };
        let view = self.view();
        if response.drag_started() {
            // Keys are the camera's again, if a field of the panel had them.
            ctx.memory_mut(|memory| memory.stop_text_input());
            // Where the button went down, not where the mouse has got to since.
            let origin = ctx.input(|input| input.pointer.press_origin()).unwrap_or(cursor);
            let (modifiers, button) = ctx.input(|input| {
                let buttons =
                    [PointerButton::Primary, PointerButton::Middle, PointerButton::Secondary];
                let down = buttons.into_iter().find(|&button| input.pointer.button_down(button));
                (input.modifiers, down)
            });
            if let Some(kind) = button.and_then(|button| keys::drag_kind(button, modifiers)) {
                let at = cursor_px(origin, response.rect, ctx.pixels_per_point());
                let point = if kind == DragKind::Look { None } else { self.pick(at) };
                self.control.begin_drag(kind, at, point, &view);
                self.zoom_anchor = None;
            }
        }
        if response.drag_stopped() {
            self.control.end_drag();
        } else if response.dragged() {
            let at = cursor_px(cursor, response.rect, ctx.pixels_per_point());
            self.control.drag_to(at, &view);
        }
    }

    fn wheel(&mut self, ctx: &egui::Context, response: &Response) {
        let notches = ctx.input(|input| input.events.iter().map(notches_of).sum::<f64>());
        let Some(cursor) = ctx.input(|input| input.pointer.latest_pos()) else { return };
        if notches == 0.0 {
            return;
        }
        if ctx.input(|input| input.pointer.button_down(PointerButton::Secondary)) {
            self.control.change_speed(notches);
            return;
        }
        let at = cursor_px(cursor, response.rect, ctx.pixels_per_point());
        // A turn of the wheel goes on towards what was under the cursor when it began, however the
        // picture refines meanwhile.
        let point = match self.zoom_anchor {
            Some((place, point)) if place.distance(cursor) < 1.0 && point.is_some() => point,
            _ => self.pick(at),
        };
        self.zoom_anchor = Some((cursor, point));
        let view = self.view();
        self.control.zoom(notches, at, point, &view);
    }

    fn fly(&mut self, ctx: &egui::Context) {
        if ctx.egui_wants_keyboard_input() {
            return;
        }
        let (direction, modifiers, seconds) = ctx.input(|input| {
            let direction = keys::flight(|key| input.key_down(key));
            (direction, input.modifiers, f64::from(input.stable_dt))
        });
        if direction == DVec3::ZERO {
            return;
        }
        self.control.fly(direction, keys::boost(modifiers), seconds.min(LONGEST_STEP_SECONDS));
        self.zoom_anchor = None;
        ctx.request_repaint();
    }

    /// The point of the scene at a place of the picture that is shown.
    pub(super) fn pick(&mut self, at: DVec2) -> Option<DVec3> {
        if at.cmplt(DVec2::ZERO).any() {
            return None;
        }
        match self.renderer.pick(at.x as u32, at.y as u32, PICK_RADIUS_PX) {
            Ok(point) => point,
            Err(error) => {
                self.note(error.to_string(), true);
                None
            }
        }
    }
}

/// A place on screen as a place in the picture, pixels.
fn cursor_px(cursor: Pos2, picture: Rect, pixels_per_point: f32) -> DVec2 {
    let at = (cursor - picture.min) * pixels_per_point;
    DVec2::new(f64::from(at.x), f64::from(at.y))
}

/// Notches of the wheel in an event, towards the scene if positive.
fn notches_of(event: &Event) -> f64 {
    match event {
        Event::MouseWheel { unit, delta, .. } => {
            let delta = f64::from(delta.y);
            match unit {
                MouseWheelUnit::Point => delta / POINTS_PER_NOTCH,
                MouseWheelUnit::Line => delta,
                MouseWheelUnit::Page => delta * 10.0,
            }
        }
        // Fingers that spread to twice their distance come near by half.
        Event::Zoom(factor) if *factor > 0.0 => 3.5 * f64::from(factor.log2()),
        _ => 0.0,
    }
}
