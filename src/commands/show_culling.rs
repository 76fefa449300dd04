//! What was culled, drawn over a picture or shown from above: `--show-culling` without a window.

use anyhow::bail;

use crate::commands::picture_options::CullingShow;
use crate::frame::{
    FrameSettings, Renderer, box_lines, camera_above, count_states, frustum_lines, frustum_reach,
};
use crate::geometry::View;
use crate::passes::{Picture, draw_line};
use crate::visibility::NodeState;

/// Most boxes drawn; the largest on screen come first.
const MOST_BOXES: usize = 20_000;

/// The picture that was just drawn with what was culled in it, and a line that counts it.
pub(super) fn shown(
    show: CullingShow,
    renderer: &mut Renderer,
    view: &View,
    settings: &FrameSettings,
    mut picture: Picture,
) -> anyhow::Result<(Picture, String)> {
    if renderer.stats().tiles > 1 {
        bail!("--show-culling: a picture of one part is needed; choose a smaller --size");
    }
    let states = renderer.culling_states();
    let mut lines = Vec::new();
    let left_out = match show {
        CullingShow::Boxes => {
            let (boxes, left_out) = box_lines(view, &states, MOST_BOXES);
            lines.extend(boxes);
            left_out
        }
        CullingShow::Above => {
            renderer.freeze_culling(view);
            let bounds = renderer.bounds();
            let above = View { camera: camera_above(&view.camera, &bounds).0, ..*view };
            let drawn = renderer.render_picture(&above, settings);
            renderer.thaw_culling();
            picture = drawn?;
            let (boxes, left_out) = box_lines(&above, &states, MOST_BOXES);
            lines.extend(boxes);
            lines.extend(frustum_lines(&above, view, frustum_reach(&bounds)));
            left_out
        }
    };
    lines.iter().for_each(|line| draw_line(&mut picture, line));
    let counts = NodeState::ALL.into_iter().zip(count_states(&states));
    let mut text: Vec<String> =
        counts.map(|(state, count)| format!("{count} {}", state.name())).collect();
    if left_out > 0 {
        text.push(format!("{left_out} boxes not shown"));
    }
    Ok((picture, text.join(", ")))
}
