//! What `arm/state` says of the commands: who commands, what was refused and why.

use tangent_schemas::convert::cut_format;
use tangent_schemas::tangent::ArmState;

use crate::admission::Admission;
use crate::lease::{self, Lease};

/// Fills the part of `arm/state` that is about commands.
#[derive(Clone, Copy, Debug, Default)]
pub struct CommandAccount {
    /// Commands refused by admission and by lease, as told last.
    refused: (u64, u64),
}

impl CommandAccount {
    /// Into `state`, which is the one of the cycle before. The reason stays until another command
    /// is refused.
    pub fn fill<T: Copy>(
        &mut self,
        state: &mut ArmState,
        admission: &Admission<T>,
        lease: &Lease,
        now_s: f64,
    ) {
        let holder = lease.holder().copied().unwrap_or_default();
        state.command_cycle_accepted = admission.cycle_accepted();
        state.commanded_by = holder.name;
        state.commander_id = lease::mark(&holder.publisher);
        state.activation_latched = admission.activation_latched();
        state.missed_cycles = admission.missed();
        let refused = (admission.refused(), lease.refused());
        if refused.0 != self.refused.0
            && let Some(refusal) = admission.refusal()
        {
            state.refusal_reason = cut_format(format_args!("{refusal}"));
        }
        if refused.1 != self.refused.1
            && let Some(rival) = lease.rival(now_s)
        {
            state.refusal_reason = lease.refusal_of(rival);
        }
        self.refused = refused;
        state.commands_refused = refused.0 + refused.1;
    }
}
