//! Descriptions of extra bytes: what a LAS file says of fields that its point format has not.
//!
//! Source: ASPRS, "LAS Specification 1.4 - R15", tables 24 and 25.

use crate::input::{LasTemplate, describes_extra_bytes, extra_bytes};
use crate::points::{Attribute, Scalar};

/// Size of one description.
const ENTRY_BYTES: usize = 192;
/// Most bytes of a name.
pub(super) const NAME_BYTES: usize = 32;

/// One description as it stands in a file.
pub(super) type Entry = [u8; ENTRY_BYTES];

/// The description of a number.
pub(super) fn number_entry(name: &str, scalar: Scalar) -> Entry {
    use Scalar::*;
    let types = [U8, I8, U16, I16, U32, I32, U64, I64, F32, F64];
    let place = types.iter().position(|&t| t == scalar).expect("all types are listed");
    let mut entry = [0; ENTRY_BYTES];
    let length = name.len().min(NAME_BYTES);
    entry[2] = place as u8 + 1;
    entry[4..4 + length].copy_from_slice(&name.as_bytes()[..length]);
    entry
}

/// A scan's own descriptions, handed out in their order.
///
/// They say more than name and type (scale, range, a text), so what still fits is used again.
#[derive(Clone, Debug, Default)]
pub(super) struct ScanDescriptions {
    waiting: std::collections::VecDeque<Entry>,
}

impl ScanDescriptions {
    /// Those of a scan's header.
    pub fn of(template: &LasTemplate) -> Self {
        ScanDescriptions {
            waiting: data_of(template).chunks_exact(ENTRY_BYTES).map(to_entry).collect(),
        }
    }

    /// The next description, if it is that of the attribute.
    pub fn take(&mut self, attribute: &Attribute) -> Option<Entry> {
        let (described, _) = extra_bytes(self.waiting.front()?);
        let Some(described) = described.first() else {
            // It describes nothing.
            self.waiting.pop_front();
            return self.take(attribute);
        };
        // Where names repeat, the attribute's got a number behind it.
        let fits = attribute.name.starts_with(&described.name)
            && (attribute.scalar, attribute.components) == (described.scalar, described.components);
        if fits { self.waiting.pop_front() } else { None }
    }
}

fn to_entry(bytes: &[u8]) -> Entry {
    bytes.try_into().expect("chunks have the size of an entry")
}

/// The layout of the template's records, as its own descriptions say.
pub(super) fn schema_of(template: &LasTemplate) -> crate::points::Schema {
    let header = template.header();
    let (described, _) = extra_bytes(&data_of(template));
    header.point_format.schema(header.record_bytes, &described).0
}

/// All descriptions of a template; some scans have a record for each.
fn data_of(template: &LasTemplate) -> Vec<u8> {
    let records = template.vlrs().into_iter().filter(describes_extra_bytes);
    let places = records.map(|vlr| vlr.data.start as usize..vlr.data.end as usize);
    places.flat_map(|place| template.vlr_bytes()[place].to_vec()).collect()
}
