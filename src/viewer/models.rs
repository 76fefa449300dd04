//! Models on view: read beside the window, shown together with the points.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use egui::{Grid, RichText, Ui};

use crate::geometry::Aabb;
use crate::input::{ModelOptions, read_model_until};
use crate::mesh::Model;
use crate::viewer::panels::{FileAction, grouped};

/// A model that is open.
#[derive(Clone, Debug)]
pub struct OpenedModel {
    /// Its file.
    pub path: PathBuf,
    /// Its shapes and objects.
    pub model: Arc<Model>,
    /// Their box.
    pub bounds: Aabb,
}

/// Reads a model, with a line for each kind of fault in it.
pub(super) fn open_model(
    path: &Path,
    options: &ModelOptions,
    cancelled: &Arc<AtomicBool>,
) -> anyhow::Result<(OpenedModel, Vec<String>)> {
    let read = read_model_until(path, options, cancelled)?;
    let lines = read.report.lines();
    let lines = lines.into_iter().map(|line| format!("{line}: {}", path.display())).collect();
    let bounds = read.model.bounds();
    Ok((OpenedModel { path: path.to_owned(), model: Arc::new(read.model), bounds }, lines))
}

/// All models as one; the only one as it is.
pub(super) fn joined(models: &[OpenedModel]) -> Arc<Model> {
    match models {
        [one] => one.model.clone(),
        more => {
            let mut all = Model::default();
            more.iter().for_each(|opened| all.append((*opened.model).clone()));
            Arc::new(all)
        }
    }
}

/// The models in the panel.
pub(super) fn list(ui: &mut Ui, models: &[OpenedModel]) -> Option<FileAction> {
    let mut asked = None;
    for (index, opened) in models.iter().enumerate() {
        ui.horizontal(|ui| {
            let name = opened.path.file_name().unwrap_or(opened.path.as_os_str()).to_string_lossy();
            let text = format!("{}\nClick to see all of it", opened.path.display());
            if ui.link(RichText::new(name).strong()).on_hover_text(text).clicked() {
                asked = Some(FileAction::Show(index));
            }
            if ui.small_button("x").on_hover_text("Close").clicked() {
                asked = Some(FileAction::Close(index));
            }
        });
        Grid::new(("model", index)).num_columns(2).spacing([8.0, 2.0]).show(ui, |ui| {
            let model = &opened.model;
            for (name, count) in [
                ("Triangles", model.triangle_count()),
                ("Objects", model.objects.len() as u64),
                ("Textures", model.textures.len() as u64),
            ] {
                ui.weak(name);
                ui.label(grouped(count));
                ui.end_row();
            }
        });
        ui.add_space(6.0);
    }
    asked
}
