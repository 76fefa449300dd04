//! The part of the panel that says what points look like: size, shape, gaps, edges.

use std::time::Duration;

use egui::{ComboBox, Grid, Slider, Ui};

use crate::frame::FrameSettings;
use crate::passes::EyeDome;
use crate::select::{SplatPolicy, SplatShape, SplatSize};

/// Side of a point of fixed size when that is first chosen, pixels.
const FIXED_PX: f64 = 2.0;
/// Gaps up to twice that wide are filled when that is first chosen.
const GAP_RADIUS_PX: u32 = 2;
/// How long nodes take to appear when that is first chosen.
const APPEAR: Duration = Duration::from_millis(250);

/// What points look like.
pub fn look(ui: &mut Ui, settings: &mut FrameSettings) {
    Grid::new("look").num_columns(2).spacing([8.0, 6.0]).show(ui, |ui| {
        size(ui, settings);
        finish(ui, settings);
    });
}

fn size(ui: &mut Ui, settings: &mut FrameSettings) {
    let splat = &mut settings.cut.splat;
    ui.label("Point size").on_hover_text(
        "Adaptive: the spacing of the points around. Fixed: the same on screen. Attenuated: the same in the world.",
    );
    let fixed = match splat.size {
        SplatSize::Fixed { .. } => splat.size,
        _ => SplatSize::Fixed { px: FIXED_PX },
    };
    let attenuated = match splat.size {
        SplatSize::Attenuated { .. } => splat.size,
        // The mean spacing of the scene.
        _ => SplatSize::Attenuated { length: 0.0 },
    };
    ComboBox::from_id_salt("size").selected_text(splat.size.name()).show_ui(ui, |ui| {
        for size in [SplatSize::Adaptive, fixed, attenuated] {
            ui.selectable_value(&mut splat.size, size, size.name());
        }
    });
    ui.end_row();

    match &mut splat.size {
        SplatSize::Adaptive => {
            ui.label("Splats").on_hover_text("Which drawn level sets the size of a point.");
            ComboBox::from_id_salt("splat").selected_text(splat.policy.name()).show_ui(ui, |ui| {
                for policy in SplatPolicy::ALL {
                    ui.selectable_value(&mut splat.policy, policy, policy.name());
                }
            });
            ui.end_row();
        }
        SplatSize::Fixed { px } => {
            ui.label("");
            ui.add(Slider::new(px, 1.0..=32.0).logarithmic(true).suffix(" px"));
            ui.end_row();
        }
        // The factor below says how many spacings.
        SplatSize::Attenuated { .. } => {}
    }

    ui.label("Size factor");
    ui.add(Slider::new(&mut splat.multiplier, 0.5..=4.0).logarithmic(true).suffix(" x"));
    ui.end_row();

    ui.label("At most");
    ui.add(Slider::new(&mut splat.max_px, 1.0..=64.0).logarithmic(true).suffix(" px"));
    ui.end_row();

    ui.label("Shape");
    ComboBox::from_id_salt("shape").selected_text(splat.shape.name()).show_ui(ui, |ui| {
        for shape in SplatShape::ALL {
            ui.selectable_value(&mut splat.shape, shape, shape.name());
        }
    });
    ui.end_row();
}

fn finish(ui: &mut Ui, settings: &mut FrameSettings) {
    let finish = &mut settings.finish;
    ui.label("");
    let mut lights = finish.eye_dome.is_some();
    let hover = "Pixels darken whose neighbours are nearer: edges and folds show.";
    if ui.checkbox(&mut lights, "eye-dome lighting").on_hover_text(hover).changed() {
        finish.eye_dome = lights.then(EyeDome::default);
    }
    ui.end_row();
    if let Some(eye_dome) = &mut finish.eye_dome {
        ui.label("Strength");
        ui.add(Slider::new(&mut eye_dome.strength, 0.1..=8.0).logarithmic(true));
        ui.end_row();
        ui.label("Width");
        ui.add(Slider::new(&mut eye_dome.radius_px, 1..=4).suffix(" px"));
        ui.end_row();
    }

    ui.label("");
    let mut fills = finish.gap_radius_px > 0;
    let hover = "Pixels that are empty or show what lies behind, amid a nearer surface.";
    if ui.checkbox(&mut fills, "fill gaps").on_hover_text(hover).changed() {
        finish.gap_radius_px = if fills { GAP_RADIUS_PX } else { 0 };
    }
    ui.end_row();
    if finish.gap_radius_px > 0 {
        ui.label("Reach");
        ui.add(Slider::new(&mut finish.gap_radius_px, 1..=4).suffix(" px"));
        ui.end_row();
    }

    ui.label("");
    let mut appears = !settings.appear.is_zero();
    let hover = "Nodes that arrive come little by little instead of at once.";
    if ui.checkbox(&mut appears, "let nodes appear").on_hover_text(hover).changed() {
        settings.appear = if appears { APPEAR } else { Duration::ZERO };
    }
    ui.end_row();
}
