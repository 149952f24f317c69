//! The tool between flange and pad: a massless spring and damper in series with the contact.

use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3, Vector6};
use serde::{Deserialize, Serialize};

use super::pad::{Pad, PadContact, PadLinearisation, PadMotion};
use crate::surfaces::Surface;

/// Series spring and damper between the flange and the pad, at the tool's origin, along tool axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ComplianceConfig {
    /// Translational stiffness `[x, y, z]`, N/m.
    pub stiffness_n_per_m: [f64; 3],
    /// Rotational stiffness `[x, y, z]`, Nm/rad.
    pub stiffness_nm_per_rad: [f64; 3],
    /// Damping over stiffness: time constant with which a deflection decays, s.
    pub relaxation_s: f64,
}

impl Default for ComplianceConfig {
    fn default() -> Self {
        Self {
            stiffness_n_per_m: [15_000.0, 15_000.0, 40_000.0],
            stiffness_nm_per_rad: [100.0, 100.0, 100.0],
            relaxation_s: 0.003,
        }
    }
}

/// Deflection of the pad against the rigid tool, tool axes.
#[derive(Clone, Debug)]
pub struct Compliance {
    stiffness: Vector6<f64>,
    damping: Vector6<f64>,
    /// Displacement (m) and small rotation (rad).
    deflection: Vector6<f64>,
    /// Rate of the deflection, m/s and rad/s.
    rate: Vector6<f64>,
}

impl Compliance {
    /// Compliance at rest.
    pub fn new(config: &ComplianceConfig) -> Self {
        let [x, y, z] = config.stiffness_n_per_m;
        let [a, b, c] = config.stiffness_nm_per_rad;
        let stiffness = Vector6::new(x, y, z, a, b, c);
        Self {
            stiffness,
            damping: stiffness * config.relaxation_s,
            deflection: Vector6::zeros(),
            rate: Vector6::zeros(),
        }
    }

