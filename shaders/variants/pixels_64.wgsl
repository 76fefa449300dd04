// Pixels as 64-bit atomics: the inverted distance in the high word, the inverted colour in the low
// one. The greatest value is the nearest point, at equal distance the smallest colour word. Points
// are opaque, so the byte of opacity says that something is there: neither word of it is zero.
#import nearest_so_far

// Whether a point looks what is there before it goes to the atomic operation. Fixed per pipeline.
override LOOKS_FIRST: bool = true;

@group(2) @binding(0) var<storage, read_write> pixels: array<atomic<u64>>;

// Whether something drawn before is nearer.
fn is_hidden(pixel: u32, nearness: u32) -> bool {
    if !LOOKS_FIRST {
        return false;
    }
    return nearest_so_far(pixel) > nearness;
}

// Colour of a point, as far as this pass needs it.
fn needed_color(color_at: u32) -> u32 {
    return words[color_at];
}

fn put_word(pixel: u32, nearness: u32, color: u32) {
    atomicMax(&pixels[pixel], (u64(nearness) << 32u) | u64(~color | 0xff000000u));
}
