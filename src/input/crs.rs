//! The coordinate reference system: its records verbatim, and its EPSG code where one is told.
//!
//! Nothing is transformed and no registry is asked.
//!
//! Sources: OGC 01-009 and 18-010 (WKT 1 and 2); OGC 19-008 (GeoTIFF keys, annex B);
//! ASPRS, "LAS Specification 1.4 - R15", section 3.

use serde::{Deserialize, Serialize};

/// What a file says about its reference system.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Crs {
    /// EPSG code of the whole, or of its horizontal part.
    pub epsg: Option<u32>,
    /// Well-known text as it stands in the file.
    pub wkt: Option<String>,
    /// GeoTIFF keys: id, tag location, count, value or index, as they stand in the file.
    pub geotiff_keys: Vec<[u16; 4]>,
    /// Numbers that keys point to.
    pub geotiff_doubles: Vec<f64>,
    /// Text that keys point to.
    pub geotiff_text: Option<String>,
}

/// Record ids of `LASF_Projection`.
pub(super) const USER_ID: &str = "LASF_Projection";
pub(super) const WKT: u16 = 2112;
pub(super) const GEOTIFF_KEYS: u16 = 34_735;
pub(super) const GEOTIFF_DOUBLES: u16 = 34_736;
pub(super) const GEOTIFF_TEXT: u16 = 34_737;

impl Crs {
    /// Takes in the data of one `LASF_Projection` record; the first of each kind counts.
    pub(super) fn add(&mut self, record_id: u16, data: &[u8]) {
        match record_id {
            WKT if self.wkt.is_none() => {
                let text = String::from_utf8_lossy(data);
                let text = text.trim_end_matches('\0').to_string();
                self.wkt = Some(text).filter(|text| !text.is_empty());
            }
            GEOTIFF_KEYS if self.geotiff_keys.is_empty() => {
                let words: Vec<u16> = data
                    .chunks_exact(2)
                    .map(|pair| u16::from_le_bytes([pair[0], pair[1]]))
                    .collect();
                let entries = words.chunks_exact(4).skip(1);
                let count = words.get(3).map_or(0, |&count| usize::from(count));
                self.geotiff_keys =
                    entries.take(count).map(|key| [key[0], key[1], key[2], key[3]]).collect();
            }
            GEOTIFF_DOUBLES if self.geotiff_doubles.is_empty() => {
                let double =
                    |eight: &[u8]| f64::from_le_bytes(eight.try_into().expect("chunks of 8"));
                self.geotiff_doubles = data.chunks_exact(8).map(double).collect();
            }
            GEOTIFF_TEXT if self.geotiff_text.is_none() => {
                let text = String::from_utf8_lossy(data);
                self.geotiff_text = Some(text.trim_end_matches('\0').to_string());
            }
            _ => {}
        }
    }

    /// Reads the code off what was taken in: from the text where there is one, else the keys.
    pub(super) fn find_epsg(&mut self) {
        let from_text = self.wkt.as_deref().and_then(wkt_epsg);
        self.epsg = from_text.or_else(|| geotiff_epsg(&self.geotiff_keys));
    }
}

/// Code of the projected system, else of the geographic, else of the geocentric one.
fn geotiff_epsg(keys: &[[u16; 4]]) -> Option<u32> {
    const PROJECTED: u16 = 3072;
    const GEODETIC: u16 = 2048;
    let code = |id: u16| {
        let key = keys.iter().find(|key| key[0] == id && key[1] == 0)?;
        // 0 is undefined, 32767 user-defined, above that private.
        (1..32_767).contains(&key[3]).then_some(u32::from(key[3]))
    };
    code(PROJECTED).or_else(|| code(GEODETIC))
}

