//! The clock of the host that netft runs on, set at will: netft lives in a cell of its own, and what it says is passed on
//! with its stamps moved. Nobody's real clock is touched.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use anyhow::Result;
use tangent_runtime::bus::answer::refused;
use tangent_runtime::{Bus, Handle, Received};
use tangent_schemas::Message;
use tangent_schemas::standard::{Header, Time, WrenchStamped};
use tangent_schemas::tangent::WrenchStatus;
use tangent_schemas::topics::{self, Topic, queries};

/// Longer than a tare takes.
const TARE_PATIENCE: Duration = Duration::from_secs(3);

/// Passes messages between netft's cell and the cell under test until it is dropped.
pub struct SensorClock {
    ahead_ns: Arc<AtomicI64>,
    _handles: Vec<Handle>,
    _far: Bus,
}

impl SensorClock {
    /// `far` is netft's cell.
    ///
    /// # Errors
    /// When a bus refuses a topic.
    pub fn start(far: Bus, near: &Bus) -> Result<Self> {
        let ahead_ns = Arc::new(AtomicI64::new(0));
        let mut handles = vec![
            moved(
                &far,
                near,
                &topics::WRENCH_STATUS,
                &ahead_ns,
                |m: &mut WrenchStatus| &mut m.header,
            )?,
            moved(
                &far,
                near,
                &topics::WRENCH_TOOL,
                &ahead_ns,
                |m: &mut WrenchStamped| &mut m.header,
            )?,
            moved(
                &far,
                near,
                &topics::WRENCH_RAW,
                &ahead_ns,
                |m: &mut WrenchStamped| &mut m.header,
            )?,
        ];
        let back = far.publisher(&topics::ARM_STATE)?;
        handles.push(near.on(&topics::ARM_STATE, move |received| {
            back.publish(&received.message);
        })?);
        let health = near.publisher(&topics::health("netft"))?;
        handles.push(far.on(&topics::health("netft"), move |received| {
            health.publish(&received.message);
        })?);
        let asked = far.clone();
        handles.push(near.answer(queries::NETFT_TARE, move |_, request| {
            asked
                .ask(queries::NETFT_TARE, &request, TARE_PATIENCE)
                .unwrap_or_else(|error| refused(error.to_string()))
        })?);
        Ok(Self {
            ahead_ns,
            _handles: handles,
            _far: far,
        })
    }

    /// From the next message on, s.
    pub fn set(&self, ahead_s: f64) {
        self.ahead_ns
            .store((ahead_s * 1e9) as i64, Ordering::Release);
    }
}

fn moved<M: Message>(
    far: &Bus,
    near: &Bus,
    topic: &Topic<M>,
    ahead_ns: &Arc<AtomicI64>,
    header: fn(&mut M) -> &mut Header,
) -> Result<Handle> {
    let publisher = near.publisher(topic)?;
    let ahead_ns = Arc::clone(ahead_ns);
    Ok(far.on(topic, move |received: &Received<M>| {
        let mut message = received.message.clone();
        let header = header(&mut message);
        header.stamp = Time::from_ns(header.stamp.to_ns() + ahead_ns.load(Ordering::Acquire));
        publisher.publish(&message);
    })?)
}
