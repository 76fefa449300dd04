//! The panel beside the picture and what lies over it: settings, files, keys, progress.
//!
//! Each function shows one thing from the data it is given and says what was asked for; none of
//! them acts.

use egui::{Align2, Area, Color32, ComboBox, Grid, Id, ProgressBar, Rect, RichText, Slider, Ui};

use crate::frame::{ColorMode, FrameSettings, NodeSource};
use crate::geometry::ViewPreset;
use crate::points::names;
use crate::select::LevelRule;
use crate::store::Metadata;
use crate::viewer::opening::{Advance, KeptIn, OpenedFile};
use crate::viewer::{keys, look_panel};

/// Range of the budget slider, points.
const BUDGETS: std::ops::RangeInclusive<u64> = 10_000..=100_000_000;
/// Range of the frame rate slider, frames per second.
const FRAME_RATES: std::ops::RangeInclusive<f64> = 5.0..=144.0;
/// Range of the error slider, pixels.
const ERRORS_PX: std::ops::RangeInclusive<f64> = 0.25..=32.0;

/// A line about something that happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notice {
    /// What.
    pub text: String,
    /// Whether something failed.
    pub is_error: bool,
}

/// What the files section asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileAction {
    /// Go to a view of the file with that index.
    Show(usize),
    /// Take the file with that index off the scene.
    Close(usize),
}

/// Buttons for the views; the one that was asked for.
pub fn views(ui: &mut Ui) -> Option<ViewPreset> {
    let mut asked = None;
    ui.horizontal(|ui| {
        for (number, preset) in ViewPreset::ALL.into_iter().enumerate() {
            let button = ui.button(capitalized(preset.name()));
            if button.on_hover_text(format!("Key {}", number + 1)).clicked() {
                asked = Some(preset);
            }
        }
        if ui.button("Reset").on_hover_text("Key R or Home").clicked() {
            asked = Some(ViewPreset::default());
        }
    });
    asked
}

/// The colour modes that at least one cloud offers, the usual ones first; values that are the same
/// everywhere are left out.
pub fn offered_colors<'a>(clouds: impl Iterator<Item = &'a dyn NodeSource>) -> Vec<ColorMode> {
    let mut offered = vec![ColorMode::Auto, ColorMode::Elevation];
    let usual = [ColorMode::Rgb, ColorMode::Intensity, ColorMode::Class];
    let mut others: Vec<ColorMode> = Vec::new();
    for cloud in clouds {
        let varies = |name: &str| {
            let index = cloud.schema().find(name).map(|(index, _)| index);
            let mut ranges = index.into_iter().flat_map(|index| cloud.value_ranges(index));
            ranges.any(|range| range.max > range.min)
        };
        let is_useful = |mode: &&ColorMode| match mode {
            ColorMode::Rgb => mode.is_offered_by(cloud),
            ColorMode::Intensity => varies(names::INTENSITY),
            _ => varies(names::CLASSIFICATION),
        };
        for mode in usual.iter().filter(is_useful) {
            if !offered.contains(mode) {
                offered.push(mode.clone());
            }
        }
        for attribute in &cloud.schema().attributes {
            let mode = ColorMode::Attribute(attribute.name.clone());
            let is_usual =
                [names::RGB, names::INTENSITY, names::CLASSIFICATION, names::WAVE_PACKET]
                    .contains(&attribute.name.as_str());
            if !is_usual && varies(&attribute.name) && !others.contains(&mode) {
                others.push(mode);
            }
        }
    }
    offered.extend(others);
    offered
}

