//! What a cell that runs says on its bus: read only, and no matter where it does not run.

use std::time::{Duration, Instant};

use tangent_runtime::{Bus, CellConfig, Stop};
use tangent_schemas::Message;
use tangent_schemas::topics::{self, Topic};

use super::Finding;
use crate::cell;

/// A router on this machine answers at once, one in the cell's network soon.
const ROUTER_PATIENCE: Duration = Duration::from_secs(1);
/// Finding out who publishes takes a moment.
const LISTEN: Duration = Duration::from_secs(2);
/// After so many messages a topic counts as present, and waiting ends.
const ENOUGH: u32 = 20;

/// The cell's bus, where there is one.
pub struct RunningCell {
    bus: Option<Bus>,
    why_not: String,
}

/// What came on a topic.
pub struct Heard<M> {
    /// The last.
    pub last: M,
    /// Per second; none after one message.
    pub rate_hz: Option<f64>,
}

impl RunningCell {
    /// Joins the cell's bus if its router runs.
    pub fn join(config: &CellConfig) -> Self {
        match cell::join_within(config, ROUTER_PATIENCE, &Stop::new()) {
            Ok(bus) => Self::on(bus),
            Err(_) => Self {
                bus: None,
                why_not: format!(
                    "the cell's router does not run ({})",
                    config.zenoh.connect.join(", ")
                ),
            },
        }
    }

    /// On a bus that is there.
    pub fn on(bus: Bus) -> Self {
        Self {
            bus: Some(bus),
            why_not: String::new(),
        }
    }

    /// Where the service of that name runs, if it does.
    pub fn instance_of(&self, service: &str) -> Option<String> {
        let alive = self.bus.as_ref()?.alive(ROUTER_PATIENCE).ok()?;
        alive
            .into_iter()
            .find(|alive| alive.service == service)
            .map(|alive| alive.instance)
    }

    /// Listens until it has heard enough, two seconds at most; none when nothing came.
    ///
    /// # Errors
    /// In words: there is no bus to listen on.
    pub fn hear<M: Message + Clone>(&self, topic: &Topic<M>) -> Result<Option<Heard<M>>, String> {
        let bus = self.bus.as_ref().ok_or_else(|| self.why_not.clone())?;
        let messages = bus.subscribe(topic, 64).map_err(|e| e.to_string())?;
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

/// An arm that speaks on the bus itself.
pub fn arm(config: &CellConfig, cell: &RunningCell) -> Vec<Finding> {
    const CHECK: &str = "robot";
    let what = format!(
        "{}, simulated (only a simulated arm takes torques without [robot] driver = \"franka\")",
        config.robot.model
    );
    let advice = "tangent run router simulator controller --cell CELL";
    vec![match cell.hear(&topics::ARM_STATE) {
        Ok(Some(heard)) => Finding::ok(
            CHECK,
            format!(
                "{what}: arm/state comes, one cycle is {:.1} ms",
                heard.last.period_s * 1e3
            ),
        ),
        Ok(None) => Finding::problem(
            CHECK,
            format!("{what}: no arm/state within {} s", LISTEN.as_secs()),
            "there is nothing to control",
            advice,
        ),
        Err(why) => Finding::problem(
            CHECK,
            format!("{what}: {why}"),
            "there is nothing to control",
            advice,
        ),
    }]
}

#[cfg(test)]
mod tests {
    use super::super::Level;
    use super::*;
    use tangent_schemas::tangent::ArmState;

    #[test]
    fn an_arm_on_the_bus_is_heard_or_missed() {
        let text = include_str!("../../deploy/cell.lippiello.toml");
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
