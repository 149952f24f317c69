//! Wrench at the tool, with its status and its age.

use std::time::Instant;

use nalgebra::Vector3;
use tangent_control::UntaredLoad;
use tangent_mechanics::{Tool, Wrench};
use tangent_runtime::Latest;
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::tangent::WrenchStatus;
use tangent_sensing::Validity;

use super::age::ContentAge;

/// Reads the wrench and its status.
pub struct WrenchReader {
    wrench: Latest<WrenchStamped>,
    status: Latest<WrenchStatus>,
    age: ContentAge,
    late_s: f64,
    /// The newest wrench that arrived with its status; its age grows until the next such pair.
    paired: Option<Paired>,
}

#[derive(Clone, Copy, Debug)]
struct Paired {
    wrench: Wrench<Tool>,
    received: Instant,
    late_s: f64,
    delay_s: f64,
}

/// The wrench at the present cycle.
#[derive(Clone, Copy, Debug)]
pub struct WrenchNow {
    /// Wrench in tool axes.
    pub wrench: Wrench<Tool>,
    /// Whether the wrench can be used.
    pub validity: Validity,
    /// Age of the wrench, s.
    pub age_s: f64,
    /// Delay of the wrench's filter, s.
    pub delay_s: f64,
    /// Age of the tare, s; `None` without one.
    pub bias_age_s: Option<f64>,
    /// Bound on the error of the zero, by its age, N; `None` if it is not known.
    pub zero_bound_n: Option<f64>,
    /// Reading before the zero is subtracted; `None` if the service does not provide it.
    pub untared: Option<UntaredLoad>,
}

impl WrenchNow {
    /// Value before the first reading.
    pub fn missing() -> Self {
        Self {
            wrench: Wrench::zero(),
            validity: Validity::Missing,
            age_s: f64::INFINITY,
            delay_s: 0.0,
            bias_age_s: None,
            zero_bound_n: None,
            untared: None,
        }
    }
}

impl WrenchReader {
    /// Reader of these two topics.
    pub fn new(wrench: Latest<WrenchStamped>, status: Latest<WrenchStatus>) -> Self {
        Self {
            wrench,
            status,
            age: ContentAge::default(),
            late_s: 0.0,
            paired: None,
        }
    }

    /// While held, no other publisher of the wrench replaces the present one.
    pub fn hold(&self, held: bool) {
        self.wrench.hold(held);
        self.status.hold(held);
    }

    /// A wrench is used only with the status of the same stamp, which is published just before it.
    /// If that status was lost, the previous wrench is used at its age. An invalid status takes
    /// effect at once.
    pub fn read(&mut self) -> WrenchNow {
        self.status.refresh();
        if let Some(new) = self.wrench.take_new() {
            let stamp = new.message.header.stamp.to_ns();
            self.late_s = self.age.take(new.publisher, stamp, new.received);
        }
        let Some((wrench, status)) = self.wrench.get().zip(self.status.get()) else {
            return WrenchNow::missing();
        };
        let validity = Validity::from(status.message.validity);
        let said = wrench.message.header.stamp.to_ns();
        let about = status.message.header.stamp.to_ns();
        let newest = Paired {
            wrench: Wrench::from(&wrench.message.wrench),
            received: wrench.received,
            late_s: self.late_s,
            delay_s: status.message.filter_delay_s.clamp(0.0, 1.0),
        };
        if about >= said || !validity.is_valid() {
            self.paired = Some(newest);
        }
        let bias_age_s = (status.message.bias_age_s >= 0.0)
            .then(|| status.message.bias_age_s + status.age().as_secs_f64());
        let used = self.paired.unwrap_or(newest);
        WrenchNow {
            wrench: used.wrench,
            age_s: used.late_s + used.received.elapsed().as_secs_f64(),
            delay_s: used.delay_s,
            validity: if self.paired.is_some() {
                validity
            } else {
                Validity::Stale
            },
            bias_age_s,
            zero_bound_n: (status.message.bias_bound_n >= 0.0)
                .then_some(status.message.bias_bound_n),
            untared: Some(untared_load(&status.message)),
        }
    }
}

/// Load of the reading before any zero is subtracted.
fn untared_load(status: &WrenchStatus) -> UntaredLoad {
    let force = |w: &tangent_schemas::standard::Wrench| Vector3::from(&w.force);
    let beyond = (force(&status.untared) - force(&status.reference)).norm();
    UntaredLoad {
        beyond_reference_n: (status.reference_age_s >= 0.0).then_some(beyond),
        rated_share: (status.rated_share >= 0.0).then_some(status.rated_share),
    }
}
