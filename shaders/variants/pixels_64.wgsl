// Pixels as 64-bit atomics: the inverted distance in the high word, the inverted colour in the low
// one. The greatest value is the nearest point, at equal distance the smallest colour word.
#import nearest_so_far

@group(2) @binding(0) var<storage, read_write> pixels: array<atomic<u64>>;

// Whether something drawn before is nearer.
fn is_hidden(pixel: u32, nearness: u32) -> bool {
    return nearest_so_far(pixel) > nearness;
}

fn put_word(pixel: u32, nearness: u32, color: u32) {
    atomicMax(&pixels[pixel], (u64(nearness) << 32u) | u64(~color));
}

fn put_point(pixel: u32, nearness: u32, color_at: u32) {
    put_word(pixel, nearness, words[color_at]);
}

fn put_ball(pixel: u32, nearness: u32, color_at: u32, height: f32) {
    put_word(pixel, nearness, ball_color(words[color_at], height));
}
