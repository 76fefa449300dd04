// Group 0: the frame.
#import shared/structs

@group(0) @binding(0) var<uniform> frame: GpuFrame;
