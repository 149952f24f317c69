//! Inverse dynamics, mass matrix and what follows from the two.
//!
//! Equation of motion: tau = M(q) qdd + c(q, qd) + g(q); tau is what the motors supply. No friction, no motor inertia.

use nalgebra::{SMatrix, Vector3};

use super::kinematics::Frames;
use super::{Arm, Body};
use crate::Joints;
use crate::linear_solve::solve_positive_definite;

impl<const N: usize> Arm<N> {
    /// Torques (Nm) that give the joints the acceleration `qdd` (rad/s²) at `q` (rad) and `qd` (rad/s).
    ///
    /// Recursive Newton-Euler in base axes: Luh, Walker, Paul 1980; gravity enters as an acceleration of the base.
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

    /// Acceleration of the joints (rad/s²) under the torques `tau` (Nm). Not a number if an input is not.
    pub fn forward_dynamics(&self, q: &Joints<N>, qd: &Joints<N>, tau: &Joints<N>) -> Joints<N> {
        let frames = self.frames(q);
        let bias = self.newton_euler(&frames, qd, &Joints::zeros(), &self.gravity);
        // A checked model's mass matrix is positive definite, so only a bad input fails here.
        solve_positive_definite(&self.mass_matrix_of(&frames), &(tau - bias))
            .unwrap_or_else(|| Joints::repeat(f64::NAN))
    }

    /// qdᵀ M qd / 2, J.
    pub fn kinetic_energy(&self, q: &Joints<N>, qd: &Joints<N>) -> f64 {
        0.5 * qd.dot(&(self.mass_matrix(q) * qd))
    }

    /// Energy of the links in the field of gravity, J; zero with all mass at the base's origin.
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
            // The tensor is constant in the link's axes: turn the vectors, not the tensor.
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
            beyond = beyond.joined_with(&self.bodies[i].seen_from(&frames.joints[i]));
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
