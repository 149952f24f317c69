//! The estimators of a live cell: messages of the estimators and the controller, received for a
//! while.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use serde::Serialize;
use tangent_recorder::RecordedMessage;
use tangent_runtime::{Bus, BusError, RawMessage, RawSubscription};
use tangent_schemas::tangent::NormalEstimate;
use tangent_schemas::topics;
use tangent_simulation::metrics::angle_deg;

use crate::comparison::{EstimatorFigures, estimators};
use crate::run::Run;
use crate::task_run::TaskRun;

/// Time to receive messages, long enough to measure a rate.
const LISTEN: Duration = Duration::from_millis(1500);
/// Time to collect liveliness tokens.
const TOKENS: Duration = Duration::from_millis(500);
/// Timeout for the controller's first message.
const FIRST_WORD: Duration = Duration::from_secs(3);

/// Estimators that publish normals in a cell.
#[derive(Clone, Debug, Serialize)]
pub struct EstimatorList {
    /// The estimator in use, if there is one.
    pub active: Option<String>,
    /// Every estimator, by name.
    pub estimators: Vec<ListedEstimator>,
}

/// One estimator of a live cell.
#[derive(Clone, Debug, Serialize)]
pub struct ListedEstimator {
    /// Name of the estimator, as in `estimate/NAME/normal`.
    pub name: String,
    /// Whether it is in use.
    pub active: bool,
    /// Processes that declare that they publish it: `HOST-PID`.
    pub instances: Vec<String>,
    /// Whether its newest estimate is valid.
    pub valid: bool,
    /// Reason why it is not valid.
    pub reason: String,
    /// Rate of estimates, Hz.
    pub rate_hz: Option<f64>,
    /// Mean age at use, as the controller reports in each of its cycles, ms.
    pub age_ms: Option<f64>,
    /// Angle between its normal and the one in use, degrees.
    pub from_active_deg: Option<f64>,
    /// Standard deviation of its normal, degrees.
    pub std_deg: f64,
    /// Friction coefficient that it estimates.
    pub friction: Option<f64>,
    /// Time that its last step took, µs.
    pub update_us: f64,
}

/// Subscribes to a cell for a moment and lists its estimators.
///
/// # Errors
/// The bus refuses.
pub fn list_estimators(bus: &Bus) -> Result<EstimatorList, BusError> {
    let heard = listen(bus, LISTEN)?;
    let mut instances: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (name, instance) in bus.alive_estimators(TOKENS)? {
        instances.entry(name).or_default().push(instance);
    }
    let task = TaskRun::of(&heard);
    let figures = estimators(&heard, &task);
    let active = in_use(&heard);
    let newest = |name: &String| heard.estimates.get(name).and_then(|all| all.last());
    let reference = active.as_ref().and_then(newest).map(normal);
    let mut rows: Vec<ListedEstimator> = figures
        .iter()
        .filter_map(|(name, figures)| {
            let own = instances.remove(name).unwrap_or_default();
            let row = row(newest(name)?, figures, reference, own);
            Some(ListedEstimator {
                active: active.as_ref() == Some(name),
                ..row
            })
        })
        .collect();
    rows.extend(instances.into_iter().map(|(name, own)| silent(name, own)));
    Ok(EstimatorList {
        active,
        estimators: rows,
    })
}

fn row(
    newest: &NormalEstimate,
    figures: &EstimatorFigures,
    reference: Option<Vector3<f64>>,
    instances: Vec<String>,
) -> ListedEstimator {
    let c = &newest.covariance;
    ListedEstimator {
        name: newest.estimator.to_string(),
        active: false,
        instances,
        valid: newest.validity == 0,
        reason: newest.reason.to_string(),
        rate_hz: figures.rate_hz,
        age_ms: figures.age_ms.map(|age| age.mean),
        from_active_deg: reference.map(|reference| angle_deg(&reference, &normal(newest))),
        std_deg: (0.5 * (c[0] + c[4] + c[8])).sqrt().to_degrees(),
        friction: (newest.friction >= 0.0).then_some(newest.friction),
        update_us: newest.update_s * 1e6,
    }
}

/// An estimator whose process is connected but publishes nothing.
fn silent(name: String, instances: Vec<String>) -> ListedEstimator {
    ListedEstimator {
        name,
        active: false,
        instances,
        valid: false,
        reason: "connected, but publishes nothing".to_owned(),
        rate_hz: None,
        age_ms: None,
        from_active_deg: None,
        std_deg: 0.0,
        friction: None,
        update_us: 0.0,
    }
}

fn normal(m: &NormalEstimate) -> Vector3<f64> {
    Vector3::from(&m.normal)
}

/// Name of the estimator in use at the end.
pub fn in_use(heard: &Run) -> Option<String> {
    let name = heard.control.last()?.estimator.to_string();
    (!name.is_empty()).then_some(name)
}

/// Messages of the cell about normals for `time` from the controller's first message on, in the
/// order of arrival.
///
/// # Errors
/// The bus refuses.
pub fn listen(bus: &Bus, time: Duration) -> Result<Run, BusError> {
    let keys = [
        topics::ARM_STATE.key(),
        topics::CONTROL_STATE.key(),
        topics::ESTIMATE_NORMALS.key(),
        topics::TRUTH_CONTACT.key(),
    ];
    let readers: Vec<RawSubscription> = keys
        .iter()
        .map(|key| bus.subscribe_raw(key, 4096))
        .collect::<Result<_, _>>()?;
    let mut messages: Vec<RawMessage> = Vec::new();
    // Publishers discover a new subscriber one by one, with some delay.
    let give_up = Instant::now() + FIRST_WORD;
    let mut until = None;
    while let Some(left) = until
        .unwrap_or(give_up)
        .checked_duration_since(Instant::now())
    {
        // The arm's state arrives in every cycle; the others are read along with it.
        let first = readers[0].recv_timeout(left.min(Duration::from_millis(50)));
        messages.extend(first);
        for reader in &readers {
            messages.extend(std::iter::from_fn(|| reader.try_recv()));
        }
        let spoken = |key: &str| messages.iter().any(|message| &*message.key == key);
        if until.is_none() && spoken(topics::CONTROL_STATE.key()) && spoken(topics::ARM_STATE.key())
        {
            until = Some(Instant::now() + time);
        }
    }
    messages.sort_by_key(|message| message.received);
    let messages: Vec<RecordedMessage> = messages.into_iter().map(recorded).collect();
    Ok(Run::heard(&messages))
}

fn recorded(message: RawMessage) -> RecordedMessage {
    RecordedMessage {
        topic: format!("/{}", message.key),
        type_name: message.type_name.into_owned(),
        log_time_ns: u64::try_from(message.received_ns).unwrap_or(0),
        publish_time_ns: u64::try_from(message.source_time_ns).unwrap_or(0),
        publisher: message.publisher,
        sequence: message.sequence as u32,
        bytes: message.payload.to_vec(),
    }
}
