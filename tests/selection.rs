//! Protects the choice of nodes: what is drawn, asked for and left out, against slow oracles.
//!
//! The octrees come from the literal insertion in `support`, so nothing here depends on the
//! builder. The oracles follow the text of the rules: plain recursion, all eight corners of each
//! box, no queue.

#[path = "support/insertion.rs"]
mod insertion;
#[path = "support/scans.rs"]
mod scans;

use std::collections::BTreeMap;

use esker::geometry::{Aabb, Containment, Frustum, View};
use esker::ids::NodeId;
use esker::octree::Octree;
use esker::select::{
    AllResident, Availability, CellSpan, Cut, CutScratch, CutSettings, LevelRule, RuleCell,
    select_nodes, select_scene,
};
use glam::{DVec3, I64Vec3};
use insertion::Parameters;
use scans::{Random, Scan, courtyard};

fn scan() -> Scan {
    Scan::new(courtyard(30_000, 14, 1), &Parameters { depth: 3, threshold: 20, bits: 14 })
}

fn settings(rule: LevelRule, point_budget: u64) -> CutSettings {
    CutSettings { rule, point_budget, ..CutSettings::default() }
}

fn select(octree: &Octree, view: &View, settings: &CutSettings) -> Cut {
    select_nodes(octree, view, settings, &AllResident, &mut CutScratch::default())
}

/// A node's cell with its upper faces, from the directory alone.
fn whole_cell(octree: &Octree, id: NodeId) -> Aabb {
    let min = octree.cell_min(id);
    let edge = I64Vec3::splat(1 << octree.local_bits(id));
    Aabb::new(octree.lattice().world(min), octree.lattice().world(min + edge))
}

fn corners(bounds: &Aabb) -> [DVec3; 8] {
    std::array::from_fn(|i| {
        let upper = DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64);
        bounds.min + upper * bounds.size()
    })
}

/// Outside one plane with all eight corners.
fn out_of_sight(view: &View, bounds: &Aabb) -> bool {
    let m = view.clip_from_eye_relative();
    let clip = corners(bounds).map(|corner| m * (corner - view.camera.eye).extend(1.0));
    let beyond: [fn(glam::DVec4) -> bool; 5] =
        [|c| c.x < -c.w, |c| c.x > c.w, |c| c.y < -c.w, |c| c.y > c.w, |c| c.w < c.z];
    beyond.iter().any(|plane| clip.iter().all(|&c| plane(c)))
}

fn distance(octree: &Octree, view: &View, id: NodeId) -> f64 {
    octree.cell_box(id).distance(view.camera.eye)
}

/// Whether the cells of global level `level`, seen from `distance`, are no larger than the error.
fn fine_enough(
    octree: &Octree,
    view: &View,
    settings: &CutSettings,
    level: i32,
    distance: f64,
) -> bool {
    let edge = octree.cell_size(0) * f64::from(-level).exp2();
    let length = match settings.rule.span {
        CellSpan::Edge => edge.max_element(),
        CellSpan::Diagonal => edge.length(),
    };
    distance > 0.0 && length * view.focal_px() / distance <= settings.error_px
}

/// Whether a node with a drawn parent is itself wanted.
fn wanted(octree: &Octree, view: &View, settings: &CutSettings, id: NodeId) -> bool {
    let finest = (octree.node(id).depth + octree.depth()) as i32;
    let judged = match settings.rule.cell {
        RuleCell::Own => finest,
        RuleCell::Parent => finest - 1,
    };
    !out_of_sight(view, &whole_cell(octree, id))
        && !fine_enough(octree, view, settings, judged, distance(octree, view, id))
}

/// Points of a root: the levels that its size asks for.
fn root_count(octree: &Octree, view: &View, settings: &CutSettings) -> u32 {
    let r = distance(octree, view, NodeId::ROOT);
    let level = (0..octree.depth()).find(|&i| fine_enough(octree, view, settings, i as i32, r));
    octree.node(NodeId::ROOT).levels.prefix_len(level.unwrap_or(octree.depth()))
}

/// The cut without a budget, by recursion.
fn recursive_cut(octree: &Octree, view: &View, settings: &CutSettings) -> BTreeMap<NodeId, u32> {
    fn descend(
        octree: &Octree,
        view: &View,
        settings: &CutSettings,
        id: NodeId,
        cut: &mut BTreeMap<NodeId, u32>,
    ) {
        for child in octree.node(id).children() {
            if wanted(octree, view, settings, child) {
                cut.insert(child, octree.node(child).point_count());
                descend(octree, view, settings, child, cut);
            }
        }
    }
    let mut cut = BTreeMap::new();
    if !out_of_sight(view, &whole_cell(octree, NodeId::ROOT)) {
        cut.insert(NodeId::ROOT, root_count(octree, view, settings));
        descend(octree, view, settings, NodeId::ROOT, &mut cut);
    }
    cut
}

