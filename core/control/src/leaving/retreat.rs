//! Whether an obstacle opposes a retraction.
//!
//! Called by `leave_watch` each cycle.

use nalgebra::Vector3;

use crate::contact::alignment::tangential;
use crate::leaving::config::LeaveConfig;
use crate::leaving::moves_in::{MovesIn, STILL_IN_M, TURN_S};
use crate::limits::Limits;

/// Distance from which the minimum force of a retraction counts if the zero cannot be trusted, m:
/// over the first part the contact may release a force that the zero hides.
const LET_GO_M: f64 = 0.001;

/// Measurements of one cycle of a retraction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Met {
    /// Direction of the retraction (unit), and the position of the tool, m; axes of the force.
    pub along: Vector3<f64>,
    pub position: Vector3<f64>,
    /// Force on the tool, base axes, N.
    pub force: Vector3<f64>,
    /// Torque on the tool, Nm.
    pub torque_nm: f64,
    /// Whether the untared reading is beyond its limit.
    pub hidden: bool,
    /// Whether the zero can be trusted: neither lost nor taken in contact.
    pub zeroed: bool,
    /// Time since the last cycle, s.
    pub dt_s: f64,
}

/// Loads at which a retraction stops, regardless of the load at its start.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ceiling {
    /// Force, N.
    pub force_n: f64,
    /// Torque, Nm.
    pub torque_nm: f64,
}

impl Ceiling {
    /// From the cell's limits.
    pub fn of(limits: &Limits) -> Self {
        Self {
            force_n: limits.force_max_n,
            torque_nm: limits.torque_max_nm,
        }
    }
}

/// Loads against which a retraction is judged.
#[derive(Clone, Copy, Debug)]
pub(super) struct Retreat {
    /// Position at the start, m, and the lowest place along the retraction relative to it (0 or
    /// negative), m.
    from: Vector3<f64>,
    lowest_m: f64,
    /// Direction of the force at the start, across the retraction.
    out: Vector3<f64>,
    /// Largest force in that direction while the tool slid on, N.
    aside_n: f64,
    /// Motion against `out`.
    against_out: MovesIn,
    /// Force and torque at the start: N, Nm.
    first: (f64, f64),
    /// Minimum force and torque since: N, Nm.
    least: (f64, f64),
    /// Force at that minimum, base axes, N.
    least_force: Vector3<f64>,
    hidden: bool,
    pub zeroed: bool,
}

impl Retreat {
    pub fn begin(met: &Met) -> Self {
        let across = tangential(&met.force, &met.along);
        let load = (met.force.dot(&met.along).abs(), met.torque_nm);
        Self {
            from: met.position,
            lowest_m: 0.0,
            out: across.try_normalize(1e-9).unwrap_or_default(),
            aside_n: across.norm(),
            against_out: MovesIn::default(),
            first: load,
            least: load,
            least_force: met.force,
            hidden: met.hidden,
            zeroed: met.zeroed,
        }
    }

    /// Force that counts as none, base axes, N: zero, or the least one felt if the zero cannot be
    /// trusted.
    pub fn none(&self) -> Vector3<f64> {
        if self.zeroed {
            Vector3::zeros()
        } else {
            self.least_force
        }
    }

    /// Processes one cycle; returns whether an obstacle opposes the motion.
    pub fn is_opposed(&mut self, config: &LeaveConfig, ceiling: &Ceiling, met: &Met) -> bool {
        let torque_nm = met.torque_nm;
        let gone = met.position - self.from;
        let gone_m = gone.dot(&met.along);
        self.lowest_m = self.lowest_m.min(gone_m);
        // A tool that has slid into something still moves on, across the retraction: what stands
        // there pushes harder until the tool is at rest. That part of the force is no obstacle.
        let slides_on = self.against_out.step(gone.dot(&self.out), met.dt_s);
        let aside_n = met.force.dot(&self.out).max(0.0);
        if slides_on {
            self.aside_n = self.aside_n.max(aside_n);
        }
        let force_n = (met.force - self.out * aside_n.min(self.aside_n)).norm();
        // Once the tool moves out again, the contact releases: a force that increases from there
        // comes from an obstacle.
        let moves_in = self.against_out.elapsed_s <= TURN_S
            && self.lowest_m < -STILL_IN_M
            && gone_m <= self.lowest_m + STILL_IN_M;
        if moves_in {
            self.first.0 = self.first.0.max(force_n);
            self.least.0 = force_n;
        }
        if moves_in || slides_on {
            self.first.1 = self.first.1.max(torque_nm);
            self.least.1 = torque_nm;
        }
        // The zero is not trusted: it is only assumed that the first millimetre releases the
        // contact.
        if force_n <= self.least.0 || !self.zeroed && gone_m < LET_GO_M {
            self.least_force = met.force;
        }
        if self.zeroed || gone_m >= LET_GO_M {
            self.least = (self.least.0.min(force_n), self.least.1.min(torque_nm));
        } else {
            self.least = (force_n, torque_nm);
        }
        let (opposed_n, opposed_nm) = (config.opposed_n, config.opposed_nm);
        force_n > self.least.0 + opposed_n
            || torque_nm > self.least.1 + opposed_nm
            || force_n > ceiling.force_n.max(self.first.0 + opposed_n)
            || torque_nm > ceiling.torque_nm.max(self.first.1 + opposed_nm)
            || (met.hidden && !self.hidden)
    }
}
