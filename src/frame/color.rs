//! The colour of each point, made when a node is loaded: one RGBA8 word per point, whatever the
//! attribute, so that the passes know nothing of attributes.
//!
//! Ramps rise evenly in lightness (keys in OKLCH, after B. Ottosson, "A perceptual color space for
//! image processing", 2020), so that equal steps of a value look equal. Their ends are the 1 % and
//! 99 % quantiles of the root's points, a sample of the whole cloud, so that a stray value does
//! not flatten the rest.

use std::fmt;
use std::str::FromStr;

use crate::frame::NodeSource;
use crate::geometry::MortonKey;
use crate::gpu::layout::position_words;
use crate::ids::NodeId;
use crate::octree::Octree;
use crate::points::{Scalar, names};
use crate::store::{FetchedNode, NodeReadError, SectionContent};

/// What points are coloured by.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum ColorMode {
    /// RGB if the cloud has any that is not all zero, else intensity if it varies, else elevation.
    #[default]
    Auto,
    /// The colours of the scan.
    Rgb,
    /// Height.
    Elevation,
    /// Strength of the return, grey.
    Intensity,
    /// Class codes, in the usual colours.
    Class,
    /// The first component of any attribute.
    Attribute(String),
}

impl FromStr for ColorMode {
    type Err = std::convert::Infallible;

    /// Any word is a mode; those that are not known name an attribute.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(match text {
            "auto" => ColorMode::Auto,
            "rgb" => ColorMode::Rgb,
            "elevation" => ColorMode::Elevation,
            names::INTENSITY => ColorMode::Intensity,
            "class" | names::CLASSIFICATION => ColorMode::Class,
            name => ColorMode::Attribute(name.to_owned()),
        })
    }
}

impl ColorMode {
    /// Whether a cloud has what this mode shows.
    pub fn is_offered_by(&self, source: &dyn NodeSource) -> bool {
        let has = |name: &str| source.schema().find(name).is_some();
        match self {
            ColorMode::Auto | ColorMode::Elevation => true,
            ColorMode::Rgb => source.has_colors(),
            ColorMode::Intensity => has(names::INTENSITY),
            ColorMode::Class => has(names::CLASSIFICATION),
            ColorMode::Attribute(name) => has(name),
        }
    }
}

impl fmt::Display for ColorMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            ColorMode::Auto => "auto",
            ColorMode::Rgb => "rgb",
            ColorMode::Elevation => "elevation",
            ColorMode::Intensity => "intensity",
            ColorMode::Class => "class",
            ColorMode::Attribute(name) => name,
        })
    }
}

/// How one cloud's points get their colours: a mode, settled for that cloud.
#[derive(Clone, Debug)]
pub enum Coloring {
    /// As stored.
    Rgb,
    /// One colour, for clouds that lack what was asked for.
    Plain,
    /// Height on a ramp.
    Elevation(Ramp),
    /// An attribute's first component on a ramp.
    Values {
        /// The attribute.
        attribute: usize,
        /// The ramp.
        ramp: Ramp,
    },
    /// Class codes.
    Classes {
        /// The attribute.
        attribute: usize,
        /// Bits of the byte that are the code.
        mask: u8,
    },
}

/// Colours over a range of values.
#[derive(Clone, Debug)]
pub struct Ramp {
    low: f64,
    per_value: f64,
    colors: [u32; 256],
}

const PLAIN: u32 = 0xffc8_c8c8;

/// Lightness (0..1), chroma and hue (degrees) of a ramp's keys, evenly spaced.
type Keys = &'static [[f64; 3]];

const ELEVATION_KEYS: Keys = &[
    [0.36, 0.12, 275.0],
    [0.50, 0.11, 235.0],
    [0.62, 0.11, 175.0],
    [0.74, 0.15, 130.0],
    [0.85, 0.14, 95.0],
    [0.95, 0.06, 75.0],
];
const GREY_KEYS: Keys = &[[0.22, 0.0, 0.0], [0.97, 0.0, 0.0]];
const VALUE_KEYS: Keys = &[
    [0.30, 0.12, 300.0],
    [0.45, 0.17, 340.0],
    [0.60, 0.19, 20.0],
    [0.76, 0.16, 60.0],
    [0.93, 0.12, 100.0],
];

