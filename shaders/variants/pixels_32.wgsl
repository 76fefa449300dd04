// Pixels as pairs of 32-bit atomics in the same memory as the 64-bit ones, low word first, for
// adapters without the latter. All points are drawn twice: first for the nearest distance, then,
// of the points at that distance, for the smallest colour word. Every point finds its distance
// with the same operations both times, so the second pass meets the first exactly.

// Which of the two. Fixed per pipeline.
override COLOR_PASS: bool = false;

// Whether a point looks what is there before it goes to the atomic operation of the first pass.
// Fixed per pipeline.
override LOOKS_FIRST: bool = true;

@group(2) @binding(0) var<storage, read_write> pixels: array<atomic<u32>>;

// Whether the point can change nothing.
fn is_hidden(pixel: u32, nearness: u32) -> bool {
    if COLOR_PASS {
        return atomicLoad(&pixels[2u * pixel + 1u]) != nearness;
    }
    if !LOOKS_FIRST {
        return false;
    }
    return atomicLoad(&pixels[2u * pixel + 1u]) >= nearness;
}

// Colour of a point, as far as this pass needs it.
fn needed_color(color_at: u32) -> u32 {
    if COLOR_PASS {
        return words[color_at];
    }
    return 0u;
}

fn put_word(pixel: u32, nearness: u32, color: u32) {
    if COLOR_PASS {
        atomicMax(&pixels[2u * pixel], ~color | 0xff000000u);
    } else {
        atomicMax(&pixels[2u * pixel + 1u], nearness);
    }
}
