//! Both sides of the GPU's structs stay in step: every shader is valid WGSL, and every shared
//! struct has the size, field names and offsets that Rust has.
#![cfg(feature = "gpu")]

use esker::gpu::layout::{STRUCTS, StructLayout};
use esker::gpu::shader::{PixelAtomics, names, source};
use naga::valid::{Capabilities, ValidationFlags, Validator};

fn parse(name: &str, text: &str) -> naga::Module {
    naga::front::wgsl::parse_str(text)
        .unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(text)))
}

#[test]
fn every_shader_is_valid() {
    let capabilities = Capabilities::SHADER_INT64 | Capabilities::SHADER_INT64_ATOMIC_MIN_MAX;
    for name in names() {
        for atomics in [PixelAtomics::Wide, PixelAtomics::WideUnread, PixelAtomics::Narrow] {
            let text = source(name, atomics);
            let module = parse(name, &text);
            let validated = Validator::new(ValidationFlags::all(), capabilities).validate(&module);
            assert!(validated.is_ok(), "{name}: {}", validated.unwrap_err().emit_to_string(&text));
        }
    }
}

#[test]
fn shared_structs_are_laid_out_as_in_rust() {
    let mut checked = Vec::new();
    for name in names() {
        let module = parse(name, &source(name, PixelAtomics::Wide));
        for (_, ty) in module.types.iter() {
            let naga::TypeInner::Struct { members, span } = &ty.inner else { continue };
            let wgsl_name = ty.name.as_deref().expect("WGSL structs have names");
            let Some(rust) = STRUCTS.iter().find(|layout| layout.name == wgsl_name) else {
                assert!(!wgsl_name.starts_with("Gpu"), "{wgsl_name} has no Rust side");
                continue;
            };
            compare(name, rust, members, *span);
            checked.push(wgsl_name.to_owned());
        }
    }
    for layout in STRUCTS {
        assert!(checked.iter().any(|name| name == layout.name), "no shader has {}", layout.name);
    }
}

fn compare(shader: &str, rust: &StructLayout, members: &[naga::StructMember], span: u32) {
    let wgsl: Vec<_> = members
        .iter()
        .map(|member| (member.name.as_deref().unwrap_or(""), member.offset as usize))
        .collect();
    assert_eq!(wgsl, rust.fields, "{shader}: fields of {}", rust.name);
    assert_eq!(span as usize, rust.size, "{shader}: size of {}", rust.name);
}
