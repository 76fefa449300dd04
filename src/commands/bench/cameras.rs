//! A fixed set of views of a scan, derived from its points: the same for every run.
//!
//! From outside, from above, near the surface, among the points, and along the longest axis, so
//! that a cut meets each of its cases: all of a cloud small on screen, little of it large, and a
//! large range of depths. [`approach`] adds the whole cloud from ever farther away.

use glam::{DVec3, I64Vec3, UVec3};

use crate::frame::NodeSource;
use crate::geometry::{Camera, MortonKey, View};
use crate::ids::NodeId;
use crate::store::{NARROW_BITS, NodeReadError};

/// Vertical field of view of all cameras, degrees.
const FOV_Y_DEG: f64 = 60.0;

/// A named view.
pub type NamedView = (String, View);

/// The views by name; none of a cloud without points.
pub fn views_of(
    source: &dyn NodeSource,
    (width_px, height_px): (u32, u32),
) -> Result<Vec<NamedView>, NodeReadError> {
    let sample = root_points(source)?;
    let bounds = source.bounds();
    if sample.is_empty() || bounds.is_empty() {
        return Ok(Vec::new());
    }
    let center = bounds.center();
    let radius = (0.5 * bounds.diagonal()).max(1e-3);
    let middle = DVec3::from_array([0, 1, 2].map(|axis| {
        let mut values: Vec<f64> = sample.iter().map(|point| point[axis]).collect();
        let half = values.len() / 2;
        *values.select_nth_unstable_by(half, f64::total_cmp).1
    }));
    let along = if bounds.size().x >= bounds.size().y { DVec3::X } else { DVec3::Y };
    let across = DVec3::new(along.y, along.x, 0.0);
    let rise = DVec3::Z * (0.04 * radius);
    let start = center - along * (0.5 * bounds.size().dot(along));
    let level = |place: DVec3| DVec3::new(place.x, place.y, middle.z);
    // A real point to walk up to: where the sample, in Morton order, is three quarters through.
    let spot = sample[sample.len() * 3 / 4];
    let from = |x, y, z, distance| center + DVec3::new(x, y, z).normalize() * distance * radius;
    let places = [
        ("outside", from(1.0, -1.0, 0.7, 2.0), center),
        ("top", from(0.0, 0.0, 1.0, 1.8), center),
        ("oblique near", middle + DVec3::new(-0.6, -0.8, 0.5) * (0.3 * radius), middle),
        ("inside low", level(middle) + rise, level(middle) + along * radius + 0.5 * rise),
        ("inside high", level(middle) + 4.0 * rise, level(middle) + (along + across) * radius),
        ("along axis", level(start) + rise, level(start) + along * (2.0 * radius)),
        ("close", spot + DVec3::new(0.5, 0.6, 0.6) * (0.03 * radius), spot),
    ];
    let view = |(name, eye, target): (&str, DVec3, DVec3)| {
        (name.to_owned(), view(eye, target, radius, (width_px, height_px)))
    };
    Ok(places.into_iter().map(view).collect())
}

/// The whole cloud from 1.6 to 10 radii away, obliquely and from above, `steps` distances each.
///
/// Cells of a level shrink on screen by the same steps as the cloud does, so these meet the
/// spacings that a rule accepts from the largest to the smallest.
pub fn approach(source: &dyn NodeSource, size: (u32, u32), steps: u32) -> Vec<NamedView> {
    let bounds = source.bounds();
    if bounds.is_empty() {
        return Vec::new();
    }
    let radius = (0.5 * bounds.diagonal()).max(1e-3);
    let directions =
        [("oblique", DVec3::new(1.0, -1.0, 0.7)), ("above", DVec3::new(0.0, -0.1, 1.0))];
    let mut views = Vec::new();
    for (name, direction) in directions {
        for step in 0..steps {
            let share = f64::from(step) / f64::from(steps.max(2) - 1);
            let radii = 1.6 * (10f64 / 1.6).powf(share);
            let eye = bounds.center() + direction.normalize() * (radii * radius);
            let name = format!("{name}, {radii:.1} radii");
            views.push((name, view(eye, bounds.center(), radius, size)));
        }
    }
    views
}

/// A flight of so many frames through the cloud: over its length in slow curves, a little above
/// its middle height, looking ahead and down, and back again after two thirds, faster.
pub fn flight(
    source: &dyn NodeSource,
    size: (u32, u32),
    frames: u32,
) -> Result<Vec<View>, NodeReadError> {
    let sample = root_points(source)?;
    let bounds = source.bounds();
    if sample.is_empty() || bounds.is_empty() {
        return Ok(Vec::new());
    }
    let radius = (0.5 * bounds.diagonal()).max(1e-3);
    let mut heights: Vec<f64> = sample.iter().map(|point| point.z).collect();
    let half = heights.len() / 2;
    let middle = *heights.select_nth_unstable_by(half, f64::total_cmp).1;
    let along = if bounds.size().x >= bounds.size().y { DVec3::X } else { DVec3::Y };
    let across = DVec3::new(along.y, along.x, 0.0);
    let (length, width) = (bounds.size().dot(along), bounds.size().dot(across));
    let place = |t: f64| {
        let there = if t < 2.0 / 3.0 { 1.5 * t } else { 3.0 * (1.0 - t) };
        let side = (there * std::f64::consts::TAU).sin();
        let level = DVec3::new(bounds.center().x, bounds.center().y, middle + 0.08 * radius);
        level + along * (length * (0.9 * there - 0.45)) + across * (0.2 * width * side)
    };
    let last = f64::from(frames.max(2) - 1);
    let views = (0..frames).map(|frame| {
        let t = f64::from(frame) / last;
        // The direction of flight, kept at the very end.
        let (from, to) = if t < 0.995 { (t, t + 0.005) } else { (0.99, 1.0) };
        let ahead = (place(to) - place(from)).normalize_or(along);
        let eye = place(t);
        view(eye, eye + ahead * (0.3 * radius) - DVec3::Z * (0.08 * radius), radius, size)
    });
    Ok(views.collect())
}

fn view(eye: DVec3, target: DVec3, radius: f64, (width_px, height_px): (u32, u32)) -> View {
    let fov_y_rad = FOV_Y_DEG.to_radians();
    let camera = Camera::looking_at(eye, target, DVec3::Z, fov_y_rad, 1e-4 * radius);
    View { camera, width_px, height_px }
}

/// World positions of the root's points, an even sample of the whole cloud, coarse to fine.
fn root_points(source: &dyn NodeSource) -> Result<Vec<DVec3>, NodeReadError> {
    let octree = source.octree();
    if octree.nodes().is_empty() {
        return Ok(Vec::new());
    }
    let mut words = Vec::new();
    source.read_positions(NodeId::ROOT, &mut words)?;
    let narrow = octree.local_bits(NodeId::ROOT) <= NARROW_BITS;
    let cells = words.chunks_exact(if narrow { 2 } else { 3 }).map(|point| match *point {
        [low, high] => (u64::from(low) | u64::from(high) << 32).decode(),
        _ => [point[0], point[1], point[2]],
    });
    let min: I64Vec3 = octree.cell_min(NodeId::ROOT);
    let world = |cell: [u32; 3]| octree.lattice().world(min + UVec3::from_array(cell).as_i64vec3());
    Ok(cells.map(world).collect())
}
