// Group 0: the frame, read once by each thread. Software adapters read a uniform lane by lane
// wherever it is named; in a loop over points that took a fifth of the time. Entry points begin
// with `frame = bound_frame;`.
#import shared/structs

@group(0) @binding(0) var<uniform> bound_frame: GpuFrame;
var<private> frame: GpuFrame;
