//! Energy balance of a run of `unified_force_impedance`: stored, supplied and removed energy.

// Each test file uses only a part of this module.
#![allow(dead_code)]

use tangent_simulation::VisuoTactileCycle;

/// No noise on the positions, so that plant and law use equal ones, and no payload error, so that
/// gravity is compensated exactly.
pub const EXACT: [&str; 3] = [
    "plant.arm.encoder_resolution_rad=0.0",
    "plant.tool.payload_error.mass_kg=0.0",
    "plant.tool.payload_error.com_in_sensor_m=[0.0,0.0,0.0]",
];

/// Energy inside arm and tanks, minus the energy that entered through a port, plus the energy
/// removed, J. Its change since the start is zero if no energy is created.
#[derive(Debug, Default)]
pub struct Balance {
    start_j: Option<f64>,
    pub worst_j: f64,
    pub at_a_stop: bool,
    /// Energy through the port to the environment until the previous period, and the sum of its
    /// magnitudes.
    environment_j: f64,
    pub turnover_j: f64,
}

impl Balance {
    pub fn see(&mut self, c: &VisuoTactileCycle<'_>) {
        let (arm, books, ports) = (c.plant.arm(), c.output.tanks, c.plant.energy());
        let model = arm.model();
        let limits = model.limits();
        // The plant's end stops remove a joint's speed independently of the other joints, which is
        // not consistent mechanics.
        self.at_a_stop |= (0..7).any(|i| {
            arm.q[i] - limits.position_lower[i] < 0.01 || limits.position_upper[i] - arm.q[i] < 0.01
        });
        let inside = model.kinetic_energy(&arm.q, &arm.qd)
            + model.potential_energy(&arm.q)
            + books.motion_j
            + books.force_j;
        // Gravity compensation lifts the arm: its work is included in that of the motors but not in
        // that of the law.
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
