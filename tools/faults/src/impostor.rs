//! False messages that no service must act on: published beside the true ones, or under the id of a
//! controller that is silenced.

use tangent_mechanics::{Base, Tool};
use tangent_runtime::{Bus, Latest, Publisher, RawPublisher, RawSubscription, clock};
use tangent_schemas::standard::{Header, WrenchStamped};
use tangent_schemas::tangent::{ArmCommand, ArmState, ControlState, NormalEstimate, WrenchStatus};
use tangent_schemas::{Message, Name, cdr, topics};

use crate::error::Result;

/// Kinds of false messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lie {
    /// A valid status with a wrench of NaN.
    WrenchNotFinite,
    /// A valid status with a wrench of zero, beside the true ones.
    WrenchOfAnother,
    /// A valid estimate with a normal of NaN, as from the estimator `blend`.
    NormalNotFinite,
    /// A command of NaN for the running task, current, under the controller's id.
    CommandNotFinite,
    /// A command faster than the limit of any joint, for the running task, current, under the
    /// controller's id.
    CommandBeyondLimits,
    /// A command for the running task that answers an old packet, under the controller's id.
    CommandOld,
    /// A sound command for the running task, from another controller.
    CommandOfAnother,
}

/// The source that the bridge obeys, and the sequence number of its last message.
struct Holder {
    publisher: [u8; 16],
    sequence: u64,
    source: Name,
}

impl Lie {
    /// Whether it is sent under the id of the controller, which must be silent meanwhile.
    pub fn as_the_controller(self) -> bool {
        matches!(
            self,
            Self::CommandNotFinite | Self::CommandBeyondLimits | Self::CommandOld
        )
    }

    /// Interval between two such messages, ms.
    pub fn period_ms(self) -> u64 {
        match self {
            Self::WrenchNotFinite | Self::WrenchOfAnother => 1,
            Self::NormalNotFinite => 4,
            _ => 10,
        }
    }
}

/// Sends false messages, made plausible with data from the cell.
pub struct Impostor {
    arm: Latest<ArmState>,
    control: Latest<ControlState>,
    status: Publisher<WrenchStatus>,
    wrench: Publisher<WrenchStamped>,
    normal: Publisher<NormalEstimate>,
    command: Publisher<ArmCommand>,
    commands: RawSubscription,
    forged: RawPublisher,
    holder: Option<Holder>,
}

impl Impostor {
    /// An impostor beside the services of the cell.
    ///
    /// # Errors
    /// The bus refuses a topic.
    pub fn new(bus: &Bus) -> Result<Self> {
        Ok(Self {
            arm: bus.latest(&topics::ARM_STATE)?,
            control: bus.latest(&topics::CONTROL_STATE)?,
            status: bus.publisher(&topics::WRENCH_STATUS)?,
            wrench: bus.publisher(&topics::WRENCH_TOOL)?,
            normal: bus.publisher(&topics::estimate_normal("blend"))?,
            command: bus.publisher(&topics::ARM_COMMAND)?,
            commands: bus.subscribe_raw(topics::ARM_COMMAND.key(), 64)?,
            forged: bus.raw_publisher(topics::ARM_COMMAND.key(), ArmCommand::NAME)?,
            holder: None,
        })
    }

    /// Finds out which source commands the arm; false if there is none.
    pub fn knows_the_controller(&mut self) -> bool {
        while let Some(message) = self.commands.try_recv() {
            if let Ok(command) = cdr::decode::<ArmCommand>(&message.payload) {
                self.holder = Some(Holder {
                    publisher: message.publisher,
                    sequence: message.sequence,
                    source: command.source,
                });
            }
        }
        self.holder.is_some()
    }

    /// Whether another process reads the topics of this false message.
    pub fn is_heard(&self, lie: Lie) -> bool {
        match lie {
            Lie::WrenchNotFinite | Lie::WrenchOfAnother => {
                self.status.is_read_remotely() && self.wrench.is_read_remotely()
            }
            Lie::NormalNotFinite => self.normal.is_read_remotely(),
            _ if lie.as_the_controller() => self.forged.is_read_remotely(),
            _ => self.command.is_read_remotely(),
        }
    }

    /// Sends the false message once.
    pub fn tell(&mut self, lie: Lie) {
        let (Some(arm), Some(control)) = (self.arm.get(), self.control.get()) else {
            return;
        };
        let (cycle, joints) = (arm.message.cycle, arm.message.q.len());
        let activation = control.message.activation;
        let now_ns = clock::now_ns();
        let command = |value: f64, age: u64| {
            let mut command = ArmCommand {
                header: Header::in_frame::<Base>(now_ns),
                cycle: cycle.saturating_sub(age),
                kind: 1,
                activation,
                ..ArmCommand::default()
            };
            command.values.extend(std::iter::repeat_n(value, joints));
            command
        };
        match lie {
            Lie::WrenchNotFinite | Lie::WrenchOfAnother => {
                self.status.publish(&WrenchStatus {
                    header: Header::in_frame::<Tool>(now_ns),
                    ..WrenchStatus::default()
                });
                let mut wrench = WrenchStamped {
                    header: Header::in_frame::<Tool>(now_ns),
                    ..WrenchStamped::default()
                };
                if lie == Lie::WrenchNotFinite {
                    wrench.wrench.force.z = f64::NAN;
                }
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
            Lie::CommandNotFinite => self.forge(command(f64::NAN, 0)),
            Lie::CommandBeyondLimits => self.forge(command(8.0, 0)),
            Lie::CommandOld => self.forge(command(0.1, 50)),
            Lie::CommandOfAnother => {
                let mut command = command(0.1, 0);
                command.source = tangent_schemas::convert::cut("impostor");
                self.command.publish(&command);
            }
        }
    }

    /// Sends a command as the next message of the source that commands the arm.
    fn forge(&mut self, mut command: ArmCommand) {
        let Some(holder) = &mut self.holder else {
            return;
        };
        holder.sequence += 1;
        command.source = holder.source;
        let mut bytes = Vec::new();
        if cdr::encode(&command, &mut bytes).is_ok() {
            self.forged
                .publish_as(&bytes, holder.publisher, holder.sequence);
        }
    }
}
