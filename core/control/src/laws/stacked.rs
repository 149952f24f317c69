//! Six-vectors of the torque laws.

use nalgebra::{Vector3, Vector6};

/// The linear part above the angular part: of a twist, an acceleration or a wrench.
pub(crate) fn stacked(linear: &Vector3<f64>, angular: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
    )
}
