//! Reasons why a gate refuses a command, with the received and the allowed value.

use std::fmt;

use tangent_schemas::CommandKind;

/// Why a command was refused.
///
/// ```
/// use tangent_actuation::Refusal;
///
/// let refusal = Refusal::Speed { joint: 1, value: 2.0, limit: 1.0 };
/// assert_eq!(refusal.to_string(), "joint 2 at 2.000 rad/s, limit 1.000 rad/s");
/// assert!(refusal.is_bad());
/// assert!(!Refusal::Old { age: 3 }.is_bad());
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Refusal {
    /// The command responds to a cycle too long ago.
    Old {
        /// Age in cycles.
        age: u64,
    },
    /// The command responds to a cycle that was already answered.
    Duplicate {
        /// The cycle.
        cycle: u64,
    },
    /// The command responds to a future cycle.
    Future {
        /// The cycle.
        cycle: u64,
    },
    /// The kind is neither hold, nor soft stop, nor the one that moves this arm.
    Kind {
        /// Kind received.
        kind: u8,
        /// Kind that moves this arm.
        moves: CommandKind,
    },
    /// The number of values differs from the number of joints.
    JointCount {
        /// Number of values received.
        got: usize,
        /// Number of joints of the arm.
        joints: usize,
    },
    /// A value or the acceleration is NaN or infinite.
    NotFinite,
    /// A value exceeds a joint's speed limit.
    Speed {
        /// Index of the joint, from 0.
        joint: usize,
        /// Value received, rad/s.
        value: f64,
        /// Limit, rad/s.
        limit: f64,
    },
    /// A value exceeds a joint's torque limit.
    Torque {
        /// Index of the joint, from 0.
        joint: usize,
        /// Value received, Nm.
        value: f64,
        /// Limit, Nm.
        limit: f64,
    },
    /// The activation is latched out.
    Latched {
        /// Activation received.
        activation: u64,
        /// Newest activation that is refused.
        latched: u64,
    },
}

impl Refusal {
    /// Whether the command itself is wrong, not only late or repeated: then the previous command is
    /// no longer followed either.
    pub fn is_bad(&self) -> bool {
        matches!(
            self,
            Self::Kind { .. }
                | Self::JointCount { .. }
                | Self::NotFinite
                | Self::Speed { .. }
                | Self::Torque { .. }
        )
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Old { age } => write!(f, "answers a cycle {age} cycles old"),
            Self::Duplicate { cycle } => write!(f, "cycle {cycle} was already answered"),
            Self::Future { cycle } => write!(f, "answers cycle {cycle}, which is in the future"),
            Self::Kind { kind, moves } => {
                write!(f, "kind {kind} is not one of")?;
                for (i, kind) in [CommandKind::Hold, *moves, CommandKind::SoftStop]
                    .into_iter()
                    .enumerate()
                {
                    let comma = if i > 0 { "," } else { "" };
                    write!(f, "{comma} {} ({})", kind.number(), kind.name())?;
                }
                Ok(())
            }
            Self::JointCount { got, joints } => write!(f, "{got} joint values for {joints} joints"),
            Self::NotFinite => write!(f, "a value is not a finite number"),
            Self::Speed {
                joint,
                value,
                limit,
            } => write!(
                f,
                "joint {} at {value:.3} rad/s, limit {limit:.3} rad/s",
                joint + 1
            ),
            Self::Torque {
                joint,
                value,
                limit,
            } => write!(
                f,
                "joint {} at {value:.2} Nm, limit {limit:.2} Nm",
                joint + 1
            ),
            Self::Latched {
                activation,
                latched,
            } => write!(
                f,
                "activation {activation} is latched out (up to {latched}); start a task again"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::torque::Trip;

    #[test]
    fn messages_count_joints_from_1_at_the_base() {
        let speed = Refusal::Speed {
            joint: 0,
            value: 2.0,
            limit: 1.0,
        };
        let torque = Refusal::Torque {
            joint: 6,
            value: 20.0,
            limit: 12.0,
        };
        for (words, joint) in [
            (speed.to_string(), "joint 1 "),
            (torque.to_string(), "joint 7 "),
            (Trip::JointSpeed(0, 2.0, 1.0).to_string(), "joint 1 "),
            (Trip::JointPosition(5, 3.1).to_string(), "joint 6 "),
        ] {
            assert!(words.starts_with(joint), "{words}");
        }
    }
}
