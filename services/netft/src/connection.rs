//! One connection to a box, and what is said of its newest record.

use std::time::Duration;

use tangent_mechanics::Tool;
use tangent_schemas::Text;
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::WrenchStatus;
use tangent_sensing::{ConditionedWrench, TareConfig, Validity};

use crate::clock::ClockRecovery;
use crate::codec::{Record, Status};
use crate::stream::Stream;

/// One connection: what lasts from the box's answer to its loss.
pub(crate) struct Connection {
    pub(crate) scales: [f64; 6],
    pub(crate) stream: Stream,
    pub(crate) clock: ClockRecovery,
    /// Counts of the box's clock between two publications.
    pub(crate) interval: i64,
    pub(crate) published: i64,
    /// The same for raw records; `None`: every one is published.
    pub(crate) raw_interval: Option<i64>,
    pub(crate) raw_published: i64,
    pub(crate) newest: Option<Newest>,
    pub(crate) restarted: bool,
    pub(crate) rate_hz: f64,
    /// What the health message says of the wrench.
    pub(crate) told: Option<Validity>,
    /// How the zero drifts, and what the sensor is rated for.
    pub(crate) tare: TareConfig,
}

impl Connection {
    /// The raw record of this sequence is due, and with that taken as published.
    pub(crate) fn raw_is_due(&mut self, sequence: i64) -> bool {
        let Some(interval) = self.raw_interval else {
            return true;
        };
        // A step back is a restart, or a late record among published ones.
        let since = sequence.saturating_sub(self.raw_published);
        if (0..interval).contains(&since) {
            return false;
        }
        self.raw_published = sequence;
        true
    }

    /// Records per second by this host's clock, Hz.
    pub(crate) fn rate_measured_hz(&self) -> f64 {
        self.clock.rate_hz() / self.stream.step() as f64
    }

    /// What is to be said of a wrench.
    pub(crate) fn status(
        &self,
        newest: &Newest,
        validity: Validity,
        stamp_ns: i64,
    ) -> WrenchStatus {
        let counts = self.stream.counts();
        WrenchStatus {
            header: Header::in_frame::<Tool>(stamp_ns),
            validity: validity as u8,
            status: newest.record.status.0,
            status_text: status_text(newest.record.status),
            rdt_sequence: newest.record.rdt_sequence,
            ft_sequence: newest.record.ft_sequence,
            records: counts.records,
            records_lost: counts.lost,
            records_out_of_order: counts.out_of_order,
            restarts: counts.restarts,
            reconnects: counts.reconnects,
            rate_hz: self.rate_measured_hz(),
            bias_age_s: newest.wrench.bias_age_s.unwrap_or(-1.0),
            bias: (&newest.wrench.bias).into(),
            filter_delay_s: newest.wrench.delay_s,
            clock_residual_s: self.clock.residual_s(),
            records_implausible: newest.implausible,
            stuck_axes: newest.stuck_axes,
            untared: (&newest.wrench.untared).into(),
            reference: newest
                .wrench
                .reference
                .map(|(bias, _)| (&bias).into())
                .unwrap_or_default(),
            reference_age_s: newest.wrench.reference.map_or(-1.0, |(_, age_s)| age_s),
            rated_share: self
                .tare
                .rated_share(&newest.wrench.untared)
                .unwrap_or(-1.0),
            bias_bound_n: newest
                .wrench
                .bias_age_s
                .map_or(-1.0, |age_s| self.tare.drift_bound_n(age_s)),
            bias_said_clear: newest.wrench.said_clear,
        }
    }
}

/// The newest record, conditioned.
#[derive(Clone, Copy)]
pub(crate) struct Newest {
    pub(crate) sequence: i64,
    pub(crate) record: Record,
    pub(crate) stamp_ns: i64,
    pub(crate) wrench: ConditionedWrench,
    pub(crate) arrival: Duration,
    /// Records left out so far, and axes that stand still, as the watch says.
    pub(crate) implausible: u64,
    pub(crate) stuck_axes: u8,
}

/// The names of the bits that are set, as many as fit.
fn status_text(status: Status) -> Text {
    let mut text = Text::new();
    for name in status.names() {
        let separator = if text.is_empty() { "" } else { ", " };
        if text.try_push_str(separator).is_err() || text.try_push_str(name).is_err() {
            break;
        }
    }
    text
}
