//! Messages that nobody should believe, published beside the true ones.

use anyhow::Result;
use tangent_mechanics::{Base, Tool};
use tangent_runtime::{Bus, Latest, Publisher, clock};
use tangent_schemas::standard::{Header, WrenchStamped};
use tangent_schemas::tangent::{ArmCommand, ArmState, ControlState, NormalEstimate, WrenchStatus};
use tangent_schemas::topics;

/// What is said.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lie {
    /// A valid status, and a wrench of NaN.
    WrenchNotFinite,
    /// A valid estimate of the active estimator, of NaN.
    NormalNotFinite,
    /// A command of NaN, timely and of the running task.
    CommandNotFinite,
    /// The same, faster than any joint may turn.
    CommandBeyondLimits,
    /// The same, in answer to a packet long ago.
    CommandOld,
    /// A sound command of the running task, by another controller.
    CommandOfAnother,
}

impl Lie {
    /// How often it is told, ms.
    pub fn period_ms(self) -> u64 {
        match self {
            Self::WrenchNotFinite => 1,
            Self::NormalNotFinite => 4,
            _ => 10,
        }
    }
}

/// Tells lies, with what it hears to make them likely.
pub struct Impostor {
    arm: Latest<ArmState>,
    control: Latest<ControlState>,
    status: Publisher<WrenchStatus>,
    wrench: Publisher<WrenchStamped>,
    normal: Publisher<NormalEstimate>,
    command: Publisher<ArmCommand>,
}

impl Impostor {
    /// Beside the services of the cell.
    ///
    /// # Errors
    /// When the bus refuses a topic.
    pub fn new(bus: &Bus) -> Result<Self> {
        Ok(Self {
            arm: bus.latest(&topics::ARM_STATE)?,
            control: bus.latest(&topics::CONTROL_STATE)?,
            status: bus.publisher(&topics::WRENCH_STATUS)?,
            wrench: bus.publisher(&topics::WRENCH_TOOL)?,
            normal: bus.publisher(&topics::estimate_normal("blend"))?,
            command: bus.publisher(&topics::ARM_COMMAND)?,
        })
    }

    /// Somebody in another process reads what this lie is told on.
    pub fn is_heard(&self, lie: Lie) -> bool {
        match lie {
            Lie::WrenchNotFinite => {
                self.status.is_read_remotely() && self.wrench.is_read_remotely()
            }
            Lie::NormalNotFinite => self.normal.is_read_remotely(),
            _ => self.command.is_read_remotely(),
        }
    }

    /// Says it once.
    pub fn tell(&mut self, lie: Lie) {
        let (Some(arm), Some(control)) = (self.arm.get(), self.control.get()) else {
            return;
        };
        let (cycle, joints) = (arm.message.cycle, arm.message.q.len());
        let activation = control.message.activation;
        let now_ns = clock::now_ns();
        let command = |value: f64, age: u64, source: &str| {
            let mut command = ArmCommand {
                header: Header::in_frame::<Base>(now_ns),
                cycle: cycle.saturating_sub(age),
                kind: 1,
                activation,
                ..ArmCommand::default()
            };
            command.values.extend(std::iter::repeat_n(value, joints));
            command.source = tangent_schemas::convert::cut(source);
            self.command.publish(&command);
        };
        match lie {
            Lie::WrenchNotFinite => {
                self.status.publish(&WrenchStatus {
                    header: Header::in_frame::<Tool>(now_ns),
                    ..WrenchStatus::default()
                });
                let mut wrench = WrenchStamped {
                    header: Header::in_frame::<Tool>(now_ns),
                    ..WrenchStamped::default()
                };
                wrench.wrench.force.z = f64::NAN;
                self.wrench.publish(&wrench);
            }
            Lie::NormalNotFinite => {
                let mut estimate = NormalEstimate {
                    header: Header::in_frame::<Base>(now_ns),
                    cycle,
                    ..NormalEstimate::default()
                };
                estimate.normal.z = f64::NAN;
                self.normal.publish(&estimate);
            }
            // The first word of a task may be anybody's: these say whose it is.
            Lie::CommandNotFinite => command(f64::NAN, 0, "impostor"),
            Lie::CommandBeyondLimits => command(8.0, 0, "impostor"),
            Lie::CommandOld => command(0.1, 50, "impostor"),
            Lie::CommandOfAnother => command(0.1, 0, "impostor"),
        }
    }
}
