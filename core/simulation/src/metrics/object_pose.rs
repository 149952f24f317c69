//! The figures of an object-pose run: pose errors, forces and moments, what the camera's calibration became.

use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use tangent_control::Phase;
use tangent_estimation::object_pose::{CameraModel, FrameCounts};
use tangent_mechanics::{Base, Flange, Object, Pose};

use super::SETTLING_LEFT_OUT_S;

/// The touchdown's peak is looked for so long after first contact, s.
const TOUCHDOWN_S: f64 = 2.0;

/// One cycle of an object-pose run.
#[derive(Clone, Copy, Debug)]
pub struct ObjectSampleTruth {
    /// s
    pub time_s: f64,
    /// The task's phase.
    pub phase: Phase,
    /// True object pose, as pressed.
    pub object: Pose<Base, Object>,
    /// Estimated one; none while there is none.
    pub estimated: Option<Pose<Base, Object>>,
    /// The tip's true position, base axes, m.
    pub tip: Vector3<f64>,
    /// Where the path wants the tip on the object, object axes, m.
    pub reference_in_object: Option<Vector3<f64>>,
    /// Pressing force along the true normal, N.
    pub force_n: f64,
    /// True force and moment on the sensor, sensor axes.
    pub sensor: (Vector3<f64>, Vector3<f64>),
    /// The tip carries load.
    pub in_contact: bool,
}

/// Errors of the camera's calibration, true against known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CalibrationError {
    /// Of the camera's position along the object's normal, m: what touching observes.
    pub along_normal_m: f64,
    /// Of its position across it, m.
    pub across_normal_m: f64,
    /// Of its orientation about the surface's axes, degrees: what touching observes.
    pub about_surface_deg: f64,
    /// Of its orientation about the normal, degrees.
    pub about_normal_deg: f64,
    /// Of the focal length, share.
    pub focal_share: f64,
}

impl CalibrationError {
    /// `known` against `truth`; the normal in flange axes.
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

/// The normal in flange axes, for [`CalibrationError::of`].
pub fn normal_in_flange(
    base_from_flange: &Pose<Base, Flange>,
    normal: &Vector3<f64>,
) -> Vector3<f64> {
    base_from_flange.unrotate(normal)
}

/// Figures of one run. Positions in the true object's axes, m; rotations as vectors, degrees. None where it never touched.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ObjectPoseFigures {
    /// Root mean square of the position's error from first contact on.
    pub position_rmse_m: Option<f64>,
    /// The same of the orientation's.
    pub orientation_rmse_deg: Option<f64>,
    /// Last error of the position before the retraction.
    pub final_position_m: Option<f64>,
    /// The same of the orientation.
    pub final_orientation_deg: Option<f64>,
    /// Error of the position along the normal, 1 s after first contact.
    pub along_normal_settled_m: Option<f64>,
    /// Error of the orientation about the surface's axes, 1 s after first contact.
    pub about_surface_settled_deg: Option<f64>,
    /// Error of the position across the normal, 1 s after first contact: the camera's share.
    pub across_normal_settled_m: Option<f64>,
    /// Highest pressing force within 2 s of first contact, N.
    pub peak_at_contact_n: Option<f64>,
    /// Pressing force in the sliding phase against the reference, N, root mean square.
    pub sliding_force_rmse_n: Option<f64>,
    /// Largest force across the tool's axis, from 1 s after contact to the path's end, N.
    pub lateral_force_max_n: Option<f64>,
    /// The same, root mean square.
    pub lateral_force_rms_n: Option<f64>,
    /// Largest moment at the wrist in that time, Nm.
    pub moment_max_nm: Option<f64>,
    /// The same, root mean square.
    pub moment_rms_nm: Option<f64>,
    /// Tip against the path drawn on the true object, in its surface, sliding: the camera's error is in it.
    pub path_on_object_rmse_m: Option<f64>,
    /// The same after the estimate's own offset is taken off: what control leaves.
    pub path_on_estimate_rmse_m: Option<f64>,
    /// Squared error over covariance and degrees of freedom, pose and camera, mean from first contact.
    pub nees_per_dof: Option<f64>,
    /// The same, at the end.
    pub nees_per_dof_final: Option<f64>,
    /// Stated calibration against the truth.
    pub calibration_stated: Option<CalibrationError>,
    /// Calibration as estimated at the end against the truth.
    pub calibration_final: Option<CalibrationError>,
    /// Object's compliance as estimated, m/N.
    pub compliance_m_per_n: Option<f64>,
    /// What became of the frames and corners: used, out of order, out of time, corners refused, starts refused, restarts.
    pub frames: [u64; 6],
    /// Periods in which a joint or torque limit cut the command.
    pub limited_cycles: u64,
    /// Highest share of a joint's torque limit.
    pub torque_share_max: f64,
}

/// The counters as they stand in the figures.
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

/// Position error in the true object's axes, m, and the rotation vector from the estimate to the truth, same axes, rad.
pub fn pose_error(
    truth: &Pose<Base, Object>,
    estimated: &Pose<Base, Object>,
) -> (Vector3<f64>, Vector3<f64>) {
    let position = truth.unrotate(&(truth.translation() - estimated.translation()));
    let turn: UnitQuaternion<f64> = truth.rotation() * estimated.rotation().inverse();
    (position, truth.unrotate(&turn.scaled_axis()))
}

impl ObjectPoseFigures {
    /// From the cycles of one run, in order of time. What is not in them (calibration, consistency, limits) stays as it was.
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
