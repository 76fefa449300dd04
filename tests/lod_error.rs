//! Protects what level of detail promises about the picture, against brute force over all points.
//!
//! The scans are synthetic (`support/scans.rs`), their octrees come from the literal insertion, and
//! pictures from the CPU pass. Errors are means over camera paths; nothing here depends on time.

#[path = "support/insertion.rs"]
mod insertion;
#[path = "support/scans.rs"]
mod scans;

use std::collections::{HashMap, HashSet};
use std::f64::consts::TAU;
use std::sync::OnceLock;

use esker::geometry::{Camera, View};
use esker::ids::NodeId;
use esker::metrics::{PictureError, Pixels, compare};
use esker::passes::{DrawnNode, Picture};
use esker::select::{
    AllResident, Availability, CellSpan, Cut, CutScratch, CutSettings, LevelRule, RuleCell,
    SplatPolicy, SplatSettings, select_nodes,
};
use glam::{DVec3, UVec3};
use insertion::{InputPoint, Parameters};
use scans::{Random, Scan, courtyard};

/// For pictures: the paper's node depth, more points than pixels in every view.
fn scan() -> &'static Scan {
    static SCAN: OnceLock<Scan> = OnceLock::new();
    SCAN.get_or_init(|| {
        let parameters = Parameters { depth: 7, threshold: 300, bits: 15 };
        Scan::new(courtyard(400_000, 15, 5), &parameters)
    })
}

/// For point by point checks: fewer points in smaller nodes.
fn small_scan() -> &'static Scan {
    static SCAN: OnceLock<Scan> = OnceLock::new();
    SCAN.get_or_init(|| {
        let parameters = Parameters { depth: 5, threshold: 100, bits: 14 };
        Scan::new(courtyard(100_000, 14, 5), &parameters)
    })
}

/// A path of 200 views with their reference pictures.
fn views() -> &'static [(View, Picture)] {
    static VIEWS: OnceLock<Vec<(View, Picture)>> = OnceLock::new();
    VIEWS.get_or_init(|| {
        path(scan(), 200).into_iter().map(|view| (view, scan().reference(&view))).collect()
    })
}

fn select(scan: &Scan, view: &View, settings: &CutSettings) -> Cut {
    select_nodes(&scan.octree, view, settings, &AllResident, &mut CutScratch::default())
}

fn pixels(picture: &Picture) -> Pixels<'_> {
    Pixels { width_px: picture.width_px, colors: &picture.colors, distances: &picture.distances }
}

/// Around the courtyard and through it, always looking at its middle from another height.
fn path(scan: &Scan, count: usize) -> Vec<View> {
    let view = |i: usize| {
        let share = i as f64 / count as f64;
        let (angle, reach) = (3.0 * TAU * share, 0.25 + 0.75 * (TAU * share).cos().powi(2));
        let offset = DVec3::new(angle.cos(), angle.sin(), 0.15 + 0.5 * share) * reach;
        let target = scan.center() - DVec3::Z * (0.45 * scan.edge());
        let eye = target + offset * scan.edge();
        let camera = Camera::looking_at(eye, target, DVec3::Z, 60f64.to_radians(), 0.01);
        View { camera, width_px: 160, height_px: 120 }
    };
    (0..count).map(view).collect()
}

fn one_px() -> SplatSettings {
    SplatSettings { policy: SplatPolicy::Own, max_px: 1.0, ..SplatSettings::default() }
}

/// The pixel of a world position, off-screen ones included; `None` before the near plane.
fn pixel_of(view: &View, world: DVec3) -> Option<(i64, i64)> {
    view.project(world).map(|(x, y, _)| (x.floor() as i64, y.floor() as i64))
}

/// Pixels of any point on screen that have no drawn point within one pixel, out of how many.
fn far_from_drawn(scan: &Scan, view: &View, cut: &Cut) -> (usize, usize) {
    let mut drawn = HashSet::new();
    for node in &cut.draw {
        let points = &scan.nodes[node.node.index()].points[..node.count as usize];
        drawn.extend(points.iter().filter_map(|&point| pixel_of(view, scan.world(point))));
    }
    let on_screen = |&(x, y): &(i64, i64)| {
        (0..i64::from(view.width_px)).contains(&x) && (0..i64::from(view.height_px)).contains(&y)
    };
    let covered: HashSet<(i64, i64)> = (0..scan.points.len())
        .filter_map(|point| pixel_of(view, scan.world(point)))
        .filter(on_screen)
        .collect();
    let near = |(x, y): (i64, i64)| {
        (-1..=1).any(|dy| (-1..=1).any(|dx| drawn.contains(&(x + dx, y + dy))))
    };
    (covered.iter().filter(|&&pixel| !near(pixel)).count(), covered.len())
}

