//! The paper's measurements and their Jacobians, eqs. (13), (17), (19), (22), (23), (26), with the
//! unit quaternion in the state.

use nalgebra::{
    Matrix3x4, Matrix6, Quaternion, SMatrix, UnitQuaternion, Vector2, Vector3, Vector4,
};
use tangent_mechanics::{Base, Camera, Object, Pose};

use super::ImplicitSurface;

/// x_o = [o_o; quaternion], the quaternion as scalar, then vector.
pub(super) type PoseVector = nalgebra::SVector<f64, 7>;

/// The pose of x_o; the quaternion is normalised first.
pub(super) fn pose(x: &PoseVector) -> Pose<Base, Object> {
    let quaternion = Quaternion::new(x[3], x[4], x[5], x[6]);
    Pose::new(
        x.fixed_rows::<3>(0).into_owned(),
        UnitQuaternion::new_normalize(quaternion),
    )
}

/// x_o of a pose.
pub(super) fn vector(pose: &Pose<Base, Object>) -> PoseVector {
    let (t, q) = (pose.translation(), pose.rotation());
    PoseVector::from_column_slice(&[t.x, t.y, t.z, q.w, q.i, q.j, q.k])
}

/// L(x_o) of eq. (12): maps ẋ_o to the velocity screw, 6 × 7. With ω = 2 E(Q) Q̇ and E = [-ε, η I +
/// S(ε)] in base axes.
pub(super) fn screw_from_rate(x: &PoseVector) -> SMatrix<f64, 6, 7> {
    let q = Vector4::new(x[3], x[4], x[5], x[6]);
    let q = q / q.norm().max(1e-12);
    let (eta, eps) = (q[0], Vector3::new(q[1], q[2], q[3]));
    let mut e = Matrix3x4::zeros();
    e.fixed_view_mut::<3, 1>(0, 0).copy_from(&-eps);
    e.fixed_view_mut::<3, 3>(0, 1)
        .copy_from(&(nalgebra::Matrix3::identity() * eta + eps.cross_matrix()));
    let mut l = SMatrix::<f64, 6, 7>::zeros();
    l.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    l.fixed_view_mut::<3, 4>(3, 3).copy_from(&(e * 2.0));
    l
}

/// Eq. (13) for one point: `[X, Y]`, m on the image plane; `None` if the point is not in front of
/// the camera.
pub(super) fn feature(
    x: &PoseVector,
    base_from_camera: &Pose<Base, Camera>,
    point: &Vector3<f64>,
    focal_m: f64,
) -> Option<Vector2<f64>> {
    let in_base = pose(x).transform_point(point);
    let p = base_from_camera.inverse().transform_point(&in_base);
    (p.z > 0.01).then(|| p.xy() * (focal_m / p.z))
}

/// Eq. (17): J_f = J_o,c cL(x_o), for one point.
pub(super) fn feature_jacobian(
    x: &PoseVector,
    base_from_camera: &Pose<Base, Camera>,
    point: &Vector3<f64>,
    focal_m: f64,
) -> SMatrix<f64, 2, 7> {
    let object = pose(x);
    let arm = base_from_camera.unrotate(&object.rotate(point));
    let p = base_from_camera
        .inverse()
        .transform_point(&object.transform_point(point));
    // J_o,c: derivative of the image of a point that moves with the object's screw, camera axes.
    let by_point =
        SMatrix::<f64, 2, 3>::new(1.0, 0.0, -p.x / p.z, 0.0, 1.0, -p.y / p.z) * (focal_m / p.z);
    let mut by_screw = SMatrix::<f64, 2, 6>::zeros();
    by_screw.fixed_view_mut::<2, 3>(0, 0).copy_from(&by_point);
    by_screw
        .fixed_view_mut::<2, 3>(0, 3)
        .copy_from(&(by_point * -arm.cross_matrix()));
    // cL: the screw in camera axes.
    let turn = base_from_camera.rotation().inverse().to_rotation_matrix();
    let mut axes = Matrix6::zeros();
    axes.fixed_view_mut::<3, 3>(0, 0).copy_from(turn.matrix());
    axes.fixed_view_mut::<3, 3>(3, 3).copy_from(turn.matrix());
    by_screw * axes * screw_from_rate(x)
}

/// Eq. (19): g_h, the normal under the tip, base axes.
pub(super) fn normal(
    x: &PoseVector,
    surface: &dyn ImplicitSurface,
    tip: &Vector3<f64>,
) -> Vector3<f64> {
    let object = pose(x);
    object.rotate(&surface.normal(&object.inverse().transform_point(tip)))
}

