//! How a node's columns are compressed: differences, byte planes, LZ4.
//!
//! A column is `count` elements of `components` little-endian integers. Encoding takes each
//! component's difference to the previous element (optional), splits the result into byte planes
//! (all lowest bytes first), and compresses the planes with LZ4. If LZ4 does not make it smaller,
//! the planes are stored as they are; readers tell the two by the length.
//! Decoding gives exactly the bytes that went in; nothing else has to be done to them.
//! This is done block by block (`blocks`), so that no column has to be in memory as a whole.

/// How the elements of a column are prepared before LZ4.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Filter {
    /// Byte planes of the values.
    Planes,
    /// Byte planes of the differences between neighbours, modulo 2^bits.
    DeltaPlanes,
    /// Byte planes of zigzag-coded differences: small steps up and down both give small numbers.
    ZigzagDeltaPlanes,
}

/// The shape of a column's elements.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct ElementShape {
    /// Bytes of one component: 1, 2, 4 or 8.
    pub component_bytes: u32,
    /// Components of one element.
    pub components: u32,
    /// What is done before compression.
    pub filter: Filter,
}

impl ElementShape {
    /// Bytes of one element.
    pub fn bytes(&self) -> usize {
        self.component_bytes as usize * self.components as usize
    }
}

/// Reusable memory for encoding and decoding.
#[derive(Default)]
pub struct CodecScratch {
    planes: Vec<u8>,
    packed: Vec<u8>,
}

/// Compresses one block, whole elements of `shape`, and appends the result to `out`.
/// Returns the number of bytes appended.
pub(super) fn encode(
    shape: ElementShape,
    raw: &[u8],
    scratch: &mut CodecScratch,
    out: &mut Vec<u8>,
) -> usize {
    assert_eq!(raw.len() % shape.bytes(), 0, "a column holds whole elements");
    if scratch.planes.len() < raw.len() {
        scratch.planes.resize(raw.len(), 0);
    }
    let planes = if shape.filter == Filter::Planes && shape.bytes() == 1 {
        raw
    } else {
        let planes = &mut scratch.planes[..raw.len()];
        match shape.component_bytes {
            1 => to_planes::<1>(shape, raw, planes),
            2 => to_planes::<2>(shape, raw, planes),
            4 => to_planes::<4>(shape, raw, planes),
            8 => to_planes::<8>(shape, raw, planes),
            other => unreachable!("components of {other} bytes do not exist"),
        }
        planes
    };
    let bound = lz4_flex::block::get_maximum_output_size(raw.len());
    if scratch.packed.len() < bound {
        scratch.packed.resize(bound, 0);
    }
    let written = lz4_flex::block::compress_into(planes, &mut scratch.packed)
        .expect("the buffer has LZ4's stated bound");
    let stored = if written < raw.len() { &scratch.packed[..written] } else { planes };
    out.extend_from_slice(stored);
    stored.len()
}

/// Decodes what [`encode`] wrote into `raw`, whose length says how many elements there are.
///
/// Errors say what does not fit; `raw` then holds nothing of use.
pub(super) fn decode(
    shape: ElementShape,
    stored: &[u8],
    scratch: &mut CodecScratch,
    raw: &mut [u8],
) -> Result<(), String> {
    let planes = if stored.len() == raw.len() {
        stored
    } else {
        if scratch.planes.len() < raw.len() {
            scratch.planes.resize(raw.len(), 0);
        }
        let length = lz4_flex::block::decompress_into(stored, &mut scratch.planes[..raw.len()])
            .map_err(|error| format!("LZ4: {error}"))?;
        if length != raw.len() {
            return Err(format!("decodes to {length} bytes, expected {}", raw.len()));
        }
        &scratch.planes[..raw.len()]
    };
    match shape.component_bytes {
        1 => from_planes::<1>(shape, planes, raw),
        2 => from_planes::<2>(shape, planes, raw),
        4 => from_planes::<4>(shape, planes, raw),
        8 => from_planes::<8>(shape, planes, raw),
        other => return Err(format!("components of {other} bytes do not exist")),
    }
    Ok(())
}

/// Component of `N` bytes, as an integer of 64 bits.
fn load<const N: usize>(bytes: &[u8]) -> u64 {
    let mut word = [0; 8];
    word[..N].copy_from_slice(&bytes[..N]);
    u64::from_le_bytes(word)
}

/// Removes what does not belong to `N` bytes.
fn wrap<const N: usize>(value: u64) -> u64 {
    value & (u64::MAX >> (64 - 8 * N))
}

fn zigzag<const N: usize>(difference: u64) -> u64 {
    let sign = wrap::<N>(0u64.wrapping_sub(difference >> (8 * N - 1)));
    wrap::<N>(difference << 1) ^ sign
}

fn unzigzag<const N: usize>(coded: u64) -> u64 {
    (coded >> 1) ^ wrap::<N>(0u64.wrapping_sub(coded & 1))
}

