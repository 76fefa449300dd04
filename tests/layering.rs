//! Protects the order of rooms: lower layers know nothing of higher ones.
//!
//! Reads the table of rooms from `ARCHITECTURE.md` and every `crate::room` path from `src/`; a use
//! that goes up, or sideways without the table allowing it, fails.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

struct Room {
    layer: u32,
    sideways: Vec<String>,
}

/// Rows look like `| 3 | \`store\` | what it is for | \`points\`, \`ids\` |`.
fn rooms() -> BTreeMap<String, Room> {
    let text = fs::read_to_string(root().join("ARCHITECTURE.md")).expect("ARCHITECTURE.md reads");
    let names = |cell: &str| -> Vec<String> {
        cell.split('`').skip(1).step_by(2).map(|name| name.trim_end_matches('/').into()).collect()
    };
    let mut rooms = BTreeMap::new();
    for line in text.lines().filter(|line| line.starts_with('|')) {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let [layer, room, _, sideways] = cells[..] else { continue };
        let Ok(layer) = layer.parse() else { continue };
        for name in names(room) {
            rooms.insert(name, Room { layer, sideways: names(sideways) });
        }
    }
    rooms
}

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("src lists") {
        let path = entry.expect("an entry reads").path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|suffix| suffix == "rs") {
            found.push(path);
        }
    }
}

/// The room of a file: its first folder under `src`, or its own name.
fn room_of(path: &Path) -> String {
    let inside = path.strip_prefix(root().join("src")).expect("it is under src");
    let first = inside.components().next().expect("it has a name");
    first.as_os_str().to_string_lossy().trim_end_matches(".rs").to_string()
}

/// Rooms that a file names as `crate::room` or, in braces, `crate::{room, ...}`.
fn used_rooms(text: &str) -> Vec<String> {
    let code: String = text
        .lines()
        .filter(|line| !line.trim_start().starts_with("//"))
        .flat_map(|line| [line, "\n"])
        .collect();
    let word = |text: &str| -> String {
        text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
    };
    let mut used = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        let rest = &code[at + "crate::".len()..];
        match rest.strip_prefix('{') {
            Some(list) => {
                let list = &list[..list.find('}').unwrap_or(list.len())];
                used.extend(list.split(',').map(|item| word(item.trim())));
            }
            None => used.push(word(rest)),
        }
    }
    used.retain(|room| !room.is_empty());
    used
}

#[test]
fn no_room_uses_a_higher_or_unnamed_sideways_room() {
    let rooms = rooms();
    assert!(rooms.len() > 10, "the table of rooms was found: {:?}", rooms.keys());
    let mut files = Vec::new();
    sources(&root().join("src"), &mut files);
    let mut wrong = Vec::new();
    for path in files {
        let name = room_of(&path);
        if name == "lib" {
            continue;
        }
        let room = rooms.get(&name).unwrap_or_else(|| panic!("{name} is not in the table"));
        for used in used_rooms(&fs::read_to_string(&path).expect("a source reads")) {
            let Some(target) = rooms.get(&used) else {
                wrong.push(format!("{}: {used} is not in the table", path.display()));
                continue;
            };
            let allowed = used == name
                || target.layer < room.layer
                || target.layer == room.layer && room.sideways.contains(&used);
            if !allowed {
                wrong.push(format!("{}: {name} may not use {used}", path.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn wgpu_and_egui_stay_in_their_rooms() {
    let mut files = Vec::new();
    sources(&root().join("src"), &mut files);
    for path in files {
        let room = room_of(&path);
        let text = fs::read_to_string(&path).expect("a source reads");
        let code: Vec<&str> =
            text.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
        let names = |word: &str| code.iter().any(|line| line.contains(word));
        let draws = ["gpu", "passes", "frame", "viewer"].contains(&room.as_str());
        assert!(draws || !names("wgpu::"), "{} uses wgpu", path.display());
        assert!(room == "viewer" || !names("egui::"), "{} uses egui", path.display());
    }
}
