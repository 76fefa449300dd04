//! Files on the lattice and in the layout of a store that is there already.
//!
//! Nothing is rounded and nothing left out: what the store cannot hold is refused. A store of a
//! single source has no attribute `source`; it gets one, of zeros.

use std::path::PathBuf;

use crate::build::BuildError;
use crate::build::sources::adapt::Coordinates;
use crate::build::sources::common_lattice::{Fit, Wish, common_lattice, fit_onto};
use crate::build::sources::layout::layout_onto;
use crate::build::sources::{Source, Sources, assemble, open_scans, source_count, with_source};
use crate::input::{CoordinateKind, Placing, ReadOptions, Scan};
use crate::points::{Lattice, Scalar, names};
use crate::store::{Metadata, ValueRange, sections_for};

impl Sources {
    /// Opens files whose points are to join those of a store; also what the store then says of
    /// itself, but for these points. Files that need another lattice are [`BuildError::Outgrown`].
    pub fn open_onto(
        paths: &[PathBuf],
        options: &ReadOptions,
        store: &Metadata,
    ) -> Result<(Self, Metadata), BuildError> {
        let scans = open_scans(paths, options)?;
        let (lattice, target) = (store.lattice(), with_sources(store, &scans));
        let scans = sources_onto(scans, &target, lattice)?.into();
        let schema = target.schema.clone();
        let read = options.clone();
        Ok((Sources { scans, schema, lattice, sample: None, read }, target))
    }
}

/// The metadata of a store that can tell its points' sources when these scans have joined it.
pub(super) fn with_sources(store: &Metadata, scans: &[Scan]) -> Metadata {
    let mut target = store.clone();
    // Of several sources in one without the attribute no one knows which point is whose.
    if store.schema.find(names::SOURCE).is_none() && store.sources.len() <= 1 {
        let sources = store.sources.len() + scans.iter().map(source_count).sum::<usize>();
        target.schema = with_source(target.schema, sources);
        target.sections = sections_for(&target.schema, target.color_bits);
        // Those that are there are of the first source.
        target.attribute_ranges.push(vec![ValueRange { min: 0.0, max: 0.0 }]);
    }
    target
}

/// The store's lattice, if all scans are exact on it, or a finer one on which the store is, too.
pub(super) fn lattice_with(store: &Metadata, scans: &[Scan]) -> Lattice {
    let (own, residual) = (store.lattice(), residual_of(store));
    let all_exact =
        |lattice| scans.iter().all(|scan| exact_fit(&Wish::of(scan), lattice, residual).is_some());
    if all_exact(own) {
        return own;
    }
    let bounds = store.bounds();
    let of_store = Wish {
        lattice: own,
        bounds: Some([bounds.min, bounds.max]),
        kind: CoordinateKind::Lattice(own),
        exact: true,
        movable: false,
    };
    let wishes: Vec<Wish> = std::iter::once(of_store).chain(scans.iter().map(Wish::of)).collect();
    let common = common_lattice(&wishes).lattice;
    // Residuals count from the lattice that they were made for.
    let is_finer = residual.is_none() && exact_fit(&of_store, common, None).is_some();
    if is_finer && all_exact(common) { common } else { own }
}

fn residual_of(store: &Metadata) -> Option<Scalar> {
    store.schema.find(names::COORDINATE_RESIDUAL).map(|(_, a)| a.scalar)
}

/// Files in the layout of a store, on that lattice.
pub(super) fn sources_onto(
    mut scans: Vec<Scan>,
    store: &Metadata,
    lattice: Lattice,
) -> Result<Vec<Source>, BuildError> {
    let residual = residual_of(store);
    let mut fits = Vec::with_capacity(scans.len());
    for scan in &mut scans {
        let fit = exact_fit(&Wish::of(scan), lattice, residual).ok_or_else(|| {
            BuildError::Outgrown { reason: off_lattice(lattice), path: scan.path().into() }
        })?;
        if let Fit::Place(placing) = fit {
            scan.place(placing);
        }
        fits.push(fit);
    }
    let layout = layout_onto(&scans, &store.schema)
        .map_err(|(index, reason)| refused(&scans[index], reason))?;
    let first_source = store.sources.len();
    let sources = first_source + scans.iter().map(source_count).sum::<usize>();
    let place = layout.schema.find(names::SOURCE).map(|(_, a)| (a.record_offset, a.scalar));
    if let Some((_, Scalar::U16)) = place
        && sources > usize::from(u16::MAX)
    {
        let reason = format!("the store numbers its sources with 16 bits, {sources} are more");
        return Err(refused(&scans[0], reason));
    }
    let source_place = place.map(|(offset, scalar)| (offset as usize, scalar));
    Ok(assemble(scans, fits, layout, source_place, first_source as u32))
}

fn refused(scan: &Scan, reason: String) -> BuildError {
    BuildError::Append { reason, path: scan.path().into() }
}

fn off_lattice(lattice: Lattice) -> String {
    format!(
        "its coordinates are not all on the store's lattice (steps of {}); convert all scans \
         together",
        lattice.scale
    )
}

/// How a source comes onto a lattice without any loss.
fn exact_fit(wish: &Wish, lattice: Lattice, residual: Option<Scalar>) -> Option<Fit> {
    match fit_onto(wish, lattice, residual) {
        Fit::Change(Coordinates::Round { .. }) => None,
        Fit::Place(Placing { residual: Some(Scalar::I32), .. }) => {
            // Residuals of 32 bits count in singles.
            let fits = residual == Some(Scalar::I32) && wish.kind == CoordinateKind::F32;
            fits.then_some(Fit::Place(Placing { lattice, residual }))
        }
        Fit::Place(Placing { residual: Some(_), .. }) => {
            let fits = residual == Some(Scalar::I64);
            fits.then_some(Fit::Place(Placing { lattice, residual }))
        }
        fit => Some(fit),
    }
}
