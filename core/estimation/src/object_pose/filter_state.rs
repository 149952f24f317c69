//! State and covariance of `object_pose`: prediction, and one correction for every kind of
//! measurement.
//!
//! Error states, in this order: the object's position (m) and small rotation (rad), its velocity
//! (m/s) and angular velocity (rad/s), all base axes; the camera's position (m) and small rotation
//! (rad), flange axes; focal length (share); principal point (2, share of the focal length);
//! compliance of the whole object along the normal (m/N); friction coefficient; compliance of the
//! spot under the tip (m/N); error of the tip's stated position (3, m, flange axes); tilt of the
//! measured force (2, rad, along the tool's x and y axes). Rotations are updated from the left by
//! `exp(δ)`: the error lives in the tangent space, and the state always stays on the group.

use nalgebra::{Matrix2, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};
use tangent_mechanics::{Base, Camera, Flange, Object, Pose};

use super::{CameraModel, ObjectPoseConfig};

pub(super) const STATES: usize = 29;
pub(super) const POSITION: usize = 0;
pub(super) const TURN: usize = 3;
pub(super) const VELOCITY: usize = 6;
pub(super) const SPIN: usize = 9;
pub(super) const CAMERA_POSITION: usize = 12;
pub(super) const CAMERA_TURN: usize = 15;
pub(super) const FOCAL: usize = 18;
pub(super) const PRINCIPAL: usize = 19;
pub(super) const COMPLIANCE: usize = 21;
pub(super) const FRICTION: usize = 22;
pub(super) const LOCAL: usize = 23;
pub(super) const TIP: usize = 24;
pub(super) const FORCE_TILT: usize = 27;

/// Transposed Jacobian of `M` measurements: one column per measurement.
pub(super) type Columns<const M: usize> = SMatrix<f64, STATES, M>;

/// Standard deviation of the first position before its own image is used, m: almost no information.
const START_POSITION_SD_M: f64 = 1.0;
const START_TURN_SD_RAD: f64 = 1.0;

/// State estimate and its covariance.
#[derive(Clone, Debug)]
pub(super) struct FilterState {
    /// Pose of the object without load.
    pub rest: Pose<Base, Object>,
    pub velocity: Vector3<f64>,
    pub spin: Vector3<f64>,
    pub flange_from_camera: Pose<Flange, Camera>,
    /// True focal length divided by the calibration's.
    pub focal: f64,
    /// True principal point minus the calibration's, divided by the calibration's focal length.
    pub principal: Vector2<f64>,
    /// Compliance of the whole object, m/N: what the camera sees.
    pub compliance: f64,
    pub friction: f64,
    /// Compliance of the spot under the tip, m/N: what the camera does not see.
    pub local: f64,
    /// True position of the tip minus the stated one, flange axes, m.
    pub tip: Vector3<f64>,
    /// Measured minus true direction of the force, along the tool's x and y axes, rad.
    pub force_tilt: Vector2<f64>,
    pub covariance: SMatrix<f64, STATES, STATES>,
}

impl FilterState {
    /// `rest` is only a point to linearise at; it carries no information.
    pub fn new(config: &ObjectPoseConfig, camera: &CameraModel, rest: Pose<Base, Object>) -> Self {
        let p = &config.prior;
        let mut sd = SVector::<f64, STATES>::zeros();
        for (start, count, value) in [
            (POSITION, 3, START_POSITION_SD_M),
            (TURN, 3, START_TURN_SD_RAD),
            (VELOCITY, 3, p.speed_sd_m_per_s),
            (SPIN, 3, p.turn_rate_sd_rad_per_s),
            (CAMERA_POSITION, 3, p.camera_position_sd_m),
            (CAMERA_TURN, 3, p.camera_orientation_sd_rad),
            (FOCAL, 1, p.focal_sd_share),
            (PRINCIPAL, 2, p.principal_sd_share),
            (COMPLIANCE, 1, p.compliance_sd_m_per_n),
            (FRICTION, 1, config.contact.friction_sd),
            (LOCAL, 1, p.local_compliance_sd_m_per_n),
            (TIP, 3, p.tip_sd_m),
            (FORCE_TILT, 2, p.force_tilt_sd_rad),
        ] {
            sd.rows_mut(start, count).fill(value);
        }
        Self {
            rest,
            velocity: Vector3::zeros(),
            spin: Vector3::zeros(),
            flange_from_camera: camera.flange_from_camera,
            focal: 1.0,
            principal: Vector2::zeros(),
            compliance: p.compliance_m_per_n,
            friction: 0.0,
            local: 0.0,
            tip: Vector3::zeros(),
            force_tilt: Vector2::zeros(),
            covariance: SMatrix::from_diagonal(&sd.component_mul(&sd)),
        }
    }

