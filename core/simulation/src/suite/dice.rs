//! Random numbers of one draw of the suite.

use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::surface_kind::SurfaceKind;

/// Random numbers of one draw.
pub(super) struct Dice(Pcg64Mcg);

impl Dice {
    /// Numbers of one draw, which follow from its name alone.
    pub(super) fn new(seed: u64, surface: SurfaceKind, number: u64) -> Self {
        // FNV-1a over all that names a draw: the order of the kinds does not matter.
        let mut hash = 0xcbf2_9ce4_8422_2325_u64;
        let words = [seed.to_le_bytes(), number.to_le_bytes()];
        for byte in surface.name().bytes().chain(words.into_iter().flatten()) {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
        Self(Pcg64Mcg::seed_from_u64(hash))
    }

    /// Uniform in a range.
    pub(super) fn within(&mut self, (low, high): (f64, f64)) -> f64 {
        let share: f64 = self.0.random();
        low + (high - low) * share
    }

    /// Uniform in the logarithm of a range.
    pub(super) fn within_log(&mut self, (low, high): (f64, f64)) -> f64 {
        self.within((low.ln(), high.ln())).exp()
    }

    /// Uniform between minus and plus `size`.
    pub(super) fn either_sign(&mut self, size: f64) -> f64 {
        self.within((-size, size))
    }

    /// One of `count`, from 0.
    pub(super) fn one_of(&mut self, count: usize) -> usize {
        let share: f64 = self.0.random();
        ((share * count as f64) as usize).min(count - 1)
    }

    /// True in this share of the cases.
    pub(super) fn chance(&mut self, share: f64) -> bool {
        self.within((0.0, 1.0)) < share
    }

    /// An angle, rad.
    pub(super) fn angle(&mut self) -> f64 {
        self.within((0.0, std::f64::consts::TAU))
    }

    /// A vector of a drawn length in a direction that is uniform over the sphere.
    pub(super) fn vector(&mut self, length: (f64, f64)) -> [f64; 3] {
        let z = self.either_sign(1.0);
        let (sin, cos) = self.angle().sin_cos();
        let across = (1.0 - z * z).sqrt();
        let length = self.within(length);
        [across * cos * length, across * sin * length, z * length]
    }

    /// Seed of another generator.
    pub(super) fn next_seed(&mut self) -> u64 {
        self.0.next_u64() >> 16
    }
}
