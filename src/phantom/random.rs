//! A small random generator of our own, so that a seed outlives every version of every crate.

use nalgebra::{Unit, Vector3};

/// SplitMix64 (Steele, Lea and Flood, OOPSLA 2014).
#[derive(Debug, Clone)]
pub(super) struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut word = self.0;
        word = (word ^ (word >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        word = (word ^ (word >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        word ^ (word >> 31)
    }

    /// Uniform in `low..high`.
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        let unit = (self.next() >> 11) as f64 / (1_u64 << 53) as f64;
        low + unit * (high - low)
    }

    /// Normal with mean 0 and deviation 1 (Box and Muller, 1958).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.range(0.0, 1.0)).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.range(0.0, 1.0)).cos()
    }

    /// Uniform among the directions perpendicular to `direction`.
    pub fn perpendicular(&mut self, direction: &Unit<Vector3<f64>>) -> Unit<Vector3<f64>> {
        let angle = self.range(0.0, std::f64::consts::TAU);
        let (first, second) = frame(direction);
        Unit::new_normalize(first.scale(angle.cos()) + second.scale(angle.sin()))
    }
}

/// Two directions that make a right-handed frame with `direction`.
pub(super) fn frame(direction: &Unit<Vector3<f64>>) -> (Vector3<f64>, Vector3<f64>) {
    // The axis least along the direction, so that the product is never short.
    let axis = Vector3::ith(direction.iamin(), 1.0);
    let first = direction.cross(&axis).normalize();
    (first, direction.cross(&first))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first numbers of the reference implementation with seed 1234567.
    #[test]
    fn the_sequence_is_that_of_splitmix64() {
        let mut random = Random::new(1_234_567);
        let first: Vec<_> = (0..3).map(|_| random.next()).collect();
        assert_eq!(first, [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423]);
    }

    #[test]
    fn moments_are_those_of_the_distributions() {
        let mut random = Random::new(7);
        let count = 20_000;
        let uniform: Vec<_> = (0..count).map(|_| random.range(-1.0, 3.0)).collect();
        let normal: Vec<_> = (0..count).map(|_| random.normal()).collect();
        let moments = |values: &[f64]| {
            let mean = values.iter().sum::<f64>() / f64::from(count);
            let square = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
            (mean, square / f64::from(count))
        };
        let (mean, variance) = moments(&uniform);
        assert!((mean - 1.0).abs() < 0.04 && (variance - 16.0 / 12.0).abs() < 0.04, "{mean} {variance}");
        let (mean, variance) = moments(&normal);
        assert!(mean.abs() < 0.03 && (variance - 1.0).abs() < 0.04, "{mean} {variance}");
    }

    #[test]
    fn perpendicular_means_perpendicular() {
        let mut random = Random::new(1);
        for _ in 0..100 {
            let components = [0; 3].map(|_| random.normal());
            let direction = Unit::new_normalize(Vector3::from(components));
            assert!(random.perpendicular(&direction).dot(&direction).abs() < 1e-12);
        }
    }
}