    /// One step of `dt` (s). `rigid` is the motion that the pad would have on a rigid tool. Returns
    /// the contact and the true motion.
    ///
    /// The balance `W(x, x') = K d + C d'` is solved with a linearly implicit step: contact and
    /// friction are far too stiff for an explicit step of a millisecond. The rigid tool goes on
    /// meanwhile; without that part of its motion, a tool that leaves would keep a deflection for
    /// which nothing presses any more, and snap back.
    pub fn step(
        &mut self,
        pad: &mut Pad,
        surface: &Surface,
        rigid: &PadMotion,
        dt: f64,
    ) -> (PadContact, PadMotion) {
        let rotation = rigid.rotation.to_rotation_matrix();
        let moved = self.moved(rigid, rotation.matrix());
        let mut linear = PadLinearisation::none();
        let contact = pad.step(surface, &moved, dt, Some(&mut linear));
        if contact.touching == 0 {
            // Without contact, the spring alone is solved exactly.
            let fade = Vector6::from_fn(|i, _| (-dt * self.stiffness[i] / self.damping[i]).exp());
            let next = self.deflection.component_mul(&fade);
            self.rate = (next - self.deflection) / dt;
            self.deflection = next;
            return (contact, self.moved(rigid, rotation.matrix()));
        }
        let back = rotation.matrix().transpose();
        let into_tool = |m: &Matrix6<f64>| {
            let mut turned = Matrix6::zeros();
            for (i, j) in [(0, 0), (0, 3), (3, 0), (3, 3)] {
                let block: Matrix3<f64> = m.fixed_view::<3, 3>(i, j).into_owned();
                turned
                    .fixed_view_mut::<3, 3>(i, j)
                    .copy_from(&(back * block * rotation.matrix()));
            }
            turned
        };
        let (kc, bc) = (into_tool(&linear.stiffness), into_tool(&linear.damping));
        let (f, t) = (back * contact.force, back * contact.torque);
        let wrench = Vector6::new(f.x, f.y, f.z, t.x, t.y, t.z);
        let mut matrix = kc * dt + bc;
        for i in 0..6 {
            matrix[(i, i)] += self.stiffness[i] * dt + self.damping[i];
        }
        let (v, w) = (back * rigid.linear, back * rigid.angular);
        let goes_on = Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z) * dt;
        let mut right = wrench - self.stiffness.component_mul(&self.deflection) - kc * goes_on;
        for i in 0..6 {
            for j in 0..6 {
                right[i] += bc[(i, j)] * self.rate[j];
            }
        }
        // Positive definite by construction: a positive diagonal and sums of Jᵀ K J.
        if let Some(factor) = matrix.cholesky() {
            self.rate = factor.solve(&right);
        }
        self.deflection += self.rate * dt;
        (contact, self.moved(rigid, rotation.matrix()))
    }

    fn moved(&self, rigid: &PadMotion, rotation: &Matrix3<f64>) -> PadMotion {
        let part = |v: &Vector6<f64>, i: usize| rotation * Vector3::new(v[i], v[i + 1], v[i + 2]);
        PadMotion {
            origin: rigid.origin + part(&self.deflection, 0),
            rotation: UnitQuaternion::new(part(&self.deflection, 3)) * rigid.rotation,
            linear: rigid.linear + part(&self.rate, 0),
            angular: rigid.angular + part(&self.rate, 3),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use tangent_mechanics::Pose;

    use super::*;
    use crate::PoseConfig;
    use crate::contact::{ContactConfig, FrictionConfig, FrictionModel};
    use crate::surfaces::ShapeConfig;

    const STIFF_N_PER_M: f64 = 6e4;
    const SOFT_N_PER_M: f64 = 1e3;

    /// A soft tool that rests 10 mm deep in a stiff table and then leaves it at 20 mm/s: the forces
    /// along the normal, N, in steps of a millisecond.
    fn leaves() -> Vec<f64> {
        let surface = Surface::new(&ShapeConfig::Plane {}, &PoseConfig::default()).unwrap();
        let contact = ContactConfig {
            friction: FrictionConfig {
                model: FrictionModel::None,
                ..FrictionConfig::default()
            },
            ..ContactConfig::default()
        };
        let mut pad = Pad::ball(0.008, &contact, STIFF_N_PER_M);
        let mut compliance = Compliance::new(&ComplianceConfig {
            stiffness_n_per_m: [9.0 * SOFT_N_PER_M, 9.0 * SOFT_N_PER_M, SOFT_N_PER_M],
            ..ComplianceConfig::default()
        });
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
        let mut force_at = |height_m: f64, speed_m_per_s: f64| {
            let pose = Pose::new(Vector3::new(0.0, 0.0, height_m), down);
            let twist = Vector6::new(0.0, 0.0, speed_m_per_s, 0.0, 0.0, 0.0);
            let motion = PadMotion::moving(&pose, &twist);
            compliance.step(&mut pad, &surface, &motion, 1e-3).0.force.z
        };
        let rests = (0..1000).map(|_| force_at(-0.01, 0.0)).last();
        let leaves = (0..600).map(|k| force_at(-0.01 + 2e-5 * f64::from(k), 0.02));
        rests.into_iter().chain(leaves).collect()
    }

    #[test]
    fn a_soft_tool_that_leaves_lets_go_and_does_not_snap_back() {
        let forces = leaves();
        // Two springs in series.
        let begins_n = 0.01 * STIFF_N_PER_M * SOFT_N_PER_M / (STIFF_N_PER_M + SOFT_N_PER_M);
        assert!((forces[0] - begins_n).abs() < 0.01, "{}", forces[0]);
        // After the jump of the speed.
        for pair in forces[20..].windows(2) {
            assert!(pair[1] < pair[0] + 1e-3, "{pair:?}");
        }
        assert_eq!(forces.last(), Some(&0.0));
    }
}