/// Everything that changes the picture.
pub fn settings(ui: &mut Ui, settings: &mut FrameSettings, colors: &[ColorMode]) {
    let cut = &mut settings.cut;
    Grid::new("settings").num_columns(2).spacing([8.0, 6.0]).show(ui, |ui| {
        ui.label("Colour");
        ComboBox::from_id_salt("color").selected_text(color_name(&settings.color)).show_ui(
            ui,
            |ui| {
                for mode in colors {
                    ui.selectable_value(&mut settings.color, mode.clone(), color_name(mode));
                }
            },
        );
        ui.end_row();

        ui.label("Points").on_hover_text(
            "Most points drawn. More shows more detail until the error is reached, and takes longer.",
        );
        ui.add(
            Slider::new(&mut cut.point_budget, BUDGETS)
                .logarithmic(true)
                .custom_formatter(|points, _| short_count(points))
                .custom_parser(parse_count),
        );
        ui.end_row();

        ui.label("Frame rate").on_hover_text(
            "Fewer points are drawn where more would take longer. Measures the machine when it is \
             switched on, which takes about a second.",
        );
        ui.horizontal(|ui| {
            let mut is_on = settings.target_ms.is_some();
            let mut fps = 1e3 / settings.target_ms.unwrap_or(1e3 / 30.0);
            ui.checkbox(&mut is_on, "");
            let slider = Slider::new(&mut fps, FRAME_RATES).logarithmic(true).fixed_decimals(0);
            ui.add_enabled(is_on, slider.suffix(" /s"));
            settings.target_ms = is_on.then(|| 1e3 / fps.clamp(1.0, 1000.0));
        });
        ui.end_row();

        ui.label("Error").on_hover_text(
            "Spacing of points on screen that is fine enough. Half of it takes about four times the points.",
        );
        ui.add(Slider::new(&mut cut.error_px, ERRORS_PX).logarithmic(true).suffix(" px"));
        ui.end_row();

        ui.label("Level rule").on_hover_text("Which cell's spacing counts as the error.");
        ComboBox::from_id_salt("rule").selected_text(rule_name(&cut.rule)).show_ui(ui, |ui| {
            for rule in LevelRule::FOUR {
                let rule = LevelRule { off_axis: cut.rule.off_axis, ..rule };
                ui.selectable_value(&mut cut.rule, rule, rule_name(&rule));
            }
        });
        ui.end_row();

        ui.label("");
        ui.checkbox(&mut cut.rule.off_axis, "allow for the corners")
            .on_hover_text("The picture stretches towards its corners; draw finer there.");
        ui.end_row();

        ui.label("");
        ui.checkbox(&mut cut.fill, "fill the budget")
            .on_hover_text("The node that no longer fits draws the levels that do.");
        ui.end_row();

        ui.label("");
        ui.checkbox(&mut cut.cull_frustum, "drop what is out of sight")
            .on_hover_text("Off only to see what it saves.");
        ui.end_row();

        ui.label("");
        ui.checkbox(&mut cut.continuous, "pass levels continuously")
            .on_hover_text("Nodes come and go by shares of their points as the camera moves.");
        ui.end_row();
    });
    look_panel::look(ui, settings);
    if ui.button("Defaults").clicked() {
        let FrameSettings { color, background, loading, culling, .. } = settings.clone();
        let default = FrameSettings::default();
        *settings = FrameSettings { color, background, loading, culling, ..default };
    }
}

/// What is on view.
pub fn files(ui: &mut Ui, files: &[OpenedFile]) -> Option<FileAction> {
    let mut asked = None;
    for (index, file) in files.iter().enumerate() {
        let metadata = file.store.metadata();
        ui.horizontal(|ui| {
            let name = file.path.file_name().unwrap_or(file.path.as_os_str()).to_string_lossy();
            let text = format!("{}\nClick to see all of it", file.path.display());
            if ui.link(RichText::new(name).strong()).on_hover_text(text).clicked() {
                asked = Some(FileAction::Show(index));
            }
            if ui.small_button("x").on_hover_text("Close").clicked() {
                asked = Some(FileAction::Close(index));
            }
        });
        Grid::new(("file", index)).num_columns(2).spacing([8.0, 2.0]).show(ui, |ui| {
            for (name, value) in facts(metadata) {
                ui.weak(name);
                ui.label(value);
                ui.end_row();
            }
            match &file.kept_in {
                KeptIn::Itself => {}
                KeptIn::Temporary => {
                    ui.weak("Store");
                    ui.label("temporary");
                    ui.end_row();
                }
                KeptIn::Preview => {
                    ui.weak("Store");
                    ui.label("not yet: some of the points");
                    ui.end_row();
                }
                KeptIn::Found(path) | KeptIn::Made(path) => {
                    ui.weak("Store");
                    let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
                    ui.label(name).on_hover_text(path.display().to_string());
                    ui.end_row();
                }
            }
        });
        ui.add_space(6.0);
    }
    asked
}

