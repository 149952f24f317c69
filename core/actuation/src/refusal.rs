//! Why a gate does not take a command: what came, and what is allowed.

use std::fmt;

use tangent_schemas::CommandKind;

/// Why a command was refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Refusal {
    /// It answers a cycle too long ago.
    Old {
        /// Cycles.
        age: u64,
    },
    /// It answers a cycle that was answered before.
    Duplicate {
        /// The cycle.
        cycle: u64,
    },
    /// It answers a cycle that is yet to come.
    Future {
        /// The cycle.
        cycle: u64,
    },
    /// Neither hold, nor soft stop, nor the one kind that moves this arm.
    Kind {
        /// What came.
        kind: u8,
        /// What moves this arm.
        moves: CommandKind,
    },
    /// Not one value per joint.
    JointCount {
        /// What came.
        got: usize,
        /// Joints of the arm.
        joints: usize,
    },
    /// A value or the acceleration is NaN or infinite.
    NotFinite,
    /// Beyond a joint's speed limit.
    Speed {
        /// Which joint, from 0.
        joint: usize,
        /// What came, rad/s.
        value: f64,
        /// What is allowed, rad/s.
        limit: f64,
    },
    /// Beyond a joint's torque limit.
    Torque {
        /// Which joint, from 0.
        joint: usize,
        /// What came, Nm.
        value: f64,
        /// What is allowed, Nm.
        limit: f64,
    },
    /// Its activation is latched out.
    Latched {
        /// What came.
        activation: u64,
        /// The newest that is refused.
        latched: u64,
    },
}

impl Refusal {
    /// The command itself is wrong, not only late or repeated: the command before it is not
    /// followed any longer either.
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
            Self::Future { cycle } => write!(f, "answers cycle {cycle}, which has not been yet"),
            Self::Kind { kind, moves } => {
                write!(f, "kind {kind} is none of")?;
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
