//! The methods that are compared, by name.

use crate::hierarchy::TightCut;
use crate::visibility::{Algorithm, ChcOptions, ChcPlusOptions, CullingCosts, LateAnswers};

/// A named method.
#[derive(Clone, Debug)]
pub(super) struct Method {
    pub name: String,
    pub algorithm: Algorithm,
}

pub(super) fn named(name: impl Into<String>, algorithm: Algorithm) -> Method {
    Method { name: name.into(), algorithm }
}

/// Rounds beyond what any course needs, so that counters are those of the method.
const FREE: LateAnswers = LateAnswers::Rounds(64);

pub(super) fn chc() -> ChcOptions {
    ChcOptions { late: FREE, ..ChcOptions::default() }
}

pub(super) fn plus() -> ChcPlusOptions {
    ChcPlusOptions { late: FREE, ..ChcPlusOptions::default() }
}

/// Every method.
pub(super) fn all() -> Vec<Method> {
    let late = LateAnswers::NextFrame;
    let costs = CullingCosts::default();
    vec![
        named("frustum", Algorithm::Frustum),
        named("naive", Algorithm::Naive),
        named("stop-and-wait", Algorithm::StopAndWait),
        named("a frame late", Algorithm::Chc(ChcOptions { late, ..chc() })),
        named("chc", Algorithm::Chc(chc())),
        named("chc, k = 3", Algorithm::Chc(ChcOptions { assume_visible_frames: 3, ..chc() })),
        named("near-optimal", Algorithm::NearOptimal(chc(), costs)),
        named("chc++ classic", Algorithm::ChcPlus(ChcPlusOptions { optimized: false, ..plus() })),
        named("chc++", Algorithm::ChcPlus(plus())),
        named("chc++, fixed", Algorithm::ChcPlus(ChcPlusOptions { in_vain: None, ..plus() })),
        named("chc++, leaf 1000", Algorithm::ChcPlus(ChcPlusOptions { leaf_cost: 1000, ..plus() })),
        named("auto", Algorithm::Auto(plus(), costs)),
    ]
}

/// From CHC to CHC++, one part at a time.
pub(super) fn ablation() -> Vec<Method> {
    let plain = ChcPlusOptions { late: FREE, ..ChcPlusOptions::PLAIN };
    let batching = ChcPlusOptions { batching: true, batch_size: 50, ..plain };
    let jitter = ChcPlusOptions { jitter: true, assumed_visible_frames: 10, ..batching };
    let tight = ChcPlusOptions { tight: Some(TightCut::default()), ..jitter };
    let multi = ChcPlusOptions { multiqueries: true, ..tight };
    let optimized = ChcPlusOptions { optimized: true, ..multi };
    let rested = ChcPlusOptions { remember_splits: true, ..optimized };
    let bounded = ChcPlusOptions { in_vain: plus().in_vain, ..rested };
    vec![
        named("frustum", Algorithm::Frustum),
        named("chc", Algorithm::Chc(chc())),
        named("+B batching", Algorithm::ChcPlus(batching)),
        named("+R jitter", Algorithm::ChcPlus(jitter)),
        named("+TB tight bounds", Algorithm::ChcPlus(tight)),
        named("+MQ multiqueries", Algorithm::ChcPlus(multi)),
        named("+OPT", Algorithm::ChcPlus(optimized)),
        named("+remembered splits", Algorithm::ChcPlus(rested)),
        named("+bounded waste", Algorithm::ChcPlus(bounded)),
    ]
}
