//! PLY, the Stanford polygon format: its vertices as points.
//!
//! Text and both binary orders; elements before the vertices are passed over, lists and other
//! elements are left out and counted.
//!
//! Source: Turk, "The PLY Polygon File Format", 1994.

pub(super) mod header;
mod listed;

use super::detect::{ReadOptions, Signs};
use super::foreign::{ForeignFault, ForeignReader, ScanPart};
use super::positioned_file::PositionedFile;
use super::table::{
    AsciiEntry, AsciiRows, Field, FixedRows, RowPlan, TableFacts, is_single, open_table,
};
use header::{Element, Encoding, Header, Property};
use listed::ListedRows;

/// Suffixes of such files.
pub(super) const SUFFIXES: &[&str] = &["ply"];

/// Whether a file begins as one.
pub(super) fn claims(signs: &Signs) -> bool {
    signs.head.starts_with(b"ply\n") || signs.head.starts_with(b"ply\r")
}

/// Opens a file and looks through its vertices.
pub(super) fn open(
    file: PositionedFile,
    options: &ReadOptions,
) -> Result<Box<dyn ForeignReader>, ForeignFault> {
    let header = Header::read(&file)?;
    let is_cloud = |element: &Element| {
        let has = |name: &str| element.properties.iter().any(|property| property.is(name));
        has("x") && has("y") && has("z")
    };
    let place =
        header.elements.iter().position(is_cloud).ok_or_else(|| {
            ForeignFault::at("header", "no element has the properties x, y and z")
        })?;
    let (before, rest) = header.elements.split_at(place);
    let cloud = &rest[0];
    let entries: Vec<AsciiEntry> = cloud.properties.iter().map(entry_of).collect();
    let fields = match header.encoding {
        Encoding::Ascii => AsciiRows::packed_fields(&entries),
        _ => cloud.properties.iter().filter_map(field_of).collect(),
    };
    let plan = RowPlan::new(&fields, false)?;
    let mut facts = facts_of(&header, place);
    facts.salvaged = options.salvage.then_some(cloud.count);
    let swaps = header.encoding == Encoding::BigEndian;
    if header.encoding == Encoding::Ascii {
        let skipped = before.iter().map(|element| element.count).fold(0, u64::saturating_add);
        let start = (header.bytes, header.lines + 1);
        let rows =
            AsciiRows::new(file, start, skipped, cloud.count, &entries, &plan, options.salvage)?;
        return open_table(rows, plan, facts);
    }
    let start = listed::pass_over(&file, header.bytes, before, swaps)?;
    if cloud.has_lists() {
        let rows = ListedRows::new(file, start, cloud, swaps)?;
        return open_table(rows, plan, facts);
    }
    let sizes = cloud.properties.iter().filter_map(field_of).map(|f| f.scalar.bytes() as u8);
    let sizes = swaps.then(|| sizes.collect());
    let rows = FixedRows::new(file, start, cloud.count, plan.row_bytes, sizes, options.salvage)?;
    open_table(rows, plan, facts)
}

fn field_of(property: &Property) -> Option<Field> {
    match property {
        Property::Number { name, scalar } => {
            Some(Field { name: name.clone(), scalar: *scalar, count: 1 })
        }
        Property::List { .. } => None,
    }
}

fn entry_of(property: &Property) -> AsciiEntry {
    field_of(property).map_or(AsciiEntry::List, AsciiEntry::Field)
}

fn facts_of(header: &Header, place: usize) -> TableFacts {
    let cloud = &header.elements[place];
    let lists = cloud.properties.iter().filter_map(|property| match property {
        Property::List { name, .. } => {
            Some((format!("lists {name} of {}", cloud.name), cloud.count))
        }
        Property::Number { .. } => None,
    });
    let others = header.elements.iter().enumerate().filter(|(i, e)| *i != place && e.count > 0);
    let others = others.map(|(_, element)| (element.name.clone(), element.count));
    let declared = cloud.properties.iter().filter_map(|property| match property {
        Property::Number { name, scalar } => Some((name.as_str(), *scalar)),
        Property::List { .. } => None,
    });
    TableFacts {
        format: header.encoding.name().to_string(),
        is_single: is_single(declared),
        part: ScanPart { name: None, pose: None, points: 0 },
        applies_pose: true,
        skipped: lists.chain(others).collect(),
        warnings: Vec::new(),
        salvaged: None,
    }
}