fn facts(metadata: &Metadata) -> Vec<(&'static str, String)> {
    let mut facts = vec![("Points", grouped(metadata.points))];
    if metadata.points > 0 {
        let bounds = metadata.bounds();
        let size = bounds.size();
        let digits = decimals(size.max_element());
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            let (min, max) = (bounds.min[axis], bounds.max[axis]);
            facts.push((name, format!("{min:.digits$} … {max:.digits$}")));
        }
        let [x, y, z] = size.to_array();
        facts.push(("Size", format!("{x:.digits$} x {y:.digits$} x {z:.digits$}")));
    }
    let crs = match (&metadata.crs.epsg, &metadata.crs.wkt) {
        (Some(epsg), _) => format!("EPSG:{epsg}"),
        (None, Some(wkt)) => wkt_name(wkt).unwrap_or("as in its WKT").to_owned(),
        (None, None) => "not stated".to_owned(),
    };
    facts.push(("CRS", crs));
    if let Some(bits) = metadata.color_bits {
        facts.push(("RGB", format!("{bits} bits per channel")));
    }
    facts
}

/// The name in `PROJCS["the name",...`.
fn wkt_name(wkt: &str) -> Option<&str> {
    wkt.split('"').nth(1).filter(|name| !name.is_empty())
}

/// Decimals that show lengths of that size to about five digits.
fn decimals(size: f64) -> usize {
    if size > 0.0 { (4.0 - size.log10().floor()).clamp(0.0, 9.0) as usize } else { 3 }
}

/// The list of keys, in the middle.
pub fn help(ctx: &egui::Context, picture: Rect) {
    over(ctx, "help", picture, Align2::CENTER_CENTER, |ui| {
        ui.style_mut().wrap_mode = Some(egui::TextWrapMode::Extend);
        Grid::new("help").num_columns(2).spacing([16.0, 4.0]).min_row_height(0.0).show(ui, |ui| {
            for (keys, effect) in keys::HELP {
                ui.strong(keys);
                ui.label(effect);
                ui.end_row();
            }
        });
    });
}

/// A line in the middle of an empty picture.
pub fn hint(ui: &Ui, picture: Rect, text: &str) {
    let font = egui::FontId::proportional(18.0);
    ui.painter().text(picture.center(), Align2::CENTER_CENTER, text, font, Color32::GRAY);
}

/// Progress of a conversion and what happened, in the bottom left corner of the picture. Returns
/// whether the conversion is to be cancelled; dismissed notices are removed.
pub fn progress_and_notices(
    ctx: &egui::Context,
    picture: Rect,
    is_opening: bool,
    advance: Option<&Advance>,
    notices: &mut Vec<Notice>,
) -> bool {
    let mut cancelled = false;
    if !is_opening && notices.is_empty() {
        return cancelled;
    }
    over(ctx, "progress", picture, Align2::LEFT_BOTTOM, |ui| {
        ui.set_max_width((picture.width() - 40.0).clamp(80.0, 560.0));
        let mut dismissed = None;
        for (index, notice) in notices.iter().enumerate() {
            ui.horizontal_top(|ui| {
                dismissed = if ui.small_button("x").clicked() { Some(index) } else { dismissed };
                let color = if notice.is_error {
                    ui.visuals().error_fg_color
                } else {
                    ui.visuals().warn_fg_color
                };
                ui.add(egui::Label::new(RichText::new(&notice.text).color(color)).wrap());
            });
        }
        if let Some(index) = dismissed {
            notices.remove(index);
        }
        if is_opening {
            ui.horizontal(|ui| {
                cancelled = ui.button("Cancel").clicked();
                match advance {
                    Some(advance) => {
                        let name = advance.path.file_name().unwrap_or_default().to_string_lossy();
                        let share = advance.points_done as f32 / advance.points_total.max(1) as f32;
                        let what = match advance.stage {
                            Some(stage) => format!("Converting {name}: {stage}"),
                            None => format!("A first look at {name}"),
                        };
                        let text = format!(
                            "{what}, {} of {}",
                            short_count(advance.points_done as f64),
                            short_count(advance.points_total as f64)
                        );
                        ui.add(ProgressBar::new(share.min(1.0)).desired_width(420.0).text(text));
                    }
                    None => {
                        ui.label("Opening");
                    }
                }
            });
        }
    });
    cancelled
}

