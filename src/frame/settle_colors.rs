//! Which colours a scene has: a colour mode, settled for each of its clouds.

use std::sync::Arc;

use crate::frame::color::{Coloring, elevation_range, shows_elevation};
use crate::frame::{ColorMode, NodeSource, Renderer};

impl Renderer {
    /// Settles how each cloud is coloured; a new mode drops all loaded nodes.
    pub(super) fn settle_colors(&mut self, mode: &ColorMode) {
        if self.colored_by.as_ref() == Some(mode) {
            return;
        }
        self.cache.clear();
        let mut problems = Vec::new();
        let mut noted = |result: Result<Option<(f64, f64)>, _>| {
            result.unwrap_or_else(|error: crate::store::NodeReadError| {
                problems.push(error.to_string());
                None
            })
        };
        let shown = |source: &&Arc<dyn NodeSource>| shows_elevation(mode, source.as_ref());
        let ranges = self.sources.iter().filter(shown);
        // One range for the whole scene, so that colours compare between clouds.
        let elevation = ranges
            .filter_map(|source| noted(elevation_range(source.as_ref())))
            .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        let mut coloring = Vec::new();
        for source in &self.sources {
            coloring.push(Coloring::settle(mode, source.as_ref(), elevation).unwrap_or_else(
                |error| {
                    problems.push(error.to_string());
                    Coloring::Plain
                },
            ));
        }
        if let Some((former_mode, former)) = self.former.take()
            && former_mode == *mode
        {
            for settled in &mut coloring {
                if let Some(near) = former.iter().find(|former| settled.is_near(former)) {
                    *settled = near.clone();
                }
            }
        }
        self.coloring = coloring;
        problems.into_iter().for_each(|problem| self.note_problem(problem));
        self.colored_by = Some(mode.clone());
    }
}
