//! What every estimator of an object's pose takes and gives.

use nalgebra::{Matrix6, Vector3};
use tangent_mechanics::{Base, Flange, Object, Pose, Tool, Twist, Wrench};
use tangent_sensing::Validity;

use super::CameraFrame;
use crate::NormalEstimate;

/// One control cycle as an object-pose estimator sees it.
#[derive(Clone, Copy, Debug)]
pub struct ObjectSample {
    /// Time of measurement, s, on any clock that does not jump; the camera's frames use the same.
    pub time_s: f64,
    /// Measured flange pose.
    pub base_from_flange: Pose<Base, Flange>,
    /// Measured tool pose; its origin is the paper's tip `P_q`.
    pub base_from_tool: Pose<Base, Tool>,
    /// Conditioned wrench: what the environment does to the tool.
    pub wrench: Wrench<Tool>,
    /// Delay of the wrench's filter, s.
    pub wrench_delay_s: f64,
    /// Whether `wrench` can be used.
    pub wrench_validity: Validity,
    /// Age of the sensor's tare, s; while there was none, its zero may look like a contact, and
    /// nothing is felt.
    pub wrench_bias_age_s: Option<f64>,
    /// The camera's frame that arrived in this cycle.
    pub frame: Option<CameraFrame>,
}

impl ObjectSample {
    /// Time and poses are finite; without them nothing else in the sample can be placed.
    pub(crate) fn is_placed(&self) -> bool {
        let flange = self.base_from_flange.matrix();
        let tool = self.base_from_tool.matrix();
        self.time_s.is_finite() && flange.iter().chain(tool.iter()).all(|x| x.is_finite())
    }
}

/// Where the object is, and how sure that is.
#[derive(Clone, Copy, Debug)]
pub struct ObjectEstimate {
    /// The object's pose now: with what it yields under the tool's force.
    pub base_from_object: Pose<Base, Object>,
    /// Velocity of the object's origin and its angular velocity, base axes; without what it yields.
    pub twist: Twist<Base>,
    /// Of position (m) and small rotation (rad), base axes.
    pub covariance: Matrix6<f64>,
    /// Whether to use it.
    pub validity: Validity,
    /// Age of the newest frame that was used, s; infinite without one.
    pub vision_age_s: f64,
    /// The estimator holds that the tool touches the object.
    pub in_contact: bool,
    /// Pressing force along the estimated normal, N.
    pub force_n: f64,
}

impl ObjectEstimate {
    /// An estimate that says only why there is none.
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

    /// The normal that this pose implies under `tip` (base axes, m), as any normal estimator
    /// publishes it.
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

/// An estimator of an object's pose. One call per control cycle; no clock, no allocation after
/// construction.
pub trait ObjectPoseEstimator: Send {
    /// Name as in `estimate/NAME/object`.
    fn name(&self) -> &'static str;

    /// Takes one cycle's sample and returns the estimate at its time.
    fn update(&mut self, sample: &ObjectSample) -> ObjectEstimate;

    /// Forgets everything learnt; called when a task starts.
    fn reset(&mut self);

    /// What became of the frames so far.
    fn frames(&self) -> FrameCounts;

    /// What it has learnt of the camera; none where the calibration is taken for granted.
    fn calibration(&self) -> Option<CalibrationEstimate>;

    /// Squared error of pose and camera over their covariance and degrees of freedom, against the
    /// truth: the object at rest and the camera as it is. None where the covariance does not speak
    /// of both.
    fn nees(&self, rest: &Pose<Base, Object>, camera: &super::CameraModel) -> Option<f64>;
}

/// What became of the camera's frames and corners.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCounts {
    /// Frames of which at least one corner was used.
    pub used: u64,
    /// Frames older than one that was used before, or repeated.
    pub out_of_order: u64,
    /// Frames from before the arm's remembered poses, or from the future.
    pub out_of_time: u64,
    /// Corners that lay too far from where they were expected.
    pub corners_refused: u64,
    /// First frames that show no such object: mirrored, wrongly matched, not all corners.
    pub starts_refused: u64,
    /// Times that the estimate was given up and begun anew.
    pub restarts: u64,
}

/// What is known of the camera beyond its stated calibration.
#[derive(Clone, Copy, Debug)]
pub struct CalibrationEstimate {
    /// Camera as estimated.
    pub camera: super::CameraModel,
    /// Covariance of the camera's position (m) and turn (rad) in flange axes.
    pub covariance: Matrix6<f64>,
    /// Standard deviation of the focal length's share.
    pub focal_sd_share: f64,
    /// Compliance of the object along its normal, m/N, and its standard deviation.
    pub compliance_m_per_n: (f64, f64),
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object_pose::{ImplicitSurface, ObjectShape};
    use nalgebra::UnitQuaternion;

    #[test]
    fn the_implied_normal_and_its_covariance_are_those_of_the_pose() {
        let sd = [1e-3, 2e-3, 3e-3, 0.01, 0.02, 0.03];
        for shape in [ObjectShape::Plane, ObjectShape::Sphere { radius_m: 0.3 }] {
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
