//! The figures of a run, from plain per-cycle samples. Used by `evaluate` and by `report` on a recording.
//!
//! Every figure's definition is in `docs/evaluate.md`; the two commands agree because both call this.

pub mod object_pose;
pub mod tactile;

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use tangent_control::Phase;

/// After first contact, figures called settled leave out this long, s.
pub const SETTLING_LEFT_OUT_S: f64 = 1.0;
/// Force counts as settled within this share of the reference...
const SETTLED_SHARE: f64 = 0.10;
/// ...for this long, s.
const SETTLED_FOR_S: f64 = 0.5;

/// What the estimator in use said in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EstimateSample {
    /// Unit, out of the material, base axes.
    pub normal: Vector3<f64>,
    /// Of the normal, base axes, rad².
    pub covariance: Matrix3<f64>,
    /// Whether it said it may be used.
    pub valid: bool,
}

/// The truth in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthSample {
    /// Unit, out of the material, base axes.
    pub normal: Vector3<f64>,
    /// The tool's true z axis, base axes.
    pub tool_z: Vector3<f64>,
    /// Some pad point carries load.
    pub in_contact: bool,
    /// Pressing force along the true normal, N.
    pub force_n: f64,
}

/// One cycle of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CycleSample {
    /// s
    pub time_s: f64,
    /// The task's phase.
    pub phase: Phase,
    /// Newest estimate of the estimator in use.
    pub estimate: Option<EstimateSample>,
    /// Only with a simulator.
    pub truth: Option<TruthSample>,
    /// Tool's origin as measured, base axes, m.
    pub tool_position: Vector3<f64>,
    /// Tool's z axis as measured, base axes.
    pub tool_z: Vector3<f64>,
    /// Pressing force as measured along the normal in use, N; none where no wrench could be used.
    pub force_n: Option<f64>,
    /// What it should be, N.
    pub force_reference_n: f64,
    /// The controller holds that the tool touches.
    pub in_contact: bool,
    /// Where the path wants the tool, base axes, m.
    pub path_reference: Vector3<f64>,
    /// Distance from it in the tangent plane, m.
    pub path_error_m: f64,
    /// Largest joint speed, rad/s.
    pub joint_speed_rad_per_s: f64,
    /// `sqrt(det(J Jᵀ))` at the tool.
    pub manipulability: f64,
    /// Energy in the motion tank, J; none where the law has no tanks.
    pub motion_tank_j: Option<f64>,
    /// Energy in the force tank, J.
    pub force_tank_j: Option<f64>,
}

impl CycleSample {
    /// In contact by the truth if there is one, else as the controller holds.
    fn touches(&self) -> bool {
        self.truth.map_or(self.in_contact, |t| t.in_contact)
    }

    /// Pressing force by the truth if there is one, else as measured; none where neither is known.
    fn pressing_n(&self) -> Option<f64> {
        self.truth.map_or(self.force_n, |t| Some(t.force_n))
    }
}

/// Summary of a list of non-negative errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Arithmetic mean.
    pub mean: f64,
    /// The middle one; between the two middle ones for an even count.
    pub median: f64,
    /// Standard deviation about the mean, divided by `n`.
    pub std: f64,
    /// Root of the mean square.
    pub rmse: f64,
    /// Smallest value that 95 % of them do not exceed.
    pub p95: f64,
    /// The largest.
    pub max: f64,
    /// How many.
    pub n: usize,
}

impl Spread {
    /// None of an empty list. Sorts `values`.
    pub fn of(values: &mut [f64]) -> Option<Self> {
        let n = values.len();
        if n == 0 {
            return None;
        }
        values.sort_by(f64::total_cmp);
        let mean = values.iter().sum::<f64>() / n as f64;
        let square = values.iter().map(|v| v * v).sum::<f64>() / n as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n as f64;
        Some(Self {
            mean,
            median: 0.5 * (values[(n - 1) / 2] + values[n / 2]),
            std: variance.sqrt(),
            rmse: square.sqrt(),
            p95: percentile_95(values),
            max: values[n - 1],
            n,
        })
    }
}

