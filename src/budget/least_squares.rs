//! Linear least squares for a handful of prices: non-negative, robust, and refused where samples do
//! not tell the prices apart.
//!
//! Columns are scaled to unit length first, so that points and megabytes compare; then
//! Householder's QR (normal equations would square the condition number), the condition from the
//! singular values of R, and Lawson and Hanson's active set on R for prices of at least zero.

/// Largest ratio of singular values (of columns scaled to unit length) that is solved.
pub const MAX_CONDITION: f64 = 1e4;
/// Share of each diagonal element of the normal equations that is added to it.
const RIDGE: f64 = 1e-6;
/// Rounds of reweighting for the Huber loss.
const HUBER_ROUNDS: usize = 12;

/// Why nothing was fitted.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FitError {
    /// Fewer samples than unknowns.
    #[error("{samples} samples for {unknowns} unknowns")]
    TooFew {
        /// Samples that counted.
        samples: usize,
        /// Prices wanted.
        unknowns: usize,
    },
    /// The samples do not tell the prices apart.
    #[error("the samples do not tell the prices apart: condition {condition:.1e}")]
    Singular {
        /// Largest over smallest singular value; infinite if a column is zero or a combination of
        /// others.
        condition: f64,
    },
}

/// Rows of counts with the value each shall give.
#[derive(Clone, Debug)]
pub struct Design {
    columns: usize,
    rows: Vec<f64>,
    values: Vec<f64>,
    rejected: usize,
}

/// Fitted prices.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// One per column, none negative.
    pub prices: Vec<f64>,
    /// Ratio of the singular values.
    pub condition: f64,
    /// Median of the absolute residuals, in the unit of the weighted values.
    pub median_residual: f64,
}

impl Design {
    /// No rows yet.
    pub fn new(columns: usize) -> Self {
        Design { columns, rows: Vec::new(), values: Vec::new(), rejected: 0 }
    }

    /// Adds a row that counts `weight` times. What is not finite is left out and counted.
    pub fn push(&mut self, counts: &[f64], value: f64, weight: f64) {
        debug_assert_eq!(counts.len(), self.columns);
        let numbers = counts.iter().chain([&value, &weight]);
        if numbers.clone().any(|number| !number.is_finite()) || weight <= 0.0 {
            self.rejected += 1;
            return;
        }
        self.rows.extend(counts.iter().map(|count| count * weight));
        self.values.push(value * weight);
    }

    /// Rows that count.
    pub fn samples(&self) -> usize {
        self.values.len()
    }

    /// Rows that were left out.
    pub fn rejected(&self) -> usize {
        self.rejected
    }

    /// Prices of least squared residuals, none negative.
    pub fn solve(&self) -> Result<Solution, FitError> {
        self.solve_weighted(None)
    }

    /// Prices of least Huber loss, none negative: quadratic up to twice the median residual, then
    /// linear, so that a page fault does not set the prices.
    pub fn solve_robust(&self) -> Result<Solution, FitError> {
        let mut solution = self.solve_weighted(None)?;
        for _ in 0..HUBER_ROUNDS {
            let residuals = self.residuals(&solution.prices);
            let delta = 2.0 * solution.median_residual;
            if delta <= 0.0 {
                break;
            }
            let weights: Vec<f64> = residuals
                .iter()
                .map(|residual| (delta / residual.abs().max(delta)).sqrt())
                .collect();
            let next = self.solve_weighted(Some(&weights))?;
            let moved = next
                .prices
                .iter()
                .zip(&solution.prices)
                .any(|(new, old)| (new - old).abs() > 1e-9 * old.abs());
            solution = next;
            if !moved {
                break;
            }
        }
        Ok(solution)
    }

    fn residuals(&self, prices: &[f64]) -> Vec<f64> {
        let rows = self.rows.chunks_exact(self.columns.max(1));
        let predict = |row: &[f64]| row.iter().zip(prices).map(|(c, p)| c * p).sum::<f64>();
        rows.zip(&self.values).map(|(row, value)| value - predict(row)).collect()
    }

