//! Inverse and forward dynamics, mass matrix and energy.
//!
//! Equation of motion: tau = M(q) qdd + c(q, qd) + g(q); tau is what the motors supply. No
//! friction, no motor inertia.

use nalgebra::{SMatrix, Vector3};

use super::kinematics::Frames;
use super::{Arm, Body};
use crate::Joints;
use crate::linear_solve::solve_positive_definite;

impl<const N: usize> Arm<N> {
    /// Torques (Nm) that give the joints the acceleration `qdd` (rad/s²) at `q` (rad) and `qd`
    /// (rad/s).
    ///
    /// Recursive Newton-Euler in base axes: Luh, Walker, Paul 1980; gravity enters as an
    /// acceleration of the base.
    pub fn inverse_dynamics(&self, q: &Joints<N>, qd: &Joints<N>, qdd: &Joints<N>) -> Joints<N> {
        self.newton_euler(&self.frames(q), qd, qdd, &self.gravity)
    }

    /// Torques (Nm) that hold the arm still against gravity.
    pub fn gravity(&self, q: &Joints<N>) -> Joints<N> {
        let rest = Joints::zeros();
        self.newton_euler(&self.frames(q), &rest, &rest, &self.gravity)
    }

    /// Centrifugal and Coriolis torques C(q, qd) qd, Nm.
    pub fn coriolis(&self, q: &Joints<N>, qd: &Joints<N>) -> Joints<N> {
        self.newton_euler(&self.frames(q), qd, &Joints::zeros(), &Vector3::zeros())
    }

    /// Joint-space mass matrix, kg m²: symmetric, positive definite.
    ///
    /// Composite rigid bodies: Walker, Orin 1982.
    pub fn mass_matrix(&self, q: &Joints<N>) -> SMatrix<f64, N, N> {
        self.mass_matrix_of(&self.frames(q))
    }

    /// Mass matrix (kg m²) and bias torques C(q, qd) qd + g(q) (Nm), from one pass over the frames.
    /// Inverse-dynamics laws and implicit integrators need both in every step.
    pub fn mass_matrix_and_bias(
        &self,
        q: &Joints<N>,
        qd: &Joints<N>,
    ) -> (SMatrix<f64, N, N>, Joints<N>) {
        let frames = self.frames(q);
        let bias = self.newton_euler(&frames, qd, &Joints::zeros(), &self.gravity);
        (self.mass_matrix_of(&frames), bias)
    }

    /// Acceleration of the joints (rad/s²) under the torques `tau` (Nm). NaN if an input is NaN.
    pub fn forward_dynamics(&self, q: &Joints<N>, qd: &Joints<N>, tau: &Joints<N>) -> Joints<N> {
        let frames = self.frames(q);
        let bias = self.newton_euler(&frames, qd, &Joints::zeros(), &self.gravity);
        // A checked model's mass matrix is positive definite, so only a bad input fails here.
        solve_positive_definite(&self.mass_matrix_of(&frames), &(tau - bias))
            .unwrap_or_else(|| Joints::repeat(f64::NAN))
    }

    /// Kinetic energy qdᵀ M qd / 2, J.
    pub fn kinetic_energy(&self, q: &Joints<N>, qd: &Joints<N>) -> f64 {
        0.5 * qd.dot(&(self.mass_matrix(q) * qd))
    }

    /// Potential energy of the links, J; zero if all mass were at the base's origin.
    pub fn potential_energy(&self, q: &Joints<N>) -> f64 {
        let frames = self.frames(q);
        (0..N)
            .map(|i| {
                let body = &self.bodies[i];
                let com = frames.origin(i) + frames.joints[i].rotation * body.com;
                -body.mass * self.gravity.dot(&com)
            })
            .sum()
    }

    fn newton_euler(
        &self,
        frames: &Frames<N>,
        qd: &Joints<N>,
        qdd: &Joints<N>,
        gravity: &Vector3<f64>,
    ) -> Joints<N> {
        let (mut omega, mut alpha) = (Vector3::zeros(), Vector3::zeros());
        let mut acceleration = -gravity;
        let mut force = [Vector3::zeros(); N];
        let mut moment = [Vector3::zeros(); N];
        let mut com = [Vector3::zeros(); N];
        for i in 0..N {
            if i > 0 {
                let span = frames.origin(i) - frames.origin(i - 1);
                acceleration += alpha.cross(&span) + omega.cross(&omega.cross(&span));
            }
            let axis = frames.axis(i);
            alpha += axis * qdd[i] + omega.cross(&axis) * qd[i];
            omega += axis * qd[i];
            let (rotation, body) = (&frames.joints[i].rotation, &self.bodies[i]);
            com[i] = rotation * body.com;
            let at_com = acceleration + alpha.cross(&com[i]) + omega.cross(&omega.cross(&com[i]));
            force[i] = at_com * body.mass;
            // The tensor is constant in the link's axes, so the vectors are rotated instead of it.
            let spin = rotation.tr_mul(&omega);
            moment[i] = rotation
                * (body.inertia * rotation.tr_mul(&alpha) + spin.cross(&(body.inertia * spin)));
        }
        let mut tau = Joints::zeros();
        let (mut force_on, mut moment_on) = (Vector3::zeros(), Vector3::zeros());
        for i in (0..N).rev() {
            if i + 1 < N {
                // From the next joint's origin to this one's.
                let span = frames.origin(i + 1) - frames.origin(i);
                moment_on += span.cross(&force_on);
            }
            moment_on += moment[i] + com[i].cross(&force[i]);
            force_on += force[i];
            tau[i] = frames.axis(i).dot(&moment_on);
        }
        tau
    }