/// Nearest rank, of a sorted list that is not empty.
fn percentile_95(sorted: &[f64]) -> f64 {
    let rank = (0.95 * sorted.len() as f64).ceil() as usize;
    sorted[rank.clamp(1, sorted.len()) - 1]
}

/// Figures of the force.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ForceFigures {
    /// Highest reference, N.
    pub reference_n: f64,
    /// From 1 s after first contact, sliding and holding.
    pub mean_n: Option<f64>,
    /// The same cycles, against the reference.
    pub rmse_n: Option<f64>,
    /// Mean absolute deviation from the reference, the same cycles.
    pub mad_n: Option<f64>,
    /// 95th percentile of the absolute error, the same cycles.
    pub p95_abs_error_n: Option<f64>,
    /// Highest of the whole run.
    pub peak_n: Option<f64>,
    /// Peak of the whole touchdown, bounces and all, above the reference, in percent of it; 0 when it stays below.
    pub overshoot_percent: Option<f64>,
    /// From first contact until it stays within 10 % for half a second.
    pub settling_s: Option<f64>,
}

/// Figures of the path, in the sliding phase.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PathFigures {
    /// In the tangent plane, m.
    pub rmse_m: Option<f64>,
    /// m
    pub max_m: Option<f64>,
    /// Mean absolute deviation per axis, base axes, m.
    pub mad_xyz_m: Option<[f64; 3]>,
    /// Root mean square per axis, base axes, m.
    pub rmse_xyz_m: Option<[f64; 3]>,
}

/// Figures of the contact.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ContactFigures {
    /// Time of first contact, s.
    pub first_s: Option<f64>,
    /// Times that contact ended before the retraction.
    pub lost_count: usize,
    /// Time without contact between first contact and the retraction, s.
    pub lost_s: f64,
    /// Share of that span in contact.
    pub fraction: Option<f64>,
}

/// Figures of the joints.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointFigures {
    /// Of any joint, rad/s.
    pub speed_peak_rad_per_s: Option<f64>,
    /// Least manipulability of the run.
    pub manipulability_min: Option<f64>,
}

/// Energy in the tanks, J. A velocity-controlled arm has one for force alone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct TankFigures {
    pub motion_min_j: Option<f64>,
    pub motion_max_j: Option<f64>,
    pub force_min_j: f64,
    pub force_max_j: f64,
}

/// All figures that follow from the samples alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Estimate against truth, in contact, degrees.
    pub normal_error_deg: Option<Spread>,
    /// The same from 1 s after first contact.
    pub normal_error_settled_deg: Option<Spread>,
    /// Estimate against `-z_tool` as measured, in contact, degrees.
    pub alignment_error_deg: Option<Spread>,
    /// Truth against the true `-z_tool`, in contact, degrees.
    pub tool_error_deg: Option<Spread>,
    /// Mean of `eᵀ P⁻¹ e / 2` over valid estimates in contact; 1 for a covariance that tells the truth.
    pub normal_nees_per_dof: Option<f64>,
    /// Force.
    pub force: ForceFigures,
    /// Path.
    pub path: PathFigures,
    /// Contact.
    pub contact: ContactFigures,
    /// Joints.
    pub joints: JointFigures,
    /// None for laws without tanks.
    pub tanks: Option<TankFigures>,
}

/// Angle between two unit vectors, degrees; exact for small angles, where an arc cosine is not.
pub fn angle_deg(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b)).to_degrees()
}

