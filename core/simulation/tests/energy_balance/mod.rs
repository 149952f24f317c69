//! Energy of a run of `unified_force_impedance`: what is stored, what came in, what was taken out.

// Each test file takes what it needs.
#![allow(dead_code)]

use tangent_simulation::TactileCycle;

/// No noise on the positions, so that plant and law see the same ones, and no error of the payload,
/// so that gravity is cancelled.
pub const EXACT: [&str; 3] = [
    "plant.arm.encoder_resolution_rad=0.0",
    "plant.tool.payload_error.mass_kg=0.0",
    "plant.tool.payload_error.com_in_sensor_m=[0.0,0.0,0.0]",
];

/// Joules inside arm and tanks that did not come in through a port, and what was taken out, since
/// the start: all of it is zero where nothing is made from nothing.
#[derive(Debug, Default)]
pub struct Balance {
    start_j: Option<f64>,
    pub worst_j: f64,
    pub at_a_stop: bool,
    /// Through the world's port until the period before, and all that went through it either way.
    environment_j: f64,
    pub turnover_j: f64,
}

impl Balance {
    pub fn see(&mut self, c: &TactileCycle<'_>) {
        let (arm, books, ports) = (c.plant.arm(), c.output.tanks, c.plant.energy());
        let model = arm.model();
        let limits = model.limits();
        // The plant's end stops take a joint's speed without asking the others: what happens there
        // is not mechanics.
        self.at_a_stop |= (0..7).any(|i| {
            arm.q[i] - limits.position_lower[i] < 0.01 || limits.position_upper[i] - arm.q[i] < 0.01
        });
        let inside = model.kinetic_energy(&arm.q, &arm.qd)
            + model.potential_energy(&arm.q)
            + books.motion_j
            + books.force_j;
        // Gravity's compensation lifts the arm: what it did is in the motors' work and not in the
        // law's.
        let came = (ports.motors_j - books.work_j) + ports.environment_j + books.short_j;
        let went = ports.friction_j + books.dissipated_j;
        let sum = inside - came + went;
        self.turnover_j += (ports.environment_j - self.environment_j).abs();
        self.environment_j = ports.environment_j;
        let start = *self.start_j.get_or_insert(sum);
        if !self.at_a_stop {
            self.worst_j = self.worst_j.max((sum - start).abs());
        }
    }
}
