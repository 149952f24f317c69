//! What the values of an arm's command are.

/// Kind of an [`crate::tangent::ArmCommand`], as its `kind` says by number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum CommandKind {
    /// Stand still; nothing is asked of the arm.
    #[default]
    Hold = 0,
    /// Follow joint velocities, rad/s.
    JointVelocity = 1,
    /// Give these joint torques, Nm.
    JointTorque = 2,
    /// The robot itself shall stop, and not move again for this task.
    SoftStop = 3,
}

impl CommandKind {
    /// All of them.
    pub const ALL: [Self; 4] = [
        Self::Hold,
        Self::JointVelocity,
        Self::JointTorque,
        Self::SoftStop,
    ];

    /// As in the message.
    pub fn number(self) -> u8 {
        self as u8
    }

    /// The kind of this number; none where no kind has it.
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.number() == number)
    }

    /// In words.
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
