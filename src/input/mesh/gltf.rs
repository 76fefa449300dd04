//! glTF 2.0, as text with buffers beside or inside it, and as one binary file (GLB).
//!
//! Nodes become objects; a mesh that several nodes name is one shape. Transforms are multiplied in
//! f64. Read: triangles, strips and fans, colours, texture coordinates, base colour and its
//! texture, opacity as a cutoff, sparse accessors, quantized attributes. Not read: skins, morphing,
//! animation, samplers (textures repeat), compressed geometry, transforms of textures.

use std::borrow::Cow;
use std::path::Path;

use glam::{DAffine3, DMat4, DQuat, DVec3};

use super::accessor::{Buffers, Reason, rows, view_bytes};
use super::gltf_json::{Document, Image, Node, Primitive};
use super::picture;
use super::shape::{Assembly, RawShape};
use crate::ids::{MaterialId, MeshId, TextureId};
use crate::input::detect::open_regular;
use crate::input::foreign::ForeignFault;
use crate::mesh::{Material, Texture};

const GLB_HEADER_BYTES: usize = 12;
const CHUNK_HEADER_BYTES: usize = 8;
/// Longest file beside a document that is read.
const MOST_BUFFER_BYTES: u64 = 1 << 36;
/// Extensions that change nothing that is read here, or are understood.
const KNOWN_EXTENSIONS: [&str; 2] = ["KHR_mesh_quantization", "KHR_materials_unlit"];
/// Opacity below which parts of a blended material are left out: nothing here is blended.
const BLEND_CUTOFF: f32 = 0.1;

/// Reads a document and all it names.
pub(super) fn read(bytes: &[u8], folder: &Path, parts: &mut Assembly) -> Result<(), ForeignFault> {
    let (json, blob) = match bytes.starts_with(b"glTF") {
        true => chunks(bytes, parts)?,
        false => (bytes, None),
    };
    let document: Document = serde_json::from_slice(json).map_err(|error| {
        ForeignFault::at_line(error.line() as u64, format!("not a glTF document: {error}"))
    })?;
    for extension in &document.extensions_required {
        if !KNOWN_EXTENSIONS.contains(&extension.as_str()) {
            parts.report.note(format!("the file needs {extension}, which is not read"));
        }
    }
    for (what, count) in
        [("animation(s)", document.animations.len()), ("skin(s)", document.skins.len())]
    {
        if count > 0 {
            parts.report.note(format!("{count} {what} not read"));
        }
    }
    let buffers: Vec<_> = (0..document.buffers.len())
        .map(|index| {
            let buffer = buffer(&document, index, folder, blob);
            let missing = |reason| parts.report.note(format!("buffer {index} missing: {reason}"));
            buffer.map_err(missing).ok()
        })
        .collect();
    let materials = materials(&document, &buffers, folder, parts);
    let meshes = meshes(&document, &buffers, &materials, parts)?;
    place_nodes(&document, &meshes, parts);
    Ok(())
}

/// The JSON and the binary chunk of a GLB file.
fn chunks<'a>(
    bytes: &'a [u8],
    parts: &mut Assembly,
) -> Result<(&'a [u8], Option<&'a [u8]>), ForeignFault> {
    let word = |at: usize| -> Option<u32> {
        Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
    };
    let version = word(4).unwrap_or(0);
    if version != 2 {
        return Err(ForeignFault::at_byte(4, format!("glTF version {version}, expected 2")));
    }
    let (mut json, mut blob, mut at) = (None, None, GLB_HEADER_BYTES);
    while let (Some(length), Some(kind)) = (word(at), word(at + 4)) {
        let start = at + CHUNK_HEADER_BYTES;
        let end = start.saturating_add(length as usize);
        if end > bytes.len() {
            parts.report.note(format!(
                "the chunk at byte {at} claims {length} bytes, the file has {}",
                bytes.len() - start
            ));
        }
        let chunk = &bytes[start..end.min(bytes.len())];
        match kind {
            0x4e4f_534a => json = json.or(Some(chunk)),
            0x004e_4942 => blob = blob.or(Some(chunk)),
            _ => {}
        }
        at = end.next_multiple_of(4);
    }
    let json = json.ok_or_else(|| ForeignFault::at_byte(12, "no JSON chunk"))?;
    Ok((json, blob))
}

