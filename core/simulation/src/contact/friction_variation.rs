//! Friction that varies along the surface: stains, wear, a lubricant that is not everywhere.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::plant_error::PlantError;

/// Relative change of the friction coefficients over the surface. Two waves of the same length, in
/// different directions, so that it varies along every path.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrictionVariation {
    /// Largest change of the coefficients, as a share of them: 0 to 0.9.
    pub relative: f64,
    /// Wavelength, m.
    pub wavelength_m: f64,
}

/// Directions of the two waves, base axes.
const DIRECTIONS: [[f64; 3]; 2] = [[0.8, 0.6, 0.0], [-0.36, 0.48, 0.8]];

impl FrictionVariation {
    pub(crate) fn check(&self) -> Result<(), PlantError> {
        let (share, length) = (self.relative, self.wavelength_m);
        PlantError::unless(
            "errors.friction.relative",
            share,
            "0 to 0.9",
            (0.0..=0.9).contains(&share),
        )?;
        PlantError::unless(
            "errors.friction.wavelength_m",
            length,
            "0.001 to 10 m",
            (0.001..=10.0).contains(&length),
        )
    }

    /// Factor on the friction coefficients at a point (m), between `1 - relative` and
    /// `1 + relative`.
    pub fn factor(&self, point: &Vector3<f64>) -> f64 {
        let wavenumber = std::f64::consts::TAU / self.wavelength_m;
        let waves = DIRECTIONS.map(|d| (wavenumber * point.dot(&Vector3::from(d))).sin());
        1.0 + self.relative * 0.5 * (waves[0] + waves[1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_stays_within_its_share_reaches_most_of_it_and_is_right_on_average() {
        let variation = FrictionVariation {
            relative: 0.2,
            wavelength_m: 0.04,
        };
        let factors: Vec<f64> = (0..2000)
            .map(|i| variation.factor(&(Vector3::new(0.31, 0.27, 0.11) * (f64::from(i) * 1e-3))))
            .collect();
        let mean = factors.iter().sum::<f64>() / factors.len() as f64;
        assert!((mean - 1.0).abs() < 0.01, "{mean}");
        let least = factors.iter().copied().fold(f64::INFINITY, f64::min);
        let most = factors.iter().copied().fold(0.0, f64::max);
        assert!((0.8..0.84).contains(&least) && (1.16..=1.2).contains(&most));
    }
}
