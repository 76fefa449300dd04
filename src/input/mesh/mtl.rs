//! MTL: the materials of OBJ files, as far as they are colour, opacity and a texture.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::obj::{numbers, text_after};
use super::picture;
use super::report::ModelReport;
use super::shape::Assembly;
use crate::ids::{MaterialId, TextureId};
use crate::mesh::Material;

/// Largest file that is read.
const MOST_BYTES: u64 = 64 << 20;

/// A material as it stands in a file.
#[derive(Debug, Default)]
struct Raw {
    name: String,
    color: Option<[f64; 3]>,
    opacity: Option<f64>,
    map: Option<String>,
    /// A texture that says which parts are cut out.
    has_cut_out: bool,
}

/// Reads a library and adds its materials by name. What is missing is counted.
pub(super) fn read(
    path: &Path,
    parts: &mut Assembly,
    textures: &mut HashMap<PathBuf, Option<TextureId>>,
    by_name: &mut HashMap<String, MaterialId>,
) {
    let read = || -> Result<Vec<u8>, String> {
        let file = crate::input::detect::open_regular(path).map_err(|fault| fault.to_string())?;
        if file.bytes() > MOST_BYTES {
            return Err("too large".into());
        }
        file.read_range(0..file.bytes()).map_err(|fault| fault.to_string())
    };
    let bytes = match read() {
        Ok(bytes) => bytes,
        Err(reason) => {
            let note = format!("materials missing: {reason}: {}", path.display());
            return parts.report.note(note);
        }
    };
    let folder = path.parent().unwrap_or(Path::new(""));
    for raw in parse(&bytes, &mut parts.report) {
        let texture = raw.map.as_deref().and_then(|map| texture(folder, map, parts, textures));
        // Many programs write black below a texture and mean the texture.
        let is_black = raw.color.is_none_or(|color| color == [0.0; 3]);
        let [r, g, b] = match raw.color {
            Some(color) if !(is_black && texture.is_some()) => color,
            _ if texture.is_some() => [1.0; 3],
            _ => [0.8; 3],
        };
        let byte = |share: f64| (share.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        let opacity = byte(raw.opacity.unwrap_or(1.0));
        let material = parts.material(Material {
            color: [byte(r), byte(g), byte(b), opacity],
            texture,
            alpha_cutoff: (raw.has_cut_out || opacity < 255).then_some(0.1),
            double_sided: true,
        });
        by_name.entry(raw.name).or_insert(material);
    }
}

fn texture(
    folder: &Path,
    map: &str,
    parts: &mut Assembly,
    textures: &mut HashMap<PathBuf, Option<TextureId>>,
) -> Option<TextureId> {
    // Files from other systems have other separators.
    let path = folder.join(map.replace('\\', "/"));
    if let Some(known) = textures.get(&path) {
        return *known;
    }
    let texture = match picture::read(&path) {
        Ok(texture) => Some(parts.texture(texture)),
        Err(reason) => {
            parts.report.missing_textures += 1;
            parts.report.note(format!("texture missing: {reason}: {}", path.display()));
            None
        }
    };
    textures.insert(path, texture);
    texture
}

fn parse(bytes: &[u8], report: &mut ModelReport) -> Vec<Raw> {
    let mut materials: Vec<Raw> = Vec::new();
    for line in bytes.split(|&byte| byte == b'\n') {
        let line = String::from_utf8_lossy(line);
        let line = line.trim();
        let (key, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        if key == "newmtl" {
            materials.push(Raw { name: rest.trim().to_string(), ..Raw::default() });
            continue;
        }
        let Some(material) = materials.last_mut() else { continue };
        match key {
            "Kd" => match numbers(rest)[..] {
                [r, g, b, ..] => material.color = Some([r, g, b]),
                [gray] => material.color = Some([gray; 3]),
                _ => report.damaged += 1,
            },
            "d" => material.opacity = numbers(rest).first().copied(),
            "Tr" => material.opacity = numbers(rest).first().map(|through| 1.0 - through),
            "map_Kd" => material.map = file_of(rest),
            "map_d" => material.has_cut_out = true,
            _ => {}
        }
    }
    materials
}

/// The file's name behind the options of a texture.
fn file_of(rest: &str) -> Option<String> {
    let mut rest = rest.trim();
    while rest.starts_with('-') {
        let (option, after) = rest.split_once(char::is_whitespace)?;
        rest = after.trim_start();
        let most = match option {
            "-o" | "-s" | "-t" => 3,
            "-mm" => 2,
            _ => 1,
        };
        for taken in 0..most {
            let word = rest.split(char::is_whitespace).next()?;
            // Vectors may have one, two or three numbers.
            if taken > 0 && word.parse::<f64>().is_err() {
                break;
            }
            rest = text_after(rest, word);
        }
    }
    (!rest.is_empty()).then(|| rest.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_stand_before_the_name() {
        let name = |text| file_of(text);
        assert_eq!(name("a b.png").as_deref(), Some("a b.png"));
        assert_eq!(name("-s 1 1 1 -clamp on a.png").as_deref(), Some("a.png"));
        assert_eq!(name("-o 0.5 a.png").as_deref(), Some("a.png"));
        assert_eq!(name("-bm"), None);
    }

    #[test]
    fn colours_and_opacity() {
        let text = b"Kd 1 1 1\nnewmtl a b\r\nKd 0.5 0 1\nTr 0.25\n newmtl c\nKd x\n";
        let mut report = ModelReport::default();
        let materials = parse(text, &mut report);
        assert_eq!((materials.len(), report.damaged), (2, 1));
        assert_eq!((&materials[0].name[..], materials[0].opacity), ("a b", Some(0.75)));
        assert_eq!(materials[0].color, Some([0.5, 0.0, 1.0]));
    }
}
