//! The figures of an object-pose run: pose errors, forces and moments, and the errors of the
//! camera's calibration.

use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use tangent_control::Phase;
use tangent_estimation::object_pose::{CameraModel, FrameCounts};
use tangent_mechanics::{Base, Flange, Object, Pose};

use super::span::SETTLING_LEFT_OUT_S;

/// Time after first contact within which the peak of the touchdown is taken, s.
const TOUCHDOWN_S: f64 = 2.0;

/// One cycle of an object-pose run.
#[derive(Clone, Copy, Debug)]
pub struct ObjectSampleTruth {
    /// Time of the cycle, s.
    pub time_s: f64,
    /// The task's phase.
    pub phase: Phase,
    /// True pose of the object, including its deflection under the tool.
    pub object: Pose<Base, Object>,
    /// Estimated pose of the object; `None` if there is none.
    pub estimated: Option<Pose<Base, Object>>,
    /// True position of the tip, base axes, m.
    pub tip: Vector3<f64>,
    /// Reference position of the tip on the object, object axes, m.
    pub reference_in_object: Option<Vector3<f64>>,
    /// Pressing force along the true normal, N.
    pub force_n: f64,
    /// True force (N) and moment (Nm) on the sensor, sensor axes.
    pub sensor: (Vector3<f64>, Vector3<f64>),
    /// Whether the tip carries load.
    pub in_contact: bool,
}

/// Errors of an estimated camera calibration against the true one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CalibrationError {
    /// Error of the camera's position along the object's normal, m: observable by contact.
    pub along_normal_m: f64,
    /// Error of the camera's position across the object's normal, m.
    pub across_normal_m: f64,
    /// Error of the camera's orientation about axes in the surface, degrees: observable by contact.
    pub about_surface_deg: f64,
    /// Error of the camera's orientation about the normal, degrees.
    pub about_normal_deg: f64,
    /// Error of the focal length, as a share.
    pub focal_share: f64,
}

impl CalibrationError {
    /// Errors of `known` against `truth`; the normal is in flange axes.
    pub fn of(known: &CameraModel, truth: &CameraModel, normal_in_flange: &Vector3<f64>) -> Self {
        let n = normal_in_flange;
        let position =
            truth.flange_from_camera.translation() - known.flange_from_camera.translation();
        let turn = (truth.flange_from_camera.rotation()
            * known.flange_from_camera.rotation().inverse())
        .scaled_axis();
        let split = |v: &Vector3<f64>| {
            let along = n.dot(v);
            (along.abs(), (v - n * along).norm())
        };
        let (along_normal_m, across_normal_m) = split(&position);
        let (about_normal, about_surface) = split(&turn);
        Self {
            along_normal_m,
            across_normal_m,
            about_surface_deg: about_surface.to_degrees(),
            about_normal_deg: about_normal.to_degrees(),
            focal_share: (truth.focal_px / known.focal_px - 1.0).abs(),
        }
    }
}

/// Transforms a normal to flange axes, for [`CalibrationError::of`].
pub fn normal_in_flange(
    base_from_flange: &Pose<Base, Flange>,
    normal: &Vector3<f64>,
) -> Vector3<f64> {
    base_from_flange.unrotate(normal)
}

/// Figures of one run. Positions are in axes of the true object, m; rotations are vectors, degrees.
/// `None` if the tip was never in contact.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ObjectFigures {
    /// Root mean square of the position error from first contact on, m.
    pub position_rmse_m: Option<f64>,
    /// Root mean square of the orientation error from first contact on, degrees.
    pub orientation_rmse_deg: Option<f64>,
    /// Last position error before the retraction, m.
    pub final_position_m: Option<f64>,
    /// Last orientation error before the retraction, degrees.
    pub final_orientation_deg: Option<f64>,
    /// Position error along the normal, 1 s after first contact, m.
    pub along_normal_settled_m: Option<f64>,
    /// Orientation error about axes in the surface, 1 s after first contact, degrees.
    pub about_surface_settled_deg: Option<f64>,
    /// Position error across the normal, 1 s after first contact, m; it comes from the camera.
    pub across_normal_settled_m: Option<f64>,
    /// Highest pressing force within 2 s of first contact, N.
    pub peak_at_contact_n: Option<f64>,
    /// Root mean square deviation of the pressing force from the reference while sliding, N.
    pub sliding_force_rmse_n: Option<f64>,
    /// Largest force across the tool's axis, from 1 s after first contact to the retraction, N.
    pub lateral_force_max_n: Option<f64>,
    /// Root mean square force across the tool's axis, from 1 s after first contact to the
    /// retraction, N.
    pub lateral_force_rms_n: Option<f64>,
    /// Largest moment at the wrist, from 1 s after first contact to the retraction, Nm.
    pub moment_max_nm: Option<f64>,
    /// Root mean square moment at the wrist, from 1 s after first contact to the retraction, Nm.
    pub moment_rms_nm: Option<f64>,
    /// Root mean square distance of the tip from the path on the true object, in its surface, while
    /// sliding, m. It contains the error of the camera.
    pub path_on_object_rmse_m: Option<f64>,
    /// Root mean square distance of the tip from the path on the estimated object, in its surface,
    /// while sliding, m. It is the error of the control alone.
    pub path_on_estimate_rmse_m: Option<f64>,
    /// Normalised squared error of pose and camera, divided by the degrees of freedom: mean while
    /// pressing.
    pub nees_per_dof: Option<f64>,
    /// Normalised squared error of pose and camera, divided by the degrees of freedom: last value
    /// while pressing.
    pub nees_per_dof_final: Option<f64>,
    /// Errors of the stated calibration.
    pub calibration_stated: Option<CalibrationError>,
    /// Errors of the last calibration estimated while pressing.
    pub calibration_final: Option<CalibrationError>,
    /// Estimated compliance of the object, m/N.
    pub compliance_m_per_n: Option<f64>,
    /// Counts of frames and corners: frames used, out of order and out of time; corners rejected;
    /// starts rejected; restarts.
    pub frames: [u64; 6],
    /// Number of periods in which a joint or torque limit cut the command.
    pub limited_cycles: u64,
    /// Highest torque of any joint, as a share of its limit.
    pub torque_share_max: f64,
}

