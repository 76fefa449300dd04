//! One lattice for sources of several.
//!
//! Lattices whose steps have a common decimal measure meet on the finest common step, exactly.
//! Floats do not ask for a lattice: a residual per point gives them back from any. They only make
//! it finer where there is room. What cannot be had exactly within 32 bits is rounded, and told.

use glam::DVec3;

use crate::build::sources::adapt::Coordinates;
use crate::build::sources::lattice_shift;
use crate::input::{CoordinateKind, Placing, Scan, fine_lattice, reaches};
use crate::points::{Lattice, Scalar};

/// The store's lattice, and what each source does to come onto it.
#[derive(Clone, Debug)]
pub struct CommonLattice {
    /// The store's lattice.
    pub lattice: Lattice,
    /// Per source.
    pub fits: Vec<Fit>,
}

/// How a source comes onto the store's lattice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fit {
    /// Its integers count from another origin.
    Shift([i64; 3]),
    /// Its integers become others.
    Change(Coordinates),
    /// Its reader places it, with or without residuals.
    Place(Placing),
}

/// A source as the choice sees it.
#[derive(Clone, Copy, Debug)]
pub struct Wish {
    /// Its own lattice.
    pub lattice: Lattice,
    /// Its points lie in this box, if it says so.
    pub bounds: Option<[DVec3; 2]>,
    /// How it writes coordinates.
    pub kind: CoordinateKind,
    /// Whether its values are all on its own lattice, without residuals and rounding.
    pub exact: bool,
    /// Whether its reader can place it on any lattice.
    pub movable: bool,
}

impl Wish {
    /// What a scan file wishes for.
    pub fn of(scan: &Scan) -> Wish {
        let lattice = scan.lattice();
        match scan {
            Scan::Las(las) => {
                let bounds = [las.header().bounds.min, las.header().bounds.max];
                let usable = bounds[0].cmple(bounds[1]).all() && reaches(&lattice, bounds);
                let kind = CoordinateKind::Lattice(lattice);
                let bounds = usable.then_some(bounds);
                Wish { lattice, bounds, kind, exact: true, movable: false }
            }
            Scan::Foreign(foreign) => {
                let facts = foreign.facts();
                let bounds = (facts.points > 0).then_some(facts.bounds);
                let exact = foreign.placing().residual.is_none() && !foreign.is_rounded();
                Wish { lattice, bounds, kind: facts.coordinates, exact, movable: true }
            }
        }
    }

    /// Whether its values are integers on a lattice that others can meet.
    fn is_fixed(&self) -> bool {
        self.exact && !matches!(self.kind, CoordinateKind::F32 | CoordinateKind::F64)
    }
}

/// Chooses the lattice of a store with those sources, of which there is at least one, where they
/// do not share one already.
pub fn common_lattice(wishes: &[Wish]) -> CommonLattice {
    let boxes = wishes.iter().filter_map(|wish| wish.bounds);
    let Some(bounds) = boxes.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]) else {
        // No box at all: nothing is known to fit, so everything keeps the first one's steps.
        return fit_all(wishes, wishes[0].lattice);
    };
    let fixed: Vec<Lattice> =
        wishes.iter().filter(|wish| wish.is_fixed()).map(|wish| wish.lattice).collect();
    let lattice = match fixed.first() {
        Some(_) => lattice_of_fixed(&fixed, wishes, bounds),
        None => lattice_of_floats(wishes, bounds),
    };
    fit_all(wishes, lattice)
}

/// All sources on the first one's lattice, if their steps coincide.
pub fn shared_lattice(wishes: &[Wish]) -> Option<CommonLattice> {
    let lattice = wishes[0].lattice;
    let fit = |wish: &Wish| {
        let shift = wish.exact.then(|| lattice_shift(&lattice, &wish.lattice))?;
        shift.map(|shift| Fit::Shift(shift.to_array()))
    };
    let fits = wishes.iter().map(fit).collect::<Option<Vec<Fit>>>()?;
    Some(CommonLattice { lattice, fits })
}

