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
    /// friction are far too stiff for an explicit step of a millisecond.
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
        let mut right = wrench - self.stiffness.component_mul(&self.deflection);
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
