//! The figures of a run, computed from plain per-cycle samples. Used by `evaluate`, and by `report`
//! on a recording.
//!
//! `docs/evaluate.md` defines every figure; the two commands agree because both call this module.

mod normal_found;
pub mod object;
pub mod visuo_tactile;

use std::borrow::Cow;

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use tangent_control::Phase;

/// Time after first contact that the settled figures leave out, s.
pub const SETTLING_LEFT_OUT_S: f64 = 1.0;
/// Deviation within which the force counts as settled, share of the reference.
const SETTLED_SHARE: f64 = 0.10;
/// Time for which the force must stay within that deviation, s.
const SETTLED_FOR_S: f64 = 0.5;

/// Output of the estimator in use in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EstimateSample {
    /// Unit normal, out of the material, base axes.
    pub normal: Vector3<f64>,
    /// Covariance of the normal, base axes, rad².
    pub covariance: Matrix3<f64>,
    /// Whether the estimator reports it as valid.
    pub valid: bool,
}

/// True state in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthSample {
    /// Unit normal, out of the material, base axes.
    pub normal: Vector3<f64>,
    /// The tool's true z axis, base axes.
    pub tool_z: Vector3<f64>,
    /// Whether any point of the pad carries load.
    pub in_contact: bool,
    /// Pressing force along the true normal, N.
    pub force_n: f64,
}

/// One cycle of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CycleSample {
    /// Time of the cycle, s.
    pub time_s: f64,
    /// The task's phase.
    pub phase: Phase,
    /// Newest estimate of the estimator in use.
    pub estimate: Option<EstimateSample>,
    /// True state; only with a simulator.
    pub truth: Option<TruthSample>,
    /// Tool's origin as measured, base axes, m.
    pub tool_position: Vector3<f64>,
    /// Tool's z axis as measured, base axes.
    pub tool_z: Vector3<f64>,
    /// Measured pressing force along the normal in use, N; `None` without a usable wrench.
    pub force_n: Option<f64>,
    /// Reference of the pressing force, N.
    pub force_reference_n: f64,
    /// Whether the tool is in contact according to the controller.
    pub in_contact: bool,
    /// Reference position of the tool on the path, base axes, m.
    pub path_reference: Vector3<f64>,
    /// Distance of the tool from the reference in the tangent plane, m.
    pub path_error_m: f64,
    /// Largest joint speed, rad/s.
    pub joint_speed_rad_per_s: f64,
    /// `sqrt(det(J Jᵀ))` at the tool.
    pub manipulability: f64,
    /// Energy in the motion tank, J; `None` if the law has no such tank.
    pub motion_tank_j: Option<f64>,
    /// Energy in the force tank, J; `None` if the law has no such tank.
    pub force_tank_j: Option<f64>,
}

impl CycleSample {
    /// Whether the tool is in contact: by the true state if it is known, otherwise by the
    /// controller.
    fn touches(&self) -> bool {
        self.truth.map_or(self.in_contact, |t| t.in_contact)
    }

    /// Whether the tool leaves the surface, or has left it.
    pub(crate) fn is_after_pressing(&self) -> bool {
        matches!(self.phase, Phase::Retract | Phase::Done)
    }

    /// Pressing force, N: the true one if it is known, otherwise the measured one; `None` if
    /// neither is.
    pub fn pressing_n(&self) -> Option<f64> {
        self.truth.map_or(self.force_n, |t| Some(t.force_n))
    }
}

/// Summary of a list of non-negative errors.
///
/// ```
/// use tangent_simulation::metrics::Spread;
///
/// let spread = Spread::of(&mut [4.0, 1.0, 3.0, 2.0]).unwrap();
/// assert_eq!((spread.mean, spread.median, spread.max, spread.n), (2.5, 2.5, 4.0, 4));
/// assert_eq!(Spread::of(&mut []), None);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Arithmetic mean.
    pub mean: f64,
    /// Median; the mean of the two middle values for an even count.
    pub median: f64,
    /// Standard deviation about the mean, divided by `n`.
    pub std: f64,
    /// Root of the mean square.
    pub rmse: f64,
    /// 95th percentile: the smallest value that 95 % of the values do not exceed.
    pub p95: f64,
    /// Largest value.
    pub max: f64,
    /// Number of values.
    pub n: usize,
}