fn buffer<'a>(
    document: &Document,
    index: usize,
    folder: &Path,
    blob: Option<&'a [u8]>,
) -> Result<Cow<'a, [u8]>, Reason> {
    match &document.buffers[index].uri {
        None if index == 0 => blob.map(Cow::Borrowed).ok_or_else(|| "no binary chunk".into()),
        None => Err("no place is given".into()),
        Some(uri) => resource(uri, folder).map(Cow::Owned),
    }
}

/// What a reference names: data within it, or a file beside the document.
fn resource(uri: &str, folder: &Path) -> Result<Vec<u8>, Reason> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (kind, text) = data.split_once(',').ok_or("a data reference without data")?;
        if !kind.ends_with(";base64") {
            return Err("a data reference that is not base64".into());
        }
        return base64(text.as_bytes()).ok_or_else(|| "damaged base64".into());
    }
    if uri.contains("://") {
        return Err(format!("not a file: {uri}"));
    }
    let path = folder.join(percent_decoded(uri));
    let file = open_regular(&path).map_err(|fault| format!("{fault}: {}", path.display()))?;
    if file.bytes() > MOST_BUFFER_BYTES {
        return Err(format!("{} bytes are too many: {}", file.bytes(), path.display()));
    }
    file.read_range(0..file.bytes()).map_err(|fault| fault.to_string())
}

fn base64(text: &[u8]) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3 + 3);
    let (mut word, mut bits) = (0u32, 0);
    for &letter in text.iter().filter(|letter| !letter.is_ascii_whitespace() && **letter != b'=') {
        let six = match letter {
            b'A'..=b'Z' => letter - b'A',
            b'a'..=b'z' => letter - b'a' + 26,
            b'0'..=b'9' => letter - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            _ => return None,
        };
        word = word << 6 | u32::from(six);
        bits += 6;
        if bits >= 8 {
            bits -= 8;
            bytes.push((word >> bits) as u8);
        }
    }
    Some(bytes)
}

fn percent_decoded(uri: &str) -> String {
    let bytes = uri.as_bytes();
    let mut decoded = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        let code = || {
            let digits = std::str::from_utf8(bytes.get(at + 1..at + 3)?).ok()?;
            u8::from_str_radix(digits, 16).ok()
        };
        match (bytes[at], code()) {
            (b'%', Some(byte)) => {
                decoded.push(byte);
                at += 3;
            }
            (byte, _) => {
                decoded.push(byte);
                at += 1;
            }
        }
    }
    String::from_utf8_lossy(&decoded).into_owned()
}

/// The materials, and the set of texture coordinates that each uses; the last one is for
/// primitives that name none.
fn materials(
    document: &Document,
    buffers: &Buffers,
    folder: &Path,
    parts: &mut Assembly,
) -> Vec<(MaterialId, u32)> {
    let mut textures: Vec<Option<Option<TextureId>>> = vec![None; document.textures.len()];
    let mut materials = Vec::with_capacity(document.materials.len() + 1);
    for material in &document.materials {
        let info = material.pbr_metallic_roughness.base_color_texture.as_ref();
        let texture = info.and_then(|info| match textures.get(info.index) {
            Some(Some(known)) => *known,
            Some(None) => {
                let read = texture(document, buffers, folder, info.index);
                let added = match read {
                    Ok(texture) => Some(parts.texture(texture)),
                    Err(reason) => {
                        parts.report.missing_textures += 1;
                        parts.report.note(format!("texture {} missing: {reason}", info.index));
                        None
                    }
                };
                textures[info.index] = Some(added);
                added
            }
            None => {
                parts.report.missing_textures += 1;
                None
            }
        });
        let [r, g, b, a] = material.pbr_metallic_roughness.base_color_factor.unwrap_or([1.0; 4]);
        let is_opaque = !matches!(material.alpha_mode.as_deref(), Some("MASK" | "BLEND"));
        let alpha = if is_opaque { 255 } else { (a.clamp(0.0, 1.0) * 255.0 + 0.5) as u8 };
        let id = parts.material(Material {
            color: [srgb(r), srgb(g), srgb(b), alpha],
            texture,
            alpha_cutoff: match material.alpha_mode.as_deref() {
                Some("MASK") => Some(material.alpha_cutoff.unwrap_or(0.5)),
                Some("BLEND") => Some(BLEND_CUTOFF),
                _ => None,
            },
            double_sided: material.double_sided,
        });
        materials.push((id, info.map_or(0, |info| info.tex_coord)));
    }
    let plain = Material { double_sided: false, ..Material::default() };
    materials.push((parts.material(plain), 0));
    materials
}