impl Figures {
    /// From the cycles of one task, in order of time.
    pub fn of(samples: &[CycleSample]) -> Self {
        // A figure is about pressing: from first contact to the retraction.
        let first = samples.iter().position(CycleSample::touches);
        let span = first.map_or(&samples[..0], |first| {
            let from_first = &samples[first..];
            let ends = |s: &CycleSample| matches!(s.phase, Phase::Retract | Phase::Done);
            let end = from_first.iter().position(ends).unwrap_or(from_first.len());
            &from_first[..end]
        });
        let first_s = first.map(|i| samples[i].time_s);
        let settled_from = first_s.map_or(f64::INFINITY, |t| t + SETTLING_LEFT_OUT_S);
        let touching = || span.iter().filter(|s| s.touches());
        let spread = |pick: &dyn Fn(&CycleSample) -> Option<f64>| {
            Spread::of(&mut touching().filter_map(pick).collect::<Vec<_>>())
        };
        let normal_error = |s: &CycleSample| Some(angle_deg(&s.estimate?.normal, &s.truth?.normal));
        let nees: Vec<f64> = touching().filter_map(nees_per_dof).collect();
        Self {
            normal_error_deg: spread(&normal_error),
            normal_error_settled_deg: spread(&|s| {
                if s.time_s >= settled_from {
                    normal_error(s)
                } else {
                    None
                }
            }),
            alignment_error_deg: spread(&|s| Some(angle_deg(&s.estimate?.normal, &-s.tool_z))),
            tool_error_deg: spread(&|s| s.truth.map(|t| angle_deg(&t.normal, &-t.tool_z))),
            normal_nees_per_dof: mean(&nees),
            force: force(samples, span, settled_from),
            path: path(span),
            contact: contact(span, first_s),
            joints: JointFigures {
                speed_peak_rad_per_s: samples
                    .iter()
                    .map(|s| s.joint_speed_rad_per_s)
                    .reduce(f64::max),
                manipulability_min: samples.iter().map(|s| s.manipulability).reduce(f64::min),
            },
            tanks: tanks(samples),
        }
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn root_mean_square(values: &[f64]) -> Option<f64> {
    (!values.is_empty())
        .then(|| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt())
}

fn nees_per_dof(sample: &CycleSample) -> Option<f64> {
    let estimate = sample.estimate.filter(|e| e.valid)?;
    nees_of_normal(
        &estimate.normal,
        &estimate.covariance,
        &sample.truth?.normal,
    )
}

/// Normalised squared error of a normal in its tangent plane, over its two degrees of freedom; none where the
/// covariance (rad²) is singular there.
pub fn nees_of_normal(
    n: &Vector3<f64>,
    covariance: &Matrix3<f64>,
    truth: &Vector3<f64>,
) -> Option<f64> {
    let seed = if n.x.abs() < 0.9 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let a = n.cross(&seed).normalize();
    let b = n.cross(&a);
    let p = covariance;
    let (aa, ab, bb) = (a.dot(&(p * a)), a.dot(&(p * b)), b.dot(&(p * b)));
    let determinant = aa * bb - ab * ab;
    let (ea, eb) = (truth.dot(&a), truth.dot(&b));
    let value = (bb * ea * ea - 2.0 * ab * ea * eb + aa * eb * eb) / determinant / 2.0;
    (determinant > 0.0 && value.is_finite()).then_some(value)
}

fn force(samples: &[CycleSample], span: &[CycleSample], settled_from: f64) -> ForceFigures {
    let reference_n = samples
        .iter()
        .map(|s| s.force_reference_n)
        .fold(0.0, f64::max);
    let working = |s: &&CycleSample| {
        s.time_s >= settled_from && matches!(s.phase, Phase::Slide | Phase::Hold)
    };
    let forces: Vec<f64> = span
        .iter()
        .filter(working)
        .filter_map(CycleSample::pressing_n)
        .collect();
    let errors: Vec<f64> = span
        .iter()
        .filter(working)
        .filter_map(|s| Some(s.pressing_n()? - s.force_reference_n))
        .collect();
    let mut sizes: Vec<f64> = errors.iter().map(|e| e.abs()).collect();
    sizes.sort_by(f64::total_cmp);

    let start = span.first().map_or(0.0, |s| s.time_s);
    let settled = settling(span, reference_n);
    let touchdown = touchdown(span, settled)
        .iter()
        .filter_map(CycleSample::pressing_n)
        .reduce(f64::max);
    let overshoot = |peak: f64| ((peak / reference_n - 1.0) * 100.0).max(0.0);
    ForceFigures {
        reference_n,
        mean_n: mean(&forces),
        rmse_n: root_mean_square(&errors),
        mad_n: mean(&sizes),
        p95_abs_error_n: (!sizes.is_empty()).then(|| percentile_95(&sizes)),
        peak_n: span
            .iter()
            .filter_map(CycleSample::pressing_n)
            .reduce(f64::max),
        overshoot_percent: touchdown.filter(|_| reference_n > 0.0).map(overshoot),
        settling_s: settled.map(|t| t - start),
    }
}

/// The touchdown: from first contact until the force has settled or the tool slides for good, whatever contacts are lost and
/// found again between; the whole span where neither ever comes.
fn touchdown(span: &[CycleSample], settled: Option<f64>) -> &[CycleSample] {
    let mut sliding_from = None;
    let mut end = span.len();
    for (i, sample) in span.iter().enumerate() {
        if settled.is_some_and(|t| sample.time_s >= t + SETTLED_FOR_S) {
            end = i;
            break;
        }
        if sample.phase != Phase::Slide || !sample.touches() {
            sliding_from = None;
            continue;
        }
        let (from, since) = *sliding_from.get_or_insert((i, sample.time_s));
        if sample.time_s - since >= SETTLED_FOR_S {
            end = from;
            break;
        }
    }
    &span[..end.max(1).min(span.len())]
}

/// Time from which the force stays within its band for long enough.
fn settling(span: &[CycleSample], reference_n: f64) -> Option<f64> {
    let mut since: Option<f64> = None;
    for sample in span {
        let Some(force_n) = sample.pressing_n() else {
            continue;
        };
        if (force_n - reference_n).abs() > SETTLED_SHARE * reference_n {
            since = None;
            continue;
        }
        let from = *since.get_or_insert(sample.time_s);
        if sample.time_s - from >= SETTLED_FOR_S {
            return Some(from);
        }
    }
    None
}

fn path(span: &[CycleSample]) -> PathFigures {
    let sliding: Vec<&CycleSample> = span.iter().filter(|s| s.phase == Phase::Slide).collect();
    if sliding.is_empty() {
        return PathFigures::default();
    }
    let errors: Vec<f64> = sliding.iter().map(|s| s.path_error_m).collect();
    let axis = |i: usize| -> Vec<f64> {
        sliding
            .iter()
            .map(|s| (s.tool_position[i] - s.path_reference[i]).abs())
            .collect()
    };
    let per_axis =
        |f: &dyn Fn(&[f64]) -> Option<f64>| [0, 1, 2].map(|i| f(&axis(i)).unwrap_or_default());
    PathFigures {
        rmse_m: root_mean_square(&errors),
        max_m: errors.iter().copied().reduce(f64::max),
        mad_xyz_m: Some(per_axis(&mean)),
        rmse_xyz_m: Some(per_axis(&root_mean_square)),
    }
}

fn contact(span: &[CycleSample], first_s: Option<f64>) -> ContactFigures {
    let lost_count = span
        .windows(2)
        .filter(|w| w[0].touches() && !w[1].touches())
        .count();
    let lost_s = span
        .windows(2)
        .filter(|w| !w[1].touches())
        .map(|w| w[1].time_s - w[0].time_s)
        .sum();
    let touching = span.iter().filter(|s| s.touches()).count();
    ContactFigures {
        first_s,
        lost_count,
        lost_s,
        fraction: (!span.is_empty()).then(|| touching as f64 / span.len() as f64),
    }
}

fn tanks(samples: &[CycleSample]) -> Option<TankFigures> {
    let bounds = |pick: &dyn Fn(&CycleSample) -> Option<f64>| {
        let values: Vec<f64> = samples.iter().filter_map(pick).collect();
        Some((
            values.iter().copied().reduce(f64::min)?,
            values.iter().copied().reduce(f64::max)?,
        ))
    };
    let motion = bounds(&|s| s.motion_tank_j);
    let (force_min_j, force_max_j) = bounds(&|s| s.force_tank_j)?;
    Some(TankFigures {
        motion_min_j: motion.map(|(least, _)| least),
        motion_max_j: motion.map(|(_, most)| most),
        force_min_j,
        force_max_j,
    })
}

#[cfg(test)]
mod tests;
