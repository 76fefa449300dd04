//! Export to LAS, LAZ and COPC.

use std::io::{self, Read};

use super::{Job, Outcome};
use crate::input::LasTemplate;
use crate::output::{self, Compression, FormatChoice, LasFacts, LasRecords, LasWriter, WriteError};
use crate::store::{Store, StoreError};

/// Writes a LAS or LAZ file.
pub fn write_las(job: &Job, is_compressed: bool) -> anyhow::Result<Outcome> {
    let LasTarget { records, template, mut evlrs, notes } = LasTarget::new(job, FormatChoice::Own)?;
    let compression = if is_compressed { Compression::Laz } else { Compression::None };
    let mut writer = LasWriter::create(job.output, &template, records.schema(), compression)?;
    let encode = |rows: &[u8], out: &mut Vec<u8>| records.convert(rows, out);
    job.for_each_node(&encode, &mut |encoded, _| Ok(writer.write(encoded)?))?;
    let report = writer.finish(&mut evlrs)?;
    Ok(Outcome { report, notes })
}

/// Writes a COPC file.
pub fn write_copc(job: &Job) -> anyhow::Result<Outcome> {
    let LasTarget { records, template, mut evlrs, notes } =
        LasTarget::new(job, FormatChoice::Extended)?;
    let octree = job.store.octree();
    let low = octree.root_cube().min - job.rows.origin();
    let read = |node, out: &mut Vec<u8>| -> anyhow::Result<Vec<usize>> {
        job.check_cancelled()?;
        let mut rows = Vec::new();
        let ends = job.rows.read(node, &mut rows)?;
        records.convert(&rows, out);
        Ok(ends)
    };
    let report = output::write_copc(job.output, &template, octree, low, &read, &mut evlrs)?;
    Ok(Outcome { report, notes })
}

/// How the points of a store become a file of the LAS family.
struct LasTarget<'a> {
    records: LasRecords,
    template: LasTemplate,
    evlrs: AppendixReader<'a>,
    notes: Vec<String>,
}

impl<'a> LasTarget<'a> {
    fn new(job: &Job<'a>, choice: FormatChoice) -> anyhow::Result<Self> {
        let metadata = job.store.metadata();
        let (scan, evlrs) = scan_of(job.store)?;
        let ranges = job.ranges();
        let unfit = |reason| WriteError::Unfit { reason, path: job.output.to_path_buf() };
        let records = LasRecords::new(&metadata.schema, &ranges, scan.as_ref(), choice);
        let records = records.map_err(unfit)?;
        let template = records.template(&LasFacts {
            scan: scan.as_ref(),
            lattice: job.rows.lattice(),
            epsg: metadata.crs.epsg,
            wkt: metadata.crs.wkt.as_deref(),
        });
        let template = template.map_err(|fault| unfit(fault.to_string()))?;
        let mut notes = records.notes().to_vec();
        notes.extend(output::note_on_reference_system(&template).map(str::to_string));
        Ok(LasTarget { records, template, evlrs, notes })
    }
}

/// Header and records of the first input if it was of the LAS family, and its extended records.
fn scan_of(store: &Store) -> anyhow::Result<(Option<LasTemplate>, AppendixReader<'_>)> {
    let source = store.metadata().sources.first().filter(|source| source.header_bytes > 0);
    let Some(source) = source else {
        return Ok((None, AppendixReader { store, at: 0, left: 0 }));
    };
    let header = store.read_appendix(0, source.header_bytes)?;
    let vlrs = store.read_appendix(source.header_bytes, source.vlr_bytes)?;
    let template = LasTemplate::new(header, vlrs, Vec::new()).map_err(|fault| {
        anyhow::anyhow!("{}: header of the input: {fault}", store.path().display())
    })?;
    let at = source.header_bytes + source.vlr_bytes;
    Ok((Some(template), AppendixReader { store, at, left: source.evlr_bytes }))
}

/// A range of a store's appendix, read in pieces.
struct AppendixReader<'a> {
    store: &'a Store,
    at: u64,
    left: u64,
}

impl Read for AppendixReader<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let length = (buffer.len() as u64).min(self.left);
        let bytes = self.store.read_appendix(self.at, length).map_err(|error| match error {
            StoreError::Io { source, .. } => source,
            other => io::Error::other(other),
        })?;
        buffer[..bytes.len()].copy_from_slice(&bytes);
        self.at += length;
        self.left -= length;
        Ok(bytes.len())
    }
}