    fn mass_matrix_of(&self, frames: &Frames<N>) -> SMatrix<f64, N, N> {
        let mut mass = SMatrix::zeros();
        let mut beyond = Body::NONE;
        for i in (0..N).rev() {
            beyond = beyond.joined_with(&self.bodies[i].placed_in(&frames.joints[i]));
            // Momentum of everything beyond joint i when that joint alone turns at 1 rad/s.
            let axis = frames.axis(i);
            let linear = axis.cross(&(beyond.com - frames.origin(i))) * beyond.mass;
            let angular = beyond.inertia * axis;
            for j in 0..=i {
                let about_j = angular + (beyond.com - frames.origin(j)).cross(&linear);
                let entry = frames.axis(j).dot(&about_j);
                mass[(i, j)] = entry;
                mass[(j, i)] = entry;
            }
        }
        mass
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ModelData, Payload};
    use nalgebra::Matrix3;
    use proptest::prelude::*;

    fn arm<const N: usize>(name: &str) -> Arm<N> {
        Arm::new(&ModelData::builtin(name).unwrap()).unwrap()
    }

    fn laws_of_mechanics_hold<const N: usize>(
        name: &str,
        values: &[Vec<f64>; 3],
    ) -> Result<(), TestCaseError> {
        let arm = arm::<N>(name);
        let [q, qd, qdd] = std::array::from_fn(|i| Joints::<N>::from_column_slice(&values[i][..N]));
        let mass = arm.mass_matrix(&q);
        prop_assert_eq!(mass, mass.transpose());
        let scale = mass.amax().max(1.0);

        // Newton-Euler and the mass matrix give the same torques.
        let tau = arm.inverse_dynamics(&q, &qd, &qdd);
        let parts = mass * qdd + arm.coriolis(&q, &qd) + arm.gravity(&q);
        prop_assert!((tau - parts).amax() < 1e-11 * scale * tau.amax().max(1.0));
        let (same_mass, bias) = arm.mass_matrix_and_bias(&q, &qd);
        prop_assert_eq!(same_mass, mass);
        prop_assert!((mass * qdd + bias - parts).amax() < 1e-11 * scale * tau.amax().max(1.0));
        let back = arm.forward_dynamics(&q, &qd, &tau);
        prop_assert!(
            (back - qdd).amax() < 1e-8,
            "{name}: {}",
            (back - qdd).amax()
        );

        // Kinetic energy is positive, and gravity is the slope of potential energy.
        prop_assert!(arm.kinetic_energy(&q, &qd) > 0.0);
        let h = 1e-5;
        for i in 0..N {
            let mut step = Joints::zeros();
            step[i] = h;
            let slope =
                (arm.potential_energy(&(q + step)) - arm.potential_energy(&(q - step))) / (2.0 * h);
            let difference = (slope - arm.gravity(&q)[i]).abs();
            prop_assert!(difference < 1e-6, "{name}: gravity off by {difference}");
        }

        // Passivity: qd' (Mdot - 2 C) qd = 0, so the power of the Coriolis torques equals that of
        // the change of M.
        let mass_dot =
            (arm.mass_matrix(&(q + qd * h)) - arm.mass_matrix(&(q - qd * h))) / (2.0 * h);
        let power = 0.5 * qd.dot(&(mass_dot * qd));
        let difference = (power - qd.dot(&arm.coriolis(&q, &qd))).abs();
        prop_assert!(
            difference < 1e-7 * scale,
            "{name}: {difference} W from nowhere"
        );
        Ok(())
    }

    proptest! {
        #[test]
        fn every_model_obeys_the_laws_of_mechanics(
            q in prop::collection::vec(-3.0f64..3.0, 7),
            qd in prop::collection::vec(-2.0f64..2.0, 7),
            qdd in prop::collection::vec(-5.0f64..5.0, 7),
        ) {
            let values = [q, qd, qdd];
            laws_of_mechanics_hold::<6>("ur5", &values)?;
            laws_of_mechanics_hold::<6>("ur5e", &values)?;
            laws_of_mechanics_hold::<7>("panda", &values)?;
            laws_of_mechanics_hold::<6>("smart3s_substitute", &values)?;
            laws_of_mechanics_hold::<2>("planar2", &values)?;
        }
    }

