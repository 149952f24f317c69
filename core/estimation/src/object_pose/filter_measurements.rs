//! Measurements of `object_pose`: corners, the tip on the surface, and the force's direction; each
//! with its prediction and Jacobian.

use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector2, Vector3};

use super::ImplicitSurface;
use super::arm_history::ArmMoment;
use super::contact::Touch;
use super::filter_state::{
    CAMERA_POSITION, CAMERA_TURN, COMPLIANCE, Columns, FOCAL, FORCE_TILT, FRICTION, FilterState,
    LOCAL, POSITION, PRINCIPAL, SPIN, TIP, TURN, VELOCITY,
};

/// Predicted pixel of a corner (object axes, m) in a frame that is `age` (s) old, for the stated
/// calibration, with its derivative by the current state: eqs. (13)-(17), including the camera's
/// own errors. `None` if the corner is not in front of the camera.
pub(super) fn expected_corner(
    state: &FilterState,
    moment: &ArmMoment,
    age: f64,
    corner: &Vector3<f64>,
) -> Option<(Vector2<f64>, Columns<2>)> {
    let then = state.rest_at(-age);
    let arm = then.rotate(corner);
    // The whole object is deflected by the force at that time.
    let in_base = then.translation() + arm - moment.yielding_n * state.compliance;
    let in_flange = moment.base_from_flange.inverse().transform_point(&in_base);
    let from_camera = in_flange - state.flange_from_camera.translation();
    let p = state.flange_from_camera.unrotate(&from_camera);
    if p.z < 0.01 {
        return None;
    }
    let ratio = p.xy() / p.z;
    let by_point =
        SMatrix::<f64, 2, 3>::new(1.0, 0.0, -ratio.x, 0.0, 1.0, -ratio.y) * (state.focal / p.z);
    let camera_from_flange = state
        .flange_from_camera
        .rotation()
        .inverse()
        .to_rotation_matrix();
    let by_flange = by_point * camera_from_flange.matrix();
    let flange_from_base = moment
        .base_from_flange
        .rotation()
        .inverse()
        .to_rotation_matrix();
    let by_base = by_flange * flange_from_base.matrix();
    let by_turn = by_base * -arm.cross_matrix();

    let mut columns = Columns::<2>::zeros();
    let mut put = |row: usize, block: &SMatrix<f64, 2, 3>| {
        columns
            .fixed_view_mut::<3, 2>(row, 0)
            .copy_from(&block.transpose());
    };
    put(POSITION, &by_base);
    put(TURN, &by_turn);
    put(VELOCITY, &(by_base * -age));
    put(SPIN, &(by_turn * -age));
    put(CAMERA_POSITION, &-by_flange);
    put(CAMERA_TURN, &(by_flange * from_camera.cross_matrix()));
    let by_compliance = by_base * -moment.yielding_n;
    for i in 0..2 {
        columns[(FOCAL, i)] = ratio[i];
        columns[(PRINCIPAL + i, i)] = 1.0;
        columns[(COMPLIANCE, i)] = by_compliance[i];
    }
    Some((ratio * state.focal + state.principal, columns))
}

/// The tip at one time, as the arm measures it.
#[derive(Clone, Copy, Debug)]
pub(super) struct TipPose {
    /// Stated position, base axes, m.
    pub position: Vector3<f64>,
    /// Orientation of the flange.
    pub flange: UnitQuaternion<f64>,
    /// Orientation of the tool.
    pub tool: UnitQuaternion<f64>,
}

impl TipPose {
    /// Position with the estimated error of the stated one, base axes, m.
    fn at(&self, state: &FilterState) -> Vector3<f64> {
        self.position + self.flange * state.tip
    }
}

/// Predicted distance of the tip above the deflected surface, m: φ/|∇φ| + c F with the compliances
/// of the whole object and of the spot, whose measured value is zero; with its derivative by the
/// state.
fn expected_gap(
    state: &FilterState,
    surface: &dyn ImplicitSurface,
    force_n: f64,
    tip: &TipPose,
) -> (f64, Columns<1>) {
    let at = tip.at(state);
    let in_object = state.rest.inverse().transform_point(&at);
    let normal = state.rest.rotate(&surface.normal(&in_object));
    let arm = at - state.rest.translation();
    let gap = surface.distance(&in_object) + (state.compliance + state.local) * force_n;
    let mut columns = Columns::<1>::zeros();
    columns.fixed_rows_mut::<3>(POSITION).copy_from(&-normal);
    columns
        .fixed_rows_mut::<3>(TURN)
        .copy_from(&normal.cross(&arm));
    columns[COMPLIANCE] = force_n;
    columns[LOCAL] = force_n;
    columns
        .fixed_rows_mut::<3>(TIP)
        .copy_from(&tip.flange.inverse_transform_vector(&normal));
    (gap, columns)
}