/// The usual colours of the classes that the LAS specification names; others get a hue of their
/// own.
pub fn class_color(class: u8) -> u32 {
    let rgb: u32 = match class {
        0 | 1 => 0xb4b4b4, // never classified, unassigned
        2 => 0xa87d4a,     // ground
        3 => 0xa8d78a,     // low vegetation
        4 => 0x63b24a,     // medium vegetation
        5 => 0x2b7a2f,     // high vegetation
        6 => 0xe0694f,     // building
        7 => 0xff2fd0,     // low noise
        8 => 0x8d8d8d,     // model key point
        9 => 0x3f8fe0,     // water
        10 => 0x8c5fb0,    // rail
        11 => 0x6d6d78,    // road surface
        12 => 0xd0c8a0,    // overlap
        13 => 0xf2d544,    // wire, guard
        14 => 0xffe98a,    // wire, conductor
        15 => 0xe8a23a,    // transmission tower
        16 => 0xc98f2a,    // wire, connector
        17 => 0x70c0c0,    // bridge deck
        18 => 0xff5fe0,    // high noise
        _ => return hue_color(class),
    };
    0xff00_0000 | rgb.swap_bytes() >> 8
}

/// Colours around the circle, neighbouring codes far apart.
fn hue_color(code: u8) -> u32 {
    word_of_oklch([0.68, 0.15, f64::from(code) * 137.508])
}

impl Coloring {
    /// Settles a mode for a cloud. `root` holds the root's raw columns as [`read_raw`] gives them
    /// for the mode's columns; without a root all is plain.
    pub fn settle(
        mode: &ColorMode,
        source: &dyn NodeSource,
        elevation: Option<(f64, f64)>,
    ) -> Result<Coloring, NodeReadError> {
        if source.octree().nodes().is_empty() {
            return Ok(Coloring::Plain);
        }
        let find = |name: &str| source.schema().find(name);
        let by_elevation = || match elevation {
            Some((low, high)) => Coloring::Elevation(Ramp::new(low, high, ELEVATION_KEYS)),
            None => Coloring::Plain,
        };
        let by_value = |name: &str, keys| match find(name) {
            Some((attribute, _)) => {
                let (low, high) = attribute_range(source, attribute)?;
                Ok(Coloring::Values { attribute, ramp: Ramp::new(low, high, keys) })
            }
            None => Ok(Coloring::Plain),
        };
        Ok(match mode {
            ColorMode::Auto if has_visible_rgb(source) => Coloring::Rgb,
            ColorMode::Auto if varies(source, names::INTENSITY) => {
                by_value(names::INTENSITY, GREY_KEYS)?
            }
            ColorMode::Auto | ColorMode::Elevation => by_elevation(),
            ColorMode::Rgb if source.has_colors() => Coloring::Rgb,
            ColorMode::Rgb => Coloring::Plain,
            ColorMode::Intensity => by_value(names::INTENSITY, GREY_KEYS)?,
            ColorMode::Class => match find(names::CLASSIFICATION) {
                // Formats without a byte of flags keep three of them beside the code.
                Some((attribute, _)) => {
                    let mask = if find(names::FLAGS).is_some() { 0xff } else { 0x1f };
                    Coloring::Classes { attribute, mask }
                }
                None => Coloring::Plain,
            },
            ColorMode::Attribute(name) => by_value(name, VALUE_KEYS)?,
        })
    }

    /// The column that colours come from, besides positions.
    pub fn column(&self) -> Option<SectionContent> {
        match self {
            Coloring::Rgb => Some(SectionContent::Color),
            Coloring::Plain | Coloring::Elevation(_) => None,
            Coloring::Values { attribute, .. } | Coloring::Classes { attribute, .. } => {
                Some(SectionContent::Attribute(*attribute as u32))
            }
        }
    }