/// Eq. (22): J_h = -[N, S(n) - N S(p - o)] L.
pub(super) fn normal_jacobian(
    x: &PoseVector,
    surface: &dyn ImplicitSurface,
    tip: &Vector3<f64>,
) -> SMatrix<f64, 3, 7> {
    let object = pose(x);
    let rotation = object.rotation().to_rotation_matrix();
    let in_object = object.inverse().transform_point(tip);
    let n = rotation * surface.normal_change(&in_object) * rotation.transpose();
    let s = normal(x, surface, tip).cross_matrix();
    let arm = (tip - object.translation()).cross_matrix();
    let mut by_screw = SMatrix::<f64, 3, 6>::zeros();
    by_screw.fixed_view_mut::<3, 3>(0, 0).copy_from(&-n);
    by_screw
        .fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&(n * arm - s));
    by_screw * screw_from_rate(x)
}

/// Eq. (23) as a function of the pose: δ = nᵀ p at the surface point under the tip. The paper
/// measures it with the tip, which lies on the surface; for the estimated pose it may lie φ above.
pub(super) fn offset(x: &PoseVector, surface: &dyn ImplicitSurface, tip: &Vector3<f64>) -> f64 {
    let in_object = pose(x).inverse().transform_point(tip);
    normal(x, surface, tip).dot(tip) - surface.distance(&in_object)
}

/// Eq. (26): J_hq = pᵀ J_h + nᵀ Λ(p - o) L.
pub(super) fn offset_jacobian(
    x: &PoseVector,
    surface: &dyn ImplicitSurface,
    tip: &Vector3<f64>,
) -> SMatrix<f64, 1, 7> {
    let arm = tip - pose(x).translation();
    let mut lambda = SMatrix::<f64, 3, 6>::zeros();
    lambda.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    lambda
        .fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&-arm.cross_matrix());
    tip.transpose() * normal_jacobian(x, surface, tip)
        + normal(x, surface, tip).transpose() * lambda * screw_from_rate(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object_pose::ObjectShape;
    use proptest::prelude::*;

    const H: f64 = 1e-6;

    fn differences<const M: usize>(
        x: &PoseVector,
        g: impl Fn(&PoseVector) -> nalgebra::SVector<f64, M>,
    ) -> SMatrix<f64, M, 7> {
        let mut jacobian = SMatrix::<f64, M, 7>::zeros();
        for i in 0..7 {
            let mut step = PoseVector::zeros();
            step[i] = H;
            jacobian.set_column(i, &((g(&(x + step)) - g(&(x - step))) / (2.0 * H)));
        }
        jacobian
    }

    fn at(t: [f64; 3], turn: [f64; 3]) -> PoseVector {
        vector(&Pose::new(
            Vector3::from(t),
            UnitQuaternion::from_scaled_axis(Vector3::from(turn)),
        ))
    }

    proptest! {
        #[test]
        fn eq_17_22_and_26_are_the_derivatives(
            t in prop::array::uniform3(-0.1f64..0.1), turn in prop::array::uniform3(-1.0f64..1.0),
            tip in prop::array::uniform3(0.15f64..0.3), corner in prop::array::uniform3(-0.05f64..0.05)) {
            let x = at(t, turn);
            let (tip, corner) = (Vector3::from(tip), Vector3::from(corner));
            let camera: Pose<Base, Camera> = Pose::new(
                Vector3::new(0.05, -0.02, 0.6),
                UnitQuaternion::from_scaled_axis(Vector3::new(3.0, 0.2, -0.1)),
            );
            let f = feature_jacobian(&x, &camera, &corner, 0.008);
            let by_difference = differences(&x, |x| feature(x, &camera, &corner, 0.008).unwrap());
            prop_assert!((f - by_difference).amax() < 1e-9, "{f} {by_difference}");
            for shape in [ObjectShape::Plane {}, ObjectShape::Cylinder { radius_m: 0.2 }, ObjectShape::Sphere { radius_m: 0.2 }] {
                // Curved shapes need the tip near their surface: eq. (26) holds on the surface.
                let object = pose(&x);
                let on = object.transform_point(&shape.closest(&object.inverse().transform_point(&tip)));
                let h = normal_jacobian(&x, &shape, &on);
                let by_difference = differences(&x, |x| normal(x, &shape, &on));
                prop_assert!((h - by_difference).amax() < 1e-6, "{shape:?}: {h} {by_difference}");
                let hq = offset_jacobian(&x, &shape, &on);
                let by_difference = differences(&x, |x| nalgebra::Vector1::new(offset(x, &shape, &on)));
                prop_assert!((hq - by_difference).amax() < 1e-6, "{shape:?}: {hq} {by_difference}");
            }
        }
    }

    #[test]
    fn the_quaternions_rate_gives_the_angular_velocity() {
        let (q, omega) = (
            UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.8, 0.5)),
            Vector3::new(0.2, 1.0, -0.7),
        );
        let rate = Quaternion::from_imag(omega) * q.into_inner() * 0.5;
        let x = vector(&Pose::new(Vector3::zeros(), q));
        let mut xd = PoseVector::zeros();
        xd[3] = rate.w;
        xd.fixed_rows_mut::<3>(4).copy_from(&rate.imag());
        let screw = screw_from_rate(&x) * xd;
        assert!((screw.fixed_rows::<3>(3) - omega).amax() < 1e-14);
    }
}