/// Updates with the constraint that the tip lies on the surface.
pub(super) fn touch_point(
    state: &mut FilterState,
    surface: &dyn ImplicitSurface,
    touch: &Touch,
    tip: &TipPose,
    sd_m: f64,
) {
    let (gap, columns) = expected_gap(state, surface, touch.force_n, tip);
    let innovation = SVector::<f64, 1>::new(-gap);
    state.correct(
        &columns,
        &innovation,
        &SVector::<f64, 1>::new(sd_m * sd_m),
        f64::INFINITY,
    );
}

/// Two axes perpendicular to the normal: the first along the sliding direction, if the tool slides.
fn tangents(normal: &Vector3<f64>, sliding: Option<Vector3<f64>>) -> [Vector3<f64>; 2] {
    let seed = sliding.unwrap_or_else(|| {
        if normal.x.abs() < 0.9 {
            Vector3::x()
        } else {
            Vector3::y()
        }
    });
    let first = (seed - normal * normal.dot(&seed))
        .try_normalize(1e-9)
        .unwrap_or_else(|| {
            normal
                .cross(&Vector3::new(normal.y, normal.z, normal.x))
                .normalize()
        });
    [first, normal.cross(&first)]
}

/// Predicted direction of the force perpendicular to the estimated normal: n - μ s of eq. (19) with
/// friction, and the tilt of the measurement.
fn expected_direction(
    state: &FilterState,
    surface: &dyn ImplicitSurface,
    tip: &TipPose,
    sliding: Option<Vector3<f64>>,
) -> (Vector3<f64>, [Vector3<f64>; 2], Vector2<f64>, Columns<2>) {
    let at = tip.at(state);
    let in_object = state.rest.inverse().transform_point(&at);
    let normal = state.rest.rotate(&surface.normal(&in_object));
    let rotation = state.rest.rotation().to_rotation_matrix();
    let change = rotation * surface.normal_change(&in_object) * rotation.transpose();
    let arm = at - state.rest.translation();
    // Eq. (22): dn = -N do - (S(n) - N S(d)) dθ.
    let by_turn = change * arm.cross_matrix() - normal.cross_matrix();
    let axes = tangents(&normal, sliding);
    let mut columns = Columns::<2>::zeros();
    let mut expected = Vector2::zeros();
    let across = [tip.tool * Vector3::x(), tip.tool * Vector3::y()];
    for (i, axis) in axes.iter().enumerate() {
        columns
            .fixed_view_mut::<3, 1>(POSITION, i)
            .copy_from(&(-change.tr_mul(axis)));
        columns
            .fixed_view_mut::<3, 1>(TURN, i)
            .copy_from(&by_turn.tr_mul(axis));
        columns
            .fixed_view_mut::<3, 1>(TIP, i)
            .copy_from(&tip.flange.inverse_transform_vector(&change.tr_mul(axis)));
        for (k, tilted) in across.iter().enumerate() {
            let share = axis.dot(tilted);
            expected[i] += state.force_tilt[k] * share;
            columns[(FORCE_TILT + k, i)] = share;
        }
        if let Some(direction) = sliding {
            expected[i] -= state.friction * axis.dot(&direction);
            columns[(FRICTION, i)] = -axis.dot(&direction);
        }
    }
    (normal, axes, expected, columns)
}

