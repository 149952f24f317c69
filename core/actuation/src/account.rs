//! Report on the commands in `arm/state`: who commands, what was refused and why.

use tangent_schemas::Text;
use tangent_schemas::convert::cut_format;
use tangent_schemas::tangent::ArmState;

use crate::admission::Admission;
use crate::lease::{self, Lease};

/// Fills the part of `arm/state` that describes the commands. It stores the reason of the last
/// refusal, so that the gates need not.
///
/// ```
/// use tangent_actuation::CommandAccount;
/// use tangent_actuation::admission::{Admission, AdmissionRules};
/// use tangent_actuation::lease::{Lease, Source};
/// use tangent_schemas::CommandKind;
/// use tangent_schemas::tangent::ArmState;
///
/// let admission = Admission::<f64>::new(AdmissionRules {
///     moves: CommandKind::JointTorque,
///     patience_cycles: 2,
///     silence_latch_s: 0.1,
///     refusal_ends_task: false,
/// });
/// let mut lease = Lease::default();
/// lease.admit(&Source::default(), 0.0, true);
///
/// let mut account = CommandAccount::default();
/// let mut state = ArmState::default();
/// account.fill(&mut state, &admission, &lease, 0.0);
/// assert_eq!(state.commanded_by.as_str(), "a source without a name");
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct CommandAccount {
    /// Number of commands refused by admission and by lease at the last call of
    /// [`CommandAccount::fill`].
    refused: (u64, u64),
    reason: Text,
}

impl CommandAccount {
    /// Writes every field of `state` that describes the commands, at time `now_s` of the lease's
    /// clock, s. The reason stays until another command is refused. A holder without a name is
    /// shown with the text of [`lease::Source`].
    pub fn fill<T: Copy>(
        &mut self,
        state: &mut ArmState,
        admission: &Admission<T>,
        lease: &Lease,
        now_s: f64,
    ) {
        let (commanded_by, commander_id) = lease.holder().map_or_else(Default::default, |holder| {
            (
                cut_format(format_args!("{holder}")),
                lease::mark(&holder.publisher),
            )
        });
        let refused = (admission.refused(), lease.refused());
        if refused.0 != self.refused.0
            && let Some(refusal) = admission.refusal()
        {
            self.reason = cut_format(format_args!("{refusal}"));
        }
        if refused.1 != self.refused.1
            && let Some(rival) = lease.rival(now_s)
        {
            self.reason = lease.refusal_of(rival);
        }
        self.refused = refused;
        state.command_cycle_accepted = admission.cycle_accepted();
        state.commanded_by = commanded_by;
        state.commander_id = commander_id;
        state.activation_latched = admission.activation_latched();
        state.missed_cycles = admission.missed();
        state.commands_refused = refused.0 + refused.1;
        state.refusal_reason = self.reason;
    }

    /// Replaces the reason, also in `state`: for a stop with a cause other than a refused command.
    /// It stays until another command is refused.
    pub fn overrule(&mut self, state: &mut ArmState, reason: Text) {
        self.reason = reason;
        state.refusal_reason = reason;
    }
}

#[cfg(test)]
mod tests {
    use tangent_schemas::CommandKind;
    use tangent_schemas::convert::cut;

    use super::*;
    use crate::admission::AdmissionRules;
    use crate::command::Command;
    use crate::lease::Source;
    use crate::refusal::Refusal;

    fn admission() -> Admission<()> {
        Admission::new(AdmissionRules {
            moves: CommandKind::JointTorque,
            patience_cycles: 2,
            silence_latch_s: 0.1,
            refusal_ends_task: false,
        })
    }

    fn refuse(admission: &mut Admission<()>) {
        let command = Command {
            cycle: 1,
            kind: CommandKind::JointTorque.number(),
            values: &[],
            acceleration: 0.0,
            activation: 1,
        };
        admission.begin(1, true, Some(&command), |_| Err(Refusal::NotFinite));
    }

    #[test]
    fn the_reason_stays_until_another_refusal_and_is_written_into_any_state() {
        let (mut account, mut admission, lease) =
            (CommandAccount::default(), admission(), Lease::default());
        refuse(&mut admission);
        for _ in 0..2 {
            let mut state = ArmState::default();
            account.fill(&mut state, &admission, &lease, 0.0);
            assert_eq!(
                state.refusal_reason.as_str(),
                "a value is not a finite number"
            );
            assert_eq!(state.commands_refused, 1);
        }
        let mut state = ArmState::default();
        account.overrule(&mut state, cut("tripped"));
        for _ in 0..2 {
            assert_eq!(state.refusal_reason.as_str(), "tripped");
            state = ArmState::default();
            account.fill(&mut state, &admission, &lease, 0.0);
        }
        refuse(&mut admission);
        account.fill(&mut state, &admission, &lease, 0.0);
        assert_eq!(
            state.refusal_reason.as_str(),
            "a value is not a finite number"
        );
    }

    #[test]
    fn a_holder_without_a_name_is_told_from_no_holder() {
        let (mut account, admission, mut lease) =
            (CommandAccount::default(), admission(), Lease::default());
        let mut state = ArmState::default();
        account.fill(&mut state, &admission, &lease, 0.0);
        assert!(state.commanded_by.is_empty());
        assert_eq!(state.commander_id, [0; 16]);
        lease.admit(&Source::default(), 0.0, true);
        account.fill(&mut state, &admission, &lease, 0.0);
        assert_eq!(state.commanded_by.as_str(), "a source without a name");
    }
}