/// With the diagonal of the parent's cell, no pixel that any point hits is farther than one pixel
/// from a drawn point: near the image axis as it is, everywhere with the off-axis correction.
#[test]
fn drawn_points_are_within_one_pixel_of_all() {
    let scan = small_scan();
    let mut random = Random::new(21);
    let mut thinned = 0;
    for i in 0..24 {
        let mut view = scan.random_view(&mut random);
        if i % 3 == 0 {
            view = scan.view_from(random.vector(-1.0, 1.0) * 3.0);
        }
        let off_axis = i % 2 == 0;
        view.camera.fov_y_rad = if off_axis { 1.6 } else { 0.09 };
        let rule = LevelRule { cell: RuleCell::Parent, span: CellSpan::Diagonal, off_axis };
        for error_px in [1.0, 0.5] {
            let settings =
                CutSettings { rule, error_px, point_budget: u64::MAX, ..CutSettings::default() };
            let cut = select(scan, &view, &settings);
            let (violations, covered) = far_from_drawn(scan, &view, &cut);
            assert_eq!(violations, 0, "of {covered} pixels, view {i}, {error_px} px");
            thinned += usize::from(cut.counters.nodes_fine_enough > 0 && covered > 100);
        }
    }
    assert!(thinned >= 10, "only {thinned} pictures left something out");
    // The oracle sees a violation where one must be: at four times the error.
    let view = scan.view_from(DVec3::new(0.1, -0.2, 1.4));
    let rule = LevelRule::FOUR[3];
    let coarse =
        CutSettings { rule, error_px: 4.0, point_budget: u64::MAX, ..CutSettings::default() };
    assert!(far_from_drawn(scan, &view, &select(scan, &view, &coarse)).0 > 0);
}

/// Lonely pairs in opposite corners of cells of all sizes: the farthest that what is drawn can be
/// from what is left out.
fn pairs() -> Scan {
    let mut random = Random::new(23);
    let mut points = Vec::new();
    for size in [6u32, 7, 8, 9, 10, 11] {
        for _ in 0..12 {
            let low = random.vector(0.0, f64::from(1u32 << (14 - size))).as_uvec3() << size;
            let corner = (random.unit() * 8.0) as u32;
            let end = |flip: u32| {
                let upper = corner ^ flip;
                let bits = UVec3::new(upper & 1, upper >> 1 & 1, upper >> 2);
                (low + bits * ((1 << size) - 1)).to_array()
            };
            let color = [100; 3];
            points.extend([0, 7].map(|flip| InputPoint { position: end(flip), color }));
        }
    }
    Scan::new(points, &Parameters { depth: 5, threshold: 1, bits: 14 })
}

/// A view of the whole scan from anywhere, just as far as its cells are a pixel or less, turned
/// about its axis, the scan up to `aside` of the way from the middle to the corner of the picture.
fn distant_view(scan: &Scan, random: &mut Random, fov_y_rad: f64, aside: f64) -> View {
    let direction = random.vector(-1.0, 1.0).normalize();
    let up = random.vector(-1.0, 1.0).normalize();
    let mut view = scan.view_from(direction);
    view.camera.fov_y_rad = fov_y_rad;
    let reach = view.focal_px() * 10f64.powf(random.range(-1.7, 0.0));
    let to_scan = -direction;
    let sideways = to_scan.cross(up).normalize();
    let angle = aside * (0.5 * fov_y_rad) * random.unit();
    let forward = to_scan * angle.cos() + sideways * angle.sin();
    let eye = scan.center() + direction * (reach * 0.3 * scan.edge());
    view.camera = Camera::looking_at(eye, eye + forward, up, fov_y_rad, 0.05);
    view
}

