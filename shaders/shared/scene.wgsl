// Group 0, the frame, and group 1, the drawn nodes and the words of one shard.
#import shared/structs

@group(0) @binding(0) var<uniform> frame: GpuFrame;
@group(1) @binding(0) var<storage, read> nodes: array<GpuNode>;
@group(1) @binding(1) var<storage, read> words: array<u32>;