    fn solve_weighted(&self, weights: Option<&[f64]>) -> Result<Solution, FitError> {
        let n = self.columns;
        if self.samples() < n || n == 0 {
            return Err(FitError::TooFew { samples: self.samples(), unknowns: n });
        }
        let weight = |i: usize| weights.map_or(1.0, |weights| weights[i]);
        let mut lengths = vec![0.0f64; n];
        for (i, row) in self.rows.chunks_exact(n).enumerate() {
            for (length, count) in lengths.iter_mut().zip(row) {
                *length += (count * weight(i)).powi(2);
            }
        }
        if lengths.contains(&0.0) {
            return Err(FitError::Singular { condition: f64::INFINITY });
        }
        lengths.iter_mut().for_each(|length| *length = length.sqrt());
        let mut system = Triangle::new(n);
        for (i, row) in self.rows.chunks_exact(n).enumerate() {
            let scaled: Vec<f64> = row
                .iter()
                .zip(&lengths)
                .map(|(count, length)| count * weight(i) / length)
                .collect();
            system.absorb(scaled, self.values[i] * weight(i));
        }
        let condition = condition(&system);
        if condition.is_nan() || condition > MAX_CONDITION {
            return Err(FitError::Singular { condition });
        }
        for i in 0..n {
            let mut row = vec![0.0; n];
            row[i] = RIDGE.sqrt();
            system.absorb(row, 0.0);
        }
        let mut prices = non_negative(&system);
        prices.iter_mut().zip(&lengths).for_each(|(price, length)| *price /= length);
        let mut residuals: Vec<f64> = self.residuals(&prices).into_iter().map(f64::abs).collect();
        let middle = residuals.len() / 2;
        let median_residual = *residuals.select_nth_unstable_by(middle, f64::total_cmp).1;
        Ok(Solution { prices, condition, median_residual })
    }
}

/// An upper triangle R and the rotated values d, so that `|A x - b|` is `|R x - d|` plus a
/// constant. Rows are taken in by Givens rotations: any number of them in constant memory.
#[derive(Clone, Debug)]
pub(super) struct Triangle {
    n: usize,
    r: Vec<f64>,
    d: Vec<f64>,
}

impl Triangle {
    pub(super) fn new(n: usize) -> Self {
        Triangle { n, r: vec![0.0; n * n], d: vec![0.0; n] }
    }

    /// Takes in a row.
    pub(super) fn absorb(&mut self, mut row: Vec<f64>, mut value: f64) {
        let n = self.n;
        for i in 0..n {
            if row[i] == 0.0 {
                continue;
            }
            let (diagonal, below) = (self.r[i * n + i], row[i]);
            let length = diagonal.hypot(below);
            let (cos, sin) = (diagonal / length, below / length);
            for (number, below) in self.r[i * n + i..(i + 1) * n].iter_mut().zip(&mut row[i..]) {
                let (upper, lower) = (*number, *below);
                *number = cos * upper + sin * lower;
                *below = cos * lower - sin * upper;
            }
            let (upper, lower) = (self.d[i], value);
            self.d[i] = cos * upper + sin * lower;
            value = cos * lower - sin * upper;
        }
    }

    /// Lets all rows so far count `factor` times.
    pub(super) fn fade(&mut self, factor: f64) {
        self.r.iter_mut().chain(&mut self.d).for_each(|number| *number *= factor);
    }

    /// Forgets everything.
    pub(super) fn clear(&mut self) {
        self.r.fill(0.0);
        self.d.fill(0.0);
    }

    /// Counts component `i` in a unit `factors[i]` times as large from now on.
    pub(super) fn rescale(&mut self, factors: &[f64]) {
        for row in self.r.chunks_exact_mut(self.n.max(1)) {
            row.iter_mut().zip(factors).for_each(|(number, factor)| *number *= factor);
        }
    }

    /// The one number that, as every component, leaves the least residual; 1 if nothing is known.
    pub(super) fn common_factor(&self) -> f64 {
        let sums: Vec<f64> =
            self.r.chunks_exact(self.n.max(1)).map(|row| row.iter().sum()).collect();
        let dot: f64 = sums.iter().zip(&self.d).map(|(sum, d)| sum * d).sum();
        let squares: f64 = sums.iter().map(|sum| sum * sum).sum();
        if squares > 0.0 { dot / squares } else { 1.0 }
    }
}

