//! On what lattice the coordinates of a format without one are exact.
//!
//! Decimal text lies on powers of ten. Floats lie on a power of two if all of them are multiples of
//! one that is coarse enough for 32 bits; otherwise their lattice is as fine as 31 bits over the
//! extent allow, and a residual per point gives the exact float back (`points::exact_position`).
//! Computed coordinates have no exact value to keep: the fine lattice alone.

use std::sync::atomic::{AtomicI32, Ordering};

use glam::DVec3;
use rayon::prelude::*;

use super::foreign::{CoordinateKind, ForeignFacts, ForeignFault, ForeignReader, RowBuffer};
use crate::points::{Lattice, Scalar};

/// Lattice of a scan, and the type of its residuals where the lattice alone is not exact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placing {
    /// The lattice.
    pub lattice: Lattice,
    /// Type of the attribute `coordinate_residual`, if there is one.
    pub residual: Option<Scalar>,
}

/// Steps over which the finest lattices spread.
const FINE_BITS: i32 = 31;
/// Finest step, as a power of two: far from where floats lose precision.
const LEAST_EXPONENT: i32 = -900;
/// Largest integer coordinate, of either sign, that lattices are chosen for.
const MOST_STEPS: f64 = 2_147_483_647.0;

/// Chooses for one scan alone. Floats may be read through once.
pub(super) fn choose(reader: &dyn ForeignReader) -> Result<Placing, ForeignFault> {
    let facts = reader.facts();
    if facts.points == 0 {
        let lattice = Lattice { scale: DVec3::splat(1e-3), offset: DVec3::ZERO };
        return Ok(Placing { lattice, residual: None });
    }
    let exact = |lattice| Placing { lattice, residual: None };
    let fine = |residual| Placing { lattice: fine_lattice(facts.bounds), residual };
    Ok(match facts.coordinates {
        CoordinateKind::Lattice(lattice) => {
            centred(lattice, facts.bounds).map_or(fine(Some(Scalar::I64)), exact)
        }
        CoordinateKind::Decimal { digits } => {
            decimal_lattice(facts.bounds, digits).map_or(fine(Some(Scalar::I64)), exact)
        }
        CoordinateKind::F32 => float_lattice(reader)?.map_or(fine(Some(Scalar::I32)), exact),
        CoordinateKind::F64 => float_lattice(reader)?.map_or(fine(Some(Scalar::I64)), exact),
        CoordinateKind::Computed => fine(None),
    })
}

/// The lattice of powers of ten for a box, if the box fits 32 bits on it.
pub fn decimal_lattice(bounds: [DVec3; 2], digits: u32) -> Option<Lattice> {
    if digits > 15 {
        return None;
    }
    // Parsed, because powers computed by multiplication are not the nearest floats.
    let step: f64 = format!("1e-{digits}").parse().ok()?;
    let lattice = Lattice { scale: DVec3::splat(step), offset: DVec3::ZERO };
    if reaches(&lattice, bounds) {
        return Some(lattice);
    }
    // Whole numbers are on every lattice of powers of ten, and short to write.
    let offset = ((bounds[0] + bounds[1]) * 0.5).round();
    let lattice = Lattice { offset, ..lattice };
    reaches(&lattice, bounds).then_some(lattice)
}

/// The lattice, or the same with its origin moved by whole steps into the box, if the box fits.
fn centred(lattice: Lattice, bounds: [DVec3; 2]) -> Option<Lattice> {
    if reaches(&lattice, bounds) {
        return Some(lattice);
    }
    let steps = lattice.lattice((bounds[0] + bounds[1]) * 0.5).round();
    let moved = Lattice { offset: lattice.offset + steps * lattice.scale, ..lattice };
    reaches(&moved, bounds).then_some(moved)
}

/// Whether 32-bit coordinates reach all of a box.
pub fn reaches(lattice: &Lattice, bounds: [DVec3; 2]) -> bool {
    let most = DVec3::splat(MOST_STEPS - 1.0);
    bounds.into_iter().all(|corner| lattice.lattice(corner).abs().cmple(most).all())
}

/// The power of two that is as fine as 31 bits over the box, or the box's own precision, allow.
pub fn fine_lattice(bounds: [DVec3; 2]) -> Lattice {
    // Half of it, because all of it may leave the range of numbers.
    let half_extent = (bounds[1] * 0.5 - bounds[0] * 0.5).max_element();
    let most = bounds[0].abs().max(bounds[1].abs()).max_element();
    // Finer than 2^-50 of the largest coordinate, no integer would come back from its position.
    let exponent = (exponent_above(half_extent) + 1 - FINE_BITS).max(exponent_above(most) - 50);
    power_lattice(bounds, exponent.clamp(LEAST_EXPONENT, 1000))
}

/// The lattice of steps of `2^exponent` whose origin is a step in the middle of the box.
fn power_lattice(bounds: [DVec3; 2], exponent: i32) -> Lattice {
    let step = 2f64.powi(exponent);
    let zero = Lattice { scale: DVec3::splat(step), offset: DVec3::ZERO };
    if reaches(&zero, bounds) {
        return zero;
    }
    // Halves are added apart, because the sum may leave the range of numbers.
    let middle = bounds[0] * 0.5 + bounds[1] * 0.5;
    Lattice { offset: (middle / step).round() * step, ..zero }
}