/// A share of light as a byte of sRGB.
fn srgb(linear: f64) -> u8 {
    let share = match linear.clamp(0.0, 1.0) {
        linear if linear <= 0.003_130_8 => 12.92 * linear,
        linear => 1.055 * linear.powf(1.0 / 2.4) - 0.055,
    };
    (share * 255.0 + 0.5) as u8
}

fn texture(
    document: &Document,
    buffers: &Buffers,
    folder: &Path,
    index: usize,
) -> Result<Texture, Reason> {
    let source = document.textures[index].source.ok_or("no source that is read")?;
    match document.images.get(source).ok_or("its image is not there")? {
        Image { uri: Some(uri), .. } => picture::decode(&resource(uri, folder)?),
        Image { buffer_view: Some(view), .. } => {
            picture::decode(view_bytes(document, buffers, *view)?)
        }
        _ => Err("its image has no data".into()),
    }
}

/// The shapes of each mesh with their materials.
fn meshes(
    document: &Document,
    buffers: &Buffers,
    materials: &[(MaterialId, u32)],
    parts: &mut Assembly,
) -> Result<Vec<Vec<(MeshId, MaterialId)>>, ForeignFault> {
    let plain = materials.len() - 1;
    let mut is_used = vec![false; document.meshes.len()];
    for mesh in document.nodes.iter().filter_map(|node| node.mesh) {
        if let Some(used) = is_used.get_mut(mesh) {
            *used = true;
        }
    }
    let mut meshes = Vec::with_capacity(document.meshes.len());
    for (index, mesh) in document.meshes.iter().enumerate() {
        let mut shapes = Vec::new();
        for (at, primitive) in mesh.primitives.iter().enumerate().filter(|_| is_used[index]) {
            parts.go_on()?;
            if !matches!(primitive.mode.unwrap_or(4), 4..=6) {
                parts.report.no_triangles += 1;
                continue;
            }
            let material = primitive.material.unwrap_or(plain);
            let (material, uv_set) = materials.get(material).copied().unwrap_or_else(|| {
                parts.report.missing_materials += 1;
                materials[plain]
            });
            match shape_of(document, buffers, primitive, uv_set, parts) {
                Ok(raw) => shapes.extend(parts.shape(raw).into_iter().map(|id| (id, material))),
                Err(reason) => {
                    parts.report.unreadable += 1;
                    parts.report.note(format!("mesh {index}, primitive {at}: {reason}"));
                }
            }
        }
        meshes.push(shapes);
    }
    Ok(meshes)
}

fn shape_of(
    document: &Document,
    buffers: &Buffers,
    primitive: &Primitive,
    uv_set: u32,
    parts: &mut Assembly,
) -> Result<RawShape, Reason> {
    if let Some(name) = primitive.extensions.keys().find(|name| name.contains("compression")) {
        return Err(format!("{name} is not read"));
    }
    let attribute = |name: &str| -> Option<Result<(Vec<f64>, usize), Reason>> {
        primitive.attributes.get(name).map(|&index| rows(document, buffers, index))
    };
    let (positions, width) = attribute("POSITION").ok_or("no positions")??;
    if width != 3 {
        return Err(format!("positions of {width} numbers"));
    }
    let positions: Vec<DVec3> = positions.chunks_exact(3).map(DVec3::from_slice).collect();
    let mut raw = RawShape { positions, ..RawShape::default() };
    // What only adorns may be missing.
    let mut optional = |name: &str, widths: &[usize]| match attribute(name)? {
        Ok((values, width)) if widths.contains(&width) => Some((values, width)),
        Ok((_, width)) => {
            parts.report.note(format!("{name} of {width} numbers not used"));
            None
        }
        Err(reason) => {
            parts.report.note(format!("{name} not used: {reason}"));
            None
        }
    };
    if let Some((values, _)) = optional("NORMAL", &[3]) {
        raw.normals = values.chunks_exact(3).map(|n| [0, 1, 2].map(|i| n[i] as f32)).collect();
    }
    if let Some((values, _)) = optional(&format!("TEXCOORD_{uv_set}"), &[2]) {
        raw.uvs = values.chunks_exact(2).map(|uv| [uv[0] as f32, uv[1] as f32]).collect();
    }
    if let Some((values, width)) = optional("COLOR_0", &[3, 4]) {
        let color = |c: &[f64]| {
            let alpha = c.get(3).map_or(255, |a| (a.clamp(0.0, 1.0) * 255.0 + 0.5) as u8);
            [srgb(c[0]), srgb(c[1]), srgb(c[2]), alpha]
        };
        raw.colors = values.chunks_exact(width).map(color).collect();
    }
    let corners: Vec<u32> = match primitive.indices {
        None => (0..raw.positions.len() as u32).collect(),
        Some(index) => {
            let (values, width) = rows(document, buffers, index)?;
            if width != 1 {
                return Err(format!("indices of {width} numbers"));
            }
            values.into_iter().map(|value| value as u32).collect()
        }
    };
    raw.triangles = match primitive.mode.unwrap_or(4) {
        5 => corners
            .windows(3)
            .enumerate()
            .map(|(i, c)| if i % 2 == 0 { [c[0], c[1], c[2]] } else { [c[1], c[0], c[2]] })
            // Strips turn around by triangles without area; they are no fault.
            .filter(|[a, b, c]| a != b && b != c && a != c)
            .collect(),
        6 => corners
            .get(1..)
            .unwrap_or_default()
            .windows(2)
            .map(|c| [corners[0], c[0], c[1]])
            .collect(),
        _ => {
            parts.report.damaged += u64::from(!corners.len().is_multiple_of(3));
            corners.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect()
        }
    };
    Ok(raw)
}