    /// Appends the colours of a node; `positions` are its words.
    pub fn append_colors(
        &self,
        columns: &NodeColumns,
        positions: &[u32],
        words: &mut Vec<u32>,
    ) -> Result<(), NodeReadError> {
        let NodeColumns { source, node, .. } = *columns;
        let octree = source.octree();
        let count = octree.node(node).point_count() as usize;
        match self {
            Coloring::Rgb => {
                let mut colors = Vec::new();
                columns.colors(&mut colors)?;
                words.append(&mut colors);
            }
            Coloring::Plain => words.resize(words.len() + count, PLAIN),
            Coloring::Elevation(ramp) => {
                words.extend(elevations(octree, node, positions).map(|z| ramp.color(z)));
            }
            Coloring::Values { attribute, ramp } => {
                let bytes = columns.attribute(*attribute)?;
                let attribute = &source.schema().attributes[*attribute];
                let values = first_components(&bytes, attribute.scalar, attribute.bytes());
                words.extend(values.map(|value| ramp.color(value)));
            }
            Coloring::Classes { attribute, mask } => {
                let bytes = columns.attribute(*attribute)?;
                let colors: Vec<u32> = (0..=255).map(|code| class_color(code & mask)).collect();
                words.extend(bytes.iter().map(|&code| colors[usize::from(code)]));
            }
        }
        Ok(())
    }
}

/// The columns of one node, of what was fetched of it or else as the source reads them.
#[derive(Clone, Copy)]
pub struct NodeColumns<'a> {
    /// Where it is from.
    pub source: &'a dyn NodeSource,
    /// The node.
    pub node: NodeId,
    /// Its stored bytes.
    pub fetched: Option<&'a FetchedNode>,
}

impl NodeColumns<'_> {
    /// Replaces `words` by the positions.
    pub fn positions(&self, words: &mut Vec<u32>) -> Result<(), NodeReadError> {
        match self.fetched {
            Some(fetched) => self.source.unpack_positions(fetched, words),
            None => self.source.read_positions(self.node, words),
        }
    }

    fn colors(&self, words: &mut Vec<u32>) -> Result<(), NodeReadError> {
        match self.fetched {
            Some(fetched) => self.source.unpack_colors(fetched, words),
            None => self.source.read_colors(self.node, words),
        }
    }

    fn attribute(&self, attribute: usize) -> Result<Vec<u8>, NodeReadError> {
        let mut bytes = Vec::new();
        match self.fetched {
            Some(fetched) => self.source.unpack_attribute(fetched, attribute, &mut bytes)?,
            None => self.source.read_attribute(self.node, attribute, &mut bytes)?,
        }
        Ok(bytes)
    }
}

impl Coloring {
    /// Whether it shows the same as another one on nearly the same range.
    pub fn is_near(&self, other: &Coloring) -> bool {
        match (self, other) {
            (Coloring::Elevation(ramp), Coloring::Elevation(other)) => ramp.is_near(other),
            (
                Coloring::Values { attribute, ramp },
                Coloring::Values { attribute: others, ramp: other },
            ) => attribute == others && ramp.is_near(other),
            _ => false,
        }
    }
}

/// Part of a range by which the ends of a near one may differ.
const NEAR: f64 = 0.05;

impl Ramp {
    /// Whether it has the same colours on nearly the same range.
    fn is_near(&self, other: &Ramp) -> bool {
        if self.per_value == 0.0 || other.per_value == 0.0 || self.colors != other.colors {
            return false;
        }
        let [span, others] = [self, other].map(|ramp| 255.0 / ramp.per_value);
        let high = self.low + span - other.low - others;
        (self.low - other.low).abs() <= NEAR * span && high.abs() <= NEAR * span
    }