/// The finest of the lattices on which floats are exact, or one that is as fine as can be.
fn lattice_of_floats(wishes: &[Wish], bounds: [DVec3; 2]) -> Lattice {
    let scales = wishes.iter().map(|wish| wish.exact.then_some(wish.lattice.scale));
    let finest = scales.reduce(|a, b| Some(a?.min(b?))).flatten();
    let offset = wishes[0].lattice.offset;
    let meets = finest.and_then(|scale| anchored(Lattice { scale, offset }, bounds));
    meets.unwrap_or_else(|| fine_lattice(bounds))
}

/// The finest common lattice of decimal steps, finer where floats want it, coarser where the box
/// does not fit.
fn lattice_of_fixed(fixed: &[Lattice], wishes: &[Wish], bounds: [DVec3; 2]) -> Lattice {
    let finest = fixed.iter().fold(DVec3::splat(f64::MAX), |least, l| least.min(l.scale));
    let common = common_steps(fixed)
        .filter(|&scale| anchored(Lattice { scale, offset: fixed[0].offset }, bounds).is_some());
    let mut scale = common.unwrap_or(finest);
    let wanted = wishes.iter().filter(|wish| !wish.is_fixed()).map(|wish| wish.lattice.scale);
    let wanted = wanted.fold(DVec3::splat(f64::MAX), DVec3::min);
    loop {
        let finer = Lattice { scale: decimal_tenth(scale), offset: fixed[0].offset };
        let wants = scale.cmpgt(wanted).any() && finer.scale.min_element() > 1e-15;
        match anchored(finer, bounds) {
            Some(_) if wants => scale = finer.scale,
            _ => break,
        }
    }
    let mut lattice = Lattice { scale, offset: fixed[0].offset };
    loop {
        if let Some(anchored) = anchored(lattice, bounds) {
            return anchored;
        }
        lattice.scale *= 10.0;
        if !lattice.scale.is_finite() {
            return fine_lattice(bounds);
        }
    }
}

/// The lattice, its origin moved by whole steps if need be, if the box fits 32 bits on it.
fn anchored(lattice: Lattice, bounds: [DVec3; 2]) -> Option<Lattice> {
    if reaches(&lattice, bounds) {
        return Some(lattice);
    }
    let steps = lattice.lattice(bounds[0] * 0.5 + bounds[1] * 0.5).round();
    let moved = Lattice { offset: lattice.offset + steps * lattice.scale, ..lattice };
    (moved.offset.is_finite() && reaches(&moved, bounds)).then_some(moved)
}

/// A tenth of decimal steps, as the nearest float to the decimal number.
fn decimal_tenth(scale: DVec3) -> DVec3 {
    DVec3::from_array(scale.to_array().map(|step| match decimal(step) {
        Some((units, digits)) => format!("{units}e-{}", digits + 1).parse().unwrap_or(step * 0.1),
        None => step * 0.1,
    }))
}

/// The finest common steps of all lattices and of the distances between their origins.
fn common_steps(lattices: &[Lattice]) -> Option<DVec3> {
    let axis = |axis: usize| -> Option<f64> {
        let steps = lattices.iter().map(|l| decimal(l.scale[axis]));
        let mut common = steps.reduce(|a, b| Some(common_measure(a?, b?)))??;
        for lattice in lattices {
            let distance = lattice.offset[axis] - lattices[0].offset[axis];
            let steps = distance / value(common);
            if (steps - steps.round()).abs() > 1e-4 {
                common = common_measure(common, decimal(distance.abs())?);
            }
        }
        Some(value(common))
    };
    Some(DVec3::new(axis(0)?, axis(1)?, axis(2)?))
}

