//! What was left out of a model, counted by kind, and why a file is no model.

use std::path::{Path, PathBuf};

use crate::input::foreign::ForeignFault;

/// A model file that cannot be read, and why.
#[derive(Debug, thiserror::Error)]
#[error("{fault}: {}", path.display())]
pub struct ModelReadError {
    /// The file.
    pub path: PathBuf,
    /// The place and the reason.
    #[source]
    pub fault: ForeignFault,
}

impl ModelReadError {
    pub(super) fn new(path: &Path, fault: ForeignFault) -> Self {
        ModelReadError { path: path.to_path_buf(), fault }
    }
}

/// What a file held that is not drawn, or is drawn otherwise than it says.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct ModelReport {
    /// Triangles with a corner that is not finite.
    pub not_finite: u64,
    /// Triangles that name a vertex that is not there.
    pub out_of_range: u64,
    /// Triangles without area.
    pub zero_area: u64,
    /// Triangles that repeat another one of their shape.
    pub duplicate: u64,
    /// Faces or rows that make no sense.
    pub damaged: u64,
    /// Primitives that are points or lines.
    pub no_triangles: u64,
    /// Nodes that hold themselves, or are held twice.
    pub cyclic_nodes: u64,
    /// Nodes or primitives whose data cannot be read.
    pub unreadable: u64,
    /// Textures that are missing or cannot be decoded; their surfaces have a plain colour.
    pub missing_textures: u64,
    /// Materials that are named but not there.
    pub missing_materials: u64,
    /// What else there is to tell, with the reason of the first fault of a kind.
    pub notes: Vec<String>,
}

/// Most notes that are kept.
const MOST_NOTES: usize = 16;

impl ModelReport {
    /// Adds a note, unless there are many already.
    pub(super) fn note(&mut self, note: String) {
        if self.notes.len() < MOST_NOTES && !self.notes.contains(&note) {
            self.notes.push(note);
        }
    }

    /// Triangles left out.
    pub fn triangles_left_out(&self) -> u64 {
        self.not_finite + self.out_of_range + self.zero_area + self.duplicate
    }

    /// One line per kind of fault; none for a sound file.
    pub fn lines(&self) -> Vec<String> {
        let counted = [
            (self.not_finite, "triangle(s) left out: a corner is not finite"),
            (self.out_of_range, "triangle(s) left out: a vertex that is not there"),
            (self.zero_area, "triangle(s) left out: no area"),
            (self.duplicate, "triangle(s) left out: the same as another"),
            (self.damaged, "row(s) left out: damaged"),
            (self.no_triangles, "primitive(s) left out: points or lines"),
            (self.cyclic_nodes, "node(s) left out: they hold themselves or are held twice"),
            (self.unreadable, "part(s) left out: their data cannot be read"),
            (self.missing_textures, "texture(s) missing: plain colour instead"),
            (self.missing_materials, "material(s) missing: plain colour instead"),
        ];
        let counted = counted.iter().filter(|(count, _)| *count > 0);
        let lines = counted.map(|(count, what)| format!("{count} {what}"));
        lines.chain(self.notes.iter().cloned()).collect()
    }
}
