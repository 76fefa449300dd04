//! "What is culled": boxes over the picture, and a second camera that looks at what the first one
//! culls.
//!
//! Off, nothing of it is kept or worked out. On, a still view is drawn for some frames more, so that
//! culling comes to rest. While the second camera is at work the first one stands still, and what is
//! drawn is what was chosen for it.

use egui::{Align2, Color32, Rect, RichText, Stroke, Ui};
use serde::Serialize;

use crate::frame::{
    FRUSTUM_COLOR, box_lines, camera_above, count_states, frustum_lines, frustum_reach, state_color,
};
use crate::passes::ScreenLine;
use crate::viewer::CameraControl;
use crate::viewer::app::Viewer;
use crate::viewer::panels::{grouped, over};
use crate::visibility::NodeState;

/// Most boxes drawn; the largest on screen come first.
const MOST_BOXES: usize = 4000;
/// Frames that a still view is drawn for, so that its culling comes to rest.
const SETTLING_FRAMES: u32 = 32;

/// What the view of what is culled holds.
#[derive(Default)]
pub(super) struct CullingView {
    pub(super) shows_boxes: bool,
    /// The first camera, while the second one is at work.
    first: Option<CameraControl>,
    boxes: Option<Boxes>,
    /// Frames still to be drawn of a still view.
    settling: u32,
}

/// Boxes over one frame.
struct Boxes {
    lines: Vec<ScreenLine>,
    counts: [usize; 4],
    left_out: usize,
}

/// What the view of what is culled shows.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CullingViewStatistics {
    /// Whether the second camera is at work.
    pub is_second_camera: bool,
    /// Lines over the picture.
    pub lines: usize,
    /// Leaves that were drawn.
    pub drawn: usize,
    /// Leaves that were drawn without being asked about.
    pub forced: usize,
    /// Largest hidden nodes.
    pub hidden: usize,
    /// Largest nodes outside of the view frustum.
    pub outside: usize,
    /// Boxes that there was no room for.
    pub left_out: usize,
}

impl CullingView {
    pub(super) fn new(shows_boxes: bool) -> Self {
        CullingView { shows_boxes, settling: SETTLING_FRAMES, ..CullingView::default() }
    }

    /// Whether the second camera is at work.
    pub(super) fn is_second_camera(&self) -> bool {
        self.first.is_some()
    }

    fn is_off(&self) -> bool {
        !self.shows_boxes && self.first.is_none()
    }

    /// What is shown; `None` while it is off.
    pub(super) fn statistics(&self) -> Option<CullingViewStatistics> {
        let boxes = self.boxes.as_ref()?;
        let [drawn, forced, hidden, outside] = boxes.counts;
        Some(CullingViewStatistics {
            is_second_camera: self.is_second_camera(),
            lines: boxes.lines.len(),
            drawn,
            forced,
            hidden,
            outside,
            left_out: boxes.left_out,
        })
    }
}

impl Viewer {
    /// Shows the boxes, or hides them.
    pub(super) fn show_boxes(&mut self, shows: bool) {
        self.culling_view.shows_boxes = shows;
        self.culling_view.settling = SETTLING_FRAMES;
        self.forget_boxes();
    }

    /// Goes to the second camera, or back to the first.
    pub(super) fn show_second_camera(&mut self, shows: bool) {
        if shows == self.culling_view.is_second_camera() || self.frames_drawn == 0 {
            return;
        }
        match self.culling_view.first.take() {
            Some(first) => {
                self.control = first;
                self.renderer.thaw_culling();
            }
            None => {
                self.renderer.freeze_culling(&self.view());
                let first = self.control.clone();
                let (above, target) = camera_above(&first.camera(), &self.renderer.bounds());
                self.control.go_to(&above, target);
                self.culling_view.first = Some(first);
            }
        }
        self.zoom_anchor = None;
        self.asked_view = None;
        self.forget_boxes();
    }

    /// Goes to the second camera that was asked for at the start, once the first one's culling is at
    /// rest.
    pub(super) fn go_to_asked_second_camera(&mut self, ctx: &egui::Context) {
        let rests = self.drawn.culling.is_none() || self.culling_view.settling == 0;
        if self.options.second_camera && self.opening.is_none() && self.drawn.complete && rests {
            self.options.second_camera = false;
            self.show_second_camera(true);
            ctx.request_repaint();
        }
    }

