//! Interface of a surface-normal estimator that works in world axes, in which the surface rests.
//!
//! Every estimator of the registry implements [`WorldEstimator`]; `OnMovingBase` makes a
//! [`NormalEstimator`](crate::NormalEstimator) of it.

use nalgebra::{Matrix3, Vector3};
use tangent_mechanics::{Aligned, Direction, Point, Pose, Tool, Twist, World, Wrench};
use tangent_sensing::Validity;

/// One control cycle, in world axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WorldSample {
    /// Time of measurement, s.
    pub time_s: f64,
    /// Time since the previous sample, s.
    pub dt_s: f64,
    /// Measured tool pose.
    pub world_from_tool: Pose<World, Tool>,
    /// Measured velocity of the tool's origin relative to the floor, world axes.
    pub twist: Twist<Aligned<Tool, World>>,
    /// Commanded velocity of the tool's origin relative to the floor, world axes.
    pub twist_commanded: Twist<Aligned<Tool, World>>,
    /// Conditioned wrench on the tool.
    pub wrench: Wrench<Tool>,
    /// Delay of the wrench's filter, s.
    pub wrench_delay_s: f64,
    /// Whether `wrench` can be used.
    pub wrench_validity: Validity,
    /// Age of the sensor's tare, s; `None` before the first.
    pub wrench_bias_age_s: Option<f64>,
    /// Whether the motion of the base, and its error, is part of the tool's.
    pub base_moves: bool,
}

/// Surface normal with its covariance, in world axes. The fields are those of
/// [`NormalEstimate`](crate::NormalEstimate).
#[derive(Clone, Copy, Debug)]
pub(crate) struct WorldEstimate {
    pub point: Point<World>,
    /// Unit normal, out of the material.
    pub normal: Direction<World>,
    /// Covariance of `normal`, rad², singular along the normal.
    pub covariance: Matrix3<f64>,
    pub validity: Validity,
    pub friction: Option<f64>,
    /// Shape operator, 1/m.
    pub curvature: Option<Matrix3<f64>>,
}

impl WorldEstimate {
    /// Estimate that only states why there is none. The normal falls back to `-z_tool` (Tugal et
    /// al., IV.B.d), or to that of an upright tool if the pose is not usable, so it is always
    /// finite.
    pub fn invalid(world_from_tool: &Pose<World, Tool>, validity: Validity) -> Self {
        let pose = if is_usable(world_from_tool) {
            *world_from_tool
        } else {
            Pose::identity()
        };
        Self {
            point: pose.origin(),
            normal: -(pose * Direction::<Tool>::z()),
            covariance: Matrix3::identity(),
            validity,
            friction: None,
            curvature: None,
        }
    }

    /// Components of the normal in world axes.
    pub fn normal_vector(&self) -> Vector3<f64> {
        self.normal.components()
    }
}

/// Whether a position and an axis computed from the pose are finite and of plausible size.
fn is_usable(pose: &Pose<World, Tool>) -> bool {
    pose.translation().iter().all(|x| x.abs() < 1e6) && (pose.z_axis().norm() - 1.0).abs() < 1e-6
}

/// A surface-normal estimator in world axes.
pub(crate) trait WorldEstimator: Send {
    /// Name as in `estimate/NAME/normal`.
    fn name(&self) -> &'static str;

    /// Takes one cycle's sample and returns the estimate at its time.
    fn update(&mut self, sample: &WorldSample) -> WorldEstimate;

    /// Discards everything learnt.
    fn reset(&mut self);
}
