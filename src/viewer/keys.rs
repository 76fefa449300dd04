//! What mouse and keys do: the one list that the help shows, and the questions the window asks.

use egui::{Key, Modifiers, PointerButton};
use glam::DVec3;

use crate::geometry::ViewPreset;
use crate::viewer::DragKind;

/// What the help shows.
pub const HELP: [(&str, &str); 17] = [
    ("Left drag", "orbit around the point under the cursor"),
    ("Middle or Shift + left drag", "pan: the point stays under the cursor"),
    ("Right drag", "look around"),
    ("Wheel", "zoom to the point under the cursor"),
    ("W A S D", "fly forward, left, back, right"),
    ("Q E", "fly down, up"),
    ("Shift, Ctrl", "fly faster, slower"),
    ("Right drag + wheel", "change the speed of flight"),
    ("1 2 3 4", "view from the top, front, left, corner"),
    ("R or Home", "view of everything"),
    ("F1", "these keys"),
    ("F2", "statistics"),
    ("F3", "panel"),
    ("F5", "write the file of --stats"),
    ("F6", "boxes of what is culled"),
    ("F7", "second camera: look at what the first one culls"),
    ("Drop a file", "open a store or a scan"),
];

/// What one key press asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KeyCommand {
    /// Go to a preset's view.
    Show(ViewPreset),
    /// Show or hide the list of keys.
    Help,
    /// Show or hide the statistics.
    Statistics,
    /// Show or hide the panel.
    Panel,
    /// Write the statistics file.
    WriteStatistics,
    /// Show or hide the boxes of what is culled.
    Boxes,
    /// Go to the second camera, or back to the first.
    SecondCamera,
}

/// The command of a key.
pub fn command(key: Key) -> Option<KeyCommand> {
    Some(match key {
        Key::Num1 => KeyCommand::Show(ViewPreset::Top),
        Key::Num2 => KeyCommand::Show(ViewPreset::Front),
        Key::Num3 => KeyCommand::Show(ViewPreset::Left),
        Key::Num4 => KeyCommand::Show(ViewPreset::Iso),
        Key::R | Key::Home => KeyCommand::Show(ViewPreset::default()),
        Key::F1 => KeyCommand::Help,
        Key::F2 => KeyCommand::Statistics,
        Key::F3 => KeyCommand::Panel,
        Key::F5 => KeyCommand::WriteStatistics,
        Key::F6 => KeyCommand::Boxes,
        Key::F7 => KeyCommand::SecondCamera,
        _ => return None,
    })
}

/// What dragging with a button does.
pub fn drag_kind(button: PointerButton, modifiers: Modifiers) -> Option<DragKind> {
    match button {
        PointerButton::Primary if modifiers.shift => Some(DragKind::Pan),
        PointerButton::Primary => Some(DragKind::Orbit),
        PointerButton::Middle => Some(DragKind::Pan),
        PointerButton::Secondary => Some(DragKind::Look),
        _ => None,
    }
}

/// Where the keys that are down fly to: right, forward, up; zero without any.
pub fn flight(is_down: impl Fn(Key) -> bool) -> DVec3 {
    let axis = |plus, minus| f64::from(i8::from(is_down(plus)) - i8::from(is_down(minus)));
    DVec3::new(axis(Key::D, Key::A), axis(Key::W, Key::S), axis(Key::E, Key::Q))
}

/// Factor on the speed of flight.
pub fn boost(modifiers: Modifiers) -> f64 {
    match (modifiers.shift, modifiers.ctrl) {
        (true, false) => 4.0,
        (false, true) => 0.25,
        _ => 1.0,
    }
}
