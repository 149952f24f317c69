//! The figures of a run, computed from plain per-cycle samples. Used by `evaluate`, and by `report`
//! on a recording.
//!
//! `docs/evaluate.md` defines every figure; the two commands agree because both call this module.

mod force;
mod normal_found;
mod normals;
pub mod object;
mod sample;
mod span;
mod spread;
pub mod visuo_tactile;

use serde::{Deserialize, Serialize};
use tangent_control::Phase;

pub use force::ForceFigures;
pub use normals::{NormalFigures, angle_deg, nees_of_normal};
pub use sample::{CycleSample, EstimateSample, TruthSample};
pub use span::SETTLING_LEFT_OUT_S;
pub use spread::Spread;
pub(crate) use spread::{mean, root_mean_square};

use span::meant_to_touch;

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
            force: ForceFigures::of(samples, from_first, &meant_to_touch, settled_from),
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
