//! Made models as binary glTF: shapes once, colours, and a node for each object.
//!
//! A root node turns z-up to glTF's y-up by whole numbers, so that places come back exactly.
//! Source: Khronos, "glTF 2.0 Specification", sections 3.5 to 3.9 and 4.4. No textures, normals or
//! texture coordinates: made models have none.

use std::collections::HashMap;
use std::io::Write;
use std::path::Path;

use anyhow::Context;
use glam::DVec3;
use serde_json::{Value, json};

use crate::mesh::{Mesh, Model};

const FLOAT: u32 = 5126;
const UNSIGNED: u32 = 5125;
const MAGIC: u32 = 0x4654_6c67;
const JSON_CHUNK: u32 = 0x4e4f_534a;
const BINARY_CHUNK: u32 = 0x004e_4942;

/// Writes a model moved by `origin`; the file appears when it is whole.
pub(super) fn write(model: &Model, origin: DVec3, path: &Path) -> anyhow::Result<()> {
    let (document, binary) = document(model, origin)?;
    let mut text = serde_json::to_vec(&document)?;
    text.resize(text.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + text.len() + 8 + binary.len();
    let total = u32::try_from(total).context("a binary glTF file has less than 4 GiB")?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let mut file = tempfile::NamedTempFile::new_in(folder.unwrap_or(Path::new(".")))
        .with_context(|| format!("{}: cannot write", path.display()))?;
    let mut words = |list: &[u32]| list.iter().try_for_each(|w| file.write_all(&w.to_le_bytes()));
    words(&[MAGIC, 2, total, text.len() as u32, JSON_CHUNK])?;
    file.write_all(&text)?;
    let mut words = |list: &[u32]| list.iter().try_for_each(|w| file.write_all(&w.to_le_bytes()));
    words(&[binary.len() as u32, BINARY_CHUNK])?;
    file.write_all(&binary)?;
    file.persist(path).with_context(|| format!("{}: cannot write", path.display()))?;
    Ok(())
}

fn document(model: &Model, origin: DVec3) -> anyhow::Result<(Value, Vec<u8>)> {
    let mut binary = Vec::new();
    let (mut views, mut accessors) = (Vec::new(), Vec::new());
    for mesh in &model.meshes {
        add_shape(mesh, &mut binary, &mut views, &mut accessors);
    }
    // A glTF mesh names its material: one for each pair that is used.
    let mut pairs = HashMap::new();
    let mut meshes = Vec::new();
    // Node 0 is the root.
    let mut nodes = vec![Value::Null];
    for object in &model.objects {
        let mesh = *pairs.entry((object.mesh, object.material)).or_insert_with(|| {
            let first = 2 * object.mesh.index();
            meshes.push(json!({ "primitives": [{
                "attributes": { "POSITION": first },
                "indices": first + 1,
                "material": object.material.0,
            }] }));
            meshes.len() - 1
        });
        let place = object.world_from_mesh;
        let columns = [
            place.matrix3.x_axis.extend(0.0),
            place.matrix3.y_axis.extend(0.0),
            place.matrix3.z_axis.extend(0.0),
            (place.translation + origin).extend(1.0),
        ];
        let matrix: Vec<f64> = columns.iter().flat_map(|column| column.to_array()).collect();
        nodes.push(json!({ "mesh": mesh, "matrix": matrix }));
    }
    let children: Vec<usize> = (1..nodes.len()).collect();
    nodes[0] = json!({
        "matrix": [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1],
        "children": children,
    });
    let materials: Vec<Value> = model
        .materials
        .iter()
        .map(|material| {
            let [red, green, blue, alpha] = material.color;
            let [red, green, blue] = [red, green, blue].map(linear);
            json!({
                "pbrMetallicRoughness": {
                    "baseColorFactor": [red, green, blue, f64::from(alpha) / 255.0],
                    "metallicFactor": 0.0,
                },
                "doubleSided": material.double_sided,
            })
        })
        .collect();
    binary.resize(binary.len().next_multiple_of(4), 0);
    let document = json!({
        "asset": { "version": "2.0", "generator": "esker generate" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": nodes,
        "meshes": meshes,
        "materials": materials,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{ "byteLength": binary.len() }],
    });
    Ok((document, binary))
}

/// Corners and triangles of a shape: two views, two accessors.
fn add_shape(
    mesh: &Mesh,
    binary: &mut Vec<u8>,
    views: &mut Vec<Value>,
    accessors: &mut Vec<Value>,
) {
    let mut add =
        |bytes: &[u8], component: u32, kind: &str, count: usize, range: Option<[[f32; 3]; 2]>| {
            let view = views.len();
            views.push(
                json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": bytes.len() }),
            );
            let mut accessor = json!({
                "bufferView": view, "componentType": component, "type": kind, "count": count,
            });
            if let Some([low, high]) = range {
                accessor["min"] = json!(low);
                accessor["max"] = json!(high);
            }
            accessors.push(accessor);
            binary.extend_from_slice(bytes);
        };
    let bounds = mesh.bounds();
    let range = [bounds.min, bounds.max].map(|corner| corner.as_vec3().to_array());
    let corners = bytemuck::cast_slice(&mesh.positions);
    add(corners, FLOAT, "VEC3", mesh.positions.len(), Some(range));
    let indices: &[u8] = bytemuck::cast_slice(&mesh.triangles);
    add(indices, UNSIGNED, "SCALAR", 3 * mesh.triangles.len(), None);
}

/// Linear light of an sRGB byte.
fn linear(byte: u8) -> f64 {
    let share = f64::from(byte) / 255.0;
    if share <= 0.04045 { share / 12.92 } else { ((share + 0.055) / 1.055).powf(2.4) }
}
