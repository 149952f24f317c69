//! Poses as URScript writes them, six numbers, and the arithmetic of its pose functions.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// Position (m) and rotation vector (rad), as the controller writes poses.
pub type SixPose = [f64; 6];

/// The transform of a pose.
pub fn isometry(p: &SixPose) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::new(p[0], p[1], p[2]),
        UnitQuaternion::from_scaled_axis(Vector3::new(p[3], p[4], p[5])),
    )
}

/// The pose of a transform.
pub fn six(t: &Isometry3<f64>) -> SixPose {
    let (p, r) = (t.translation.vector, t.rotation.scaled_axis());
    [p.x, p.y, p.z, r.x, r.y, r.z]
}

/// `a_from_b * b_from_c`.
pub fn compose(a: &SixPose, b: &SixPose) -> SixPose {
    six(&(isometry(a) * isometry(b)))
}

/// `b_from_a` of `a_from_b`.
pub fn invert(a: &SixPose) -> SixPose {
    six(&isometry(a).inverse())
}

/// Positions subtracted, rotation from `from` to `to` in base axes: `pose_sub`.
pub fn difference(to: &SixPose, from: &SixPose) -> SixPose {
    let (to, from) = (isometry(to), isometry(from));
    let p = to.translation.vector - from.translation.vector;
    let r = (to.rotation * from.rotation.inverse()).scaled_axis();
    [p.x, p.y, p.z, r.x, r.y, r.z]
}

/// Positions added, rotations composed: `pose_add`.
pub fn sum(a: &SixPose, b: &SixPose) -> SixPose {
    let (a, b) = (isometry(a), isometry(b));
    let p = a.translation.vector + b.translation.vector;
    let r = (b.rotation * a.rotation).scaled_axis();
    [p.x, p.y, p.z, r.x, r.y, r.z]
}

/// The pose a share of the way: positions in a line, rotation about one axis.
pub fn interpolate(from: &SixPose, to: &SixPose, share: f64) -> SixPose {
    let d = difference(to, from);
    let start = isometry(from);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(d[3], d[4], d[5]) * share);
    let p = start.translation.vector + Vector3::new(d[0], d[1], d[2]) * share;
    let r = (turn * start.rotation).scaled_axis();
    [p.x, p.y, p.z, r.x, r.y, r.z]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_times_its_inverse_is_the_identity() {
        let a = [0.3, -0.2, 0.5, 0.4, -1.1, 0.7];
        let identity = compose(&a, &invert(&a));
        assert!(identity.iter().all(|x| x.abs() < 1e-12), "{identity:?}");
        let b = [0.1, 0.0, -0.4, 0.0, 0.3, 0.2];
        let back = sum(&b, &difference(&a, &b));
        assert!(back.iter().zip(a).all(|(x, y)| (x - y).abs() < 1e-12));
    }
}