    #[test]
    fn planar2_by_hand() {
        // Lagrange's equations with l = 1, 0.5; centres at mid-link; m = 2, 1; I = 0.2, 0.05.
        let arm = arm::<2>("planar2");
        let (q1, q2, qd1, qd2) = (0.7_f64, -1.9_f64, 1.3, -0.4);
        let (q, qd) = (Joints::<2>::new(q1, q2), Joints::<2>::new(qd1, qd2));
        let (s, k) = q2.sin_cos();
        let coupling = 0.1125 + 0.25 * k;
        let mass = arm.mass_matrix(&q);
        assert!((mass[(0, 0)] - (1.8125 + 0.5 * k)).abs() < 1e-14);
        assert!((mass[(0, 1)] - coupling).abs() < 1e-14);
        assert!((mass[(1, 1)] - 0.1125).abs() < 1e-14);
        let coriolis = Joints::<2>::new(
            -0.25 * s * (2.0 * qd1 * qd2 + qd2 * qd2),
            0.25 * s * qd1 * qd1,
        );
        assert!((arm.coriolis(&q, &qd) - coriolis).amax() < 1e-14);
        let outer = 2.4525 * (q1 + q2).cos();
        let gravity = Joints::<2>::new(19.62 * q1.cos() + outer, outer);
        assert!((arm.gravity(&q) - gravity).amax() < 1e-13);
        let energy =
            0.5 * ((1.8125 + 0.5 * k) * qd1 * qd1 + 0.1125 * qd2 * qd2) + coupling * qd1 * qd2;
        assert!((arm.kinetic_energy(&q, &qd) - energy).abs() < 1e-14);
    }

    #[test]
    fn a_falling_arm_keeps_its_energy() {
        let arm = arm::<6>("ur5");
        let mut q = arm.home();
        let mut qd = Joints::<6>::new(0.3, -0.2, 0.4, 0.1, -0.5, 0.2);
        let energy =
            |q: &Joints<6>, qd: &Joints<6>| arm.kinetic_energy(q, qd) + arm.potential_energy(q);
        let at_start = energy(&q, &qd);
        let (none, dt) = (Joints::zeros(), 1e-3);
        let rate = |q: &Joints<6>, qd: &Joints<6>| (*qd, arm.forward_dynamics(q, qd, &none));
        let mut kinetic_max = 0.0_f64;
        for _ in 0..500 {
            let (v1, a1) = rate(&q, &qd);
            let (v2, a2) = rate(&(q + v1 * (dt / 2.0)), &(qd + a1 * (dt / 2.0)));
            let (v3, a3) = rate(&(q + v2 * (dt / 2.0)), &(qd + a2 * (dt / 2.0)));
            let (v4, a4) = rate(&(q + v3 * dt), &(qd + a3 * dt));
            q += (v1 + (v2 + v3) * 2.0 + v4) * (dt / 6.0);
            qd += (a1 + (a2 + a3) * 2.0 + a4) * (dt / 6.0);
            kinetic_max = kinetic_max.max(arm.kinetic_energy(&q, &qd));
        }
        assert!(kinetic_max > 1.0, "the arm did not move: {kinetic_max} J");
        let gained = (energy(&q, &qd) - at_start).abs();
        assert!(gained < 1e-6 * kinetic_max, "{gained} J of {kinetic_max} J");
    }

    #[test]
    fn a_payload_weighs_as_its_jacobian_says() {
        // A point mass at c adds J_c' (m g) to gravity and m J_c' J_c to the mass matrix.
        let bare = arm::<6>("ur5e");
        let com = Vector3::new(0.02, -0.05, 0.11);
        let loaded = bare.with_payload(&Payload {
            mass_kg: 1.7,
            com_in_flange_m: com,
            inertia_kg_m2: Matrix3::zeros(),
        });
        let q = bare.home().add_scalar(0.3);
        let at_com = crate::Pose::new(com, nalgebra::UnitQuaternion::identity());
        let jacobian = bare
            .jacobian_at(&q, &at_com)
            .fixed_rows::<3>(0)
            .into_owned();
        let weight = jacobian.tr_mul(&(-bare.gravity_in_base())) * 1.7;
        assert!((loaded.gravity(&q) - bare.gravity(&q) - weight).amax() < 1e-12);
        let inertia = jacobian.tr_mul(&jacobian) * 1.7;
        assert!((loaded.mass_matrix(&q) - bare.mass_matrix(&q) - inertia).amax() < 1e-12);
    }

    #[test]
    fn on_the_ceiling_the_gravity_torques_are_opposite() {
        let floor = arm::<6>("ur5");
        let ceiling = floor.with_gravity(-floor.gravity_in_base());
        let q = floor.home().add_scalar(0.4);
        assert_eq!(ceiling.gravity(&q), -floor.gravity(&q));
    }

    #[test]
    fn not_a_number_stays_not_a_number() {
        let arm = arm::<6>("ur5");
        let bad = Joints::<6>::repeat(f64::NAN);
        let rest = Joints::zeros();
        assert!(
            arm.forward_dynamics(&bad, &rest, &rest)
                .iter()
                .all(|x| x.is_nan())
        );
    }
}