/// The counters in the order of [`ObjectFigures::frames`].
pub fn frame_counts(counts: &FrameCounts) -> [u64; 6] {
    [
        counts.used,
        counts.out_of_order,
        counts.out_of_time,
        counts.corners_refused,
        counts.starts_refused,
        counts.restarts,
    ]
}

/// Position error in axes of the true object, m, and rotation vector from the estimate to the
/// truth, in the same axes, rad.
pub fn pose_error(
    truth: &Pose<Base, Object>,
    estimated: &Pose<Base, Object>,
) -> (Vector3<f64>, Vector3<f64>) {
    let position = truth.unrotate(&(truth.translation() - estimated.translation()));
    let turn: UnitQuaternion<f64> = truth.rotation() * estimated.rotation().inverse();
    (position, truth.unrotate(&turn.scaled_axis()))
}

impl ObjectFigures {
    /// Figures from the cycles of one run, in order of time. Figures that do not follow from the
    /// cycles (calibration, consistency, limits) keep their default.
    pub fn of(samples: &[ObjectSampleTruth], reference_n: f64) -> Self {
        let mut figures = Self::default();
        let Some(first) = samples.iter().position(|s| s.in_contact) else {
            return figures;
        };
        let pressing = &samples[first..];
        let ends =
            |s: &ObjectSampleTruth| matches!(s.phase, Phase::Retract | Phase::Done | Phase::Fault);
        let end = pressing.iter().position(ends).unwrap_or(pressing.len());
        let span = &pressing[..end];
        let start_s = samples[first].time_s;
        let settled_s = start_s + SETTLING_LEFT_OUT_S;
        let errors: Vec<_> = span
            .iter()
            .filter_map(|s| Some((s.time_s, pose_error(&s.object, s.estimated.as_ref()?))))
            .collect();
        figures.position_rmse_m = rms(errors.iter().map(|(_, (p, _))| p.norm()));
        figures.orientation_rmse_deg = rms(errors.iter().map(|(_, (_, r))| r.norm().to_degrees()));
        if let Some((_, (p, r))) = errors.last() {
            figures.final_position_m = Some(p.norm());
            figures.final_orientation_deg = Some(r.norm().to_degrees());
        }
        if let Some((_, (p, r))) = errors.iter().find(|(t, _)| *t >= settled_s) {
            figures.along_normal_settled_m = Some(p.z.abs());
            figures.across_normal_settled_m = Some(p.xy().norm());
            figures.about_surface_settled_deg = Some(r.xy().norm().to_degrees());
        }
        figures.peak_at_contact_n = span
            .iter()
            .filter(|s| s.time_s <= start_s + TOUCHDOWN_S)
            .map(|s| s.force_n)
            .reduce(f64::max);
        let sliding: Vec<_> = span.iter().filter(|s| s.phase == Phase::Slide).collect();
        figures.sliding_force_rmse_n = rms(sliding.iter().map(|s| s.force_n - reference_n));
        let settled = || span.iter().filter(|s| s.time_s >= settled_s);
        let lateral = || settled().map(|s| s.sensor.0.xy().norm());
        let moment = || settled().map(|s| s.sensor.1.norm());
        figures.lateral_force_max_n = lateral().reduce(f64::max);
        figures.lateral_force_rms_n = rms(lateral());
        figures.moment_max_nm = moment().reduce(f64::max);
        figures.moment_rms_nm = rms(moment());
        let off_path = |s: &ObjectSampleTruth, object: &Pose<Base, Object>| {
            let wanted = s.reference_in_object?;
            let at = object.inverse().transform_point(&s.tip);
            Some((at - wanted).xy().norm())
        };
        figures.path_on_object_rmse_m = rms(sliding.iter().filter_map(|s| off_path(s, &s.object)));
        figures.path_on_estimate_rmse_m = rms(sliding
            .iter()
            .filter_map(|s| off_path(s, s.estimated.as_ref()?)));
        figures
    }
}

fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0_u64);
    for value in values {
        sum += value * value;
        count += 1;
    }
    (count > 0).then(|| (sum / count as f64).sqrt())
}
