// Occlusion culling without read-back: gathers the objects that were visible in the last frame, tests
// all others against the depth of these, and gathers what newly shows, into draws whose arguments
// stand in a buffer.
// In: boxes (the objects in view, in the order of the draws), and for a test frame, pyramid. In and
// out: state (counts, then a word per object: bit 0 visible in the last frame, bit 1 in this one).
// Out: drawn (objects to draw, draw by draw, for each of the two passes), arguments (the number of
// instances of each draw).
// Oracle and test: tests/two_pass.rs. Not run unless `two-pass` culls something.
#import shared/structs
#import shared/pyramid_test

@group(2) @binding(0) var<storage, read> boxes: array<GpuBox>;
@group(2) @binding(1) var<storage, read_write> state: array<atomic<u32>>;
@group(3) @binding(0) var<storage, read_write> drawn: array<u32>;
@group(3) @binding(1) var<storage, read_write> arguments: array<u32>;

// 0: what was visible in the last frame; 1: what newly shows.
override PART: u32 = 0u;

const SEEN: u32 = 1u;
const SEEN_NOW: u32 = 2u;
// Words of an indexed draw: indices, instances, first index, base vertex, first instance.
const DRAW_WORDS: u32 = 5u;

var<workgroup> bounds: vec2<u32>;
var<workgroup> taken: array<atomic<u32>, 2>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn test_boxes(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let at = id.y * groups.x * WORKGROUP_SIZE + id.x;
    if at >= arrayLength(&boxes) {
        return;
    }
    let object = boxes[at];
    let shows = object.untested != 0u || may_show(object.low, object.high);
    let before = atomicLoad(&state[STATE_COUNTS + object.item]) & SEEN;
    atomicStore(&state[STATE_COUNTS + object.item], before | select(0u, SEEN_NOW, shows));
}

// One workgroup per draw; the order of objects stays, so pictures do not depend on who is first.
@compute @workgroup_size(WORKGROUP_SIZE)
fn gather(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let total = arrayLength(&boxes);
    let draws = arrayLength(&arguments) / (2u * DRAW_WORDS) - 1u;
    let draw = group.y * groups.x + group.x;
    let row = (PART * (draws + 1u) + min(draw, draws)) * DRAW_WORDS;
    if lane == 0u {
        // A row after the last draw tells where its objects end.
        let end = select(arguments[row + DRAW_WORDS + 4u], arguments[row + 4u], draw >= draws);
        bounds = vec2<u32>(arguments[row + 4u], end);
    }
    let range = workgroupUniformLoad(&bounds);
    var count = 0u;
    for (var start = range.x; start < range.y; start += WORKGROUP_SIZE) {
        let place = start + lane;
        var takes = false;
        var item = 0u;
        if place < range.y {
            let object = boxes[place - PART * total];
            item = object.item;
            let seen = atomicLoad(&state[STATE_COUNTS + item]);
            let is_first = object.untested != 0u || (seen & SEEN) != 0u;
            if PART == 0u {
                takes = is_first;
            } else {
                takes = (seen & SEEN_NOW) != 0u && !is_first;
                atomicStore(&state[STATE_COUNTS + item], (seen & SEEN_NOW) >> 1u);
            }
        }
        if lane < 2u {
            atomicStore(&taken[lane], 0u);
        }
        workgroupBarrier();
        let word = lane / 32u;
        let bit = 1u << (lane % 32u);
        if takes {
            atomicOr(&taken[word], bit);
        }
        workgroupBarrier();
        let low = atomicLoad(&taken[0]);
        let high = atomicLoad(&taken[1]);
        if takes {
            var rank = countOneBits(select(high, low, word == 0u) & (bit - 1u));
            rank += select(countOneBits(low), 0u, word == 0u);
            drawn[range.x + count + rank] = item;
        }
        let more = countOneBits(low) + countOneBits(high);
        count += more;
        if lane == 0u && more > 0u {
            // A sum of 64 bits.
            let triangles = more * (arguments[row] / 3u);
            let before = atomicAdd(&state[2], triangles);
            if before + triangles < before {
                atomicAdd(&state[3], 1u);
            }
        }
        workgroupBarrier();
    }
    if lane == 0u && count > 0u {
        arguments[row + 1u] = count;
        atomicAdd(&state[PART], count);
    }
}
