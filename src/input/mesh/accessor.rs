//! The numbers of glTF accessors, out of buffers that may be shorter than they claim.

use super::gltf_json::{Accessor, Document, SparsePart};

/// Why an accessor cannot be read, in words.
pub(super) type Reason = String;

/// The buffers of a document; `None` for one that is missing.
pub(super) type Buffers<'a> = [Option<std::borrow::Cow<'a, [u8]>>];

/// Bytes of a component and what it is divided by if it is normalized.
fn component(component_type: u32) -> Option<(u64, f64)> {
    Some(match component_type {
        5120 => (1, 127.0),
        5121 => (1, 255.0),
        5122 => (2, 32_767.0),
        5123 => (2, 65_535.0),
        5125 => (4, 4_294_967_295.0),
        5126 => (4, 1.0),
        _ => return None,
    })
}

fn number(component_type: u32, bytes: &[u8]) -> f64 {
    match (component_type, bytes) {
        (5120, &[a, ..]) => f64::from(a as i8),
        (5121, &[a, ..]) => f64::from(a),
        (5122, &[a, b, ..]) => f64::from(i16::from_le_bytes([a, b])),
        (5123, &[a, b, ..]) => f64::from(u16::from_le_bytes([a, b])),
        (5125, &[a, b, c, d, ..]) => f64::from(u32::from_le_bytes([a, b, c, d])),
        (5126, &[a, b, c, d, ..]) => f64::from(f32::from_le_bytes([a, b, c, d])),
        _ => f64::NAN,
    }
}

/// Components of a type.
fn width(kind: &str) -> Option<usize> {
    ["SCALAR", "VEC2", "VEC3", "VEC4"].iter().position(|name| *name == kind).map(|at| at + 1)
}

/// The bytes of a view.
pub(super) fn view_bytes<'a>(
    document: &Document,
    buffers: &'a Buffers,
    view: usize,
) -> Result<&'a [u8], Reason> {
    let named = format!("buffer view {view}");
    let view = document.buffer_views.get(view).ok_or_else(|| format!("{named} is not there"))?;
    let buffer = buffers.get(view.buffer).and_then(Option::as_deref);
    let buffer = buffer.ok_or_else(|| format!("{named}: buffer {} is missing", view.buffer))?;
    let end = view.byte_offset.checked_add(view.byte_length);
    let range = end.and_then(|end| Some(view.byte_offset.try_into().ok()?..end.try_into().ok()?));
    range.and_then(|range: std::ops::Range<usize>| buffer.get(range)).ok_or_else(|| {
        format!(
            "{named}: {} bytes at byte {} leave a buffer of {}",
            view.byte_length,
            view.byte_offset,
            buffer.len()
        )
    })
}

/// Rows of an accessor: `most` components at most each, as numbers; and how many each has.
pub(super) fn rows(
    document: &Document,
    buffers: &Buffers,
    index: usize,
) -> Result<(Vec<f64>, usize), Reason> {
    let accessor = document.accessors.get(index);
    let accessor = accessor.ok_or_else(|| format!("accessor {index} is not there"))?;
    read(document, buffers, accessor).map_err(|reason| format!("accessor {index}: {reason}"))
}

fn read(
    document: &Document,
    buffers: &Buffers,
    accessor: &Accessor,
) -> Result<(Vec<f64>, usize), Reason> {
    let width = width(&accessor.kind).ok_or_else(|| format!("odd type \"{}\"", accessor.kind))?;
    let odd = || format!("odd component type {}", accessor.component_type);
    let (bytes, divisor) = component(accessor.component_type).ok_or_else(odd)?;
    let divisor = if accessor.normalized { divisor } else { 1.0 };
    let mut values = match accessor.buffer_view {
        Some(view) => {
            let stride = document.buffer_views.get(view).and_then(|view| view.byte_stride);
            let view = view_bytes(document, buffers, view)?;
            let layout = Layout { start: accessor.byte_offset, stride, width, bytes };
            let mut values = layout.read(view, accessor.count, accessor.component_type)?;
            values.iter_mut().for_each(|value| *value /= divisor);
            values
        }
        None => {
            // All zeros; each of them must have been worth a byte somewhere.
            let held: u64 = buffers.iter().flatten().map(|buffer| buffer.len() as u64).sum();
            if accessor.sparse.is_none() || accessor.count > held {
                return Err(format!("{} rows without data", accessor.count));
            }
            vec![0.0; accessor.count as usize * width]
        }
    };
    if let Some(sparse) = &accessor.sparse {
        let part = |part: &SparsePart, component_type, width| -> Result<Vec<f64>, Reason> {
            let (bytes, _) = component(component_type).ok_or("odd sparse component type")?;
            let view = view_bytes(document, buffers, part.buffer_view)?;
            let layout = Layout { start: part.byte_offset, stride: None, width, bytes };
            layout.read(view, sparse.count, component_type)
        };
        let places = part(&sparse.indices, sparse.indices.component_type, 1)?;
        let replaced = part(&sparse.values, accessor.component_type, width)?;
        for (&place, row) in places.iter().zip(replaced.chunks_exact(width)) {
            let at = place as usize * width;
            let Some(target) = values.get_mut(at..at + width) else {
                return Err(format!("sparse row {place} of {}", accessor.count));
            };
            target.iter_mut().zip(row).for_each(|(target, value)| *target = value / divisor);
        }
    }
    Ok((values, width))
}

/// Where rows stand in a view.
struct Layout {
    start: u64,
    stride: Option<u64>,
    width: usize,
    bytes: u64,
}

impl Layout {
    fn read(&self, view: &[u8], count: u64, component_type: u32) -> Result<Vec<f64>, Reason> {
        let row_bytes = self.width as u64 * self.bytes;
        let stride = self.stride.unwrap_or(row_bytes).max(row_bytes);
        let Some(before_last) = count.checked_sub(1) else { return Ok(Vec::new()) };
        let end = before_last
            .checked_mul(stride)
            .and_then(|bytes| bytes.checked_add(row_bytes))
            .and_then(|bytes| bytes.checked_add(self.start));
        if end.is_none_or(|end| end > view.len() as u64) {
            return Err(format!("{count} rows of {row_bytes} bytes leave {} bytes", view.len()));
        }
        let mut values = Vec::with_capacity(count as usize * self.width);
        for row in 0..count {
            let at = (self.start + row * stride) as usize;
            for lane in 0..self.width {
                let place = at + lane * self.bytes as usize;
                values.push(number(component_type, &view[place..place + self.bytes as usize]));
            }
        }
        Ok(values)
    }
}
