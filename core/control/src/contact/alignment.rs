//! Eq. (4) of Tugal et al.: turns the tool square to the surface and follows the surface's
//! rotation.
//!
//! Called by the controller each cycle, in base axes.
//!
//! **Sign.** The paper prints `ω = -k_R z_ee × n`. Here `n` points out of the material, and the
//! tool's axis moves with `ω × z`. The formula as printed therefore drives `z_ee` to `-n`, which is
//! square in this convention.

use nalgebra::Vector3;

/// Turn rate that squares the tool, base axes, rad/s: `-gain * z × n`. Beyond a right angle it
/// keeps its full magnitude instead of decreasing with the sine.
pub fn alignment_rate(
    gain_per_s: f64,
    z_tool: &Vector3<f64>,
    normal: &Vector3<f64>,
) -> Vector3<f64> {
    let cross = z_tool.cross(normal);
    if z_tool.dot(normal) <= 0.0 {
        return -gain_per_s * cross;
    }
    let axis = if cross.norm() > 1e-9 {
        cross.normalize()
    } else {
        // Antiparallel: every axis is valid; a fixed choice keeps the result repeatable.
        any_perpendicular(z_tool)
    };
    -gain_per_s * axis
}

/// Angle between `normal` and `-z_tool`, rad: zero when square.
pub fn alignment_error(z_tool: &Vector3<f64>, normal: &Vector3<f64>) -> f64 {
    angle_between(&-z_tool, normal)
}

/// Angle between two vectors, rad; accurate also where they are parallel.
pub fn angle_between(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b))
}

/// A unit vector perpendicular to `v`.
pub fn any_perpendicular(v: &Vector3<f64>) -> Vector3<f64> {
    let least = if v.x.abs() < 0.6 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    v.cross(&least).normalize()
}

/// Component of `v` perpendicular to the unit vector `normal`.
pub fn tangential(v: &Vector3<f64>, normal: &Vector3<f64>) -> Vector3<f64> {
    v - normal * v.dot(normal)
}

/// How far `step` goes into a surface with this unit `normal`, and how far across that normal.
/// Both are in the unit of `step`.
pub(crate) fn depth_and_across(step: &Vector3<f64>, normal: &Vector3<f64>) -> (f64, f64) {
    (-step.dot(normal), tangential(step, normal).norm())
}

/// The x and y axes of the path's plane, unit vectors: x is `x_axis` projected into the plane, y =
/// normal × x.
pub fn plane_axes(
    plane_normal: &Vector3<f64>,
    x_axis: &Vector3<f64>,
) -> (Vector3<f64>, Vector3<f64>) {
    let x = tangential(x_axis, plane_normal);
    let x = if x.norm() > 1e-3 {
        x.normalize()
    } else {
        any_perpendicular(plane_normal)
    };
    (x, plane_normal.cross(&x))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_tool_ends_square_from_anywhere(z in prop::array::uniform3(-1.0f64..1.0), n in prop::array::uniform3(-1.0f64..1.0)) {
            let (mut z, n) = (Vector3::from(z), Vector3::from(n));
            prop_assume!(z.norm() > 0.1 && n.norm() > 0.1);
            z.normalize_mut();
            let n = n.normalize();
            let mut error = alignment_error(&z, &n);
            for _ in 0..6000 {
                z = Rotation3::new(alignment_rate(2.0, &z, &n) * 0.002) * z;
                let now = alignment_error(&z, &n);
                prop_assert!(now <= error + 1e-9);
                error = now;
            }
            prop_assert!(error < 1e-3, "{error}");
        }
    }

    #[test]
    fn small_errors_decay_with_the_gain() {
        let n = Vector3::z();
        let z = Rotation3::from_axis_angle(&Vector3::x_axis(), 0.01) * -n;
        let rate = alignment_rate(0.08, &z, &n);
        assert!((rate.norm() - 0.08 * 0.01f64.sin()).abs() < 1e-15);
    }
}
