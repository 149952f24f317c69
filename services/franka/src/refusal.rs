//! Why the guard does not take a command, in words that say what came and what is allowed.

use std::fmt;

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
    /// It answers a cycle that has not been yet.
    Future {
        /// The cycle.
        cycle: u64,
    },
    /// Neither hold, torque nor soft stop.
    Kind {
        /// What came.
        kind: u8,
    },
    /// Not one value per joint.
    JointCount {
        /// What came.
        got: usize,
    },
    /// A value is NaN or infinite.
    NotFinite,
    /// Beyond what a joint may be asked for.
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
    /// The command itself is bad, not only late: the arm is not moved on by the one before either.
    pub fn is_bad(&self) -> bool {
        matches!(
            self,
            Self::Kind { .. } | Self::JointCount { .. } | Self::NotFinite | Self::Torque { .. }
        )
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Old { age } => write!(f, "answers a cycle {age} cycles old"),
            Self::Duplicate { cycle } => write!(f, "cycle {cycle} was already answered"),
            Self::Future { cycle } => write!(f, "answers cycle {cycle}, which has not been yet"),
            Self::Kind { kind } => write!(
                f,
                "kind {kind}; 0 hold, 2 joint torque, 3 soft stop are taken"
            ),
            Self::JointCount { got } => write!(f, "{got} joint values for 7 joints"),
            Self::NotFinite => write!(f, "a value is not a finite number"),
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