/// The order in which a budget is spent: always the largest on screen of those whose parent came
/// before, found by looking at all of them.
fn spending_order(octree: &Octree, view: &View, settings: &CutSettings) -> Vec<(NodeId, u32)> {
    let priority = |id: NodeId| {
        let r = distance(octree, view, id);
        let edge = octree.cell_size(octree.node(id).depth).max_element();
        if r > 0.0 { edge * view.focal_px() / r.max(view.camera.near) } else { f64::INFINITY }
    };
    let mut open: Vec<NodeId> = recursive_cut(octree, view, settings).into_keys().collect();
    // Children are never larger on screen than their parents, so sorting all at once respects them.
    open.sort_by(|&a, &b| priority(b).total_cmp(&priority(a)).then(a.cmp(&b)));
    let count = |id: NodeId| match id {
        NodeId::ROOT => root_count(octree, view, settings),
        _ => octree.node(id).point_count(),
    };
    open.into_iter().map(|id| (id, count(id))).collect()
}

fn drawn(cut: &Cut) -> BTreeMap<NodeId, u32> {
    cut.draw.iter().map(|d| (d.node, d.count)).collect()
}

#[test]
fn the_cut_is_the_recursive_one_for_all_four_rules() {
    let scan = scan();
    let mut random = Random::new(7);
    let mut sizes = BTreeMap::new();
    for i in 0..60 {
        let mut view = scan.random_view(&mut random);
        if i % 4 == 0 {
            let far = 10f64.powf(random.range(0.0, 2.0));
            view = scan.view_from(random.vector(-1.0, 1.0).normalize() * far);
        }
        for rule in LevelRule::FOUR {
            let settings = settings(rule, u64::MAX);
            let cut = select(&scan.octree, &view, &settings);
            let expected = recursive_cut(&scan.octree, &view, &settings);
            assert_eq!(drawn(&cut), expected, "{}", rule.name());
            assert_eq!(cut.draw.len(), expected.len(), "a node is drawn once");
            *sizes.entry(rule.name()).or_insert(0) += expected.len();
        }
    }
    let nodes = scan.octree.nodes().len();
    println!("{nodes} nodes, drawn in 60 views: {sizes:?}");
    assert!(sizes["own cell, edge"] < sizes["parent cell, diagonal"], "the views tell rules apart");
}

#[test]
fn budgets_are_spent_in_order_and_never_exceeded() {
    let scan = scan();
    let total = scan.octree.point_count();
    let mut random = Random::new(8);
    let mut scratch = CutScratch::default();
    for _ in 0..40 {
        let view = scan.random_view(&mut random);
        let budgets: Vec<u64> = [0.0, 1e-5, 0.001, 0.01, 0.05, 0.2, 0.5, 0.9, 0.999]
            .map(|f| (f * total as f64) as u64)
            .into();
        let order = spending_order(&scan.octree, &view, &settings(LevelRule::default(), 0));
        let mut last = BTreeMap::new();
        for budget in budgets {
            let settings = settings(LevelRule::default(), budget);
            let cut = select_nodes(&scan.octree, &view, &settings, &AllResident, &mut scratch);
            let mut left = budget;
            let fits = |&&(_, count): &&(NodeId, u32)| {
                let fits = u64::from(count) <= left;
                left = left.saturating_sub(u64::from(count));
                fits
            };
            let mut expected: Vec<(NodeId, u32)> = order.iter().take_while(fits).copied().collect();
            if let (true, Some(&(root, count))) = (expected.is_empty(), order.first()) {
                let totals = scan.octree.node(root).levels.totals();
                let prefix =
                    totals.iter().filter(|&&t| t <= count && u64::from(t) <= budget.max(1));
                expected.push((root, *prefix.max().expect("level 0 has one point")));
            }
            let actual: Vec<(NodeId, u32)> = cut.draw.iter().map(|d| (d.node, d.count)).collect();
            assert_eq!(actual, expected, "budget {budget}");
            assert!(cut.counters.points_drawn <= budget.max(1));
            let now = drawn(&cut);
            assert!(last.iter().all(|(node, count)| now.get(node) >= Some(count)), "nested");
            assert!(cut.counters.queue_pops > 0 || order.is_empty());
            last = now;
            scratch.recycle(cut);
        }
    }
}