    /// Constant velocity over `dt` (s), eq. (27), with white noise on the acceleration.
    pub fn predict(&mut self, config: &ObjectPoseConfig, dt: f64) {
        self.rest = self.rest_at(dt);
        let p = &mut self.covariance;
        // F P Fᵀ, where F is the identity except for dt from the velocities to the pose.
        for i in 0..6 {
            for j in 0..STATES {
                p[(i, j)] += dt * p[(i + VELOCITY, j)];
            }
        }
        for i in 0..STATES {
            for j in 0..6 {
                p[(i, j)] += dt * p[(i, j + VELOCITY)];
            }
        }
        let prior = &config.prior;
        for (pose, speed, density) in [
            (POSITION, VELOCITY, prior.speed_change_m_per_s_per_sqrt_s),
            (TURN, SPIN, prior.turn_rate_change_rad_per_s_per_sqrt_s),
        ] {
            let q = density * density;
            for i in 0..3 {
                p[(pose + i, pose + i)] += q * dt * dt * dt / 3.0;
                p[(pose + i, speed + i)] += q * dt * dt / 2.0;
                p[(speed + i, pose + i)] += q * dt * dt / 2.0;
                p[(speed + i, speed + i)] += q * dt;
            }
        }
    }

    /// Pose of the object without load in `dt` (s; negative for the past), at the current velocity.
    pub fn rest_at(&self, dt: f64) -> Pose<Base, Object> {
        Pose::new(
            self.rest.translation() + self.velocity * dt,
            UnitQuaternion::from_scaled_axis(self.spin * dt) * self.rest.rotation(),
        )
    }

    /// The camera as estimated.
    pub fn camera(&self, stated: &CameraModel) -> CameraModel {
        CameraModel {
            flange_from_camera: self.flange_from_camera,
            focal_px: stated.focal_px * self.focal,
            principal_px: stated.principal_px + self.principal * stated.focal_px,
            pixel_m: stated.pixel_m,
        }
    }

    /// Kalman correction. `columns` is Hᵀ, `innovation` is measured minus predicted, `variance` the
    /// noise of each measurement. Returns false and changes nothing if the innovation exceeds
    /// `gate_sd` or is not finite.
    pub fn correct<const M: usize>(
        &mut self,
        columns: &Columns<M>,
        innovation: &SVector<f64, M>,
        variance: &SVector<f64, M>,
        gate_sd: f64,
    ) -> bool {
        let change = self.change(columns, innovation, variance, gate_sd);
        if let Some(change) = &change {
            self.apply(change);
        }
        change.is_some()
    }

    /// Computes the correction of the state and applies Joseph's update to the covariance; the
    /// state itself is not changed.
    pub fn change<const M: usize>(
        &mut self,
        columns: &Columns<M>,
        innovation: &SVector<f64, M>,
        variance: &SVector<f64, M>,
        gate_sd: f64,
    ) -> Option<SVector<f64, STATES>> {
        let from_states = self.covariance * columns;
        let mut total = columns.tr_mul(&from_states);
        for i in 0..M {
            total[(i, i)] += variance[i];
        }
        let inverse = inverse(&total)?;
        let distance = innovation.dot(&(inverse * innovation));
        if distance.is_nan() || distance > gate_sd * gate_sd {
            return None;
        }
        let gain = from_states * inverse;
        // (I - K H) P (I - K H)ᵀ + K R Kᵀ, in two products of a thin and a square matrix.
        self.covariance -= gain * from_states.transpose();
        let across = self.covariance * columns;
        let mut noisy = gain;
        for i in 0..M {
            let mut column = noisy.column_mut(i);
            column *= variance[i];
        }
        self.covariance += (noisy - across) * gain.transpose();
        for i in 0..STATES {
            for j in 0..i {
                let mean = 0.5 * (self.covariance[(i, j)] + self.covariance[(j, i)]);
                self.covariance[(i, j)] = mean;
                self.covariance[(j, i)] = mean;
            }
        }
        Some(gain * innovation)
    }

