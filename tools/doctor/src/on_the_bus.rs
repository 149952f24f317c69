//! Reads the topics of a running cell. A cell that does not run is no error.

use std::time::{Duration, Instant};

use tangent_client::session;
use tangent_runtime::{Bus, BusError, CellConfig, Stop};
use tangent_schemas::Message;
use tangent_schemas::topics::{self, Topic};

use crate::finding::Finding;

/// Timeout for the router: on this machine it answers at once, in the cell's network soon.
const ROUTER_PATIENCE: Duration = Duration::from_secs(1);
/// Time to receive messages, including the time to discover publishers.
const LISTEN: Duration = Duration::from_secs(2);
/// Number of messages after which a topic counts as present, and waiting ends.
const ENOUGH: u32 = 20;

/// Session on the cell's bus, if the cell runs.
pub struct RunningCell {
    bus: Option<Bus>,
    /// Endpoint at which the router was looked for.
    router: String,
}

/// No message can be received on the cell's bus.
#[derive(Debug, thiserror::Error)]
pub enum HearError {
    /// There is no bus to subscribe on.
    #[error("the cell's router does not run ({0})")]
    NoRouter(String),
    /// The bus refuses the subscription.
    #[error(transparent)]
    Bus(#[from] BusError),
}

/// Messages received on a topic.
pub struct Heard<M> {
    /// The last message.
    pub last: M,
    /// Messages per second, Hz; `None` after only one message.
    pub rate_hz: Option<f64>,
}

impl RunningCell {
    /// Joins the cell's bus if its router runs.
    pub fn join(config: &CellConfig) -> Self {
        Self {
            bus: session::join_within(config, ROUTER_PATIENCE, &Stop::new()).ok(),
            router: config.zenoh.connect.join(", "),
        }
    }

    /// Uses an existing bus.
    #[cfg(test)]
    pub fn on(bus: Bus) -> Self {
        Self {
            bus: Some(bus),
            router: String::new(),
        }
    }

    /// Instance of the service with this name, if it runs.
    pub fn instance_of(&self, service: &str) -> Option<String> {
        let alive = self.bus.as_ref()?.alive(ROUTER_PATIENCE).ok()?;
        alive
            .into_iter()
            .find(|alive| alive.service == service)
            .map(|alive| alive.instance)
    }

    /// Subscribes until enough messages have arrived, for at most two seconds; `None` if none
    /// arrived.
    ///
    /// # Errors
    /// There is no bus to subscribe on, or the bus refuses.
    pub fn receive<M: Message + Clone>(
        &self,
        topic: &Topic<M>,
    ) -> Result<Option<Heard<M>>, HearError> {
        let bus = self
            .bus
            .as_ref()
            .ok_or_else(|| HearError::NoRouter(self.router.clone()))?;
        let messages = bus.subscribe(topic, 64)?;
        let until = Instant::now() + LISTEN;
        let mut heard: Option<(M, Instant, Instant, u32)> = None;
        while let Some(left) = until.checked_duration_since(Instant::now()) {
            let Some(received) = messages.recv_timeout(left) else {
                break;
            };
            let (first, n) = match &heard {
                Some((_, first, _, n)) => (*first, n + 1),
                None => (received.received, 1),
            };
            heard = Some((received.message, first, received.received, n));
            if n >= ENOUGH {
                break;
            }
        }
        Ok(heard.map(|(last, first, now, n)| {
            let seconds = now.saturating_duration_since(first).as_secs_f64();
            Heard {
                last,
                rate_hz: (seconds > 0.0).then(|| f64::from(n - 1) / seconds),
            }
        }))
    }
}

/// Checks an arm that is connected to the bus directly.
pub fn arm(config: &CellConfig, cell: &RunningCell) -> Vec<Finding> {
    const CHECK: &str = "robot";
    let what = format!(
        "{}, simulated (only a simulated arm takes torques without [robot] driver = \"franka\")",
        config.robot.model
    );
    let advice = "tangent run router simulator controller --cell CELL";
    vec![match cell.receive(&topics::ARM_STATE) {
        Ok(Some(heard)) => Finding::ok(
            CHECK,
            format!(
                "{what}: arm/state arrives, one cycle is {:.1} ms",
                heard.last.period_s * 1e3
            ),
        ),
        Ok(None) => Finding::problem(
            CHECK,
            format!("{what}: no arm/state within {} s", LISTEN.as_secs()),
            "the controller has no arm to control",
            advice,
        ),
        Err(why) => Finding::problem(
            CHECK,
            format!("{what}: {why}"),
            "the controller has no arm to control",
            advice,
        ),
    }]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Level;
    use tangent_schemas::tangent::ArmState;

    #[test]
    fn an_arm_on_the_bus_is_found_or_reported_missing() {
        let text = include_str!("../../../deploy/cell.lippiello.toml");
        let config = CellConfig::parse("cell.lippiello.toml", text).unwrap();
        let bus = Bus::in_process("test");
        let cell = RunningCell::on(bus.clone());
        let silent = &arm(&config, &cell)[0];
        assert_eq!(silent.level, Level::Problem, "{silent:?}");
        let states = bus.publisher(&topics::ARM_STATE).unwrap();
        let stop = Stop::new();
        let heard = std::thread::scope(|scope| {
            let ends = stop.clone();
            scope.spawn(move || {
                while !ends.wait(Duration::from_millis(1)) {
                    states.publish(&ArmState {
                        period_s: 0.001,
                        ..ArmState::default()
                    });
                }
            });
            let heard = arm(&config, &cell).remove(0);
            stop.trigger();
            heard
        });
        assert_eq!(heard.level, Level::Ok, "{heard:?}");
        assert!(heard.found.contains("1.0 ms"), "{heard:?}");
        assert_eq!(cell.instance_of("controller"), None);
        let _token = bus.declare_alive("controller", "here-1").unwrap();
        assert_eq!(cell.instance_of("controller").as_deref(), Some("here-1"));
    }
}