/// Ratio of the largest to the smallest singular value of R with columns of unit length; columns
/// are scaled here once more, because a faded triangle has lost its scaling.
pub(super) fn condition(system: &Triangle) -> f64 {
    let n = system.n;
    let mut a = system.r.clone();
    for column in 0..n {
        let length = (0..n).map(|row| a[row * n + column].powi(2)).sum::<f64>().sqrt();
        if length == 0.0 || !length.is_finite() {
            return f64::INFINITY;
        }
        (0..n).for_each(|row| a[row * n + column] /= length);
    }
    // One-sided Jacobi: rotate pairs of columns until all are perpendicular; their lengths are the
    // singular values.
    for _ in 0..60 {
        let mut largest = 0.0f64;
        for p in 0..n {
            for q in p + 1..n {
                let dot =
                    |i: usize, j: usize| (0..n).map(|r| a[r * n + i] * a[r * n + j]).sum::<f64>();
                let (pp, qq, pq) = (dot(p, p), dot(q, q), dot(p, q));
                if pq == 0.0 || pp == 0.0 || qq == 0.0 {
                    continue;
                }
                largest = largest.max(pq.abs() / (pp * qq).sqrt());
                let zeta = (qq - pp) / (2.0 * pq);
                let tangent = zeta.signum() / (zeta.abs() + zeta.hypot(1.0));
                let cos = 1.0 / tangent.hypot(1.0);
                let sin = cos * tangent;
                for r in 0..n {
                    let (x, y) = (a[r * n + p], a[r * n + q]);
                    a[r * n + p] = cos * x - sin * y;
                    a[r * n + q] = sin * x + cos * y;
                }
            }
        }
        if largest < 1e-12 {
            break;
        }
    }
    let lengths = (0..n).map(|c| (0..n).map(|r| a[r * n + c].powi(2)).sum::<f64>().sqrt());
    let (least, most) =
        lengths.fold((f64::INFINITY, 0.0f64), |(least, most), l| (least.min(l), most.max(l)));
    if least > 0.0 { most / least } else { f64::INFINITY }
}

/// Least squares with no negative component (Lawson and Hanson, 1974): components enter the
/// solution while that lowers the residual, and leave it when they would turn negative.
pub(super) fn non_negative(system: &Triangle) -> Vec<f64> {
    let n = system.n;
    let r = |i: usize, j: usize| system.r[i * n + j];
    let mut x = vec![0.0; n];
    let mut free = vec![false; n];
    // Each round frees one more component; leaving is finite too, the bound is for rounding.
    for _ in 0..3 * n + 3 {
        let rest: Vec<f64> =
            (0..n).map(|i| system.d[i] - (0..n).map(|j| r(i, j) * x[j]).sum::<f64>()).collect();
        let gain = |j: usize| (0..n).map(|i| r(i, j) * rest[i]).sum::<f64>();
        let scale = system.d.iter().map(|d| d * d).sum::<f64>().sqrt();
        let best = (0..n).filter(|&j| !free[j]).max_by(|&a, &b| gain(a).total_cmp(&gain(b)));
        match best {
            Some(j) if gain(j) > 1e-12 * scale => free[j] = true,
            _ => break,
        }
        loop {
            let solved = solve_free(system, &free);
            let negative = (0..n).filter(|&j| free[j] && solved[j] < 0.0);
            let steps = negative.map(|j| (x[j] / (x[j] - solved[j]), j));
            let Some((step, first)) = steps.min_by(|a, b| a.0.total_cmp(&b.0)) else {
                x = solved;
                break;
            };
            for j in 0..n {
                if free[j] {
                    x[j] += step * (solved[j] - x[j]);
                }
            }
            (x[first], free[first]) = (0.0, false);
        }
    }
    x
}

