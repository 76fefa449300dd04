//! What single numbers of an attribute are called in files that know no vectors.

use crate::points::{Attribute, names};

/// One name per component: the attribute's own where it has one component.
pub(super) fn component_names(attribute: &Attribute) -> Vec<String> {
    let name = &attribute.name;
    let count = usize::from(attribute.components);
    match (name.as_str(), count) {
        (_, 1) => vec![name.clone()],
        (names::RGB, 3) => ["red", "green", "blue"].map(str::to_string).to_vec(),
        (_, 2 | 3) => {
            ["x", "y", "z"][..count].iter().map(|axis| format!("{name}_{axis}")).collect()
        }
        _ => (0..count).map(|component| format!("{name}_{component}")).collect(),
    }
}