/// Walks the nodes of the scene and places what they name. Each node is entered once: nodes are a
/// tree, and whatever else a file makes of them could be endless.
fn place_nodes(document: &Document, meshes: &[Vec<(MeshId, MaterialId)>], parts: &mut Assembly) {
    let nodes = &document.nodes;
    let mut roots: Vec<usize> = match document.scenes.get(document.scene.unwrap_or(0)) {
        Some(scene) => scene.nodes.clone(),
        None => {
            let mut is_child = vec![false; nodes.len()];
            for &child in nodes.iter().flat_map(|node| &node.children) {
                if let Some(is_child) = is_child.get_mut(child) {
                    *is_child = true;
                }
            }
            (0..nodes.len()).filter(|&node| !is_child[node]).collect()
        }
    };
    if roots.is_empty() && !nodes.is_empty() {
        // All of them hold each other: begin somewhere.
        roots.push(0);
    }
    let mut was_entered = vec![false; nodes.len()];
    let mut stack: Vec<(usize, DAffine3)> =
        roots.into_iter().rev().map(|node| (node, DAffine3::IDENTITY)).collect();
    while let Some((index, file_from_parent)) = stack.pop() {
        let Some(node) = nodes.get(index) else {
            parts.report.unreadable += 1;
            parts.report.note(format!("node {index} is not there"));
            continue;
        };
        if std::mem::replace(&mut was_entered[index], true) {
            parts.report.cyclic_nodes += 1;
            continue;
        }
        let file_from_node = file_from_parent * transform(node);
        if let Some(mesh) = node.mesh {
            match meshes.get(mesh) {
                Some(shapes) => {
                    for &(shape, material) in shapes {
                        parts.object(shape, material, file_from_node);
                    }
                }
                None => {
                    parts.report.unreadable += 1;
                    parts.report.note(format!("node {index}: mesh {mesh} is not there"));
                }
            }
        }
        stack.extend(node.children.iter().rev().map(|&child| (child, file_from_node)));
    }
}

fn transform(node: &Node) -> DAffine3 {
    if let Some(matrix) = node.matrix {
        let matrix = DMat4::from_cols_array(&matrix);
        return DAffine3::from_mat4(matrix);
    }
    let rotation = node.rotation.map_or(DQuat::IDENTITY, |[x, y, z, w]| {
        let turn = DQuat::from_xyzw(x, y, z, w);
        if turn.length_squared() > 0.0 { turn.normalize() } else { DQuat::IDENTITY }
    });
    DAffine3::from_scale_rotation_translation(
        node.scale.map_or(DVec3::ONE, DVec3::from),
        rotation,
        node.translation.map_or(DVec3::ZERO, DVec3::from),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_of_every_length() {
        for (text, bytes) in [("", &b""[..]), ("Zg==", b"f"), ("Zm8=", b"fo"), ("Zm9v", b"foo")] {
            assert_eq!(base64(text.as_bytes()).as_deref(), Some(bytes));
        }
        assert_eq!(base64(b"Zm9v!"), None);
    }

    #[test]
    fn references_are_decoded() {
        assert_eq!(percent_decoded("a%20b%2"), "a b%2");
        assert!(resource("https://example.com/a.bin", Path::new("")).is_err());
    }
}
