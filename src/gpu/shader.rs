//! WGSL files, joined by `#import` and compiled into the program.
//!
//! A line `#import name` is replaced by the file of that name, once per shader however often it is
//! asked for; the shared constants come first ([`layout::prelude`]).
//! No conditions and no macros: what differs between adapters is a file under another name.

use std::borrow::Cow;

use crate::gpu::{Gpu, GpuError, layout};

/// The shaders of the passes, by file name without suffix.
pub const SHADERS: &[&str] = &["points_compute", "points_raster", "resolve"];

const FILES: &[(&str, &str)] = &[
    ("points_compute", include_str!("../../shaders/points_compute.wgsl")),
    ("points_raster", include_str!("../../shaders/points_raster.wgsl")),
    ("resolve", include_str!("../../shaders/resolve.wgsl")),
    ("shared/structs", include_str!("../../shaders/shared/structs.wgsl")),
    ("shared/scene", include_str!("../../shaders/shared/scene.wgsl")),
    ("shared/splat", include_str!("../../shaders/shared/splat.wgsl")),
    (
        "variants/nearest_so_far_load",
        include_str!("../../shaders/variants/nearest_so_far_load.wgsl"),
    ),
    (
        "variants/nearest_so_far_unknown",
        include_str!("../../shaders/variants/nearest_so_far_unknown.wgsl"),
    ),
];

/// Whether shaders may read 64-bit atomics; Metal offers only minimum and maximum on them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AtomicRead {
    /// They may.
    Load,
    /// They may not: every candidate goes to the atomic operation.
    Unknown,
}

/// The whole text of a shader of [`SHADERS`].
///
/// `name` must be one of our files and imports must exist: both are known when this is compiled,
/// and `tests/shader_layout.rs` goes through all of them.
pub fn source(name: &str, atomic_read: AtomicRead) -> String {
    source_with(name, file(name), atomic_read)
}

/// Like [`source`], for a text from elsewhere (a bench) that imports our files.
pub fn source_with(name: &str, text: &str, atomic_read: AtomicRead) -> String {
    let mut joined = layout::prelude();
    let mut seen = vec![name.to_owned()];
    append(text, atomic_read, &mut seen, &mut joined);
    joined
}

/// Compiles a shader.
pub fn module(gpu: &Gpu, name: &str) -> Result<wgpu::ShaderModule, GpuError> {
    module_of(gpu, name, source(name, gpu.atomic_read()))
}

/// Compiles a whole text, as [`source_with`] gives it.
pub fn module_of(gpu: &Gpu, name: &str, text: String) -> Result<wgpu::ShaderModule, GpuError> {
    gpu.checked("compile a shader", || {
        gpu.device().create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(name),
            source: wgpu::ShaderSource::Wgsl(Cow::Owned(text)),
        })
    })
}

fn append(text: &str, atomic_read: AtomicRead, seen: &mut Vec<String>, joined: &mut String) {
    for line in text.lines() {
        let Some(import) = line.strip_prefix("#import ") else {
            joined.push_str(line);
            joined.push('\n');
            continue;
        };
        let import = match (import.trim(), atomic_read) {
            ("nearest_so_far", AtomicRead::Load) => "variants/nearest_so_far_load",
            ("nearest_so_far", AtomicRead::Unknown) => "variants/nearest_so_far_unknown",
            (import, _) => import,
        };
        if !seen.iter().any(|name| name == import) {
            seen.push(import.to_owned());
            append(file(import), atomic_read, seen, joined);
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
        let text = source("points_compute", AtomicRead::Load);
        assert_eq!(text.matches("struct GpuNode").count(), 1);
        assert_eq!(text.matches("const WORKGROUP_SIZE").count(), 1);
        assert!(!text.contains("#import"));
    }
}
