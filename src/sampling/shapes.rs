//! Integer coordinates of simple shapes, among them the degenerate ones that trees stumble over.

use super::random::Random;

/// Coordinates on a scan's lattice.
pub type Coordinates = [i32; 3];

/// `count` points evenly in a cube from the origin to `edge`, inclusive.
pub fn cube(count: usize, edge: u32, seed: u64) -> Vec<Coordinates> {
    each(count, seed, |random| [0; 3].map(|_| random.below(u64::from(edge) + 1) as i32))
}

/// `count` points on the plane z = (x + y) / 4, within a square of the given edge.
pub fn plane(count: usize, edge: u32, seed: u64) -> Vec<Coordinates> {
    each(count, seed, |random| {
        let [x, y] = [0; 2].map(|_| random.below(u64::from(edge) + 1) as i32);
        [x, y, ((i64::from(x) + i64::from(y)) / 4) as i32]
    })
}

/// `count` points on the line x = y = z.
pub fn line(count: usize, length: u32, seed: u64) -> Vec<Coordinates> {
    each(count, seed, |random| [random.below(u64::from(length) + 1) as i32; 3])
}

/// `count` points on one place.
pub fn coincident(count: usize, place: Coordinates) -> Vec<Coordinates> {
    vec![place; count]
}

/// `count` points in two cubes of the given edge, one at the origin, one at `distance` on all axes;
/// neighbours in the list lie in different cubes.
pub fn two_clusters(count: usize, edge: u32, distance: i32, seed: u64) -> Vec<Coordinates> {
    let mut points = cube(count, edge, seed);
    for point in points.iter_mut().skip(1).step_by(2) {
        *point = point.map(|axis| axis.saturating_add(distance));
    }
    points
}

/// All points of a regular grid with `side` points along each axis, `step` apart, in x-first order.
pub fn grid(side: u32, step: u32) -> Vec<Coordinates> {
    let axis = |i: u32| (i * step) as i32;
    let indices = (0..side).flat_map(move |z| (0..side).map(move |y| (y, z)));
    indices.flat_map(|(y, z)| (0..side).map(move |x| [axis(x), axis(y), axis(z)])).collect()
}

fn each(count: usize, seed: u64, point: impl Fn(&mut Random) -> Coordinates) -> Vec<Coordinates> {
    (0..count).map(|index| point(&mut Random::new(seed, index as u64))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_have_their_shape() {
        assert!(cube(500, 9, 1).iter().flatten().all(|axis| (0..=9).contains(axis)));
        assert!(line(50, 9, 1).iter().all(|[x, y, z]| x == y && y == z));
        assert!(plane(50, 99, 1).iter().all(|[x, y, z]| (x + y) / 4 == *z));
        let clusters = two_clusters(10, 3, 1000, 1);
        assert!(clusters.iter().step_by(2).flatten().all(|axis| *axis <= 3));
        assert!(clusters.iter().skip(1).step_by(2).flatten().all(|axis| *axis >= 1000));
        let grid = grid(3, 5);
        assert_eq!((grid.len(), grid[1], grid[26]), (27, [5, 0, 0], [10, 10, 10]));
    }
}
