//! A command as a gate takes it.

use tangent_mechanics::Joints;
use tangent_schemas::tangent::ArmCommand;

use crate::refusal::Refusal;

/// A command as it arrived. Each is given to the gate once.
#[derive(Clone, Copy, Debug)]
pub struct Command<'a> {
    /// `ArmState.cycle` that it answers.
    pub cycle: u64,
    /// Number of a [`tangent_schemas::CommandKind`], as it came.
    pub kind: u8,
    /// rad/s or Nm, base to flange.
    pub values: &'a [f64],
    /// Bound on joint acceleration, rad/s²; zero or less means the cell's own limit.
    pub acceleration: f64,
    /// Counts task starts.
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
