//! Correlated error of a stereo camera: the matcher's error varies slowly over the image and in
//! time, so that neither a larger patch nor more frames average it out.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::config::DepthNoiseConfig;

/// Number of waves that make up the error.
const WAVES: usize = 8;

/// One wave of the error over the image.
#[derive(Clone, Copy, Debug)]
struct Wave {
    /// Wavenumbers along both axes of the image, rad per pixel.
    along: [f64; 2],
    phase: f64,
    /// Angular frequency, rad/s.
    speed: f64,
}

/// A random field over image and time, as a sum of waves that follow from the seed. It is a
/// function of time, so a frame does not depend on those before it.
#[derive(Clone, Debug)]
pub(super) struct CorrelatedError {
    waves: [Wave; WAVES],
    /// Amplitude of a wave, inverse depth, 1/m.
    amplitude: f64,
    /// Cosine and sine of each wave along a line of the image.
    line: Vec<[f32; 2]>,
    field: Vec<f32>,
}

impl CorrelatedError {
    /// The error of a camera with images `width` pixels wide; `None` if it has none.
    pub(super) fn new(config: &DepthNoiseConfig, width: usize, seed: u64) -> Option<Self> {
        if config.correlated_at_half_metre_m == 0.0 {
            return None;
        }
        let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0x8c2f_47d1_0e9b_6a35);
        let mut within = |low: f64, high: f64| {
            let share: f64 = rng.random();
            low + (high - low) * share
        };
        let turn = std::f64::consts::TAU;
        let waves = std::array::from_fn(|_| {
            // A wave is as correlated as asked for at a sixth of its length.
            let length = 6.0 * config.correlation_px * within(0.7, 1.5);
            let (sin, cos) = within(0.0, turn).sin_cos();
            let period = 6.0 * config.correlation_s * within(0.7, 1.5);
            Wave {
                along: [turn / length * cos, turn / length * sin],
                phase: within(0.0, turn),
                speed: turn / period,
            }
        });
        let sd = config.correlated_at_half_metre_m / 0.25;
        Some(Self {
            waves,
            amplitude: sd * (2.0 / WAVES as f64).sqrt(),
            line: vec![[0.0; 2]; WAVES * width],
            field: vec![0.0; width],
        })
    }

    /// Prepares the frame exposed at `time_s`.
    pub(super) fn expose(&mut self, time_s: f64) {
        let width = self.field.len();
        for (wave, line) in self.waves.iter().zip(self.line.chunks_mut(width)) {
            let start = wave.phase + wave.speed * time_s;
            for (u, pair) in line.iter_mut().enumerate() {
                let (sin, cos) = (start + wave.along[0] * u as f64).sin_cos();
                *pair = [cos as f32, sin as f32];
            }
        }
    }

    /// Error of a line of the image, inverse depth, 1/m.
    pub(super) fn line(&mut self, v: usize) -> &[f32] {
        let width = self.field.len();
        self.field.fill(0.0);
        for (wave, line) in self.waves.iter().zip(self.line.chunks(width)) {
            let (sin, cos) = (wave.along[1] * v as f64).sin_cos();
            let (sin, cos) = ((self.amplitude * sin) as f32, (self.amplitude * cos) as f32);
            for (sum, [c, s]) in self.field.iter_mut().zip(line) {
                *sum += c * cos - s * sin;
            }
        }
        &self.field
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_as_wide_and_as_correlated_as_stated() {
        let config = DepthNoiseConfig {
            correlated_at_half_metre_m: 0.001,
            correlation_px: 20.0,
            correlation_s: 0.5,
            ..DepthNoiseConfig::none()
        };
        assert!(CorrelatedError::new(&DepthNoiseConfig::none(), 64, 1).is_none());
        let (mut square, mut near, mut far, mut later, mut count) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for seed in 0..400 {
            let mut error = CorrelatedError::new(&config, 64, seed).unwrap();
            error.expose(3.0);
            let line = error.line(17).to_vec();
            error.expose(3.5);
            let next = f64::from(error.line(17)[0]);
            let at = |u: usize| f64::from(line[u]);
            square += at(0) * at(0);
            near += at(0) * at(2);
            far += at(0) * at(60);
            later += at(0) * next;
            count += 1.0;
        }
        let sd = f64::sqrt(square / count);
        assert!((sd / 0.004 - 1.0).abs() < 0.12, "{sd}");
        assert!(near / square > 0.95, "{}", near / square);
        assert!(far / square < 0.3, "{}", far / square);
        assert!((0.2..0.8).contains(&(later / square)), "{}", later / square);
    }
}
