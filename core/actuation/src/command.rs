//! A command as passed to a gate.

use tangent_mechanics::Joints;
use tangent_schemas::tangent::ArmCommand;

use crate::refusal::Refusal;

/// A command as received. Each is passed to the gate once.
///
/// ```
/// use tangent_actuation::{Command, Refusal};
/// use tangent_mechanics::Joints;
/// use tangent_schemas::tangent::ArmCommand;
///
/// let message = ArmCommand {
///     values: [0.1, 0.2].into_iter().collect(),
///     ..ArmCommand::default()
/// };
/// let command = Command::from(&message);
/// assert_eq!(command.joints(), Ok(Joints::from([0.1, 0.2])));
/// let refused = command.joints::<6>();
/// assert_eq!(refused, Err(Refusal::JointCount { got: 2, joints: 6 }));
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Command<'a> {
    /// `ArmState.cycle` to which the command responds.
    pub cycle: u64,
    /// Number of a [`tangent_schemas::CommandKind`], as received.
    pub kind: u8,
    /// Joint values, rad/s or Nm, base to flange.
    pub values: &'a [f64],
    /// Bound on joint acceleration, rad/s²; zero or less means the cell's own limit.
    pub acceleration: f64,
    /// Number of task starts.
    pub activation: u64,
}

impl<'a> From<&'a ArmCommand> for Command<'a> {
    fn from(command: &'a ArmCommand) -> Self {
        Self {
            cycle: command.cycle,
            kind: command.kind,
            values: &command.values,
            acceleration: command.acceleration,
            activation: command.activation,
        }
    }
}

impl Command<'_> {
    /// The values as one number per joint.
    ///
    /// # Errors
    /// [`Refusal::JointCount`] or [`Refusal::NotFinite`].
    pub fn joints<const N: usize>(&self) -> Result<Joints<N>, Refusal> {
        let Ok(values) = <[f64; N]>::try_from(self.values) else {
            return Err(Refusal::JointCount {
                got: self.values.len(),
                joints: N,
            });
        };
        if values.iter().any(|v| !v.is_finite()) {
            return Err(Refusal::NotFinite);
        }
        Ok(Joints::from(values))
    }
}