#[test]
fn filling_draws_the_levels_that_still_fit() {
    let scan = scan();
    let view = scan.view_from(DVec3::new(0.2, -0.6, 0.3));
    let mut filled = 0;
    for budget in (500..20_000).step_by(333) {
        let strict = select(&scan.octree, &view, &settings(LevelRule::default(), budget));
        let fill = CutSettings { fill: true, ..settings(LevelRule::default(), budget) };
        let fill = select(&scan.octree, &view, &fill);
        assert!(fill.counters.points_drawn <= budget);
        assert_eq!(
            fill.draw[..strict.draw.len()].iter().map(|d| d.node).collect::<Vec<_>>(),
            strict.draw.iter().map(|d| d.node).collect::<Vec<_>>()
        );
        if let Some(extra) = fill.draw.get(strict.draw.len()) {
            let levels = &scan.octree.node(extra.node).levels;
            let left = budget - strict.counters.points_drawn;
            let next = levels.totals().iter().find(|&&t| t > extra.count);
            assert!(next.is_some_and(|&t| u64::from(t) > left), "the next level would not fit");
            filled += 1;
        }
        assert!(fill.draw.len() <= strict.draw.len() + 1);
    }
    assert!(filled > 20, "only {filled} budgets left room");
}

/// Distances up to a hundred times the model: never nothing, always coarser.
#[test]
fn a_far_model_keeps_a_coarse_prefix() {
    let scan = scan();
    let mut last = u64::MAX;
    for times in [0.8, 1.5, 3.0, 7.0, 15.0, 40.0, 100.0] {
        let view = scan.view_from(DVec3::new(0.6, -0.7, 0.4).normalize() * times);
        let cut = select(&scan.octree, &view, &CutSettings::default());
        assert!(cut.counters.points_drawn >= 1, "{times} edges away");
        assert!(cut.counters.points_drawn <= last, "{times} edges away");
        last = cut.counters.points_drawn;
        // Level 0 of the root is one point, and its cell is what the picture can show of it.
        let px = scan.edge() * view.focal_px() / (times * scan.edge());
        let cells = (px.max(1.0) * 4.0).powi(2);
        assert!(times < 3.0 || (last as f64) < cells, "{last} points for {px} pixels");
    }
    // Two pixels wide: cells of a quarter of the root are just fine enough, at most 64 of them.
    assert!(last <= 64, "{last} points from 100 edges away");
}

#[test]
fn skips_show_in_the_counters() {
    let scan = scan();
    let total = scan.octree.point_count();
    let view = scan.view_from(DVec3::new(0.4, -0.8, 0.5));
    let whole = select(&scan.octree, &view, &settings(LevelRule::default(), total));
    assert_eq!(whole.counters.queue_pops, 0, "a cloud within the budget needs no queue");
    assert!(whole.draw.is_sorted_by_key(|d| d.node), "its nodes come in directory order");
    let short = select(&scan.octree, &view, &settings(LevelRule::default(), total - 1));
    assert_eq!(drawn(&short), drawn(&whole), "the queue does not change what fits");
    assert!(short.counters.queue_pops > 0);

    let mut away = view;
    away.camera.forward = -away.camera.forward;
    let nothing = select(&scan.octree, &away, &settings(LevelRule::default(), 1000));
    assert!(nothing.draw.is_empty() && nothing.requests.is_empty());
    assert_eq!((nothing.counters.nodes_visited, nothing.counters.queue_pops), (1, 0));
}

/// With missing nodes the walk neither passes them nor asks for more than the budget, and loading
/// what it asks for ends at the cut of a fully loaded cloud.
#[test]
fn requests_stay_in_budget_and_converge() {
    let scan = scan();
    let mut random = Random::new(9);
    let mut scratch = CutScratch::default();
    for budget in [2_000, 8_000, 100_000] {
        let view = scan.random_view(&mut random);
        let settings = settings(LevelRule::default(), budget);
        let goal = select(&scan.octree, &view, &settings);
        let mut loaded = vec![false; scan.octree.nodes().len()];
        for frame in 0.. {
            assert!(frame < 200, "the requests do not end");
            let residency = |node: NodeId| match loaded[node.index()] {
                true => Availability::Resident,
                false => Availability::Absent,
            };
            let cut = select_nodes(&scan.octree, &view, &settings, &residency, &mut scratch);
            assert!(cut.counters.points_drawn + cut.counters.points_requested <= budget);
            for drawn in &cut.draw {
                let parent = scan.octree.node(drawn.node).parent;
                assert!(
                    parent.is_none_or(|p| cut.draw.iter().any(|d| d.node == p)),
                    "parent-closed"
                );
            }
            assert!(cut.requests.is_sorted_by(|a, b| a.priority_px >= b.priority_px));
            let Some(first) = cut.requests.first() else {
                assert_eq!(drawn(&cut), drawn(&goal));
                break;
            };
            loaded[first.node.index()] = true;
            cut.requests.iter().step_by(3).for_each(|r| loaded[r.node.index()] = true);
        }
    }
}

