//! WGSL files, joined by `#import` and compiled into the program.
//!
//! A line `#import name` is replaced by the file of that name, once per shader however often it is
//! asked for; the shared constants come first ([`layout::prelude`]).
//! No conditions and no macros: what differs between adapters is a file under another name.

use std::borrow::Cow;

use crate::gpu::{Gpu, GpuError, layout};

macro_rules! files {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../../shaders/", $name, ".wgsl"))),)*]
    };
}

/// Every file; those in no folder are whole shaders, the others are imported.
const FILES: &[(&str, &str)] = files![
    "checkpoint",
    "points_compute",
    "points_bare",
    "points_raster",
    "grow",
    "resolve",
    "fill_gaps",
    "eye_dome",
    "meshes",
    "occlusion_boxes",
    "depth_pyramid",
    "pyramid_answers",
    "two_pass",
    "show",
    "shared/structs",
    "shared/pyramid_test",
    "shared/frame",
    "shared/frame_once",
    "shared/scene",
    "shared/splat",
    "shared/splat_shape",
    "shared/pictures",
    "variants/pixels_64",
    "variants/pixels_32",
    "variants/nearest_so_far_load",
    "variants/nearest_so_far_unknown",
];

/// How compute shaders hold the nearest point of each pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelAtomics {
    /// 64-bit atomics that can be read.
    Wide,
    /// 64-bit atomics that know only minimum and maximum (Metal): nothing is known of a pixel, so
    /// that every point goes to the atomic operation.
    WideUnread,
    /// Pairs of 32-bit atomics and two passes, for adapters without wider ones.
    Narrow,
}

/// The shaders of the passes, by file name without suffix.
pub fn names() -> impl Iterator<Item = &'static str> {
    FILES.iter().map(|(name, _)| *name).filter(|name| !name.contains('/'))
}

/// The whole text of a shader of [`names`].
///
/// `name` must be one of our files and imports must exist: both are known when this is compiled,
/// and `tests/shader_layout.rs` goes through all of them.
pub fn source(name: &str, atomics: PixelAtomics) -> String {
    let mut joined = layout::prelude();
    let mut seen = vec![name.to_owned()];
    append(file(name), atomics, &mut seen, &mut joined);
    joined
}

/// Compiles a shader that has no pixels of its own.
pub fn module(gpu: &Gpu, name: &str) -> Result<wgpu::ShaderModule, GpuError> {
    module_with(gpu, name, PixelAtomics::Narrow)
}

/// Compiles a shader.
pub fn module_with(
    gpu: &Gpu,
    name: &str,
    atomics: PixelAtomics,
) -> Result<wgpu::ShaderModule, GpuError> {
    let text = source(name, atomics);
    gpu.checked("compile a shader", || {
        gpu.device().create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(name),
            source: wgpu::ShaderSource::Wgsl(Cow::Owned(text)),
        })
    })
}

fn append(text: &str, atomics: PixelAtomics, seen: &mut Vec<String>, joined: &mut String) {
    for line in text.lines() {
        let Some(import) = line.strip_prefix("#import ") else {
            joined.push_str(line);
            joined.push('\n');
            continue;
        };
        let import = match (import.trim(), atomics) {
            ("pixels", PixelAtomics::Narrow) => "variants/pixels_32",
            ("pixels", _) => "variants/pixels_64",
            ("nearest_so_far", PixelAtomics::Wide) => "variants/nearest_so_far_load",
            ("nearest_so_far", _) => "variants/nearest_so_far_unknown",
            (import, _) => import,
        };
        if !seen.iter().any(|name| name == import) {
            seen.push(import.to_owned());
            append(file(import), atomics, seen, joined);
        }
    }
}

fn file(name: &str) -> &'static str {
    let found = FILES.iter().find(|(file, _)| *file == name);
    found.unwrap_or_else(|| panic!("no shader file is named {name}")).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_file_is_joined_once() {
        let text = source("points_compute", PixelAtomics::Wide);
        assert_eq!(text.matches("struct GpuNode").count(), 1);
        assert_eq!(text.matches("const WORKGROUP_SIZE").count(), 1);
        assert!(!text.contains("#import"));
    }
}
