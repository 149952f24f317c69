//! Meaning of the values of an arm command.

/// Kind of an [`crate::tangent::ArmCommand`], encoded as a number in its field `kind`.
///
/// ```
/// use tangent_schemas::CommandKind;
///
/// assert_eq!(CommandKind::from_number(3), Some(CommandKind::SoftStop));
/// assert_eq!(CommandKind::SoftStop.number(), 3);
/// assert_eq!(CommandKind::from_number(4), None);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum CommandKind {
    /// Hold the position; the values are not used.
    #[default]
    Hold = 0,
    /// Follow joint velocities, rad/s.
    JointVelocity = 1,
    /// Apply these joint torques, Nm.
    JointTorque = 2,
    /// The robot itself stops, and does not move again for this task.
    SoftStop = 3,
}

impl CommandKind {
    /// All kinds.
    pub const ALL: [Self; 4] = [
        Self::Hold,
        Self::JointVelocity,
        Self::JointTorque,
        Self::SoftStop,
    ];

    /// Number of the kind, as in the message.
    pub fn number(self) -> u8 {
        self as u8
    }

    /// Kind with this number; `None` if no kind has it.
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.number() == number)
    }

    /// Name as text.
    pub fn name(self) -> &'static str {
        match self {
            Self::Hold => "hold",
            Self::JointVelocity => "joint velocity",
            Self::JointTorque => "joint torque",
            Self::SoftStop => "soft stop",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_names_its_kind_or_none() {
        for kind in CommandKind::ALL {
            assert_eq!(CommandKind::from_number(kind.number()), Some(kind));
        }
        assert_eq!(CommandKind::from_number(4), None);
    }
}