/// Least squares over the free components only; the others are zero.
fn solve_free(system: &Triangle, free: &[bool]) -> Vec<f64> {
    let n = system.n;
    let columns: Vec<usize> = (0..n).filter(|&j| free[j]).collect();
    let mut part = Triangle::new(columns.len());
    for i in 0..n {
        part.absorb(columns.iter().map(|&j| system.r[i * n + j]).collect(), system.d[i]);
    }
    let m = part.n;
    let mut solved = vec![0.0; n];
    for i in (0..m).rev() {
        let known: f64 = (i + 1..m).map(|j| part.r[i * m + j] * solved[columns[j]]).sum();
        let diagonal = part.r[i * m + i];
        solved[columns[i]] = if diagonal == 0.0 { 0.0 } else { (part.d[i] - known) / diagonal };
    }
    solved
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Random;

    fn noisy(samples: u64, noise: f64) -> Design {
        let mut design = Design::new(3);
        for index in 0..samples {
            let mut random = Random::new(3, index);
            let counts =
                [random.between(1e3, 1e6), random.between(1e2, 3e6), random.between(1.0, 400.0)];
            let true_ms = 2e-5 * counts[0] + 3e-6 * counts[1] + 1e-2 * counts[2];
            let time_ms = true_ms * (1.0 + noise * random.bell());
            design.push(&counts, time_ms, 1.0 / time_ms);
        }
        design
    }

    #[test]
    fn known_prices_come_back_from_noisy_times() {
        let solution = noisy(10_000, 0.01).solve_robust().expect("it is well posed");
        for (price, known) in solution.prices.iter().zip([2e-5, 3e-6, 1e-2]) {
            assert!((price / known - 1.0).abs() < 0.01, "{solution:?}");
        }
    }

    #[test]
    fn columns_that_move_together_are_refused() {
        let mut design = Design::new(2);
        for index in 0..1000 {
            let mut random = Random::new(4, index);
            let points = random.between(1e3, 1e6);
            let time_ms = points * 1e-5 * (1.0 + 0.01 * random.bell());
            design.push(&[points, 4.0 * points * (1.0 + 1e-6 * random.bell())], time_ms, 1.0);
        }
        assert!(matches!(design.solve(), Err(FitError::Singular { .. })), "{:?}", design.solve());
        let mut same = Design::new(2);
        (0..100).for_each(|_| same.push(&[10.0, 20.0], 1.0, 1.0));
        assert!(matches!(same.solve(), Err(FitError::Singular { .. })));
        let mut empty_column = Design::new(2);
        (1..100).for_each(|i| empty_column.push(&[f64::from(i), 0.0], 1.0, 1.0));
        assert!(matches!(empty_column.solve(), Err(FitError::Singular { .. })));
    }

    #[test]
    fn a_price_that_would_be_negative_is_zero() {
        let mut design = Design::new(2);
        for i in 1..200 {
            let (a, b) = (f64::from(i % 17 + 1), f64::from(i % 5 + 1));
            design.push(&[a, b], 3.0 * a - 0.5 * b, 1.0);
        }
        let solution = design.solve().expect("it is well posed");
        assert_eq!(solution.prices[1], 0.0);
        assert!(solution.prices[0] > 2.0 && solution.prices[0] < 3.0, "{solution:?}");
    }

    #[test]
    fn outliers_do_not_set_robust_prices() {
        let mut design = Design::new(1);
        for i in 1..=200 {
            let count = f64::from(i);
            let fault = if i % 20 == 0 { 500.0 } else { 0.0 };
            design.push(&[count], 2.0 * count + f64::from(i % 3) * 0.1 + fault, 1.0);
        }
        let robust = design.solve_robust().expect("well posed").prices[0];
        let squared = design.solve().expect("well posed").prices[0];
        assert!((robust - 2.0).abs() < 0.02 && squared > 2.1, "{robust} {squared}");
    }

    #[test]
    fn numbers_that_are_not_finite_are_counted_and_left_out() {
        let mut design = Design::new(1);
        design.push(&[f64::NAN], 1.0, 1.0);
        design.push(&[1.0], f64::INFINITY, 1.0);
        assert_eq!(design.solve(), Err(FitError::TooFew { samples: 0, unknowns: 1 }));
        design.push(&[2.0], 1.0, 1.0);
        assert_eq!((design.samples(), design.rejected()), (1, 2));
        assert!((design.solve().expect("one is enough").prices[0] - 0.5).abs() < 1e-6);
    }
}
