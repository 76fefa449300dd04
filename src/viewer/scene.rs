//! What is on view: files and models that come, go, and take each other's place.

use std::mem;
use std::sync::Arc;

use crate::frame::NodeSource;
use crate::viewer::app::Viewer;
use crate::viewer::models::{self, OpenedModel};
use crate::viewer::opening::OpenedFile;

impl Viewer {
    pub(super) fn show_files(&mut self, files: Vec<OpenedFile>) {
        self.replace_if_asked();
        let count = self.files.len();
        if let Some(preview) = self.preview.take() {
            self.files.retain(|file| !Arc::ptr_eq(&file.store, &preview));
        }
        let takes_over = self.files.len() < count;
        self.files.extend(files);
        self.take_scene(takes_over);
        // Files that come one by one are framed together, unless somebody looks around already.
        if !takes_over && !self.was_moved {
            self.asked_view = Some(self.options.view);
        }
    }

    /// Takes away what is on view if what comes is to take its place.
    fn replace_if_asked(&mut self) {
        if mem::take(&mut self.replaces) {
            self.files.clear();
            if !self.models.is_empty() {
                self.models.clear();
                self.renderer.set_model(models::joined(&self.models));
            }
            self.was_moved = false;
        }
    }

    pub(super) fn show_model(&mut self, model: OpenedModel) {
        let replaces = self.replaces;
        self.replace_if_asked();
        self.models.push(model);
        self.take_models();
        if replaces {
            self.take_scene(false);
        }
        if !self.was_moved {
            self.asked_view = Some(self.options.view);
        }
    }

    /// Gives the renderer the models on view.
    pub(super) fn take_models(&mut self) {
        self.leave_second_camera();
        self.renderer.set_model(models::joined(&self.models));
        self.is_new_scene = true;
        self.control.set_bounds(&self.renderer.bounds());
        self.zoom_anchor = None;
        self.refused = None;
    }

    /// Gives the renderer what is on view. A scene that `takes_over` shows what the last one did,
    /// only better: nothing but detail may change.
    pub(super) fn take_scene(&mut self, takes_over: bool) {
        self.leave_second_camera();
        let sources = self.files.iter().map(|file| file.store.clone() as Arc<dyn NodeSource>);
        let sources: Vec<_> = sources.collect();
        let offers = |source: &Arc<dyn NodeSource>| self.settings.color.is_offered_by(&**source);
        if !sources.iter().any(offers) {
            self.settings.color = Default::default();
        }
        match takes_over {
            true => self.renderer.replace_scene(sources),
            false => self.renderer.set_scene(sources),
        }
        self.takes_over = takes_over;
        self.is_new_scene = true;
        self.control.set_bounds(&self.renderer.bounds());
        self.zoom_anchor = None;
        self.refused = None;
    }
}
