//! Input and output of every estimator of an object's pose.

use nalgebra::{Matrix6, Vector3};
use tangent_mechanics::{Base, Flange, Object, Pose, Tool, Twist, Wrench};
use tangent_sensing::Validity;

use super::CameraFrame;
use crate::NormalEstimate;

/// Input of an object-pose estimator in one control cycle.
#[derive(Clone, Copy, Debug)]
pub struct ObjectSample {
    /// Time of measurement, s, on any clock that does not jump; the camera's frames use the same.
    pub time_s: f64,
    /// Measured flange pose.
    pub base_from_flange: Pose<Base, Flange>,
    /// Measured tool pose; its origin is the paper's tip `P_q`.
    pub base_from_tool: Pose<Base, Tool>,
    /// Conditioned wrench of the environment on the tool.
    pub wrench: Wrench<Tool>,
    /// Delay of the wrench's filter, s.
    pub wrench_delay_s: f64,
    /// Whether `wrench` is usable.
    pub wrench_validity: Validity,
    /// Age of the sensor's tare, s; `None` before the first tare. The zero may then look like a
    /// contact, so the wrench is not used.
    pub wrench_bias_age_s: Option<f64>,
    /// Camera frame that arrived in this cycle.
    pub frame: Option<CameraFrame>,
}

impl ObjectSample {
    /// Whether time and poses are finite; otherwise nothing else in the sample is usable.
    pub(crate) fn is_placed(&self) -> bool {
        let flange = self.base_from_flange.matrix();
        let tool = self.base_from_tool.matrix();
        self.time_s.is_finite() && flange.iter().chain(tool.iter()).all(|x| x.is_finite())
    }
}

/// Pose of the object, with its covariance.
#[derive(Clone, Copy, Debug)]
pub struct ObjectEstimate {
    /// Current pose of the object, including its deflection under the tool's force.
    pub base_from_object: Pose<Base, Object>,
    /// Velocity of the object's origin and its angular velocity, base axes, without the deflection.
    pub twist: Twist<Base>,
    /// Covariance of position (m) and small rotation (rad), base axes.
    pub covariance: Matrix6<f64>,
    /// Whether the estimate is usable.
    pub validity: Validity,
    /// Age of the newest frame that was used, s; infinite without one.
    pub vision_age_s: f64,
    /// Whether the tool touches the object, according to the estimator.
    pub in_contact: bool,
    /// Pressing force along the estimated normal, N.
    pub force_n: f64,
}

impl ObjectEstimate {
    /// An estimate that only states why there is none.
    pub fn invalid(validity: Validity) -> Self {
        Self {
            base_from_object: Pose::identity(),
            twist: Twist::zero(),
            covariance: Matrix6::identity(),
            validity,
            vision_age_s: f64::INFINITY,
            in_contact: false,
            force_n: 0.0,
        }
    }

    /// The normal under `tip` (base axes, m) that follows from this pose, as published by any
    /// normal estimator.
    pub fn normal_at(
        &self,
        surface: &dyn super::ImplicitSurface,
        tip: &Vector3<f64>,
    ) -> NormalEstimate {
        let pose = &self.base_from_object;
        let rotation = pose.rotation().to_rotation_matrix();
        let in_object = surface.closest(&pose.inverse().transform_point(tip));
        let normal = rotation * surface.normal(&in_object);
        let change = rotation * surface.normal_change(&in_object) * rotation.transpose();
        // Eq. (22): dn = -N do + (N S(d) - S(n)) dθ.
        let arm = tip - pose.translation();
        let by_turn = change * arm.cross_matrix() - normal.cross_matrix();
        let p = &self.covariance;
        let (oo, ot, tt) = (
            p.fixed_view::<3, 3>(0, 0),
            p.fixed_view::<3, 3>(0, 3),
            p.fixed_view::<3, 3>(3, 3),
        );
        let mixed = change * ot * by_turn.transpose();
        let covariance = change * oo * change.transpose() + by_turn * tt * by_turn.transpose()
            - mixed
            - mixed.transpose();
        NormalEstimate {
            point: pose.transform_point(&in_object),
            normal,
            covariance,
            validity: self.validity,
            friction: None,
            curvature: Some(change),
        }
    }
}

