//! The force on the tool: of the sensor, of a client in its place, and of a simulated hand.

use nalgebra::Vector3;

use super::Controller;
use crate::config::Flavour;

impl Controller {
    /// Pushes the tool from now on, N and Nm at the tool centre point, base axes. It acts only on
    /// what the controller measures, as a hand on a real tool does through its sensor. Zero ends
    /// it.
    pub fn push(&mut self, wrench: [f64; 6]) {
        self.push = wrench;
    }

    /// Takes the measured force on the tool centre point (e-Series: on the flange), base axes.
    pub(super) fn set_force(&mut self, measured: &[f64; 6]) {
        let mut force = if self.external_force_enabled {
            self.external_force()
        } else {
            *measured
        };
        let mut push = self.push;
        if self.config.flavour == Flavour::ESeries {
            push = moved(&push, &self.tcp_from_flange_in_base());
        }
        for (x, push) in force.iter_mut().zip(push) {
            *x += push;
        }
        self.tcp_force = force;
    }

    /// The force on the tool centre point itself, base axes.
    pub(super) fn tcp_force_at_tcp(&self) -> [f64; 6] {
        match self.config.flavour {
            Flavour::Cb3 => self.tcp_force,
            Flavour::ESeries => moved(&self.tcp_force, &-self.tcp_from_flange_in_base()),
        }
    }

    /// The RTDE input `external_force_torque`, which is on the flange and in its axes.
    fn external_force(&self) -> [f64; 6] {
        let rotation = self.base_from_flange();
        let [x, y, z, a, b, c] = self.registers.external_force;
        let force = rotation * Vector3::new(x, y, z);
        let torque = rotation * Vector3::new(a, b, c);
        let at_flange = [force.x, force.y, force.z, torque.x, torque.y, torque.z];
        match self.config.flavour {
            Flavour::ESeries => at_flange,
            Flavour::Cb3 => moved(&at_flange, &-self.tcp_from_flange_in_base()),
        }
    }

    /// From the flange to the tool centre point, base axes, m.
    fn tcp_from_flange_in_base(&self) -> Vector3<f64> {
        let [x, y, z, ..] = self.kinematics.tcp();
        self.base_from_flange() * Vector3::new(x, y, z)
    }
}

/// The wrench about a point that lies `back` before the one where it is given: torques gain
/// `back × force`.
fn moved(wrench: &[f64; 6], back: &Vector3<f64>) -> [f64; 6] {
    let [x, y, z, a, b, c] = *wrench;
    let torque = Vector3::new(a, b, c) + back.cross(&Vector3::new(x, y, z));
    [x, y, z, torque.x, torque.y, torque.z]
}
