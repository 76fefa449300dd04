//! Models among the files of a command: how they are placed, and what is told about them.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use glam::DVec3;
use serde_json::{Value, json};

use crate::input::{ModelOptions, ReadModel, UpAxis, detect_model, read_model};
use crate::mesh::Model;

/// Options of commands that take models.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct ModelArgs {
    /// Moves models (glTF, GLB, OBJ, STL, PLY with faces) by that much, for those whose
    /// georeferenced offset stands in another file
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_offset, allow_hyphen_values = true)]
    mesh_offset: Option<DVec3>,
    /// Axis of models that points up [default: y in glTF, z in all others]
    #[arg(long, value_enum)]
    up: Option<UpChoice>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum UpChoice {
    Y,
    Z,
}

impl ModelArgs {
    /// How models are read.
    pub fn options(&self) -> ModelOptions {
        ModelOptions {
            up: self.up.map(|up| match up {
                UpChoice::Y => UpAxis::Y,
                UpChoice::Z => UpAxis::Z,
            }),
            offset: self.mesh_offset.unwrap_or_default(),
        }
    }
}

/// The models among files, and the others.
pub fn split(files: Vec<PathBuf>) -> (Vec<PathBuf>, Vec<PathBuf>) {
    files.into_iter().partition(|path| detect_model(path).is_some())
}

/// Reads models into one and says what was left out of them.
pub fn load(files: &[PathBuf], options: &ModelOptions) -> anyhow::Result<Model> {
    let mut all = Model::default();
    for path in files {
        let read = read_model(path, options)?;
        for line in read.report.lines() {
            eprintln!("esker: {line}: {}", path.display());
        }
        all.append(read.model);
    }
    Ok(all)
}

/// What there is to tell about a model.
pub fn facts(path: &Path, options: &ModelOptions) -> anyhow::Result<Value> {
    let ReadModel { model, format, file_bytes, report } = read_model(path, options)?;
    let bounds = model.bounds();
    let shape_triangles: usize = model.meshes.iter().map(|mesh| mesh.triangles.len()).sum();
    let vertices: usize = model.meshes.iter().map(|mesh| mesh.positions.len()).sum();
    let textures: Vec<String> =
        model.textures.iter().map(|t| format!("{}x{}", t.width, t.height)).collect();
    Ok(json!({
        "file": path, "format": format.name(),
        "triangles": model.triangle_count(), "objects": model.objects.len(),
        "shapes": model.meshes.len(), "shape_triangles": shape_triangles, "vertices": vertices,
        "materials": model.materials.len(),
        "textures": (!textures.is_empty()).then_some(textures),
        "bounds": {"min": bounds.min.to_array(), "max": bounds.max.to_array()},
        "triangles_left_out": report.triangles_left_out(),
        "file_bytes": file_bytes, "warnings": report.lines(),
    }))
}

fn parse_offset(text: &str) -> Result<DVec3, String> {
    let numbers: Vec<f64> = text.split(',').map_while(|word| word.trim().parse().ok()).collect();
    match numbers[..] {
        [x, y, z] if text.matches(',').count() == 2 && DVec3::new(x, y, z).is_finite() => {
            Ok(DVec3::new(x, y, z))
        }
        _ => Err(format!("'{text}' is not X,Y,Z")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offsets_are_three_numbers() {
        assert_eq!(parse_offset("450000,-5.2e6, 3"), Ok(DVec3::new(450_000.0, -5.2e6, 3.0)));
        for bad in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,inf"] {
            assert!(parse_offset(bad).is_err(), "{bad}");
        }
    }
}