    fn new(low: f64, high: f64, keys: Keys) -> Self {
        let span = high - low;
        let per_value = if span > 0.0 { 255.0 / span } else { 0.0 };
        // A constant value takes the middle of the ramp.
        let low = if span > 0.0 { low } else { f64::NEG_INFINITY };
        let colors = std::array::from_fn(|i| {
            let at = i as f64 / 255.0 * (keys.len() - 1) as f64;
            let key = (at as usize).min(keys.len() - 2);
            let t = at - key as f64;
            word_of_oklch([0, 1, 2].map(|c| keys[key][c] * (1.0 - t) + keys[key + 1][c] * t))
        });
        Ramp { low, per_value, colors }
    }

    fn color(&self, value: f64) -> u32 {
        if self.low == f64::NEG_INFINITY {
            return self.colors[128];
        }
        // Casting clamps to 0..=255 and takes NaN to 0.
        self.colors[usize::from(((value - self.low) * self.per_value + 0.5) as u8)]
    }
}

/// Whether a mode shows the height of a cloud's points.
pub fn shows_elevation(mode: &ColorMode, source: &dyn NodeSource) -> bool {
    match mode {
        ColorMode::Elevation => true,
        ColorMode::Auto => !has_visible_rgb(source) && !varies(source, names::INTENSITY),
        _ => false,
    }
}

/// Heights between which the root's points lie, stray ones left out.
pub fn elevation_range(source: &dyn NodeSource) -> Result<Option<(f64, f64)>, NodeReadError> {
    let octree = source.octree();
    if octree.nodes().is_empty() {
        return Ok(None);
    }
    let mut positions = Vec::new();
    source.read_positions(NodeId::ROOT, &mut positions)?;
    Ok(Some(quantiles(elevations(octree, NodeId::ROOT, &positions).collect())))
}

fn attribute_range(source: &dyn NodeSource, index: usize) -> Result<(f64, f64), NodeReadError> {
    let attribute = &source.schema().attributes[index];
    let mut bytes = Vec::new();
    source.read_attribute(NodeId::ROOT, index, &mut bytes)?;
    let (low, high) =
        quantiles(first_components(&bytes, attribute.scalar, attribute.bytes()).collect());
    // Most values equal (a flag, a rare return): the full range tells them apart.
    match source.value_ranges(index).first() {
        Some(range) if low >= high => Ok((range.min, range.max)),
        _ => Ok((low, high)),
    }
}

fn quantiles(mut values: Vec<f64>) -> (f64, f64) {
    values.retain(|value| value.is_finite());
    if values.is_empty() {
        return (0.0, 0.0);
    }
    let last = values.len() - 1;
    let mut at = |share: f64| {
        let index = (share * last as f64).round() as usize;
        *values.select_nth_unstable_by(index, f64::total_cmp).1
    };
    let (low, high) = (at(0.01), at(0.99));
    if low < high { (low, high) } else { (at(0.0), at(1.0)) }
}

fn has_visible_rgb(source: &dyn NodeSource) -> bool {
    let not_black = |attribute| source.value_ranges(attribute).iter().any(|range| range.max > 0.0);
    source.has_colors() && source.schema().find(names::RGB).is_none_or(|(i, _)| not_black(i))
}

fn varies(source: &dyn NodeSource, name: &str) -> bool {
    source
        .schema()
        .find(name)
        .and_then(|(attribute, _)| source.value_ranges(attribute).first())
        .is_some_and(|range| range.max > range.min)
}

/// World z of each point of a node.
fn elevations<'a>(
    octree: &'a Octree,
    node: NodeId,
    positions: &'a [u32],
) -> impl Iterator<Item = f64> + 'a {
    let stride = position_words(octree.local_bits(node)) as usize;
    let (scale, offset) = (octree.lattice().scale.z, octree.lattice().offset.z);
    let base = octree.cell_min(node).z;
    positions.chunks_exact(stride).map(move |words| {
        let z = match words {
            &[low, high] => (u64::from(low) | u64::from(high) << 32).decode()[2],
            _ => words[2],
        };
        (base + i64::from(z)) as f64 * scale + offset
    })
}