/// The bound at its tightest. Half the diagonal, or no off-axis correction, would break it.
#[test]
fn the_bound_holds_for_points_in_opposite_corners() {
    let scan = pairs();
    let mut random = Random::new(24);
    let count = |random: &mut Random, fov_y_rad, aside, error_px, off_axis| {
        let rule = LevelRule { cell: RuleCell::Parent, span: CellSpan::Diagonal, off_axis };
        let settings =
            CutSettings { rule, error_px, point_budget: u64::MAX, ..CutSettings::default() };
        let mut violations = 0;
        for _ in 0..150 {
            let view = distant_view(&scan, random, fov_y_rad, aside);
            violations += far_from_drawn(&scan, &view, &select(&scan, &view, &settings)).0;
        }
        violations
    };
    assert_eq!(count(&mut random, 0.09, 0.0, 1.0, false), 0, "on the image axis");
    assert_eq!(count(&mut random, 1.8, 0.9, 1.0, true), 0, "towards the corners");
    assert!(count(&mut random, 0.09, 0.0, 2.0, false) > 0, "at twice the error it must break");
    assert!(count(&mut random, 1.8, 0.9, 1.0, false) > 0, "without correction it must break");
}

/// Missing children at random: one size per node taken from the coarsest of its children leaves no
/// more gaps than one taken from its deepest descendant.
#[test]
fn missing_children_leave_fewer_gaps_with_conservative_sizes() {
    let scan = small_scan();
    let mut random = Random::new(22);
    let mut sums = [0.0; 4];
    let mut runs = 0;
    for view in path(scan, 12) {
        let reference = scan.reference(&view);
        for share in [0.1, 0.3, 0.6] {
            let missing: HashSet<NodeId> = (1..scan.octree.nodes().len() as u32)
                .map(NodeId)
                .filter(|_| random.unit() < share)
                .collect();
            let residency = |node: NodeId| match missing.contains(&node) {
                true => Availability::Absent,
                false => Availability::Resident,
            };
            let holes = SplatPolicy::ALL.map(|policy| {
                let splat = SplatSettings { policy, ..SplatSettings::default() };
                let settings =
                    CutSettings { point_budget: u64::MAX, splat, ..CutSettings::default() };
                let scratch = &mut CutScratch::default();
                let cut = select_nodes(&scan.octree, &view, &settings, &residency, scratch);
                let picture = scan.draw(&cut, &view, &splat);
                compare(pixels(&reference), pixels(&picture)).hole_fraction
            });
            let [own, paper, conservative, _] = holes;
            assert!(conservative <= paper && own <= conservative, "{holes:?} with {share} missing");
            (0..4).for_each(|i| sums[i] += holes[i]);
            runs += 1;
        }
    }
    let means = sums.map(|sum| 100.0 * sum / f64::from(runs));
    println!("mean holes with missing nodes, % (own, paper, conservative, per-point): {means:.3?}");
    assert!(means[1] > 2.0 * means[3], "sizes from the deepest descendant leave gaps: {means:?}");
}

fn mean_error(scan: &Scan, views: &[(View, Picture)], settings: &CutSettings) -> PictureError {
    let errors = views.iter().map(|(view, reference)| {
        let picture = scan.draw(&select(scan, view, settings), view, &settings.splat);
        compare(pixels(reference), pixels(&picture))
    });
    let errors: Vec<PictureError> = errors.collect();
    let mean = |value: fn(&PictureError) -> f64| {
        errors.iter().map(value).sum::<f64>() / errors.len() as f64
    };
    PictureError {
        hole_fraction: mean(|e| e.hole_fraction),
        excess_fraction: mean(|e| e.excess_fraction),
        rmse: mean(|e| e.rmse),
        ssim: mean(|e| e.ssim),
    }
}

/// Rank correlation of a series with its place in it, ties at their mean rank.
fn spearman(series: &[f64]) -> f64 {
    let n = series.len() as f64;
    let rank = |value: f64| {
        let below = series.iter().filter(|&&v| v < value).count() as f64;
        let equal = series.iter().filter(|&&v| v == value).count() as f64;
        below + 0.5 * (equal - 1.0)
    };
    let middle = 0.5 * (n - 1.0);
    let (mut covariance, mut of_ranks, mut of_places) = (0.0, 0.0, 0.0);
    for (place, &value) in series.iter().enumerate() {
        let (a, b) = (rank(value) - middle, place as f64 - middle);
        covariance += a * b;
        of_ranks += a * a;
        of_places += b * b;
    }
    covariance / (of_ranks * of_places).sqrt()
}

