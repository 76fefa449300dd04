//! Files on the lattice and in the layout of a store that is there already.
//!
//! Nothing is rounded and nothing left out: what the store cannot hold is refused.

use std::path::PathBuf;

use crate::build::BuildError;
use crate::build::sources::adapt::Coordinates;
use crate::build::sources::common_lattice::{Fit, Wish, fit_onto};
use crate::build::sources::layout::layout_onto;
use crate::build::sources::{Source, Sources, assemble, open_scans, source_count};
use crate::input::{CoordinateKind, Placing, ReadOptions, Scan};
use crate::points::{Lattice, Scalar, names};
use crate::store::Metadata;

impl Sources {
    /// Opens files whose points are to join those of a store.
    pub fn open_onto(
        paths: &[PathBuf],
        options: &ReadOptions,
        store: &Metadata,
    ) -> Result<Self, BuildError> {
        let scans = sources_onto(paths, options, store)?.into();
        let (schema, lattice) = (store.schema.clone(), store.lattice());
        Ok(Sources { scans, schema, lattice, sample: None, salvage: options.salvage })
    }
}

/// Files in the layout and on the lattice of a store.
pub(super) fn sources_onto(
    paths: &[PathBuf],
    options: &ReadOptions,
    store: &Metadata,
) -> Result<Vec<Source>, BuildError> {
    let mut scans = open_scans(paths, options)?;
    let lattice = store.lattice();
    let residual = store.schema.find(names::COORDINATE_RESIDUAL).map(|(_, a)| a.scalar);
    let mut fits = Vec::with_capacity(scans.len());
    for scan in &mut scans {
        let fit = exact_fit(&Wish::of(scan), lattice, residual)
            .ok_or_else(|| refused(scan, off_lattice(lattice)))?;
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
