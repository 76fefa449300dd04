//! Textures: PNG and JPEG into pixels, within bounds.

use std::io::Cursor;
use std::path::Path;

use image::{ImageReader, Limits};

use crate::input::detect::open_regular;
use crate::mesh::Texture;

/// Largest side of a texture.
const MOST_SIDE: u32 = 16_384;
/// Most memory that decoding one may take.
const MOST_BYTES: u64 = 1 << 30;

/// Decodes a picture; why not, in words.
pub(super) fn decode(bytes: &[u8]) -> Result<Texture, String> {
    let mut reader =
        ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| e.to_string())?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(MOST_SIDE);
    limits.max_image_height = Some(MOST_SIDE);
    limits.max_alloc = Some(MOST_BYTES);
    reader.limits(limits);
    let picture = reader.decode().map_err(|error| error.to_string())?.into_rgba8();
    let (width, height) = picture.dimensions();
    let pixels = bytemuck::pod_collect_to_vec(picture.as_raw().as_slice());
    Ok(Texture { width, height, pixels })
}

/// Reads and decodes a picture beside a model; why not, in words.
pub(super) fn read(path: &Path) -> Result<Texture, String> {
    let file = open_regular(path).map_err(|fault| fault.to_string())?;
    if file.bytes() > MOST_BYTES {
        return Err(format!("{} bytes are more than a texture may have", file.bytes()));
    }
    let bytes = file.read_range(0..file.bytes()).map_err(|fault| fault.to_string())?;
    decode(&bytes)
}
