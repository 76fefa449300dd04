// The inverted distance of the nearest point drawn so far, or an older (smaller) value.

fn nearest_so_far(pixel: u32) -> u32 {
    return u32(atomicLoad(&pixels[pixel]) >> 32u);
}
