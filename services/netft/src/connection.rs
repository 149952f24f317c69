//! One connection to a sensor box, and the status of its newest record.

use std::time::Duration;

use tangent_mechanics::Tool;
use tangent_schemas::Text;
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::WrenchStatus;
use tangent_sensing::{ConditionedWrench, TareConfig, Validity};
use tangent_tare::tell_zero;

use crate::clock::ClockRecovery;
use crate::codec::{Record, Status};
use crate::stream::Stream;

/// One connection: from the box's first answer until it is lost.
pub(crate) struct Connection {
    pub(crate) scales: [f64; 6],
    pub(crate) stream: Stream,
    pub(crate) clock: ClockRecovery,
    /// Interval between two publications of the wrench, counts of the box's clock.
    pub(crate) interval: i64,
    pub(crate) published: i64,
    /// Interval between two publications of raw records, counts of the box's clock; `None`: every
    /// one is published.
    pub(crate) raw_interval: Option<i64>,
    pub(crate) raw_published: i64,
    pub(crate) newest: Option<Newest>,
    pub(crate) restarted: bool,
    pub(crate) rate_hz: f64,
    /// Validity of the wrench that the health message reports.
    pub(crate) told: Option<Validity>,
    /// Drift of the zero and rating of the sensor.
    pub(crate) tare: TareConfig,
}

impl Connection {
    /// Whether the raw record of this sequence is due; if so, it counts as published.
    pub(crate) fn raw_is_due(&mut self, sequence: i64) -> bool {
        let Some(interval) = self.raw_interval else {
            return true;
        };
        // A step back is a restart, or a late record among those published.
        let since = sequence.saturating_sub(self.raw_published);
        if (0..interval).contains(&since) {
            return false;
        }
        self.raw_published = sequence;
        true
    }

    /// Records per second, measured with this host's clock, Hz.
    pub(crate) fn rate_measured_hz(&self) -> f64 {
        self.clock.rate_hz() / self.stream.step() as f64
    }

    /// Status message for a wrench.
    pub(crate) fn status(
        &self,
        newest: &Newest,
        validity: Validity,
        stamp_ns: i64,
    ) -> WrenchStatus {
        let counts = self.stream.counts();
        let mut status = WrenchStatus {
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
            filter_delay_s: newest.wrench.delay_s,
            clock_residual_s: self.clock.residual_s(),
            records_implausible: newest.implausible,
            stuck_axes: newest.stuck_axes,
            ..WrenchStatus::default()
        };
        tell_zero(&newest.wrench, &self.tare, &mut status);
        status
    }
}

/// The newest record, with its conditioned wrench.
#[derive(Clone, Copy)]
pub(crate) struct Newest {
    pub(crate) sequence: i64,
    pub(crate) record: Record,
    pub(crate) stamp_ns: i64,
    pub(crate) wrench: ConditionedWrench,
    pub(crate) arrival: Duration,
    /// Number of records left out so far, and axes whose value stands still, according to the
    /// sensor watch.
    pub(crate) implausible: u64,
    pub(crate) stuck_axes: u8,
}

/// Names of the bits that are set, as many as fit.
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