/// Updates with the direction of the force.
pub(super) fn touch_direction(
    state: &mut FilterState,
    surface: &dyn ImplicitSurface,
    touch: &Touch,
    tip: &TipPose,
    sliding: Option<Vector3<f64>>,
    sd_rad: f64,
) {
    let (normal, axes, expected, columns) = expected_direction(state, surface, tip, sliding);
    let along = normal.dot(&touch.direction);
    // A force nearly tangential to the surface does not come from this surface.
    if along < 0.3 {
        return;
    }
    let measured =
        Vector2::new(axes[0].dot(&touch.direction), axes[1].dot(&touch.direction)) / along;
    let variance = Vector2::repeat(sd_rad * sd_rad);
    state.correct(&columns, &(measured - expected), &variance, f64::INFINITY);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object_pose::filter_state::STATES;
    use crate::object_pose::{CameraModel, ObjectPoseConfig, ObjectShape};
    use nalgebra::UnitQuaternion;
    use proptest::prelude::*;
    use tangent_mechanics::Pose;

    const H: f64 = 1e-6;

    fn state(t: [f64; 3], turn: [f64; 3]) -> FilterState {
        let camera = CameraModel {
            flange_from_camera: Pose::new(
                Vector3::new(0.07, -0.01, 0.02),
                UnitQuaternion::from_scaled_axis(Vector3::new(0.1, -0.2, 0.4)),
            ),
            focal_px: 400.0,
            principal_px: Vector2::new(320.0, 240.0),
            pixel_m: 8e-6,
        };
        let rest = Pose::new(
            Vector3::from(t),
            UnitQuaternion::from_scaled_axis(Vector3::from(turn)),
        );
        let mut state = FilterState::new(&ObjectPoseConfig::default(), &camera, rest);
        state.velocity = Vector3::new(0.02, -0.01, 0.03);
        // At rest the derivative by the angular velocity is exact; at 0.1 rad/s and 20 ms its error
        // is a thousandth.
        state.spin = Vector3::zeros();
        state.focal = 1.02;
        state.principal = Vector2::new(0.01, -0.02);
        state.compliance = 1.2e-4;
        state.friction = 0.2;
        state.local = 0.5e-4;
        state.tip = Vector3::new(1e-3, -2e-3, 1e-3);
        state.force_tilt = Vector2::new(0.01, -0.02);
        state
    }

    /// Derivatives by the error state, computed with the filter's own update of the state.
    fn differences<const M: usize>(
        state: &FilterState,
        expected: impl Fn(&FilterState) -> SVector<f64, M>,
    ) -> Columns<M> {
        let mut columns = Columns::zeros();
        for i in 0..STATES {
            let moved = |size: f64| {
                let mut change = SVector::<f64, STATES>::zeros();
                change[i] = size;
                let mut moved = state.clone();
                moved.apply(&change);
                expected(&moved)
            };
            let slope = (moved(H) - moved(-H)) / (2.0 * H);
            for j in 0..M {
                columns[(i, j)] = slope[j];
            }
        }
        columns
    }

    proptest! {
        #[test]
        fn every_jacobian_is_the_derivative(t in prop::array::uniform3(-0.1f64..0.1), turn in prop::array::uniform3(-0.6f64..0.6),
                                            tip in prop::array::uniform3(0.15f64..0.3), corner in prop::array::uniform3(-0.05f64..0.05)) {
            let state = state(t, turn);
            let (tip, corner) = (Vector3::from(tip), Vector3::from(corner));
            let moment = ArmMoment {
                time_s: 0.0,
                base_from_flange: Pose::new(Vector3::new(0.05, 0.0, 0.5), UnitQuaternion::from_scaled_axis(Vector3::new(3.1, 0.0, 0.0))),
                yielding_n: Vector3::new(1.0, -2.0, 15.0),
            };
            let (_, columns) = expected_corner(&state, &moment, 0.02, &corner).unwrap();
            let by_difference = differences(&state, |s| expected_corner(s, &moment, 0.02, &corner).unwrap().0);
            prop_assert!((columns - by_difference).amax() < 2e-6, "{}", columns - by_difference);
            for shape in [ObjectShape::Plane {}, ObjectShape::Cylinder { radius_m: 0.2 }, ObjectShape::Sphere { radius_m: 0.2 }] {
                let flange = UnitQuaternion::from_scaled_axis(Vector3::new(2.9, 0.3, 0.1));
                let tool = UnitQuaternion::from_scaled_axis(Vector3::new(3.0, 0.2, 0.4));
                let on = state.rest.transform_point(&shape.closest(&state.rest.inverse().transform_point(&tip)));
                let on = TipPose { position: on - flange * state.tip, flange, tool };
                let (_, columns) = expected_gap(&state, &shape, 20.0, &on);
                let by_difference = differences(&state, |s| SVector::<f64, 1>::new(expected_gap(s, &shape, 20.0, &on).0));
                prop_assert!((columns - by_difference).amax() < 1e-6, "{shape:?}");
                // Derivative of n - μ s along fixed axes perpendicular to the normal.
                let sliding = Vector3::new(0.6, 0.8, 0.0);
                let (normal, axes, _, columns) = expected_direction(&state, &shape, &on, Some(sliding));
                let by_difference = differences(&state, |s| {
                    let tilt = tool * Vector3::new(s.force_tilt.x, s.force_tilt.y, 0.0);
                    let n = expected_direction(s, &shape, &on, Some(sliding)).0 - sliding * s.friction + tilt;
                    Vector2::new(axes[0].dot(&n), axes[1].dot(&n))
                });
                prop_assert!(axes.iter().all(|a| a.dot(&normal).abs() < 1e-12));
                prop_assert!((columns - by_difference).amax() < 1e-6, "{shape:?} {}", columns - by_difference);
            }
        }
    }
}
