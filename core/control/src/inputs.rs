//! Newest results of the other services, as a law receives them.
//!
//! Part of the input of every law. The closed loops of `evaluate` and the `controller` service fill
//! them in.

use nalgebra::{Matrix3, Vector3};
use tangent_estimation::{NormalEstimate, ObjectEstimate};
use tangent_sensing::Validity;

/// Maximum number of estimators that a task can name.
pub const MAX_ESTIMATORS: usize = 8;

/// One estimator's newest estimate.
#[derive(Clone, Copy, Debug)]
pub struct EstimateInput {
    /// The estimate.
    pub estimate: NormalEstimate,
    /// Its age now, s.
    pub age_s: f64,
}

/// Deviation of the untared reading, without the payload, from an unloaded sensor: no zero hides a
/// load in it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UntaredLoad {
    /// Force beyond the last good zero, N; `None` without one.
    pub beyond_reference_n: Option<f64>,
    /// Largest share of the sensor's rating in any axis; `None` if it is not known.
    pub rated_share: Option<f64>,
}

/// One estimator's newest pose of an object.
#[derive(Clone, Copy, Debug)]
pub struct ObjectInput {
    /// The estimate.
    pub estimate: ObjectEstimate,
    /// Its age now, s.
    pub age_s: f64,
}

/// Camera's estimate of the surface at the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisionInput {
    /// Time of exposure, s, on the clock of the cycle.
    pub time_s: f64,
    /// Point of the surface that the normal belongs to, base axes, m.
    pub point: Vector3<f64>,
    /// Unit normal, out of the material, base axes.
    pub normal: Vector3<f64>,
    /// Covariance of the normal, base axes, rad².
    pub covariance: Matrix3<f64>,
    /// Surface variation λ₃ / tr Σ of the segment, eq. (16); the paper's l_s. `None` if the segment
    /// was lost or never cut out: the flatness of the surface is then unknown.
    pub surface_variation: Option<f64>,
    /// Shape operator at the point: moving by `dp` turns the normal by `curvature * dp`. Base axes,
    /// 1/m; `None` if not known.
    pub curvature: Option<Matrix3<f64>>,
    /// Change of the curvature ahead of the tool, from the map; `None` if the tool stands or
    /// nothing is seen there.
    pub change: Option<BendChange>,
    /// Whether the estimate can be used.
    pub validity: Validity,
}

/// Change of the curvature along a direction: a linear model of the surface ahead.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BendChange {
    /// Direction of motion, unit, base axes.
    pub way: Vector3<f64>,
    /// Change of the curvature per metre along that direction, 1/m².
    pub per_m2: f64,
}

/// Distance ahead over which the change of curvature is estimated, m.
const CHANGE_REACH_M: f64 = 0.04;
/// Largest change of curvature of a surface that a tool of this size can wipe, 1/m².
const CHANGE_MAX_PER_M2: f64 = 1000.0;

impl BendChange {
    /// Least-squares line through the curvatures (1/m) of a map's stations, each with its distance
    /// (m) and standard deviation (1/m); `way` points from the first to the second. `None` for
    /// fewer than three stations.
    pub fn of(way: &Vector3<f64>, stations: impl Iterator<Item = (f64, f64, f64)>) -> Option<Self> {
        let way = way.try_normalize(1e-9)?;
        let mut n = 0;
        let (mut w, mut wx, mut wy, mut wxx, mut wxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (x, y, sd) in stations.take_while(|(x, ..)| *x <= CHANGE_REACH_M) {
            let weight = 1.0 / (sd * sd).max(1e-6);
            n += 1;
            w += weight;
            wx += weight * x;
            wy += weight * y;
            wxx += weight * x * x;
            wxy += weight * x * y;
        }
        let spread = w * wxx - wx * wx;
        let per_m2 = (w * wxy - wx * wy) / spread;
        let found = Self { way, per_m2 };
        (n >= 3 && spread > 0.0 && found.is_sound()).then_some(found)
    }

    /// Shape operator after the displacement `moved`, m.
    pub fn after(&self, curvature: &Matrix3<f64>, moved: &Vector3<f64>) -> Matrix3<f64> {
        let on = moved.dot(&self.way);
        curvature + self.way * self.way.transpose() * (self.per_m2 * on)
    }

    /// Interpolates towards `new` by `share`.
    pub(crate) fn towards(&self, new: &Self, share: f64) -> Self {
        // In another direction the tool meets a different part of the surface.
        if self.way.dot(&new.way) < 0.9 {
            return *new;
        }
        Self {
            way: new.way,
            per_m2: self.per_m2 + (new.per_m2 - self.per_m2) * share,
        }
    }

    pub(crate) fn is_sound(&self) -> bool {
        self.per_m2.abs() <= CHANGE_MAX_PER_M2 && (self.way.norm() - 1.0).abs() < 1e-6
    }
}
