// Pixels as pairs of 32-bit atomics in the same memory as the 64-bit ones, low word first, for
// adapters without the latter. All points are drawn twice: first for the nearest distance, then,
// of the points at that distance, for the smallest colour word. Every point finds its distance
// with the same operations both times, so the second pass meets the first exactly.

// Which of the two. Fixed per pipeline.
override COLOR_PASS: bool = false;

@group(2) @binding(0) var<storage, read_write> pixels: array<atomic<u32>>;

// Whether the point can change nothing.
fn is_hidden(pixel: u32, nearness: u32) -> bool {
    let nearest = atomicLoad(&pixels[2u * pixel + 1u]);
    if COLOR_PASS {
        return nearest != nearness;
    }
    return nearest >= nearness;
}

fn put_point(pixel: u32, nearness: u32, color_at: u32) {
    if COLOR_PASS {
        atomicMax(&pixels[2u * pixel], ~words[color_at]);
    } else {
        atomicMax(&pixels[2u * pixel + 1u], nearness);
    }
}

fn put_ball(pixel: u32, nearness: u32, color_at: u32, height: f32) {
    if COLOR_PASS {
        atomicMax(&pixels[2u * pixel], ~ball_color(words[color_at], height));
    } else {
        atomicMax(&pixels[2u * pixel + 1u], nearness);
    }
}
