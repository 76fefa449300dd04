// Decides in the middle of a frame which of several alternatives is drawn: the first one that needs
// less than the time that is left, the last one if none does.
// In: checkpoint, stamps (the GPU's clock, u64 as low and high word), needs (ticks), dispatches.
// Out: arguments: three words per dispatch, zeros if its alternative was not chosen; then the
// chosen alternative.
// Twin: budget::choose_alternative, budget::ticks_left. Test: tests/checkpoint.rs. Not run where a
// frame has no alternatives.
#import shared/structs

@group(0) @binding(0) var<uniform> checkpoint: GpuCheckpoint;
@group(0) @binding(1) var<storage, read> stamps: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> needs: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> dispatches: array<GpuDispatch>;
@group(0) @binding(4) var<storage, read_write> arguments: array<u32>;

// Whether a 64-bit number is below another.
fn is_less(a: vec2<u32>, b: vec2<u32>) -> bool {
    return a.y < b.y || (a.y == b.y && a.x < b.x);
}

// The difference of 64-bit numbers, which may wrap around.
fn minus(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    return vec2<u32>(a.x - b.x, a.y - b.y - select(0u, 1u, a.x < b.x));
}

@compute @workgroup_size(1)
fn decide() {
    let allowed = vec2<u32>(checkpoint.allowed_low, checkpoint.allowed_high);
    let spent = minus(stamps[checkpoint.last_stamp], stamps[checkpoint.first_stamp]);
    var left = vec2<u32>(0u);
    if is_less(spent, allowed) {
        left = minus(allowed, spent);
    }
    var chosen = checkpoint.alternative_count - 1u;
    for (var i = checkpoint.alternative_count; i > 0u; i -= 1u) {
        if is_less(needs[i - 1u], left) {
            chosen = i - 1u;
        }
    }
    for (var i = 0u; i < checkpoint.dispatch_count; i += 1u) {
        let dispatch = dispatches[i];
        let is_on = dispatch.alternative == chosen;
        arguments[3u * i] = select(0u, dispatch.x, is_on);
        arguments[3u * i + 1u] = select(0u, dispatch.y, is_on);
        arguments[3u * i + 2u] = select(0u, dispatch.z, is_on);
    }
    arguments[3u * checkpoint.dispatch_count] = chosen;
}