/// An estimator of an object's pose, called once per control cycle. It uses no clock and does not
/// allocate after construction.
pub trait ObjectPoseEstimator: Send {
    /// Name as in `estimate/NAME/object`.
    fn name(&self) -> &'static str;

    /// Takes one cycle's sample and returns the estimate at its time.
    fn update(&mut self, sample: &ObjectSample) -> ObjectEstimate;

    /// Discards everything learnt; called when a task starts.
    fn reset(&mut self);

    /// Counts of the frames so far, by what happened to them.
    fn frames(&self) -> FrameCounts;

    /// Estimated calibration of the camera; `None` if the estimator does not calibrate the camera.
    fn calibration(&self) -> Option<CalibrationEstimate>;

    /// Squared error of pose and camera, divided by covariance and degrees of freedom. The
    /// reference is the object without load and the true camera. `None` if the covariance does not
    /// include both.
    fn nees(&self, rest: &Pose<Base, Object>, camera: &super::CameraModel) -> Option<f64>;
}

/// Counts of the camera's frames and corners.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCounts {
    /// Frames with at least one corner that was used.
    pub used: u64,
    /// Frames older than one that was used before, and repeated frames.
    pub out_of_order: u64,
    /// Frames from before the stored poses of the arm, or from the future.
    pub out_of_time: u64,
    /// Corners too far from their predicted position.
    pub corners_refused: u64,
    /// First frames that do not show the object: mirrored, wrongly matched, or with missing
    /// corners.
    pub starts_refused: u64,
    /// Number of times that the estimate was discarded and started again.
    pub restarts: u64,
}

/// Estimated calibration of the camera and compliance of the object.
#[derive(Clone, Copy, Debug)]
pub struct CalibrationEstimate {
    /// Estimated camera.
    pub camera: super::CameraModel,
    /// Covariance of the camera's position (m) and rotation (rad), flange axes.
    pub covariance: Matrix6<f64>,
    /// Standard deviation of the focal length, as a share of it.
    pub focal_sd_share: f64,
    /// Compliance of the whole object along its normal, m/N, and its standard deviation.
    pub compliance_m_per_n: (f64, f64),
    /// Compliance of the spot under the tip along the normal, m/N, and its standard deviation.
    pub local_compliance_m_per_n: (f64, f64),
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object_pose::{ImplicitSurface, ObjectShape};
    use nalgebra::UnitQuaternion;

    #[test]
    fn the_implied_normal_and_its_covariance_are_those_of_the_pose() {
        let sd = [1e-3, 2e-3, 3e-3, 0.01, 0.02, 0.03];
        for shape in [ObjectShape::Plane {}, ObjectShape::Sphere { radius_m: 0.3 }] {
            let pose: Pose<Base, Object> = Pose::new(
                Vector3::new(0.5, -0.1, 0.2),
                UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.2, 0.5)),
            );
            let tip = pose.transform_point(&shape.closest(&Vector3::new(0.1, 0.05, 0.28)));
            let normal_of = |pose: &Pose<Base, Object>| {
                pose.rotate(&shape.normal(&pose.inverse().transform_point(&tip)))
            };
            let mut expected = nalgebra::Matrix3::zeros();
            for (i, sd) in sd.iter().enumerate() {
                let h = 1e-6;
                let moved = |h: f64| {
                    let mut by = [0.0; 6];
                    by[i] = h;
                    let turn = Vector3::new(by[3], by[4], by[5]);
                    Pose::new(
                        pose.translation() + Vector3::new(by[0], by[1], by[2]),
                        UnitQuaternion::from_scaled_axis(turn) * pose.rotation(),
                    )
                };
                let slope = (normal_of(&moved(h)) - normal_of(&moved(-h))) / (2.0 * h);
                expected += slope * slope.transpose() * (sd * sd);
            }
            let estimate = ObjectEstimate {
                base_from_object: pose,
                covariance: Matrix6::from_diagonal(&sd.map(|sd| sd * sd).into()),
                validity: Validity::Valid,
                ..ObjectEstimate::invalid(Validity::Missing)
            };
            let normal = estimate.normal_at(&shape, &tip);
            assert!(normal.validity.is_valid());
            assert!((normal.normal - normal_of(&pose)).norm() < 1e-12);
            assert!((normal.covariance - expected).amax() < 1e-7, "{shape:?}");
            assert!((normal.point - tip).norm() < 1e-12);
        }
    }
}
