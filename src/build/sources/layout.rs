//! One record layout for sources of several: the union of their attributes by name.
//!
//! Types are widened where sources differ. The older point formats of LAS (0 to 5) pack returns,
//! flags and classes otherwise than the newer ones; beside newer ones, or beside other formats that
//! give classes of their own, they are taken over into the newer layout.
//!
//! Source: ASPRS, "LAS Specification 1.4 - R15", tables 7, 8, 13 and 15.

use std::collections::HashSet;

use crate::input::Scan;
use crate::points::{Attribute, COORDINATE_BYTES, Scalar, Schema, names};

/// How the bytes of one attribute come into a record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Move {
    /// Bytes as they are.
    Copy {
        /// Place in the source's record.
        from: usize,
        /// Place in the store's record.
        to: usize,
        /// How many.
        bytes: usize,
    },
    /// Components of another type.
    Convert {
        /// Place and type in the source's record.
        from: (usize, Scalar),
        /// Place and type in the store's record.
        to: (usize, Scalar),
        /// Components.
        components: usize,
    },
    /// Three bits each of return number and number of returns to four bits each.
    Returns {
        /// See [`Move::Copy`].
        from: usize,
        /// See [`Move::Copy`].
        to: usize,
    },
    /// Flags out of the upper bits of returns and class.
    Flags {
        /// Place of the returns in the source's record.
        returns: usize,
        /// Place of the class in the source's record.
        class: usize,
        /// See [`Move::Copy`].
        to: usize,
    },
    /// The class without the flags in its upper bits.
    Class {
        /// See [`Move::Copy`].
        from: usize,
        /// See [`Move::Copy`].
        to: usize,
    },
    /// Whole degrees to units of 0.006 degrees.
    ScanAngle {
        /// See [`Move::Copy`].
        from: usize,
        /// See [`Move::Copy`].
        to: usize,
    },
}

/// The store's layout, and for each source how its records come into it.
#[derive(Debug)]
pub struct UnionLayout {
    /// Columns of the store's records; without `source`.
    pub schema: Schema,
    /// Per source, what to do; attributes that no move fills are 0.
    pub moves: Vec<Vec<Move>>,
    /// Per source, the attributes that it has of its own.
    pub own: Vec<Vec<String>>,
    /// Per source, what widening changed.
    pub warnings: Vec<Vec<String>>,
}

/// An attribute of a source under the name and type that it brings to the union.
struct Offer {
    key: Offered,
    scalar: Scalar,
    origin: Origin,
}

/// What makes attributes of several sources one: name and number of components.
type Offered = (String, u16);

/// Where its value comes from.
#[derive(Clone, Copy)]
enum Origin {
    Plain(usize),
    Returns(usize),
    Flags(usize, usize),
    Class(usize),
    ScanAngle(usize),
}

/// Lays out the union of all scans' attributes.
pub fn union_layout(scans: &[Scan]) -> UnionLayout {
    let promoted = needs_promotion(scans);
    let offers: Vec<Vec<Offer>> = scans.iter().map(|scan| offers_of(scan, promoted)).collect();
    let mut columns: Vec<(Offered, Scalar)> = Vec::new();
    // Files of the LAS family first: theirs is the order in which standard attributes stand.
    let of = |las: bool| {
        let pairs = scans.iter().zip(&offers);
        pairs.filter(move |(scan, _)| scan.las().is_some() == las).flat_map(|(_, offers)| offers)
    };
    for offer in of(true).chain(of(false)) {
        match columns.iter_mut().find(|(key, _)| *key == offer.key) {
            Some((_, scalar)) => *scalar = scalar.wider(offer.scalar),
            None => columns.push((offer.key.clone(), offer.scalar)),
        }
    }
    let schema = schema_of(&columns);
    let place_of = |offer: &Offer| {
        let index = columns.iter().position(|(key, _)| *key == offer.key);
        &schema.attributes[index.expect("every offer was taken in")]
    };
    let (mut moves, mut own, mut warnings) = (Vec::new(), Vec::new(), Vec::new());
    for offers in &offers {
        let mut told = Vec::new();
        let mut names = Vec::new();
        let of_source = offers.iter().map(|offer| {
            let attribute = place_of(offer);
            names.push(attribute.name.clone());
            if loses(offer.scalar, attribute.scalar) {
                told.push(format!(
                    "values of \"{}\" beyond 2^53 are rounded, because another source has \
                     fractions",
                    attribute.name
                ));
            }
            move_of(offer, attribute)
        });
        moves.push(joined(of_source.collect()));
        own.push(names);
        warnings.push(told);
    }
    UnionLayout { schema, moves, own, warnings }
}

/// The layout of a store that is there already, for scans that must fit it: an error is the scan
/// that does not, and why.
pub fn layout_onto(scans: &[Scan], schema: &Schema) -> Result<UnionLayout, (usize, String)> {
    let has_flags = schema.find(names::FLAGS).is_some();
    let (mut moves, mut own, mut warnings) = (Vec::new(), Vec::new(), Vec::new());
    for (index, scan) in scans.iter().enumerate() {
        let (mut steps, mut names, mut told) = (Vec::new(), Vec::new(), Vec::new());
        for offer in offers_of(scan, has_flags) {
            let (name, components) = &offer.key;
            let renamed = format!("{name}_x{components}");
            let attribute = schema.attributes.iter().find(|attribute| {
                attribute.components == *components
                    && (attribute.name == *name || attribute.name == renamed)
            });
            let Some(attribute) = attribute else {
                let reason = format!(
                    "the store has no attribute \"{name}\" of {components} components; convert \
                     all scans together"
                );
                return Err((index, reason));
            };
            if attribute.scalar.wider(offer.scalar) != attribute.scalar {
                let types =
                    [offer.scalar, attribute.scalar].map(|s| format!("{s:?}").to_lowercase());
                let reason = format!(
                    "its attribute \"{name}\" is of type {}, the store's of type {}; convert all \
                     scans together",
                    types[0], types[1]
                );
                return Err((index, reason));
            }
            if loses(offer.scalar, attribute.scalar) {
                told.push(format!("values of \"{name}\" beyond 2^53 are rounded"));
            }
            names.push(attribute.name.clone());
            steps.push(move_of(&offer, attribute));
        }
        moves.push(joined(steps));
        own.push(names);
        warnings.push(told);
    }
    Ok(UnionLayout { schema: schema.clone(), moves, own, warnings })
}