    /// Applies an error state to the state.
    pub fn apply(&mut self, change: &SVector<f64, STATES>) {
        let part = |start: usize| change.fixed_rows::<3>(start).into_owned();
        let turned = |start: usize, rotation: UnitQuaternion<f64>| {
            UnitQuaternion::new_normalize(
                (UnitQuaternion::from_scaled_axis(part(start)) * rotation).into_inner(),
            )
        };
        self.rest = Pose::new(
            self.rest.translation() + part(POSITION),
            turned(TURN, self.rest.rotation()),
        );
        self.velocity += part(VELOCITY);
        self.spin += part(SPIN);
        self.flange_from_camera = Pose::new(
            self.flange_from_camera.translation() + part(CAMERA_POSITION),
            turned(CAMERA_TURN, self.flange_from_camera.rotation()),
        );
        self.focal += change[FOCAL];
        self.principal += change.fixed_rows::<2>(PRINCIPAL);
        self.compliance += change[COMPLIANCE];
        self.friction += change[FRICTION];
        self.local += change[LOCAL];
        self.tip += part(TIP);
        self.force_tilt += change.fixed_rows::<2>(FORCE_TILT);
    }
}

/// Inverse of the innovation's covariance; `None` if it is not positive definite.
fn inverse<const M: usize>(total: &SMatrix<f64, M, M>) -> Option<SMatrix<f64, M, M>> {
    match M {
        1 => (total[(0, 0)] > 0.0).then(|| SMatrix::from_element(1.0 / total[(0, 0)])),
        2 => {
            let determinant = total[(0, 0)] * total[(1, 1)] - total[(0, 1)] * total[(1, 0)];
            let swapped =
                Matrix2::new(total[(1, 1)], -total[(0, 1)], -total[(1, 0)], total[(0, 0)]);
            (determinant > 0.0 && total[(0, 0)] > 0.0)
                .then(|| SMatrix::from_fn(|i, j| swapped[(i, j)] / determinant))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_correction_is_the_least_squares_answer_and_keeps_the_covariance_sound() {
        let config = ObjectPoseConfig::default();
        let camera = CameraModel {
            flange_from_camera: Pose::identity(),
            focal_px: 400.0,
            principal_px: Vector2::zeros(),
            pixel_m: 8e-6,
        };
        let mut state = FilterState::new(&config, &camera, Pose::identity());
        state.predict(&config, 0.3);
        let before = state.covariance;
        let columns = Columns::<2>::from_fn(|i, j| (0.3 * (i * (j + 2)) as f64).sin());
        let (innovation, variance) = (Vector2::new(0.02, -0.01), Vector2::new(1e-4, 3e-4));
        assert!(state.correct(&columns, &innovation, &variance, 1e9));
        // Information form, with a general inverse.
        let prior = before + SMatrix::<f64, STATES, STATES>::from_diagonal_element(1e-30);
        let total = columns.transpose() * prior * columns + Matrix2::from_diagonal(&variance);
        let gain = prior * columns * total.try_inverse().unwrap();
        let joseph = {
            let left = SMatrix::<f64, STATES, STATES>::identity() - gain * columns.transpose();
            left * prior * left.transpose()
                + gain * Matrix2::from_diagonal(&variance) * gain.transpose()
        };
        assert!((state.covariance - joseph).amax() < 1e-12);
        assert!((state.rest.translation() - (gain * innovation).fixed_rows::<3>(0)).amax() < 1e-12);
        let smallest = state.covariance.symmetric_eigenvalues().min();
        assert!(smallest > -1e-15, "{smallest}");
        let unchanged = state.covariance;
        assert!(!state.correct(&columns, &Vector2::new(f64::NAN, 0.0), &variance, 1e9));
        assert!(!state.correct(&columns, &Vector2::new(10.0, 0.0), &variance, 3.0));
        assert_eq!(state.covariance, unchanged);
    }
}
