//! Headers for points that no longer have the layout of their scan, or never had one of LAS.

use super::las_frame::put;
use super::las_records::LasRecords;
use crate::input::{LasFault, LasTemplate, NewScan, Vlr, describes_extra_bytes, place};
use crate::points::Lattice;

/// What a header tells beside the layout of its records.
#[derive(Clone, Copy, Debug)]
pub struct LasFacts<'a> {
    /// Header and records of the scan, where it was of the LAS family.
    pub scan: Option<&'a LasTemplate>,
    /// The lattice of the records.
    pub lattice: Lattice,
    /// EPSG code of the reference system.
    pub epsg: Option<u32>,
    /// Well-known text of the reference system.
    pub wkt: Option<&'a str>,
}

const PROJECTION: &str = "LASF_Projection";
const WKT_ID: u16 = 2112;
const GEOTIFF_IDS: [u16; 3] = [34_735, 34_736, 34_737];
/// Bits of global encoding.
const WAVEFORM_BITS: u16 = 0b110;
const WKT_BIT: u16 = 0b1_0000;

impl LasRecords {
    /// The header for records of this layout.
    ///
    /// A scan's own header and records come back as far as they still hold; version, lattice,
    /// extra bytes and, without a scan, the reference system are new.
    pub fn template(&self, facts: &LasFacts) -> Result<LasTemplate, LasFault> {
        if let Some(scan) = facts.scan
            && self.are_of_scan()
            && scan.header().lattice == facts.lattice
        {
            return Ok(scan.clone());
        }
        let keeps_version = |scan: &LasTemplate| scan.header().point_format == self.format();
        let minor = facts.scan.filter(|scan| keeps_version(scan)).map_or(4, |s| s.header().minor);
        let record_bytes = self.schema().record_bytes as u16;
        let mut template = LasTemplate::for_new_scan(&NewScan {
            minor,
            point_format: self.format(),
            extra_bytes: record_bytes - self.format().base_bytes(),
            lattice: facts.lattice,
            system_identifier: "OTHER",
            generating_software: concat!("esker ", env!("CARGO_PKG_VERSION")),
            creation: (0, 0),
        });
        if let Some(scan) = facts.scan {
            template = self.with_words_of(scan, template)?;
        } else {
            template = with_reference_system(template, facts)?;
        }
        let descriptions = self.descriptions();
        if !descriptions.is_empty() {
            template = template.with_vlr("LASF_Spec", 4, &descriptions)?;
        }
        with_encoding_bits(template)
    }

    /// The template with what a scan's header says of its making, and its records.
    fn with_words_of(&self, scan: &LasTemplate, new: LasTemplate) -> Result<LasTemplate, LasFault> {
        let mut header = new.header_bytes().to_vec();
        // File source, global encoding and project id; then system, software and date.
        for words in [4..24, place::SYSTEM_IDENTIFIER..place::HEADER_BYTES] {
            header[words.clone()].copy_from_slice(&scan.header_bytes()[words]);
        }
        let bytes = scan.vlr_bytes();
        let is_kept = |vlr: &Vlr| {
            let replaced = describes_extra_bytes(vlr) && !self.are_of_scan();
            !vlr.is_laszip() && !vlr.is_copc() && !replaced
        };
        let kept: Vec<Vlr> = scan.vlrs().into_iter().filter(is_kept).collect();
        let places = kept.iter().map(|vlr| vlr.whole().start as usize..vlr.whole().end as usize);
        let region: Vec<u8> = places.flat_map(|place| bytes[place].to_vec()).collect();
        let points_start = (header.len() + region.len()) as u32;
        put(&mut header, place::POINT_DATA_OFFSET, &points_start.to_le_bytes());
        put(&mut header, place::VLR_COUNT, &(kept.len() as u32).to_le_bytes());
        LasTemplate::new(header, region, Vec::new())
    }
}

/// The template with the reference system: as text where it is known, else as a code.
fn with_reference_system(template: LasTemplate, facts: &LasFacts) -> Result<LasTemplate, LasFault> {
    if let Some(wkt) = facts.wkt {
        let text = [wkt.as_bytes(), &[0]].concat();
        return template.with_vlr(PROJECTION, WKT_ID, &text);
    }
    let Some(code) = facts.epsg.and_then(|code| u16::try_from(code).ok()) else {
        return Ok(template);
    };
    // Ids of keys.
    const MODEL: u16 = 1024;
    const GEODETIC: u16 = 2048;
    const PROJECTED: u16 = 3072;
    // Codes of geographic systems lie here, but for a few dozen newer ones; all others are
    // projected.
    const GEOGRAPHIC_CODES: std::ops::RangeInclusive<u16> = 4000..=4999;
    let (model, key) =
        if GEOGRAPHIC_CODES.contains(&code) { (2, GEODETIC) } else { (1, PROJECTED) };
    let words = [1, 1, 0, 2, MODEL, 0, 1, model, key, 0, 1, code];
    let data: Vec<u8> = words.iter().flat_map(|word: &u16| word.to_le_bytes()).collect();
    template.with_vlr(PROJECTION, GEOTIFF_IDS[0], &data)
}

/// The template with the bits of global encoding that its format calls for.
///
/// Formats from 6 on have well-known text, and readers refuse them without the bit.
fn with_encoding_bits(template: LasTemplate) -> Result<LasTemplate, LasFault> {
    let format = template.header().point_format;
    let mut header = template.header_bytes().to_vec();
    let mut bits = template.header().global_encoding;
    if !format.has_wave_packet() {
        bits &= !WAVEFORM_BITS;
    }
    if format.is_extended() {
        bits |= WKT_BIT;
    }
    put(&mut header, place::GLOBAL_ENCODING, &bits.to_le_bytes());
    LasTemplate::new(header, template.vlr_bytes().to_vec(), Vec::new())
}

/// Says so where a header of the formats from 6 on tells its reference system by keys alone, which
/// those formats have not: no text can be made of them without a registry.
pub fn note_on_reference_system(template: &LasTemplate) -> Option<&'static str> {
    let records = template.vlrs();
    let has = |ids: &[u16]| {
        records.iter().any(|vlr| vlr.user_id == PROJECTION && ids.contains(&vlr.record_id))
    };
    let is_by_keys = !has(&[WKT_ID]) && has(&GEOTIFF_IDS);
    (template.header().point_format.is_extended() && is_by_keys).then_some(
        "its reference system stands in GeoTIFF keys; readers that look for well-known text, as \
         these point formats want it, find none",
    )
}
