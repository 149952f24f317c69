//! Figures in the service's health message.

use tangent_runtime::{Age, Counter, Gauge, HealthReporter, Histogram, Rate};

use crate::stream::StreamCounts;

/// Written by the receiving thread, read by the health reporter.
pub(crate) struct Meters {
    pub(crate) records: Rate,
    pub(crate) published: Rate,
    pub(crate) record_age: Age,
    lost: Counter,
    pub(crate) arrival_to_publish: Histogram,
    out_of_order: Gauge,
    malformed: Gauge,
    restarts: Gauge,
    reconnects: Gauge,
    rate_hz: Gauge,
    clock_residual_us: Gauge,
    bias_age_s: Gauge,
    implausible: Gauge,
    pub(crate) socket_buffer_records: Gauge,
}

impl Meters {
    pub(crate) fn new(health: &HealthReporter) -> Self {
        Self {
            records: health.rate("wrench/raw"),
            published: health.rate("wrench/tool"),
            record_age: health.age("record"),
            lost: health.lost(),
            arrival_to_publish: health.histogram("arrival_to_publish"),
            out_of_order: health.gauge("records_out_of_order"),
            malformed: health.gauge("datagrams_malformed"),
            restarts: health.gauge("restarts"),
            reconnects: health.gauge("reconnects"),
            rate_hz: health.gauge("sensor_rate_hz"),
            clock_residual_us: health.gauge("clock_residual_us"),
            bias_age_s: health.gauge("bias_age_s"),
            implausible: health.gauge("records_implausible"),
            socket_buffer_records: health.gauge("socket_buffer_records"),
        }
    }

    /// Totals and the latest figures.
    pub(crate) fn tell(
        &self,
        counts: &StreamCounts,
        rate_hz: f64,
        clock_residual_s: f64,
        bias_age_s: Option<f64>,
        implausible: u64,
    ) {
        self.lost.set(counts.lost);
        self.out_of_order.set(counts.out_of_order as f64);
        self.malformed.set(counts.malformed as f64);
        self.restarts.set(counts.restarts as f64);
        self.reconnects.set(counts.reconnects as f64);
        self.rate_hz.set(rate_hz);
        self.clock_residual_us.set(clock_residual_s * 1e6);
        self.bias_age_s.set(bias_age_s.unwrap_or(-1.0));
        self.implausible.set(implausible as f64);
    }
}
