//! Figures that the loop measures, for the health reporter.

use std::time::{Duration, Instant};

use tangent_runtime::health::HealthReporter;
use tangent_runtime::meter::Gauge;
use tangent_runtime::robot_loop::{CycleFigures, LoopMeters};

use crate::bridge::Bridge;

/// Figures that only this loop measures, besides those of every robot loop.
pub(crate) struct Meters {
    common: LoopMeters,
    success: Gauge,
    reflexes: Gauge,
    violations: Gauge,
    recoveries: Gauge,
}

impl Meters {
    pub fn new(health: &HealthReporter) -> Self {
        Self {
            common: LoopMeters::new(health),
            success: health.gauge("control_command_success_rate"),
            reflexes: health.gauge("reflexes"),
            violations: health.gauge("communication_constraint_violations"),
            recoveries: health.gauge("recoveries"),
        }
    }

    /// Takes the figures of one cycle. `late` is the number of states since the start that were
    /// skipped because a newer one had arrived.
    pub fn take(&self, bridge: &Bridge, arrival: Instant, took: Duration, late: u64) {
        let (gate, session) = (bridge.gate(), bridge.session());
        let figures = CycleFigures {
            arrival,
            took,
            latency_s: bridge.latency_s(),
            packets_lost: bridge.packets_lost(),
            late,
            limited: gate.limited(),
        };
        self.common.take(&figures, &gate.admission, bridge.lease());
        self.success
            .set(bridge.robot().control_command_success_rate);
        self.reflexes.set(session.reflexes() as f64);
        self.violations.set(session.constraint_violations() as f64);
        self.recoveries.set(session.recoveries() as f64);
    }
}
