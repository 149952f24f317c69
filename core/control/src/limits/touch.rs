//! What a tool and its sensor do in one cycle, as the guard of the sensor's response takes it.

use nalgebra::{Vector3, Vector6};

use crate::limits::answer::DepthRule;
use crate::limits::reference_probe::ProbeRule;
use crate::phase_machine::Phase;

/// A force below this is no contact, N: the loss of contact is handled elsewhere.
const PRESSED_N: f64 = 0.2;

/// What the tool does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Doing {
    /// In free space, or not meant to touch.
    Free,
    /// Pressing on the surface.
    Pressing,
    /// Moving off the surface.
    Leaving,
}

impl Doing {
    /// What the tool does in a phase.
    pub fn of(phase: Phase) -> Self {
        match phase {
            Phase::Retract => Self::Leaving,
            pressing if pressing.is_pressing() => Self::Pressing,
            _ => Self::Free,
        }
    }
}

/// Measurements of one cycle of the tool and its sensor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Touch {
    pub doing: Doing,
    /// Position of the tool's origin, m, in axes in which the surface is at rest.
    pub position: Vector3<f64>,
    /// Normal in the same axes, out of the material.
    pub normal: Vector3<f64>,
    /// Wrench as read, tool axes, N and Nm.
    pub wrench: Vector6<f64>,
    /// Pressing force of that wrench, N.
    pub force_n: f64,
    /// Reference of the pressing force, N.
    pub reference_n: f64,
    /// Measured stiffness of the contact, N/m; `None` if not measured.
    pub stiffness_n_per_m: Option<f64>,
    /// Whether the law gives way to a load along the surface.
    pub gives_way: bool,
    /// Whether the arm's base is at rest.
    pub rests: bool,
    /// Whether the reading arrived since the last cycle: a repeated reading carries no new
    /// information.
    pub fresh: bool,
    /// How the mean of the reading is compared with the depth; `None`: not at all.
    pub depth: Option<DepthRule>,
    /// How the law lets its reference be lowered; `None`: not at all.
    pub probe: Option<ProbeRule>,
    /// Period, s.
    pub dt_s: f64,
}

impl Touch {
    /// A tool that presses with `force_n` along z, asked for 3 N, in a cycle of 2 ms.
    #[cfg(test)]
    pub fn pressing(force_n: f64) -> Self {
        Self {
            doing: Doing::Pressing,
            position: Vector3::zeros(),
            normal: Vector3::z(),
            wrench: Vector6::new(0.0, 0.0, -force_n, 0.0, 0.0, 0.0),
            force_n,
            reference_n: 3.0,
            stiffness_n_per_m: None,
            gives_way: false,
            rests: true,
            fresh: true,
            depth: None,
            probe: None,
            dt_s: 0.002,
        }
    }

    /// Whether the tool is meant to press, and the measured force is at least this share of the
    /// reference.
    pub fn presses(&self, share: f64) -> bool {
        self.doing == Doing::Pressing
            && self.rests
            && self.force_n >= PRESSED_N.max(share * self.reference_n)
    }
}
