//! Protects a promise of `select::CutScratch`: a warmed-up traversal allocates nothing.
//!
//! In a test binary of its own, because it counts every allocation of the process.

#[path = "support/insertion.rs"]
mod insertion;
#[path = "support/scans.rs"]
mod scans;

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicU64, Ordering};

use esker::select::{
    AllResident, CutScratch, CutSettings, SplatPolicy, SplatSettings, select_nodes,
};
use insertion::Parameters;
use scans::{Random, Scan, courtyard};

static ALLOCATIONS: AtomicU64 = AtomicU64::new(0);

struct Counting;

#[allow(unsafe_code, reason = "an allocator that counts and passes everything on")]
// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller keeps `alloc`'s contract.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the pointer came from `alloc` above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static GLOBAL: Counting = Counting;

#[test]
fn a_warm_traversal_allocates_nothing() {
    let parameters = Parameters { depth: 3, threshold: 20, bits: 14 };
    let scan = Scan::new(courtyard(20_000, 14, 1), &parameters);
    let mut random = Random::new(31);
    let views: Vec<_> = (0..20).map(|_| scan.random_view(&mut random)).collect();
    let mut scratch = CutScratch::default();
    let mut nodes_drawn = 0;
    let mut pass = |scratch: &mut CutScratch| {
        for view in &views {
            for policy in SplatPolicy::ALL {
                for point_budget in [5_000, u64::MAX] {
                    let splat = SplatSettings { policy, ..SplatSettings::default() };
                    let settings = CutSettings { point_budget, splat, ..CutSettings::default() };
                    let cut = select_nodes(&scan.octree, view, &settings, &AllResident, scratch);
                    nodes_drawn += cut.counters.nodes_drawn;
                    scratch.recycle(cut);
                }
            }
        }
    };
    pass(&mut scratch);
    let before = ALLOCATIONS.load(Ordering::Relaxed);
    pass(&mut scratch);
    assert_eq!(ALLOCATIONS.load(Ordering::Relaxed) - before, 0);
    assert!(nodes_drawn > 1000 && before > 0, "something was drawn and counted");
}
