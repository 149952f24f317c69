//! What earlier passes learnt of the surface under a path: points of the tool's origin, the
//! direction of the path on the surface, and the normal, in bins along each stroke.
//!
//! All of it is geometry in base axes, so it holds at any speed and with any estimator.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::task::path::Path;

/// Version of the stored form.
pub(super) const VERSION: u32 = 1;
/// Shortest bin, m.
const BIN_MIN_M: f64 = 0.001;
/// Largest number of bins of a memory.
pub(super) const BINS_MAX: usize = 4096;
/// The surface at one place of a stroke.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Position of the tool's origin at the reference force, base axes, m.
    pub position: Vector3<f64>,
    /// Unit vector along the path on the surface, base axes.
    pub tangent: Vector3<f64>,
    /// Unit normal, out of the material, base axes.
    pub normal: Vector3<f64>,
    /// Slope to add to a command, because the arm makes another one than it is commanded.
    pub correction: f64,
    /// Weight of what is learnt here, 0 to 1.
    pub weight: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Bin {
    pub(super) passes: u32,
    pub(super) weight: f64,
    pub(super) position: [f64; 3],
    pub(super) tangent: [f64; 3],
    pub(super) normal: [f64; 3],
    pub(super) correction: f64,
}

impl Bin {
    const EMPTY: Self = Self {
        passes: 0,
        weight: 0.0,
        position: [0.0; 3],
        tangent: [0.0; 3],
        normal: [0.0; 3],
        correction: 0.0,
    };
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Stroke {
    pub(super) length_m: f64,
    /// RMS force error of a pass without a memory, N; 0 before the first pass.
    pub(super) error_without_n: f64,
    pub(super) bins: Vec<Bin>,
}

impl Stroke {
    pub(super) fn bin_m(&self) -> f64 {
        self.length_m / self.bins.len().max(1) as f64
    }

    /// Middle of a bin, m.
    pub(super) fn place_m(&self, bin: usize) -> f64 {
        (bin as f64 + 0.5) * self.bin_m()
    }
}

/// Memory of one task on one part.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Memory {
    pub(super) version: u32,
    /// Number of passes learnt from.
    pub(super) passes: u32,
    pub(super) strokes: Vec<Stroke>,
}

impl Memory {
    /// An empty memory for `path`. Allocates.
    pub fn new(path: &Path) -> Self {
        let total_m: f64 = path.stroke_lengths_m().sum();
        let bin_m = BIN_MIN_M.max(2.0 * total_m / BINS_MAX as f64);
        let strokes = path.stroke_lengths_m().map(|length_m| Stroke {
            length_m,
            error_without_n: 0.0,
            bins: vec![Bin::EMPTY; ((length_m / bin_m).ceil() as usize).max(1)],
        });
        Self {
            version: VERSION,
            passes: 0,
            strokes: strokes.collect(),
        }
    }

    /// Number of passes learnt from.
    pub fn passes(&self) -> u32 {
        self.passes
    }

    /// Largest weight of a bin, 0 to 1.
    pub fn weight_max(&self) -> f64 {
        let bins = self.strokes.iter().flat_map(|stroke| &stroke.bins);
        bins.map(|bin| bin.weight).fold(0.0, f64::max)
    }

    /// What is known at `distance_m` along `stroke`, interpolated; `None` where nothing is.
    pub fn at(&self, stroke: usize, distance_m: f64) -> Option<SurfacePoint> {
        let stroke = self.strokes.get(stroke)?;
        let bin_m = stroke.bin_m();
        if !distance_m.is_finite() || distance_m < -bin_m || distance_m > stroke.length_m + bin_m {
            return None;
        }
        let last = stroke.bins.len() - 1;
        let place = (distance_m / bin_m - 0.5).clamp(0.0, last as f64);
        let i = (place.floor() as usize).min(last);
        let (a, b) = (&stroke.bins[i], &stroke.bins[(i + 1).min(last)]);
        if a.passes == 0 || b.passes == 0 {
            return None;
        }
        let share = place - i as f64;
        let mix = |a: &[f64; 3], b: &[f64; 3]| Vector3::from(*a).lerp(&Vector3::from(*b), share);
        let tangent = mix(&a.tangent, &b.tangent).try_normalize(0.1)?;
        // Beyond the ends of the stroke, the point moves on along the tangent.
        let beyond_m = (distance_m / bin_m - 0.5 - place) * bin_m;
        Some(SurfacePoint {
            position: mix(&a.position, &b.position) + tangent * beyond_m,
            tangent,
            normal: mix(&a.normal, &b.normal).try_normalize(0.1)?,
            correction: a.correction + (b.correction - a.correction) * share,
            weight: a.weight + (b.weight - a.weight) * share,
        })
    }
}