/// An unreadable node is passed over: nobody asks for it again, and what is below is drawn.
#[test]
fn a_failed_node_does_not_hide_its_children() {
    let scan = scan();
    let view = scan.view_from(DVec3::new(0.2, -0.4, 0.3));
    let settings = settings(LevelRule::default(), 50_000);
    let whole = select(&scan.octree, &view, &settings);
    for broken in [NodeId::ROOT, whole.draw[1].node] {
        let residency = |node: NodeId| match node == broken {
            true => Availability::Failed,
            false => Availability::Resident,
        };
        let cut =
            select_nodes(&scan.octree, &view, &settings, &residency, &mut CutScratch::default());
        let mut expected = drawn(&whole);
        expected.remove(&broken);
        assert_eq!(
            drawn(&cut).into_keys().collect::<Vec<_>>(),
            expected.into_keys().collect::<Vec<_>>()
        );
        assert_eq!(cut.counters.nodes_failed, 1);
        assert!(cut.requests.is_empty());
    }
}

/// Two octrees share a budget as one octree would spend it, and neither vanishes.
#[test]
fn octrees_of_a_scene_share_the_budget() {
    let (a, b) = (
        scan(),
        Scan::new(courtyard(5_000, 12, 3), &Parameters { depth: 3, threshold: 20, bits: 12 }),
    );
    let view = a.view_from(DVec3::new(0.5, -0.9, 0.4));
    let scene = [
        (&a.octree, &AllResident as &dyn esker::select::Residency),
        (&b.octree, &AllResident as &dyn esker::select::Residency),
    ];
    let points = |cut: &Cut| cut.counters.points_drawn;
    for budget in [0, 10, 1_000, 5_000, 15_000, 40_000] {
        let settings = settings(LevelRule::default(), budget);
        let cuts = select_scene(&scene, &view, &settings, &mut CutScratch::default());
        assert!(cuts.iter().map(points).sum::<u64>() <= budget.max(2) + 1);
        assert!(cuts.iter().all(|cut| points(cut) >= 1), "budget {budget}");
        let alone = select(&a.octree, &view, &settings);
        assert!(points(&cuts[0]) <= points(&alone).max(1));
    }
}

/// A million random boxes: nothing that a corner or an edge shows is dropped.
#[test]
fn the_frustum_test_drops_nothing_that_is_seen() {
    let mut random = Random::new(10);
    let (mut kept, mut kept_in_vain) = (0u32, 0u32);
    for _ in 0..1000 {
        let eye = random.vector(-1.0, 1.0) * 10f64.powf(random.range(0.0, 7.0));
        let target = eye + random.vector(-1.0, 1.0);
        let near = random.range(1e-4, 0.5);
        let fov_y = random.range(0.05, 2.8);
        let camera = esker::geometry::Camera::looking_at(eye, target, DVec3::Z, fov_y, near);
        let view = View { camera, width_px: 160, height_px: 90 };
        let frustum = Frustum::new(&view);
        for _ in 0..1000 {
            let center = eye + random.vector(-4.0, 4.0);
            let half = random.vector(0.0, 1.0) * 10f64.powf(random.range(-3.0, 0.7));
            let bounds = Aabb::new(center - half, center + half);
            let seen = seen_by_sampling(&view, &bounds, &mut random);
            match frustum.test_box(&bounds) {
                Containment::Outside => assert!(!seen, "{bounds:?} is seen from {camera:?}"),
                Containment::Inside => {
                    assert!(corners(&bounds).iter().all(|&c| in_picture(&view, c, 1e-6)));
                    kept += 1;
                }
                Containment::Partial => {
                    kept += 1;
                    kept_in_vain += u32::from(!seen);
                }
            }
        }
    }
    println!("{kept} of 1000000 boxes kept, {kept_in_vain} of them with no sample in sight");
    assert!(kept > 50_000 && kept < 900_000, "the boxes try both answers: {kept}");
}

/// Whether any corner or any of some random points of a box lies in the picture.
fn seen_by_sampling(view: &View, bounds: &Aabb, random: &mut Random) -> bool {
    let size = bounds.size();
    corners(bounds).iter().any(|&corner| in_picture(view, corner, 0.0))
        || (0..4).any(|_| in_picture(view, bounds.min + random.vector(0.0, 1.0) * size, 0.0))
}

fn in_picture(view: &View, world: DVec3, slack_px: f64) -> bool {
    view.project(world).is_some_and(|(x, y, _)| {
        (-slack_px..=f64::from(view.width_px) + slack_px).contains(&x)
            && (-slack_px..=f64::from(view.height_px) + slack_px).contains(&y)
    })
}