impl Spread {
    /// Summary of `values`, which are sorted in place; `None` if there are none.
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

/// 95th percentile by nearest rank of a sorted list that is not empty.
fn percentile_95(sorted: &[f64]) -> f64 {
    let rank = (0.95 * sorted.len() as f64).ceil() as usize;
    sorted[rank.clamp(1, sorted.len()) - 1]
}

/// Figures of the force.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ForceFigures {
    /// Highest reference, N.
    pub reference_n: f64,
    /// Mean pressing force while sliding and holding, from 1 s after first contact, N.
    pub mean_n: Option<f64>,
    /// Root mean square deviation from the reference while sliding and holding, from 1 s after
    /// first contact, N.
    pub rmse_n: Option<f64>,
    /// Root mean square deviation from the reference of every cycle from first contact to the
    /// retraction, N: touchdown, cycles without contact and searches for the surface included.
    /// While the law searches, the reference is that of the task.
    pub rmse_all_n: Option<f64>,
    /// That deviation in the first second after first contact, N.
    pub rmse_first_second_n: Option<f64>,
    /// Mean absolute deviation from the reference while sliding and holding, from 1 s after first
    /// contact, N.
    pub mad_n: Option<f64>,
    /// 95th percentile of the absolute deviation from the reference while sliding and holding, from
    /// 1 s after first contact, N.
    pub p95_abs_error_n: Option<f64>,
    /// Highest pressing force from first contact to the end, the retraction included, N.
    pub peak_n: Option<f64>,
    /// Peak of the whole touchdown, bounces included, above the reference, in percent of the
    /// reference; 0 if it stays below.
    pub overshoot_percent: Option<f64>,
    /// Time from first contact until the force stays within 10 % of the reference for half a
    /// second, s.
    pub settling_s: Option<f64>,
}

/// Figures of the path, in the sliding phase.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PathFigures {
    /// Root mean square error in the tangent plane, m.
    pub rmse_m: Option<f64>,
    /// Largest error in the tangent plane, m.
    pub max_m: Option<f64>,
    /// Mean absolute error per axis, base axes, m.
    pub mad_xyz_m: Option<[f64; 3]>,
    /// Root mean square error per axis, base axes, m.
    pub rmse_xyz_m: Option<[f64; 3]>,
}

/// Figures of the contact.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ContactFigures {
    /// Time of first contact, s.
    pub first_s: Option<f64>,
    /// Number of times that contact was lost before the retraction.
    pub lost_count: usize,
    /// Time without contact between first contact and the retraction, s.
    pub lost_s: f64,
    /// Share of the cycles between first contact and the retraction that are in contact.
    pub fraction: Option<f64>,
}

/// Figures of the joints.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointFigures {
    /// Highest speed of any joint, rad/s.
    pub speed_peak_rad_per_s: Option<f64>,
    /// Lowest manipulability of the run.
    pub manipulability_min: Option<f64>,
}

/// Energy in the tanks, J. The law of a velocity-controlled arm has only a force tank.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct TankFigures {
    pub motion_min_j: Option<f64>,
    pub motion_max_j: Option<f64>,
    pub force_min_j: f64,
    pub force_max_j: f64,
}

/// Figures of an estimator's normals, with the definitions of [`Figures`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NormalFigures {
    /// [`Figures::normal_error_deg`].
    pub normal_error_deg: Option<Spread>,
    /// [`Figures::normal_error_settled_deg`].
    pub normal_error_settled_deg: Option<Spread>,
    /// [`Figures::alignment_error_deg`].
    pub alignment_error_deg: Option<Spread>,
    /// [`Figures::normal_nees_per_dof`].
    pub normal_nees_per_dof: Option<f64>,
}

