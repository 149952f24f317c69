//! Planes of the grid: those of the axes of the first contact.

use nalgebra::Vector3;

/// Least cosine between the normal and the axis of the present plane.
const LEAN_MIN: f64 = 0.5;

/// Axes of a plane of the grid: two in it, and its own. Planes are numbered by axis and sign.
pub(super) fn plane_axes(
    axes: &[Vector3<f64>; 3],
    plane: u8,
) -> (Vector3<f64>, Vector3<f64>, Vector3<f64>) {
    let k = usize::from(plane / 2);
    let sign = if plane.is_multiple_of(2) { 1.0 } else { -1.0 };
    (axes[(k + 1) % 3], axes[(k + 2) % 3], axes[k] * sign)
}

/// The present plane, unless the surface leans too far away from it.
pub(super) fn plane_for(axes: &[Vector3<f64>; 3], normal: &Vector3<f64>, present: u8) -> u8 {
    let along = |plane: u8| plane_axes(axes, plane).2.dot(normal);
    if along(present) >= LEAN_MIN {
        return present;
    }
    let best = (0..6).max_by(|a, b| along(*a).total_cmp(&along(*b)));
    best.unwrap_or(present)
}
