//! Small model files, written by tests: a unit cube in each format.

#![allow(dead_code, reason = "each test binary uses a part")]

use std::fs;
use std::path::{Path, PathBuf};

/// Corners of the unit cube.
pub const CORNERS: [[f64; 3]; 8] = [
    [0.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [1.0, 1.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, 1.0],
    [1.0, 0.0, 1.0],
    [1.0, 1.0, 1.0],
    [0.0, 1.0, 1.0],
];

/// Its faces, counter-clockwise seen from outside.
pub const FACES: [[u32; 4]; 6] =
    [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]];

/// Its triangles.
pub fn triangles() -> Vec<[u32; 3]> {
    FACES.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect()
}

/// Writes a file and returns its path.
pub fn write(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.join(name);
    fs::write(&path, bytes).expect("the file is written");
    path
}

/// A PNG of 2 by 2 pixels: red, green; blue, white.
pub fn png() -> Vec<u8> {
    use image::ImageEncoder;
    let mut bytes = Vec::new();
    let pixels = [255, 0, 0, 255, 0, 255, 0, 255, 0, 0, 255, 255, 255, 255, 255, 255];
    image::codecs::png::PngEncoder::new(&mut bytes)
        .write_image(&pixels, 2, 2, image::ExtendedColorType::Rgba8)
        .expect("the picture is encoded");
    bytes
}

/// Base64 of bytes.
pub fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for three in bytes.chunks(3) {
        let word =
            three.iter().enumerate().fold(0u32, |w, (i, &b)| w | u32::from(b) << (16 - 8 * i));
        for letter in 0..4 {
            let is_there = letter <= three.len();
            let six = (word >> (18 - 6 * letter)) as usize & 63;
            text.push(if is_there { LETTERS[six] as char } else { '=' });
        }
    }
    text
}

/// The cube's positions (f32) and indices (u16), as glTF buffers have them: 96 and 72 bytes.
pub fn gltf_buffer() -> Vec<u8> {
    let positions = CORNERS.iter().flatten().flat_map(|&x| (x as f32).to_le_bytes());
    let indices = triangles().into_iter().flatten();
    positions.chain(indices.flat_map(|i| (i as u16).to_le_bytes())).collect()
}

/// A glTF document over [`gltf_buffer`]; `nodes` is the text of the list of nodes, `buffer` that
/// of the buffer without its length.
pub fn gltf_document(nodes: &str, buffer: &str) -> String {
    format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}],
        "nodes": [{nodes}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}, "indices": 1,
            "material": 0}}]}}],
        "materials": [{{"pbrMetallicRoughness": {{"baseColorFactor": [1, 0.5, 0, 1]}},
            "doubleSided": true}}],
        "accessors": [
            {{"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"}},
            {{"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"}}],
        "bufferViews": [{{"buffer": 0, "byteLength": 96}},
            {{"buffer": 0, "byteOffset": 96, "byteLength": 72}}],
        "buffers": [{{"byteLength": 168{buffer}}}]}}"#
    )
}

/// The document with its buffer inside.
pub fn gltf(nodes: &str) -> String {
    let data = base64(&gltf_buffer());
    gltf_document(nodes, &format!(r#", "uri": "data:application/octet-stream;base64,{data}""#))
}

/// The document as one binary file.
pub fn glb(nodes: &str) -> Vec<u8> {
    let mut json = gltf_document(nodes, "").into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let blob = gltf_buffer();
    let mut bytes = b"glTF".to_vec();
    let total = 12 + 8 + json.len() + 8 + blob.len();
    bytes.extend([2u32, total as u32, json.len() as u32].into_iter().flat_map(u32::to_le_bytes));
    bytes.extend(b"JSON");
    bytes.extend(&json);
    bytes.extend((blob.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(&blob);
    bytes
}

/// The cube as OBJ text, moved.
pub fn obj(at: [f64; 3]) -> String {
    let vertex = |c: &[f64; 3]| format!("v {} {} {}\n", c[0] + at[0], c[1] + at[1], c[2] + at[2]);
    let face = |f: &[u32; 4]| format!("f {} {} {} {}\n", f[0] + 1, f[1] + 1, f[2] + 1, f[3] + 1);
    let vertices: String = CORNERS.iter().map(vertex).collect();
    vertices + &FACES.iter().map(face).collect::<String>()
}

/// How a PLY file is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PlyKind {
    Ascii,
    Little,
    Big,
}

/// The cube as PLY with coordinates in f64 and colours, moved.
pub fn ply(kind: PlyKind, at: [f64; 3]) -> Vec<u8> {
    let name = match kind {
        PlyKind::Ascii => "ascii",
        PlyKind::Little => "binary_little_endian",
        PlyKind::Big => "binary_big_endian",
    };
    let mut bytes = format!(
        "ply\nformat {name} 1.0\nelement vertex 8\nproperty double x\nproperty double y\n\
         property double z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
         element face 6\nproperty list uchar int vertex_indices\nend_header\n"
    )
    .into_bytes();
    let color = |i: usize| [10 * i as u8, 200, 7];
    for (i, corner) in CORNERS.iter().enumerate() {
        let place: [f64; 3] = std::array::from_fn(|axis| corner[axis] + at[axis]);
        let [r, g, b] = color(i);
        match kind {
            PlyKind::Ascii => {
                let [x, y, z] = place;
                bytes.extend(format!("{x} {y} {z} {r} {g} {b}\n").bytes());
            }
            PlyKind::Little => bytes.extend(place.iter().flat_map(|x| x.to_le_bytes())),
            PlyKind::Big => bytes.extend(place.iter().flat_map(|x| x.to_be_bytes())),
        }
        if kind != PlyKind::Ascii {
            bytes.extend([r, g, b]);
        }
    }
    for face in &FACES {
        match kind {
            PlyKind::Ascii => {
                let [a, b, c, d] = face;
                bytes.extend(format!("4 {a} {b} {c} {d}\n").bytes());
            }
            PlyKind::Little => {
                bytes.push(4);
                bytes.extend(face.iter().flat_map(|i| i.to_le_bytes()));
            }
            PlyKind::Big => {
                bytes.push(4);
                bytes.extend(face.iter().flat_map(|i| i.to_be_bytes()));
            }
        }
    }
    bytes
}

/// The cube as binary STL.
pub fn stl_binary() -> Vec<u8> {
    let mut bytes = vec![b' '; 80];
    bytes[..5].copy_from_slice(b"solid");
    bytes.extend((triangles().len() as u32).to_le_bytes());
    for triangle in triangles() {
        bytes.extend([0; 12]);
        let corners = triangle.iter().flat_map(|&v| CORNERS[v as usize]);
        bytes.extend(corners.flat_map(|x| (x as f32).to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

/// The cube as STL text.
pub fn stl_text() -> String {
    let mut text = "solid cube\n".to_string();
    for triangle in triangles() {
        text += "facet normal 0 0 0\n outer loop\n";
        for v in triangle {
            let [x, y, z] = CORNERS[v as usize];
            text += &format!("  vertex {x:e} {y} {z}\n");
        }
        text += " endloop\nendfacet\n";
    }
    text + "endsolid cube\n"
}
