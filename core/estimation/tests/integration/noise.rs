//! Noise of a sensor.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// Draws white Gaussian noise of a given standard deviation.
pub(crate) fn gaussian(seed: u64) -> impl FnMut(f64) -> f64 {
    let mut rng = Pcg64::seed_from_u64(seed);
    move |sd| {
        let unit: f64 = StandardNormal.sample(&mut rng);
        unit * sd
    }
}