/// The first component of each value of a column whose values have `stride` bytes.
fn first_components(bytes: &[u8], scalar: Scalar, stride: usize) -> impl Iterator<Item = f64> + '_ {
    bytes.chunks_exact(stride).map(move |value| scalar.read(value))
}

/// An RGBA8 word from lightness, chroma and hue in degrees; chroma beyond sRGB is clipped.
fn word_of_oklch([lightness, chroma, hue]: [f64; 3]) -> u32 {
    let (sin, cos) = hue.to_radians().sin_cos();
    let (a, b) = (chroma * cos, chroma * sin);
    let l = (lightness + 0.3963377774 * a + 0.2158037573 * b).powi(3);
    let m = (lightness - 0.1055613458 * a - 0.0638541728 * b).powi(3);
    let s = (lightness - 0.0894841775 * a - 1.2914855480 * b).powi(3);
    let linear = [
        4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
        -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
        -0.0041960863 * l - 0.7034186147 * m + 1.7076147010 * s,
    ];
    let [r, g, b] = linear.map(|c: f64| {
        let c = c.clamp(0.0, 1.0);
        let encoded = if c <= 0.0031308 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
        (encoded * 255.0).round() as u8
    });
    u32::from_le_bytes([r, g, b, 255])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lightness in OKLCH of an RGBA8 word.
    fn lightness(word: u32) -> f64 {
        let [r, g, b, _] = word.to_le_bytes().map(|byte| {
            let c = f64::from(byte) / 255.0;
            if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
        });
        let l = 0.4122214708 * r + 0.5363325363 * g + 0.0514459929 * b;
        let m = 0.2119034982 * r + 0.6806995451 * g + 0.1073969566 * b;
        let s = 0.0883024619 * r + 0.2817188376 * g + 0.6299787005 * b;
        0.2104542553 * l.cbrt() + 0.7936177850 * m.cbrt() - 0.0040720468 * s.cbrt()
    }

    #[test]
    fn ramps_rise_in_lightness_and_clamp() {
        for keys in [ELEVATION_KEYS, GREY_KEYS, VALUE_KEYS] {
            let ramp = Ramp::new(10.0, 20.0, keys);
            let at = |value| lightness(ramp.color(value));
            for i in 0..20 {
                let value = 10.0 + 0.5 * f64::from(i);
                assert!(at(value + 0.5) > at(value), "{value} of {keys:?}");
            }
            assert_eq!(ramp.color(-1e9), ramp.color(10.0));
            assert_eq!(ramp.color(1e9), ramp.color(20.0));
            assert_eq!(ramp.color(f64::NAN), ramp.color(10.0));
        }
    }

    #[test]
    fn oklch_knows_white_black_and_red() {
        assert_eq!(word_of_oklch([1.0, 0.0, 0.0]), 0xffff_ffff);
        assert_eq!(word_of_oklch([0.0, 0.0, 0.0]), 0xff00_0000);
        let [r, g, b, _] = word_of_oklch([0.62796, 0.25768, 29.234]).to_le_bytes();
        assert!(r >= 254 && g <= 1 && b <= 1, "{r} {g} {b}");
    }

    #[test]
    fn class_words_have_red_lowest() {
        assert_eq!(class_color(2).to_le_bytes(), [0xa8, 0x7d, 0x4a, 0xff]);
        assert_ne!(class_color(64), class_color(65));
    }

    #[test]
    fn stray_values_do_not_stretch_a_range() {
        let mut values: Vec<f64> = (0..1000).map(f64::from).collect();
        values.push(1e12);
        values.push(f64::NAN);
        let (low, high) = quantiles(values);
        assert!((low, high) == (10.0, 990.0), "{low} {high}");
        assert_eq!(quantiles(vec![3.0; 5]), (3.0, 3.0));
        assert_eq!(quantiles(vec![]), (0.0, 0.0));
    }
}
