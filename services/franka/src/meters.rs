//! What the loop measures; read by the health reporter.

use std::time::{Duration, Instant};

use tangent_runtime::{Age, Counter, Gauge, HealthReporter, Histogram, Rate};

use crate::bridge::Bridge;

pub(crate) struct Meters {
    states: Rate,
    packet: Age,
    packet_to_command: Histogram,
    command_latency: Histogram,
    missed: Counter,
    lost: Counter,
    late: Gauge,
    refused: Gauge,
    refused_others: Gauge,
    limited: Gauge,
    success: Gauge,
    reflexes: Gauge,
    violations: Gauge,
    recoveries: Gauge,
    pub reconnects: Gauge,
}

impl Meters {
    pub fn new(health: &HealthReporter) -> Self {
        Self {
            states: health.rate("arm_state"),
            packet: health.age("robot_packet"),
            packet_to_command: health.histogram("packet_to_command"),
            command_latency: health.histogram("command_latency"),
            missed: health.missed_cycles(),
            lost: health.lost(),
            late: health.gauge("late_states"),
            refused: health.gauge("commands_refused"),
            refused_others: health.gauge("commands_refused_other_source"),
            limited: health.gauge("commands_limited"),
            success: health.gauge("control_command_success_rate"),
            reflexes: health.gauge("reflexes"),
            violations: health.gauge("communication_constraint_violations"),
            recoveries: health.gauge("recoveries"),
            reconnects: health.gauge("reconnects"),
        }
    }

    /// Of one cycle. `late`: states passed over since the start because a newer one was there.
    pub fn take(&self, bridge: &Bridge, arrival: Instant, took: Duration, late: u64) {
        let (gate, session) = (bridge.gate(), bridge.session());
        self.states.tick();
        self.packet.mark_at(arrival);
        self.packet_to_command.record(took);
        if let Some(latency_s) = bridge.latency_s() {
            self.command_latency.record_s(latency_s);
        }
        self.missed.set(gate.admission.missed());
        self.lost.set(bridge.packets_lost());
        self.late.set(late as f64);
        self.refused.set(gate.admission.refused() as f64);
        self.refused_others.set(bridge.lease().refused() as f64);
        self.limited.set(gate.limited() as f64);
        self.success
            .set(bridge.robot().control_command_success_rate);
        self.reflexes.set(session.reflexes() as f64);
        self.violations.set(session.constraint_violations() as f64);
        self.recoveries.set(session.recoveries() as f64);
    }
}