impl NormalFigures {
    /// Figures from the cycles of one task, in order of time, each with an estimate in place of its
    /// own. One pass and no copy: a report makes these figures of every estimator.
    pub fn of<'a>(
        cycles: impl IntoIterator<Item = (&'a CycleSample, Option<EstimateSample>)>,
    ) -> Self {
        let cycles = cycles.into_iter().skip_while(|(s, _)| !s.touches());
        let (mut errors, mut settled) = (Vec::new(), Vec::new());
        let (mut alignments, mut nees) = (Vec::new(), Vec::new());
        let mut settled_from = None;
        for (sample, estimate) in cycles.take_while(|(s, _)| !s.is_after_pressing()) {
            let from = *settled_from.get_or_insert(sample.time_s + SETTLING_LEFT_OUT_S);
            let Some(estimate) = estimate.filter(|_| sample.touches()) else {
                continue;
            };
            alignments.push(angle_deg(&estimate.normal, &-sample.tool_z));
            let Some(truth) = &sample.truth else { continue };
            let error = angle_deg(&estimate.normal, &truth.normal);
            errors.push(error);
            if sample.time_s >= from {
                settled.push(error);
            }
            if estimate.valid {
                let found = nees_of_normal(&estimate.normal, &estimate.covariance, &truth.normal);
                nees.extend(found);
            }
        }
        Self {
            normal_error_deg: Spread::of(&mut errors),
            normal_error_settled_deg: Spread::of(&mut settled),
            alignment_error_deg: Spread::of(&mut alignments),
            normal_nees_per_dof: mean(&nees),
        }
    }
}

/// All figures that follow from the samples alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Angle between the estimated and the true normal, in contact, degrees.
    pub normal_error_deg: Option<Spread>,
    /// Angle between the estimated and the true normal, in contact, from 1 s after first contact,
    /// degrees.
    pub normal_error_settled_deg: Option<Spread>,
    /// Travel of the tool on the surface from first contact until the estimated normal is within
    /// 3° of the true one and stays so for 5 mm or to the end, m; `None` if it never does.
    pub normal_found_after_m: Option<f64>,
    /// Angle between the estimated normal and the measured `-z_tool`, in contact, degrees.
    pub alignment_error_deg: Option<Spread>,
    /// Angle between the true normal and the true `-z_tool`, in contact, degrees.
    pub tool_error_deg: Option<Spread>,
    /// Mean of `eᵀ P⁻¹ e / 2` over valid estimates in contact; 1 if the covariance is consistent.
    pub normal_nees_per_dof: Option<f64>,
    /// Figures of the force.
    pub force: ForceFigures,
    /// Figures of the path.
    pub path: PathFigures,
    /// Figures of the contact.
    pub contact: ContactFigures,
    /// Figures of the joints.
    pub joints: JointFigures,
    /// Energy in the tanks; `None` for laws without tanks.
    pub tanks: Option<TankFigures>,
}

/// Angle between two unit vectors, degrees; accurate for small angles, unlike an arc cosine.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_simulation::metrics::angle_deg;
///
/// assert!((angle_deg(&Vector3::x(), &Vector3::y()) - 90.0).abs() < 1e-12);
/// ```
pub fn angle_deg(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b)).to_degrees()
}