    fn forget_boxes(&mut self) {
        self.culling_view.boxes = None;
        if self.culling_view.is_off() {
            self.renderer.forget_culling_states();
        }
    }

    /// The scene is another one: back to the first camera.
    pub(super) fn leave_second_camera(&mut self) {
        self.show_second_camera(false);
        self.culling_view.settling = SETTLING_FRAMES;
    }

    /// A frame was drawn: its boxes are others.
    pub(super) fn follow_culling(&mut self) {
        if !self.culling_view.is_off() {
            self.culling_view.boxes = None;
        }
    }

    /// Whether a picture that still holds is to be drawn again. `moved`: the view is another one.
    pub(super) fn settles_culling(&mut self, moved: bool) -> bool {
        if self.culling_view.is_off() || self.culling_view.is_second_camera() {
            return false;
        }
        if moved {
            self.culling_view.settling = SETTLING_FRAMES;
        }
        let settles = self.culling_view.settling > 0 && self.drawn.culling.is_some();
        self.culling_view.settling = self.culling_view.settling.saturating_sub(1);
        settles
    }

    /// Draws the boxes over the picture.
    pub(super) fn paint_culling(&mut self, ui: &Ui, picture: Rect) {
        if self.culling_view.is_off() {
            return;
        }
        if self.culling_view.boxes.is_none() {
            self.culling_view.boxes = Some(self.boxes());
        }
        let Some(boxes) = &self.culling_view.boxes else { return };
        let points = ui.ctx().pixels_per_point();
        let painter = ui.painter().with_clip_rect(picture);
        for line in &boxes.lines {
            let place = |[x, y]: [f32; 2]| picture.min + egui::Vec2::new(x, y) / points;
            let [r, g, b] = line.color;
            let stroke = Stroke::new(1.0 / points, Color32::from_rgb(r, g, b));
            painter.line_segment(line.ends.map(place), stroke);
        }
        legend(ui, picture, boxes, self.culling_view.is_second_camera());
    }

    fn boxes(&mut self) -> Boxes {
        let view = self.view();
        let states = self.renderer.culling_states();
        let (mut lines, left_out) = match self.culling_view.shows_boxes {
            true => box_lines(&view, &states, MOST_BOXES),
            false => (Vec::new(), 0),
        };
        if let Some(frozen) = self.renderer.frozen_view() {
            lines.extend(frustum_lines(&view, frozen, frustum_reach(&self.renderer.bounds())));
        }
        Boxes { lines, counts: count_states(&states), left_out }
    }
}

fn legend(ui: &Ui, picture: Rect, boxes: &Boxes, is_second_camera: bool) {
    over(ui.ctx(), "culling", picture, Align2::RIGHT_BOTTOM, |ui| {
        ui.style_mut().wrap_mode = Some(egui::TextWrapMode::Extend);
        let mut row = |[r, g, b]: [u8; 3], text: String| {
            ui.horizontal(|ui| {
                let square = egui::Vec2::splat(10.0);
                let (rect, _) = ui.allocate_exact_size(square, egui::Sense::hover());
                ui.painter().rect_filled(rect, 0.0, Color32::from_rgb(r, g, b));
                ui.label(RichText::new(text).size(11.0));
            });
        };
        for (state, count) in NodeState::ALL.into_iter().zip(boxes.counts) {
            let what = match state {
                NodeState::Drawn => "drawn",
                NodeState::Forced => "drawn unasked",
                NodeState::Hidden => "hidden, largest boxes",
                NodeState::Outside => "outside the frustum, largest boxes",
            };
            row(state_color(state), format!("{} {what}", grouped(count as u64)));
        }
        if is_second_camera {
            row(FRUSTUM_COLOR, "frustum of the first camera, which stands still".to_owned());
        }
        if boxes.left_out > 0 {
            let text = format!("{} smaller boxes are not shown", grouped(boxes.left_out as u64));
            ui.label(RichText::new(text).size(11.0).weak());
        }
    });
}
