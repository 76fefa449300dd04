//! The part of the panel that says how hidden things are found, and what is shown of it.

use egui::{ComboBox, Ui};

use crate::visibility::Algorithm;

/// What the buttons ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CullingAction {
    /// Boxes over the picture, or none.
    Boxes(bool),
    /// The second camera, or the first.
    SecondCamera(bool),
}

/// The selector of the algorithm, and the switches of the view of what is culled.
pub fn culling(
    ui: &mut Ui,
    algorithm: &mut Algorithm,
    shows_boxes: bool,
    is_second_camera: bool,
) -> Option<CullingAction> {
    let mut asked = None;
    ui.horizontal(|ui| {
        ui.label("Hidden objects").on_hover_text(
            "How objects of models are found that stand behind something. The picture is the same.",
        );
        ComboBox::from_id_salt("culling").selected_text(algorithm.name()).show_ui(ui, |ui| {
            for one in Algorithm::usual() {
                let is_chosen = one.name() == algorithm.name();
                if ui.selectable_label(is_chosen, one.name()).on_hover_text(meaning(&one)).clicked()
                    && !is_chosen
                {
                    *algorithm = one;
                }
            }
        });
    });
    let mut boxes = shows_boxes;
    let hover = "Green: drawn. Yellow: drawn unasked. Red: hidden. Blue: outside the frustum.";
    if ui.checkbox(&mut boxes, "boxes of what is culled (F6)").on_hover_text(hover).changed() {
        asked = Some(CullingAction::Boxes(boxes));
    }
    let mut second = is_second_camera;
    let hover = "Look around while everything is drawn as the camera that stands still chose it.";
    if ui.checkbox(&mut second, "second camera, from above (F7)").on_hover_text(hover).changed() {
        asked = Some(CullingAction::SecondCamera(second));
    }
    asked
}

fn meaning(algorithm: &Algorithm) -> &'static str {
    match algorithm {
        Algorithm::None => "Everything is drawn",
        Algorithm::Frustum => "What lies in the view frustum is drawn",
        Algorithm::Naive => "Each object in view is asked about and waited for",
        Algorithm::StopAndWait => "Each box on the way down is asked about and waited for",
        Algorithm::Chc(_) => "Coherent hierarchical culling",
        Algorithm::ChcPlus(_) => "The same in batches, several hidden boxes in one question",
        Algorithm::TwoPass => "What was visible first, then what a test on the device finds",
        Algorithm::NearOptimal(..) => "Questions only where they are expected to pay",
        Algorithm::Auto(..) => "chc++ while it pays, else the view frustum alone",
    }
}
