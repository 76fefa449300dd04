//! Export to PLY and text.

use super::rows::positions_of;
use super::{Job, Outcome};
use crate::output::{
    PlyEncoding, PlyFacts, PlyFormat, Positions, RowFormat, RowWriter, TextFormat, TextKind,
};

/// Writes a PLY file.
pub fn write_ply(job: &Job, encoding: PlyEncoding) -> anyhow::Result<Outcome> {
    let metadata = job.store.metadata();
    let mut comments = vec![format!("written by {}", metadata.generator)];
    comments.extend(metadata.crs.epsg.map(|code| format!("crs EPSG:{code}")));
    let ranges = job.ranges();
    let facts = PlyFacts {
        schema: &metadata.schema,
        ranges: &ranges,
        color_bits: metadata.color_bits,
        comments: &comments,
    };
    write_rows(job, &PlyFormat::new(encoding, positions(job), &facts))
}

/// Writes a text file.
pub fn write_text(job: &Job, kind: TextKind) -> anyhow::Result<Outcome> {
    let metadata = job.store.metadata();
    let format = TextFormat::new(kind, positions(job), &metadata.schema, metadata.color_bits);
    write_rows(job, &format)
}

fn positions(job: &Job) -> Positions {
    positions_of(job.store, job.rows.origin())
}

fn write_rows(job: &Job, format: &dyn RowFormat) -> anyhow::Result<Outcome> {
    let mut writer = RowWriter::create(job.output, format, job.rows.known_points())?;
    let encode = |rows: &[u8], out: &mut Vec<u8>| format.append(rows, out);
    job.for_each_node(&encode, &mut |encoded, points| Ok(writer.write(encoded, points)?))?;
    Ok(Outcome { report: writer.finish()?, notes: format.notes() })
}