impl Figures {
    /// Figures from the cycles of one task, in order of time.
    pub fn of(samples: &[CycleSample]) -> Self {
        // The figures cover the pressing: from first contact to the retraction.
        let first = samples.iter().position(CycleSample::touches);
        let from_first = first.map_or(&samples[..0], |first| &samples[first..]);
        let end = from_first
            .iter()
            .position(CycleSample::is_after_pressing)
            .unwrap_or(from_first.len());
        let span = &from_first[..end];
        let meant_to_touch = meant_to_touch(span);
        let first_s = first.map(|i| samples[i].time_s);
        let settled_from = first_s.map_or(f64::INFINITY, |t| t + SETTLING_LEFT_OUT_S);
        let normals = NormalFigures::of(samples.iter().map(|s| (s, s.estimate)));
        let touching = || span.iter().filter(|s| s.touches());
        let spread = |pick: &dyn Fn(&CycleSample) -> Option<f64>| {
            Spread::of(&mut touching().filter_map(pick).collect::<Vec<_>>())
        };
        Self {
            normal_error_deg: normals.normal_error_deg,
            normal_error_settled_deg: normals.normal_error_settled_deg,
            normal_found_after_m: normal_found::after_m(span),
            alignment_error_deg: normals.alignment_error_deg,
            tool_error_deg: spread(&|s| s.truth.map(|t| angle_deg(&t.normal, &-t.tool_z))),
            normal_nees_per_dof: normals.normal_nees_per_dof,
            force: force(samples, from_first, &meant_to_touch, settled_from),
            path: path(span),
            contact: contact(&meant_to_touch, first_s),
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

/// The cycles in which the tool is meant to be on the surface: without its ways above the surface,
/// from stroke to stroke, up to the touch at their end.
fn meant_to_touch(span: &[CycleSample]) -> Cow<'_, [CycleSample]> {
    if !span.iter().any(|sample| sample.phase == Phase::Lift) {
        return Cow::Borrowed(span);
    }
    let mut above = false;
    let mut meant = Vec::with_capacity(span.len());
    for sample in span {
        above = sample.phase == Phase::Lift
            || above && sample.phase == Phase::Seek && !sample.touches();
        if !above {
            meant.push(*sample);
        }
    }
    Cow::Owned(meant)
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn root_mean_square(values: &[f64]) -> Option<f64> {
    (!values.is_empty())
        .then(|| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt())
}

/// Normalised squared error of a normal in its tangent plane, per degree of freedom (two); `None`
/// if the covariance (rad²) is singular there.
///
/// ```
/// use nalgebra::{Matrix3, Vector3};
/// use tangent_simulation::metrics::nees_of_normal;
///
/// // 0.02 rad off, with a stated standard deviation of 0.01 rad: 2² over two degrees of freedom.
/// let truth = Vector3::new(0.02_f64.sin(), 0.0, 0.02_f64.cos());
/// let nees = nees_of_normal(&Vector3::z(), &(Matrix3::identity() * 1e-4), &truth).unwrap();
/// assert!((nees - 2.0).abs() < 0.001);
/// ```
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

fn force(
    samples: &[CycleSample],
    from_first: &[CycleSample],
    span: &[CycleSample],
    settled_from: f64,
) -> ForceFigures {
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
    let deviation = |s: &CycleSample| {
        let searching = matches!(s.phase, Phase::Seek | Phase::Approach);
        let wanted = if searching {
            reference_n
        } else {
            s.force_reference_n
        };
        Some(s.pressing_n()? - wanted)
    };
    let all: Vec<f64> = span.iter().filter_map(deviation).collect();
    let first_second: Vec<f64> = span
        .iter()
        .filter(|s| s.time_s < settled_from)
        .filter_map(deviation)
        .collect();
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
        rmse_all_n: root_mean_square(&all),
        rmse_first_second_n: root_mean_square(&first_second),
        mad_n: mean(&sizes),
        p95_abs_error_n: (!sizes.is_empty()).then(|| percentile_95(&sizes)),
        // A retraction can press as well.
        peak_n: from_first
            .iter()
            .filter_map(CycleSample::pressing_n)
            .reduce(f64::max),
        overshoot_percent: touchdown.filter(|_| reference_n > 0.0).map(overshoot),
        settling_s: settled.map(|t| t - start),
    }
}

/// The touchdown: from first contact until the force has settled or the tool slides without loss of
/// contact for long enough, including contacts lost and regained in between. The whole span if
/// neither happens.
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

/// Time from which the force stays within its band for `SETTLED_FOR_S`.
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
