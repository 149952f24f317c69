//! What earlier passes learnt of the surface under a path: points of the tool's origin, the
//! direction of the path on the surface, and the normal, in bins along each stroke.
//!
//! All of it is geometry in base axes, so it holds at any speed and with any estimator.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::pass::{Pass, Point};
use super::spec::LearningSpec;
use super::store::MemoryError;
use crate::contact::alignment::angle_between;
use crate::task::path::Path;

/// Version of the stored form.
pub(super) const VERSION: u32 = 1;
/// Shortest bin, m.
const BIN_MIN_M: f64 = 0.001;
/// Largest number of bins of a memory.
pub(super) const BINS_MAX: usize = 4096;
/// Growth of a bin's weight by a pass that agrees with it.
const WEIGHT_STEP: f64 = 0.5;
/// Angle between the stored and the measured direction of the surface beyond which a pass
/// contradicts a bin, rad.
const CONTRADICTION_RAD: f64 = 0.06;
/// Share of contradicted bins above which a pass was over another part: all are replaced.
const OTHER_PART_SHARE: f64 = 0.15;
/// Number of passes over which a bin averages.
const AVERAGED_MAX: u32 = 4;
/// Growth of a stroke's force error over that without a memory at which its weights are halved.
const WORSE_FACTOR: f64 = 1.2;
/// Force error below which no such growth counts, N.
const WORSE_LEAST_N: f64 = 0.02;

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

    fn contradicts(&self, point: &Point) -> bool {
        angle_between(&Vector3::from(self.tangent), &point.tangent) > CONTRADICTION_RAD
    }
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
    fn place_m(&self, bin: usize) -> f64 {
        (bin as f64 + 0.5) * self.bin_m()
    }

    /// What a pass measured, by bin.
    fn measured<'a>(
        &'a self,
        pass: &'a Pass,
        index: usize,
    ) -> impl Iterator<Item = (usize, Point)> + 'a {
        (0..self.bins.len()).filter_map(move |bin| {
            let point = pass.smoothed(index, self.place_m(bin))?;
            Some((bin, point))
        })
    }
}

/// Memory of one task on one part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
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

    /// Checks that the memory is of `path`.
    ///
    /// # Errors
    /// The strokes differ in number or length.
    pub fn check_path(&self, path: &Path) -> Result<(), MemoryError> {
        let fits = self.strokes.len() == path.stroke_lengths_m().count()
            && (self.strokes.iter().zip(path.stroke_lengths_m()))
                .all(|(stroke, length_m)| (stroke.length_m - length_m).abs() < 1e-3);
        if fits {
            Ok(())
        } else {
            Err(MemoryError::OtherPath)
        }
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

    /// Learns from a completed pass.
    pub(super) fn learn(&mut self, pass: &Pass, spec: &LearningSpec) {
        let (mut learnt, mut measured, mut contradicted) = (false, 0.0, 0.0);
        for (index, stroke) in self.strokes.iter().enumerate() {
            for (bin, point) in stroke.measured(pass, index) {
                if stroke.bins[bin].passes > 0 {
                    measured += 1.0;
                    contradicted += f64::from(u8::from(stroke.bins[bin].contradicts(&point)));
                }
            }
        }
        let is_other_part = contradicted > OTHER_PART_SHARE * measured;
        for (index, stroke) in self.strokes.iter_mut().enumerate() {
            if is_other_part {
                stroke.bins.iter_mut().for_each(|bin| bin.weight = 0.0);
            }
            for i in 0..stroke.bins.len() {
                if let Some(point) = pass.smoothed(index, stroke.place_m(i)) {
                    update(
                        &mut stroke.bins[i],
                        &point,
                        spec.change_max_rad,
                        is_other_part,
                    );
                    learnt = true;
                }
            }
            let error_n = pass.error_rms_n(index);
            if pass.weight(index) < 0.1 {
                if error_n > 0.0 {
                    stroke.error_without_n = error_n;
                }
            } else if stroke.error_without_n > 0.0
                && error_n > WORSE_FACTOR * stroke.error_without_n + WORSE_LEAST_N
            {
                stroke.bins.iter_mut().for_each(|bin| bin.weight *= 0.5);
            }
        }
        if learnt {
            self.passes = self.passes.saturating_add(1);
        }
    }
}

fn update(bin: &mut Bin, point: &Point, change_max_rad: f64, is_other_part: bool) {
    let tangent = Vector3::from(bin.tangent);
    let angle = angle_between(&tangent, &point.tangent);
    if bin.passes == 0 || is_other_part || bin.contradicts(point) {
        // The first pass here, or another surface: what was known is replaced, and a replacement
        // has no weight before the next pass confirms it.
        let weight = if bin.passes == 0 { WEIGHT_STEP } else { 0.0 };
        *bin = Bin {
            passes: 1,
            weight,
            position: point.position.into(),
            tangent: point.tangent.into(),
            normal: point.normal.into(),
            correction: point.correction,
        };
        return;
    }
    bin.passes = (bin.passes + 1).min(AVERAGED_MAX);
    let gain = 1.0 / f64::from(bin.passes);
    let limited = gain.min(change_max_rad / angle.max(1e-9));
    let turned = tangent.lerp(&point.tangent, limited);
    let position = Vector3::from(bin.position).lerp(&point.position, gain);
    let old_normal = Vector3::from(bin.normal);
    let turn = angle_between(&old_normal, &point.normal);
    let normal = old_normal.lerp(&point.normal, gain.min(change_max_rad / turn.max(1e-9)));
    if let (Some(tangent), Some(normal)) = (turned.try_normalize(0.1), normal.try_normalize(0.1)) {
        bin.tangent = tangent.into();
        bin.normal = normal.into();
        bin.position = position.into();
        let step = (point.correction - bin.correction) * gain;
        bin.correction += step.clamp(-change_max_rad, change_max_rad);
        bin.weight = (bin.weight + WEIGHT_STEP).min(1.0);
    }
}