/// More points, less error: over a path of 200 views, against the reference picture of each.
#[test]
fn errors_fall_with_the_budget() {
    let scan = scan();
    let total = scan.octree.point_count();
    let budgets = [25_000, 50_000, 75_000, 100_000, 150_000, 200_000, total];
    let with = |policy, point_budget| {
        let splat = SplatSettings { policy, ..SplatSettings::default() };
        mean_error(scan, views(), &CutSettings { point_budget, splat, ..CutSettings::default() })
    };
    let (mut holes, mut colors) = (Vec::new(), Vec::new());
    for budget in budgets {
        let (per_point, own) =
            (with(SplatPolicy::PerPoint, budget), with(SplatPolicy::Own, budget));
        println!("{budget}: per-point {per_point:?}, own {own:?}");
        assert!(per_point.rmse <= own.rmse, "budget {budget}");
        holes.push(per_point.hole_fraction);
        colors.push(per_point.rmse);
    }
    assert!(spearman(&holes) < -0.95, "holes {holes:?}");
    assert!(spearman(&colors) < -0.95, "RMSE {colors:?}");
}

/// Without a budget and with splats of one pixel the rules differ by what they leave out alone.
#[test]
fn finer_rules_have_smaller_errors() {
    let scan = scan();
    let errors = LevelRule::FOUR.map(|rule| {
        let settings =
            CutSettings { rule, point_budget: u64::MAX, splat: one_px(), ..CutSettings::default() };
        mean_error(scan, views(), &settings)
    });
    for (rule, error) in LevelRule::FOUR.iter().zip(&errors) {
        println!("{}: {error:?}", rule.name());
    }
    let [own_edge, _, parent_edge, parent_diagonal] = errors;
    assert!(parent_edge.hole_fraction <= 0.02);
    assert!(parent_diagonal.rmse <= parent_edge.rmse && parent_edge.rmse <= own_edge.rmse);
    assert!(own_edge.rmse > 1.0, "the views tell the rules apart");
}

/// Up to a hundred times its size away, something is on screen while any point would be.
#[test]
fn a_far_model_is_never_lost() {
    let scan = scan();
    for times in [2.0, 5.0, 12.0, 30.0, 60.0, 100.0] {
        let view = scan.view_from(DVec3::new(0.5, -0.6, 0.3).normalize() * times);
        let reference = scan.reference(&view);
        let picture = scan.draw(&select(scan, &view, &CutSettings::default()), &view, &one_px());
        assert!(reference.covered() > 0 && picture.covered() > 0, "{times} edges away");
    }
}

/// One draw per node (asserted where pictures are drawn), few of them, with many points each.
#[test]
fn draws_are_few_and_large() {
    let scan = scan();
    let (mut points, mut draws) = (0, 0);
    for view in path(scan, 200) {
        let cut = select(scan, &view, &CutSettings::default());
        assert!(cut.draw.len() < 1000, "{} draws", cut.draw.len());
        assert_eq!(cut.counters.nodes_drawn as usize, cut.draw.len());
        points += cut.counters.points_drawn;
        draws += cut.draw.len() as u64;
    }
    println!("{} points per draw", points / draws);
    assert!(points / draws > 1000);
}

/// With continuous levels the sizes of splats change by little when the error does, also as the last
/// child of a node comes, which tells how wide the node's own points lie.
#[test]
fn sizes_pass_continuously_with_the_levels() {
    let mut random = Random::new(11);
    let views: Vec<View> = (0..12).map(|_| scan().random_view(&mut random)).collect();
    let largest = |continuous: bool| {
        let mut largest = 1.0f32;
        for view in &views {
            let mut before: HashMap<NodeId, f32> = HashMap::new();
            for step in 0..60 {
                let error_px = 4.0 * 0.985f64.powi(step);
                let settings = CutSettings { error_px, continuous, ..CutSettings::default() };
                let cut = select(scan(), view, &settings);
                let table = scan().table(&cut, view, &settings.splat);
                let size = |draw: &DrawnNode| table.nodes[draw.slot as usize].splat_px_m;
                let now: HashMap<_, _> = table.draws.iter().map(|d| (d.node, size(d))).collect();
                for (node, size) in &now {
                    let ratio = before.get(node).map_or(1.0, |before| size / before);
                    largest = largest.max(ratio).max(ratio.recip());
                }
                before = now;
            }
        }
        largest
    };
    let (plain, continuous) = (largest(false), largest(true));
    assert!(continuous < 1.15, "{continuous}");
    assert!(plain > 1.5, "{plain}: there is something to see");
}
