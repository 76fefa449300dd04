//! Model files in: glTF and GLB, OBJ with MTL, PLY with faces, STL.
//!
//! [`detect_model`] says whether a file is a model, [`read_model`] makes a
//! [`Model`] of it. As with scans no byte is trusted: counts are compared
//! with the bytes there are before anything is allocated, and what cannot be drawn (a triangle
//! without area, a texture that is missing, a node that holds itself) is left out and counted in a
//! [`ModelReport`], one line per kind. Only a file of which nothing can be read is an error.
//!
//! Placement is f64: coordinates that lie far from the origin are kept relative to the middle of
//! the file's shapes, and the place goes into the objects. The world is z-up; glTF is turned.
//! Large shapes are split (`shape`).
//!
//! Sources: Khronos, "glTF 2.0 Specification", 2021; Alias Wavefront, "Object Files (.obj)", 1995;
//! Turk, "The PLY Polygon File Format", 1994; 3D Systems, "StereoLithography Interface
//! Specification", 1989.

mod accessor;
mod gltf;
mod gltf_json;
mod mtl;
mod obj;
mod picture;
mod ply;
mod report;
mod shape;
mod stl;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{DAffine3, DMat3, DVec3};

pub use report::{ModelReadError, ModelReport};

use super::detect::open_regular;
use super::foreign::ForeignFault;
use super::positioned_file::PositionedFile;
use crate::mesh::Model;

/// What kind of model a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ModelFormat {
    /// glTF, text.
    Gltf,
    /// glTF, one binary file.
    Glb,
    /// Wavefront OBJ.
    Obj,
    /// A Stanford polygon file with faces.
    Ply,
    /// STL, text or binary.
    Stl,
}

impl ModelFormat {
    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            ModelFormat::Gltf => "gltf",
            ModelFormat::Glb => "glb",
            ModelFormat::Obj => "obj",
            ModelFormat::Ply => "ply mesh",
            ModelFormat::Stl => "stl",
        }
    }
}

/// Which axis of a file points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UpAxis {
    /// y, as in glTF; turned by a quarter about x.
    Y,
    /// z, as in scans.
    Z,
}

/// How models are placed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ModelOptions {
    /// The axis that points up; of none y in glTF and z in all others.
    pub up: Option<UpAxis>,
    /// Added to all coordinates, after turning.
    pub offset: DVec3,
}

/// A model and what there is to tell about its file.
#[derive(Clone, Debug)]
pub struct ReadModel {
    /// Its shapes and objects; always sound by [`Model::check`].
    pub model: Model,
    /// The kind of file.
    pub format: ModelFormat,
    /// Length of the file, without those it names.
    pub file_bytes: u64,
    /// What was left out.
    pub report: ModelReport,
}

/// What kind of model a file is; `None` for all other files, and for those that cannot be read.
pub fn detect_model(path: &Path) -> Option<ModelFormat> {
    let file = open_regular(path).ok()?;
    let head = file.read_range(0..file.bytes().min(16)).ok()?;
    if head.starts_with(b"glTF") {
        return Some(ModelFormat::Glb);
    }
    if head.starts_with(b"ply") {
        return ply::has_faces(&file).then_some(ModelFormat::Ply);
    }
    match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
        "gltf" => Some(ModelFormat::Gltf),
        "glb" => Some(ModelFormat::Glb),
        "obj" => Some(ModelFormat::Obj),
        "stl" => Some(ModelFormat::Stl),
        _ => None,
    }
}

/// Suffixes of model files; a PLY file is one if it has faces.
pub fn model_suffixes() -> impl Iterator<Item = &'static str> {
    ["gltf", "glb", "obj", "stl"].into_iter()
}

/// Reads a model.
///
/// # Errors
/// If the file cannot be read, is no model, or holds nothing that can be drawn.
pub fn read_model(path: &Path, options: &ModelOptions) -> Result<ReadModel, ModelReadError> {
    read_model_until(path, options, &Arc::default())
}

/// Reads a model, unless it is cancelled meanwhile: then reading ends soon, with an error.
///
/// # Errors
/// As [`read_model`], and if it was cancelled.
pub fn read_model_until(
    path: &Path,
    options: &ModelOptions,
    cancelled: &Arc<AtomicBool>,
) -> Result<ReadModel, ModelReadError> {
    let in_file = |fault| ModelReadError::new(path, fault);
    let file = open_regular(path).map_err(|fault| in_file(fault.into()))?;
    let format = detect_model(path)
        .ok_or_else(|| in_file(ForeignFault::at("header", "not a model (glTF, OBJ, PLY, STL)")))?;
    let (model, report) = parse(&file, path, format, options, cancelled).map_err(in_file)?;
    if model.is_empty() {
        let why = report.lines().into_iter().next().unwrap_or_else(|| "it holds none".into());
        return Err(in_file(ForeignFault::at("file", format!("no triangle to draw: {why}"))));
    }
    if let Err(error) = model.check() {
        return Err(in_file(ForeignFault::at("model", error.to_string())));
    }
    Ok(ReadModel { model, format, file_bytes: file.bytes(), report })
}

fn parse(
    file: &PositionedFile,
    path: &Path,
    format: ModelFormat,
    options: &ModelOptions,
    cancelled: &Arc<AtomicBool>,
) -> Result<(Model, ModelReport), ForeignFault> {
    let up = options.up.unwrap_or(match format {
        ModelFormat::Gltf | ModelFormat::Glb => UpAxis::Y,
        _ => UpAxis::Z,
    });
    let turned = match up {
        UpAxis::Y => DMat3::from_cols(DVec3::X, DVec3::Z, -DVec3::Y),
        UpAxis::Z => DMat3::IDENTITY,
    };
    let world_from_file = DAffine3::from_mat3_translation(turned, options.offset);
    let mut parts = shape::Assembly::new(world_from_file, cancelled.clone());
    let bytes = all_bytes(file, &parts)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    match format {
        ModelFormat::Gltf | ModelFormat::Glb => gltf::read(&bytes, folder, &mut parts)?,
        ModelFormat::Obj => obj::read(&bytes, folder, &mut parts)?,
        ModelFormat::Ply => ply::read(file, &bytes, &mut parts)?,
        ModelFormat::Stl => stl::read(&bytes, &mut parts)?,
    }
    Ok(parts.finish())
}

/// Bytes read between two looks at whether anybody still wants them.
const READ_BYTES: u64 = 32 << 20;

fn all_bytes(file: &PositionedFile, parts: &shape::Assembly) -> Result<Vec<u8>, ForeignFault> {
    let total = file.bytes();
    if total <= READ_BYTES {
        parts.go_on()?;
        return Ok(file.read_range(0..total)?);
    }
    let mut bytes = Vec::new();
    for first in (0..total).step_by(READ_BYTES as usize) {
        parts.go_on()?;
        bytes.extend_from_slice(&file.read_range(first..total.min(first + READ_BYTES))?);
    }
    Ok(bytes)
}
