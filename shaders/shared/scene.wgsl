// Group 1: the drawn nodes and the words of one shard.
#import shared/structs

@group(1) @binding(0) var<storage, read> nodes: array<GpuNode>;
@group(1) @binding(1) var<storage, read> words: array<u32>;