/// Whether older LAS records must become newer ones.
fn needs_promotion(scans: &[Scan]) -> bool {
    let formats = || scans.iter().filter_map(Scan::las).map(|las| las.header().point_format);
    let has_old = formats().any(|format| !format.is_extended());
    let has_new = formats().any(|format| format.is_extended());
    let clashes = |scan: &Scan| {
        let packed = [names::RETURNS, names::FLAGS, names::CLASSIFICATION, names::SCAN_ANGLE];
        scan.las().is_none() && packed.iter().any(|name| scan.schema().find(name).is_some())
    };
    has_old && (has_new || scans.iter().any(clashes))
}

fn offers_of(scan: &Scan, promoted: bool) -> Vec<Offer> {
    let schema = scan.schema();
    let is_old = scan.las().is_some_and(|las| !las.header().point_format.is_extended());
    let place = |name| schema.find(name).map_or(0, |(_, a)| a.record_offset as usize);
    let mut offers = Vec::new();
    for (index, attribute) in schema.attributes.iter().enumerate() {
        let at = attribute.record_offset as usize;
        let mut offer = Offer {
            key: (attribute.name.clone(), attribute.components),
            scalar: attribute.scalar,
            origin: Origin::Plain(at),
        };
        if scan.las().is_some() && RESERVED.contains(&offer.key.0.as_str()) {
            // Extra bytes of that name do not mean this store's sources and lattice.
            offer.key.0.push_str("_2");
        }
        // The standard fields of old formats stand first; extra bytes never have their names.
        if promoted && is_old && index < 6 {
            match attribute.name.as_str() {
                names::RETURNS => {
                    offer.origin = Origin::Returns(at);
                    offers.push(offer);
                    offer = Offer {
                        key: (names::FLAGS.into(), 1),
                        scalar: Scalar::U8,
                        origin: Origin::Flags(at, place(names::CLASSIFICATION)),
                    };
                }
                names::CLASSIFICATION => offer.origin = Origin::Class(at),
                names::SCAN_ANGLE => {
                    offer.scalar = Scalar::I16;
                    offer.origin = Origin::ScanAngle(at);
                }
                _ => {}
            }
        }
        offers.push(offer);
    }
    offers
}

/// Names that conversion gives a meaning of its own.
const RESERVED: [&str; 2] = [names::SOURCE, names::COORDINATE_RESIDUAL];

/// The columns one after the other. Those of one name and several widths tell the width.
fn schema_of(columns: &[(Offered, Scalar)]) -> Schema {
    let mut taken = HashSet::new();
    let mut at = COORDINATE_BYTES;
    let mut attributes = Vec::with_capacity(columns.len());
    for ((name, components), scalar) in columns {
        let mut name = name.clone();
        while !taken.insert(name.clone()) {
            name = format!("{name}_x{components}");
        }
        let record_offset = at as u32;
        let attribute = Attribute { name, scalar: *scalar, components: *components, record_offset };
        at += attribute.bytes();
        attributes.push(attribute);
    }
    Schema { record_bytes: at as u32, attributes }
}

fn move_of(offer: &Offer, attribute: &Attribute) -> Move {
    let to = attribute.record_offset as usize;
    match offer.origin {
        Origin::Plain(from) if offer.scalar == attribute.scalar => {
            Move::Copy { from, to, bytes: attribute.bytes() }
        }
        Origin::Plain(from) => Move::Convert {
            from: (from, offer.scalar),
            to: (to, attribute.scalar),
            components: usize::from(attribute.components),
        },
        Origin::Returns(from) => Move::Returns { from, to },
        Origin::Flags(returns, class) => Move::Flags { returns, class, to },
        Origin::Class(from) => Move::Class { from, to },
        Origin::ScanAngle(from) => Move::ScanAngle { from, to },
    }
}

/// Copies of neighbouring bytes as one.
fn joined(moves: Vec<Move>) -> Vec<Move> {
    let mut joined: Vec<Move> = Vec::new();
    for next in moves {
        if let (
            Some(Move::Copy { from, to, bytes }),
            Move::Copy { from: next_from, to: next_to, bytes: more },
        ) = (joined.last_mut(), &next)
            && (*from + *bytes, *to + *bytes) == (*next_from, *next_to)
        {
            *bytes += more;
            continue;
        }
        joined.push(next);
    }
    joined
}

/// Whether some values of a type do not fit another.
fn loses(from: Scalar, to: Scalar) -> bool {
    matches!((from, to), (Scalar::U64 | Scalar::I64, Scalar::F64))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbouring_copies_are_one() {
        let copy = |from, to, bytes| Move::Copy { from, to, bytes };
        let moves = vec![copy(12, 12, 2), copy(14, 14, 1), copy(15, 20, 1), copy(16, 21, 4)];
        assert_eq!(joined(moves), [copy(12, 12, 3), copy(15, 20, 5)]);
    }
}