fn to_planes<const N: usize>(shape: ElementShape, raw: &[u8], planes: &mut [u8]) {
    // One loop per filter: the choice must not be made per element.
    match shape.filter {
        Filter::Planes => fill_planes::<N>(shape, raw, planes, |value, _| value),
        Filter::DeltaPlanes => fill_planes::<N>(shape, raw, planes, |value, previous| {
            wrap::<N>(value.wrapping_sub(previous))
        }),
        Filter::ZigzagDeltaPlanes => fill_planes::<N>(shape, raw, planes, |value, previous| {
            zigzag::<N>(wrap::<N>(value.wrapping_sub(previous)))
        }),
    }
}

#[inline(always)]
fn fill_planes<const N: usize>(
    shape: ElementShape,
    raw: &[u8],
    planes: &mut [u8],
    code: impl Fn(u64, u64) -> u64,
) {
    let stride = shape.bytes();
    let count = raw.len() / stride;
    if count == 0 {
        return;
    }
    // As many elements at a time as stay in the cache: there may be thousands of components.
    let tile = (TILE_BYTES / stride).clamp(1, count);
    let mut previous = vec![0; shape.components as usize];
    for (first, elements) in (0..count).step_by(tile).zip(raw.chunks(tile * stride)) {
        let planes = planes.chunks_exact_mut(count * N).zip(&mut previous);
        for (component, (planes, previous)) in planes.enumerate() {
            let mut columns: [&mut [u8]; N] = split_planes(planes, count);
            for (i, element) in (first..).zip(elements.chunks_exact(stride)) {
                let value = load::<N>(&element[component * N..]);
                let coded = code(value, *previous);
                *previous = value;
                for (plane, byte) in columns.iter_mut().zip(coded.to_le_bytes()) {
                    plane[i] = byte;
                }
            }
        }
    }
}

/// Bytes of elements that are taken apart together.
const TILE_BYTES: usize = 1 << 15;

fn from_planes<const N: usize>(shape: ElementShape, planes: &[u8], raw: &mut [u8]) {
    let stride = shape.bytes();
    let count = raw.len() / stride;
    if count == 0 {
        return;
    }
    for (component, planes) in planes.chunks_exact(count * N).enumerate() {
        let columns: [&[u8]; N] = std::array::from_fn(|i| &planes[i * count..(i + 1) * count]);
        let mut value = 0u64;
        for (i, element) in raw.chunks_exact_mut(stride).enumerate() {
            let mut word = [0; 8];
            for (byte, plane) in word.iter_mut().zip(&columns) {
                *byte = plane[i];
            }
            let coded = u64::from_le_bytes(word);
            value = match shape.filter {
                Filter::Planes => coded,
                Filter::DeltaPlanes => value.wrapping_add(coded),
                Filter::ZigzagDeltaPlanes => value.wrapping_add(unzigzag::<N>(coded)),
            };
            element[component * N..(component + 1) * N].copy_from_slice(&value.to_le_bytes()[..N]);
        }
    }
}

fn split_planes<const N: usize>(planes: &mut [u8], count: usize) -> [&mut [u8]; N] {
    let mut rest = planes.chunks_exact_mut(count);
    std::array::from_fn(|_| rest.next().expect("one plane per byte of a component"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn round_trip(shape: ElementShape, raw: &[u8]) -> usize {
        let mut scratch = CodecScratch::default();
        let mut stored = vec![7; 3];
        let written = encode(shape, raw, &mut scratch, &mut stored);
        assert_eq!(stored.len(), 3 + written);
        let mut back = vec![0xaa; raw.len()];
        decode(shape, &stored[3..], &mut scratch, &mut back).expect("what was encoded decodes");
        assert_eq!(back, raw);
        written
    }

    fn any_shape() -> impl Strategy<Value = ElementShape> {
        let filter = prop_oneof![
            Just(Filter::Planes),
            Just(Filter::DeltaPlanes),
            Just(Filter::ZigzagDeltaPlanes)
        ];
        (prop_oneof![Just(1u32), Just(2), Just(4), Just(8)], 1u32..5, filter).prop_map(
            |(component_bytes, components, filter)| ElementShape {
                component_bytes,
                components,
                filter,
            },
        )
    }

    proptest! {
        #[test]
        fn columns_come_back(shape in any_shape(), bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
            let whole = bytes.len() / shape.bytes() * shape.bytes();
            round_trip(shape, &bytes[..whole]);
        }

        #[test]
        fn foreign_bytes_are_an_error_or_a_value_but_no_panic(shape in any_shape(), bytes in proptest::collection::vec(any::<u8>(), 0..200), count in 0usize..50) {
            let mut raw = vec![0; count * shape.bytes()];
            let _ = decode(shape, &bytes, &mut CodecScratch::default(), &mut raw);
        }
    }

    #[test]
    fn sorted_codes_shrink_and_noise_does_not_grow() {
        let shape = ElementShape { component_bytes: 8, components: 1, filter: Filter::DeltaPlanes };
        let sorted: Vec<u8> = (0..10_000u64).flat_map(|i| (i * i).to_le_bytes()).collect();
        assert!(round_trip(shape, &sorted) * 3 < sorted.len());
        let mut state = 1u64;
        let noise: Vec<u8> = std::iter::repeat_with(|| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 56) as u8
        })
        .take(8000)
        .collect();
        assert_eq!(round_trip(shape, &noise), noise.len());
    }
}
