//! Figures that a robot loop measures, for the health reporter.

use std::time::{Duration, Instant};

use tangent_actuation::admission::Admission;
use tangent_actuation::lease::Lease;

use crate::health::HealthReporter;
use crate::meter::{Age, Counter, Gauge, Histogram, Rate};

/// Figures of one cycle.
#[derive(Clone, Copy, Debug)]
pub struct CycleFigures {
    /// Time of arrival of the robot's packet.
    pub arrival: Instant,
    /// Time from that arrival until the answer was sent.
    pub took: Duration,
    /// Time from a command to its use by the robot, s; `None` if this cycle did not show it.
    pub latency_s: Option<f64>,
    /// Robot packets lost since the start.
    pub packets_lost: u64,
    /// Robot packets since the start that were too late to be answered.
    pub late: u64,
    /// Cycles since the start in which a limit changed what was commanded.
    pub limited: u64,
}

/// Meters that every robot loop has.
pub struct LoopMeters {
    states: Rate,
    packet: Age,
    packet_to_command: Histogram,
    command_latency: Histogram,
    late: Gauge,
    missed: Counter,
    lost: Counter,
    refused: Gauge,
    refused_others: Gauge,
    limited: Gauge,
}

impl LoopMeters {
    /// Registers the meters with `health`.
    pub fn new(health: &HealthReporter) -> Self {
        Self {
            states: health.rate("arm_state"),
            packet: health.age("robot_packet"),
            packet_to_command: health.histogram("packet_to_command"),
            command_latency: health.histogram("command_latency"),
            late: health.gauge("late_states"),
            missed: health.missed_cycles(),
            lost: health.lost(),
            refused: health.gauge("commands_refused"),
            refused_others: health.gauge("commands_refused_other_source"),
            limited: health.gauge("commands_limited"),
        }
    }

    /// Adds the figures of one cycle. Takes no lock and allocates nothing.
    pub fn take<T: Copy>(&self, figures: &CycleFigures, admission: &Admission<T>, lease: &Lease) {
        self.states.tick();
        self.packet.mark_at(figures.arrival);
        self.packet_to_command.record(figures.took);
        if let Some(latency_s) = figures.latency_s {
            self.command_latency.record_s(latency_s);
        }
        self.late.set(figures.late as f64);
        self.missed.set(admission.missed());
        self.lost.set(figures.packets_lost);
        self.refused.set(admission.refused() as f64);
        self.refused_others.set(lease.refused() as f64);
        self.limited.set(figures.limited as f64);
    }
}