/// A positive number as `units * 10^-digits`, where it is one of at most 15 digits.
fn decimal(number: f64) -> Option<(u64, u32)> {
    if !(number > 0.0 && number < 1e9) {
        return None;
    }
    (0..=12).find_map(|digits| {
        let units = (number * 10f64.powi(digits as i32)).round();
        let back: f64 = format!("{units}e-{digits}").parse().ok()?;
        let close = (back - number).abs() <= 4.0 * f64::EPSILON * number;
        (close && units < 1e15).then_some((units as u64, digits))
    })
}

fn value((units, digits): (u64, u32)) -> f64 {
    format!("{units}e-{digits}").parse().expect("a decimal number parses")
}

/// Greatest common measure of two decimal numbers.
fn common_measure(a: (u64, u32), b: (u64, u32)) -> (u64, u32) {
    let digits = a.1.max(b.1);
    let units = |n: (u64, u32)| u128::from(n.0) * 10u128.pow(digits - n.1);
    let (mut a, mut b) = (units(a), units(b));
    while b > 0 {
        (a, b) = (b, a % b);
    }
    // Never above the smaller of both, so it fits again unless digits made it large.
    (u64::try_from(a).unwrap_or(u64::MAX), digits)
}

fn fit_all(wishes: &[Wish], lattice: Lattice) -> CommonLattice {
    // Residuals count in the floats of the file only if all files have the same.
    let single = wishes.iter().all(|wish| wish.kind == CoordinateKind::F32);
    let residual = if single { Scalar::I32 } else { Scalar::I64 };
    let fits = wishes.iter().map(|wish| fit(wish, lattice, residual)).collect();
    CommonLattice { lattice, fits }
}

fn fit(wish: &Wish, lattice: Lattice, residual: Scalar) -> Fit {
    let multiple = whole_multiple(&lattice, &wish.lattice).filter(|_| wish.exact);
    match (multiple, wish.movable, wish.kind) {
        (Some((factor, shift)), ..) => Fit::Change(Coordinates::Scale { factor, shift }),
        (None, true, CoordinateKind::Computed) => Fit::Place(Placing { lattice, residual: None }),
        (None, true, _) => Fit::Place(Placing { lattice, residual: Some(residual) }),
        (None, false, _) => Fit::Change(Coordinates::Round { from: wish.lattice, to: lattice }),
    }
}

/// How a source comes onto a lattice that is given, with residuals of a given type if there are
/// any: of 64 bits unless it says otherwise.
pub fn fit_onto(wish: &Wish, lattice: Lattice, residual: Option<Scalar>) -> Fit {
    let shift = wish.exact.then(|| lattice_shift(&lattice, &wish.lattice)).flatten();
    match shift {
        Some(shift) => Fit::Shift(shift.to_array()),
        None => fit(wish, lattice, residual.unwrap_or(Scalar::I64)),
    }
}

