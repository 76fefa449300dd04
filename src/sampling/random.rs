//! Random numbers by number: a stream for every (seed, index).
//!
//! Not for secrets. The mixing is SplitMix64 (Steele, Lea, Flood: "Fast splittable pseudorandom
//! number generators", 2014), whose output function decorrelates neighbouring counters.

/// A stream of random numbers.
#[derive(Clone, Debug)]
pub struct Random {
    state: u64,
}

const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

impl Random {
    /// The stream that belongs to an index under a seed.
    pub fn new(seed: u64, index: u64) -> Self {
        let state =
            mix(seed.wrapping_add(GOLDEN)) ^ mix(index.wrapping_mul(GOLDEN).wrapping_add(1));
        Random { state }
    }

    /// The next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(GOLDEN);
        mix(self.state)
    }

    /// The next number in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * 2f64.powi(-53)
    }

    /// The next number in [low, high).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// The next integer below `limit`, which is above 0; biased by less than `limit / 2^64`.
    pub fn below(&mut self, limit: u64) -> u64 {
        ((u128::from(self.bits()) * u128::from(limit)) >> 64) as u64
    }

    /// A number around 0 with standard deviation 1, bounded by 3.5: the sum of four uniform ones.
    pub fn bell(&mut self) -> f64 {
        let sum: f64 = (0..4).map(|_| self.unit()).sum();
        (sum - 2.0) * 3f64.sqrt()
    }

    /// Fills bytes.
    pub fn fill(&mut self, bytes: &mut [u8]) {
        for part in bytes.chunks_mut(8) {
            let random = self.bits().to_le_bytes();
            part.copy_from_slice(&random[..part.len()]);
        }
    }
}

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_even_and_streams_differ() {
        let mut cells = [0u32; 64];
        for index in 0..6_400 {
            let mut random = Random::new(7, index);
            let (a, b) = (random.below(8), random.unit());
            cells[(8 * a + (8.0 * b) as u64) as usize] += 1;
        }
        // 100 expected in each, standard deviation 10.
        assert!(cells.iter().all(|count| (50..150).contains(count)), "{cells:?}");
        assert_ne!(Random::new(7, 0).bits(), Random::new(8, 0).bits());
        let mut random = Random::new(1, 1);
        let bells: Vec<f64> = (0..10_000).map(|_| random.bell()).collect();
        let mean = bells.iter().sum::<f64>() / 1e4;
        let variance = bells.iter().map(|x| x * x).sum::<f64>() / 1e4;
        assert!(mean.abs() < 0.04 && (variance - 1.0).abs() < 0.05, "{mean} {variance}");
    }
}