/// A see-through box in a corner of the picture.
pub(super) fn over(
    ctx: &egui::Context,
    name: &str,
    picture: Rect,
    corner: Align2,
    contents: impl FnOnce(&mut Ui),
) {
    Area::new(Id::unique(name))
        .pivot(corner)
        .fixed_pos(corner.pos_in_rect(&picture.shrink(8.0)))
        .constrain_to(picture)
        .show(ctx, |ui| {
            let frame = egui::Frame::popup(ui.style()).multiply_with_opacity(0.85);
            frame.show(ui, contents);
        });
}

fn color_name(mode: &ColorMode) -> String {
    match mode {
        ColorMode::Auto => "Automatic".to_owned(),
        ColorMode::Rgb => "RGB".to_owned(),
        ColorMode::Elevation => "Elevation".to_owned(),
        ColorMode::Intensity => "Intensity".to_owned(),
        ColorMode::Class => "Classification".to_owned(),
        ColorMode::Attribute(name) => name.clone(),
    }
}

fn rule_name(rule: &LevelRule) -> &'static str {
    LevelRule { off_axis: false, ..*rule }.name()
}

fn capitalized(word: &str) -> String {
    let mut letters = word.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

/// `1 234 567`, with thin gaps.
pub(super) fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(' ');
        }
        text.push(digit);
    }
    text
}

/// `1.5 M`.
fn short_count(number: f64) -> String {
    match number {
        n if n >= 1e9 => format!("{:.2} G", n / 1e9),
        n if n >= 1e6 => format!("{:.2} M", n / 1e6),
        n if n >= 1e3 => format!("{:.0} k", n / 1e3),
        n => format!("{n:.0}"),
    }
}

/// Reads `1.5 M`, `20k`, `3000`.
fn parse_count(text: &str) -> Option<f64> {
    let text = text.trim();
    let (number, factor) = match text.char_indices().last()? {
        (at, 'k' | 'K') => (&text[..at], 1e3),
        (at, 'm' | 'M') => (&text[..at], 1e6),
        (at, 'g' | 'G') => (&text[..at], 1e9),
        _ => (text, 1.0),
    };
    number.trim().parse::<f64>().ok().map(|number| number * factor)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_readable_and_read_back() {
        assert_eq!(grouped(0), "0");
        assert_eq!(grouped(123), "123");
        assert_eq!(grouped(10_653_336), "10 653 336");
        for number in [7.0, 20e3, 1.25e6, 5e6, 2e9] {
            assert_eq!(parse_count(&short_count(number)), Some(number));
        }
        assert_eq!(parse_count(" 3 m"), Some(3e6));
        assert_eq!(parse_count("many"), None);
        assert_eq!(parse_count(""), None);
    }

    #[test]
    fn lengths_show_about_five_digits() {
        assert_eq!(decimals(4655.0), 1);
        assert_eq!(decimals(0.02), 6);
        assert_eq!(decimals(0.0), 3);
    }

    #[test]
    fn the_name_of_a_reference_system_is_found() {
        assert_eq!(wkt_name(r#"PROJCS["UTM 10N",GEOGCS["x"]]"#), Some("UTM 10N"));
        assert_eq!(wkt_name("LOCAL_CS[]"), None);
    }
}