/// Code that well-known text gives for its outermost object, else for the first object in it that
/// is a reference system (a compound's horizontal part, a bound system's source).
///
/// One pass over the text; brackets are only counted, so depth costs nothing.
fn wkt_epsg(text: &str) -> Option<u32> {
    let mut depth = 0usize;
    let mut systems = 0usize;
    let mut horizontal = None;
    // Depth of the object whose code was asked for second best: the first system inside.
    let mut horizontal_depth = None;
    let mut rest = text;
    while let Some(at) = rest.find(['"', '[', ']', '(', ')']) {
        let (before, after) = rest.split_at(at);
        rest = &after[1..];
        match after.as_bytes()[0] {
            b'"' => rest = &rest[rest.find('"')? + 1..],
            b'[' | b'(' => {
                let keyword = before.trim_matches(|c: char| c == ',' || c.is_whitespace());
                if keyword.eq_ignore_ascii_case("AUTHORITY") || keyword.eq_ignore_ascii_case("ID") {
                    let code = epsg_of(rest);
                    if depth == 1 && code.is_some() {
                        return code;
                    }
                    if horizontal_depth == Some(depth) && horizontal.is_none() {
                        horizontal = code;
                    }
                }
                depth += 1;
                if is_system(keyword) {
                    systems += 1;
                    if systems == 2 {
                        horizontal_depth = Some(depth);
                    }
                }
            }
            _ => {
                // The second system ended: what follows on its depth belongs to others.
                if horizontal_depth == Some(depth) {
                    horizontal_depth = Some(usize::MAX);
                }
                depth = depth.checked_sub(1)?;
            }
        }
    }
    // A projected system without a code must not be told by the code of its geographic base.
    let root = text.trim_start().to_ascii_uppercase();
    let holds_systems = ["COMPD_CS", "COMPOUNDCRS", "BOUNDCRS"];
    horizontal.filter(|_| holds_systems.iter().any(|word| root.starts_with(word)))
}

fn is_system(keyword: &str) -> bool {
    let keyword = keyword.to_ascii_uppercase();
    keyword.ends_with("_CS")
        || keyword.ends_with("CRS") && keyword != "SOURCECRS" && keyword != "TARGETCRS"
        || ["PROJCS", "GEOGCS", "GEOCCS"].contains(&keyword.as_str())
}

/// The number in `"EPSG","2992"]` or `"EPSG",2992]`.
fn epsg_of(inside: &str) -> Option<u32> {
    let inside = &inside[..inside.find([']', ')'])?];
    let (authority, code) = inside.split_once(',')?;
    let bare = |part: &str| part.trim().trim_matches('"').trim().to_string();
    if !bare(authority).eq_ignore_ascii_case("EPSG") {
        return None;
    }
    bare(code.split(',').next()?).parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_of_well_known_text() {
        let projected = r#"PROJCS["x (y], z",GEOGCS["g",AUTHORITY["EPSG","4269"]],UNIT["m",1],AUTHORITY["EPSG","2992"]]"#;
        assert_eq!(wkt_epsg(projected), Some(2992));
        let second = r#"PROJCRS["a",BASEGEOGCRS["b",ID["EPSG",4258]],ID["EPSG",2154]]"#;
        assert_eq!(wkt_epsg(second), Some(2154));
        let compound =
            format!(r#"COMPD_CS["c",{projected},VERT_CS["v",AUTHORITY["EPSG","5720"]]]"#);
        assert_eq!(wkt_epsg(&compound), Some(2992));
        let named = format!(r#"COMPD_CS["c",{projected},AUTHORITY["EPSG","7405"]]"#);
        assert_eq!(wkt_epsg(&named), Some(7405));
        let bare = r#"PROJCS["a",GEOGCS["g",AUTHORITY["EPSG","4269"]]]"#;
        assert_eq!(wkt_epsg(bare), None, "the base's code is not the projection's");
        let only_vertical = r#"COMPD_CS["c",PROJCS["p"],VERT_CS["v",AUTHORITY["EPSG","5720"]]]"#;
        assert_eq!(wkt_epsg(only_vertical), None);
        for odd in ["", "]", "\"", "ID[", "A[\"", "AUTHORITY[\"EPSG\",\"x\"]"] {
            assert_eq!(wkt_epsg(odd), None, "{odd:?}");
        }
    }

    #[test]
    fn codes_of_geotiff_keys() {
        let mut data = Vec::new();
        for word in [1u16, 1, 0, 3, 1024, 0, 1, 1, 2048, 0, 1, 4326, 3072, 0, 1, 32_767] {
            data.extend(word.to_le_bytes());
        }
        let mut crs = Crs::default();
        crs.add(GEOTIFF_KEYS, &data);
        crs.find_epsg();
        assert_eq!(crs.geotiff_keys.len(), 3);
        assert_eq!(crs.epsg, Some(4326));
        let mut short = Crs::default();
        short.add(GEOTIFF_KEYS, &data[..5]);
        short.find_epsg();
        assert_eq!(short, Crs::default());
    }
}