/// The smallest `e` with `value < 2^e`, for a value from 0; about -1000 for 0.
fn exponent_above(value: f64) -> i32 {
    if value > 0.0 { value.log2().floor().clamp(-1000.0, 1100.0) as i32 + 1 } else { -1000 }
}

/// The coarsest power of two of which all coordinates are multiples, if the box fits 32 bits on it.
fn float_lattice(reader: &dyn ForeignReader) -> Result<Option<Lattice>, ForeignFault> {
    let facts = reader.facts();
    let extent = (facts.bounds[1] - facts.bounds[0]).max_element();
    // On steps of 2^least or more the box fits 31 bits, and its middle is a multiple.
    let least = (exponent_above(extent) - FINE_BITS).max(LEAST_EXPONENT);
    let exponent = match precision_of_box(facts) {
        Some(exponent) if exponent >= least => exponent,
        _ => match precision_of_points(reader, least)? {
            Some(exponent) => exponent,
            None => return Ok(None),
        },
    };
    let lattice = power_lattice(facts.bounds, exponent.min(least.max(0)));
    Ok(reaches(&lattice, facts.bounds).then_some(lattice))
}

/// What the smallest magnitude in a box of single-precision numbers says about all of them.
fn precision_of_box(facts: &ForeignFacts) -> Option<i32> {
    let mantissa_bits = match facts.coordinates {
        CoordinateKind::F32 => 23,
        _ => 52,
    };
    let [low, high] = facts.bounds;
    let one_sided = low.cmpgt(DVec3::ZERO) | high.cmplt(DVec3::ZERO);
    let smallest = low.abs().min(high.abs()).min_element();
    one_sided.all().then(|| exponent_above(smallest) - 1 - mantissa_bits)
}

/// Exponent of the lowest bit that is set in any coordinate; `None` as soon as it is below `least`.
fn precision_of_points(
    reader: &dyn ForeignReader,
    least: i32,
) -> Result<Option<i32>, ForeignFault> {
    let lowest = AtomicI32::new(i32::MAX);
    let blocks = 0..reader.facts().blocks.len();
    blocks.into_par_iter().try_for_each_init(RowBuffer::default, |rows, block| {
        if lowest.load(Ordering::Relaxed) < least {
            return Ok::<(), ForeignFault>(());
        }
        reader.read_block(block, rows)?;
        let exponents = rows.positions.iter().flat_map(|p| p.to_array()).map(lowest_bit);
        lowest.fetch_min(exponents.min().unwrap_or(i32::MAX), Ordering::Relaxed);
        Ok(())
    })?;
    let lowest = lowest.into_inner();
    Ok((lowest >= least).then_some(lowest))
}

/// Exponent of the lowest bit that is set in a number; `i32::MAX` for 0.
fn lowest_bit(value: f64) -> i32 {
    let bits = value.to_bits();
    let (exponent, mantissa) = ((bits >> 52 & 0x7ff) as i32, bits & ((1 << 52) - 1));
    if exponent == 0 {
        return if mantissa == 0 { i32::MAX } else { mantissa.trailing_zeros() as i32 - 1074 };
    }
    (mantissa | 1 << 52).trailing_zeros() as i32 + exponent - 1075
}

#[cfg(test)]
mod tests {
    use super::*;

    fn boxed(low: f64, high: f64) -> [DVec3; 2] {
        [DVec3::splat(low), DVec3::splat(high)]
    }

    #[test]
    fn lowest_bits() {
        assert_eq!(lowest_bit(1.0), 0);
        assert_eq!(lowest_bit(-0.75), -2);
        assert_eq!(lowest_bit(6.0), 1);
        assert_eq!(lowest_bit(0.0), i32::MAX);
        assert_eq!(lowest_bit(f64::from_bits(1)), -1074);
    }

    #[test]
    fn decimal_lattices_fit_or_are_refused() {
        let lattice = decimal_lattice(boxed(-3.0, 5.0), 4).unwrap();
        assert_eq!((lattice.scale.x, lattice.offset.x), (1e-4, 0.0));
        let far = decimal_lattice(boxed(5_000_000.0, 5_000_900.0), 4).unwrap();
        assert_eq!(far.offset.x, 5_000_450.0);
        assert_eq!(decimal_lattice(boxed(0.0, 1000.0), 7), None);
        assert_eq!(decimal_lattice(boxed(0.0, 1.0), 400), None);
    }

    #[test]
    fn fine_lattices_reach_their_box_whatever_it_is() {
        for (low, high) in [
            (0.0, 0.0),
            (1e300, 1e300),
            (-1.7e308, 1.7e308),
            (1e-310, 2e-310),
            (-3.0, 4.5),
            (5e8, 5e8 + 1e-7),
        ] {
            let bounds = boxed(low, high);
            let lattice = fine_lattice(bounds);
            assert!(reaches(&lattice, bounds), "{low} {high}: {lattice:?}");
            assert!(lattice.offset.is_finite() && lattice.scale.x.is_normal());
        }
        let lattice = fine_lattice(boxed(0.0, 4.5));
        assert!(lattice.scale.x <= 4.5 / 2f64.powi(30));
    }
}