/// Factor and shift that take integers on `own` to integers on `store`, if whole numbers do.
pub fn whole_multiple(store: &Lattice, own: &Lattice) -> Option<([i64; 3], [i64; 3])> {
    let factor = own.scale / store.scale;
    let shift = (own.offset - store.offset) / store.scale;
    let whole = |v: DVec3, tolerance: f64| {
        let near = (v - v.round()).abs().cmple(DVec3::splat(tolerance)).all();
        (near && v.abs().cmple(DVec3::splat(1e15)).all()).then(|| v.round().as_i64vec3().to_array())
    };
    let relative = 1e-12 * factor.max_element().max(1.0);
    let factor = whole(factor, relative).filter(|factor| factor.iter().all(|&f| f >= 1))?;
    Some((factor, whole(shift, 1e-4)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lattice(scale: f64, offset: f64) -> Lattice {
        Lattice { scale: DVec3::splat(scale), offset: DVec3::splat(offset) }
    }

    fn fixed(scale: f64, offset: f64, low: f64, high: f64) -> Wish {
        let lattice = lattice(scale, offset);
        let bounds = Some([DVec3::splat(low), DVec3::splat(high)]);
        Wish {
            lattice,
            bounds,
            kind: CoordinateKind::Lattice(lattice),
            exact: true,
            movable: false,
        }
    }

    fn float(kind: CoordinateKind, low: f64, high: f64) -> Wish {
        let bounds = [DVec3::splat(low), DVec3::splat(high)];
        Wish {
            lattice: fine_lattice(bounds),
            bounds: Some(bounds),
            kind,
            exact: false,
            movable: true,
        }
    }

    #[test]
    fn equal_steps_only_shift() {
        let wishes = [fixed(0.01, 0.0, 0.0, 9.0), fixed(0.01, 1000.0, 1000.0, 1009.0)];
        let common = shared_lattice(&wishes).unwrap();
        assert_eq!(common.lattice, lattice(0.01, 0.0));
        assert_eq!(common.fits, [Fit::Shift([0; 3]), Fit::Shift([100_000; 3])]);
    }

    #[test]
    fn decimal_steps_meet_on_their_finest_common_one() {
        let wishes = [fixed(0.01, 0.0, 0.0, 90.0), fixed(0.025, 0.005, 0.0, 90.0)];
        let common = common_lattice(&wishes);
        assert_eq!(common.lattice, lattice(0.005, 0.0));
        let scale = |factor, shift| {
            Fit::Change(Coordinates::Scale { factor: [factor; 3], shift: [shift; 3] })
        };
        assert_eq!(common.fits, [scale(2, 0), scale(5, 1)]);
        let odd_origin = [fixed(0.01, 0.0, 0.0, 9.0), fixed(0.01, 0.0037, 0.0, 9.0)];
        assert_eq!(common_lattice(&odd_origin).lattice, lattice(0.0001, 0.0));
    }

    #[test]
    fn steps_without_a_common_one_within_32_bits_are_rounded_to_the_finest() {
        let wishes = [fixed(0.01, 0.0, 0.0, 1e6), fixed(0.003_048_006, 0.0, 0.0, 1e6)];
        let common = common_lattice(&wishes);
        assert_eq!(common.lattice.scale.x, 0.003_048_006);
        assert!(matches!(common.fits[0], Fit::Change(Coordinates::Round { .. })));
        assert!(matches!(common.fits[1], Fit::Change(Coordinates::Scale { .. })));
    }

    #[test]
    fn floats_make_steps_finer_and_keep_a_residual() {
        let wishes = [fixed(0.01, 500.0, 500.0, 600.0), float(CoordinateKind::F32, -1.0, 2.0)];
        let common = common_lattice(&wishes);
        assert_eq!(common.lattice.scale.x, 1e-6, "600 m fit 31 bits and a bit");
        let placing = Placing { lattice: common.lattice, residual: Some(Scalar::I64) };
        assert_eq!(common.fits[1], Fit::Place(placing));
        assert!(matches!(common.fits[0], Fit::Change(Coordinates::Scale { .. })));
        let singles = [float(CoordinateKind::F32, 0.0, 1.0), float(CoordinateKind::F32, 5.0, 9.0)];
        let common = common_lattice(&singles);
        assert!(
            common
                .fits
                .iter()
                .all(|fit| matches!(fit, Fit::Place(Placing { residual: Some(Scalar::I32), .. })))
        );
    }

    #[test]
    fn a_wide_union_is_coarsened_until_it_fits() {
        let wishes = [fixed(1e-7, 0.0, -94.0, -90.0), fixed(0.01, 0.0, 0.0, 1e7)];
        let common = common_lattice(&wishes);
        assert!(common.lattice.scale.x >= 1e7 / 4.3e9 && common.lattice.scale.x <= 0.01);
        assert!(matches!(common.fits[0], Fit::Change(Coordinates::Round { .. })));
    }

    #[test]
    fn decimals() {
        assert_eq!(decimal(0.00025), Some((25, 5)));
        assert_eq!(decimal(1.0 / 3.0), None);
        assert_eq!(decimal(2.0), Some((2, 0)));
        assert_eq!(common_measure((25, 3), (1, 2)), (5, 3));
    }
}
