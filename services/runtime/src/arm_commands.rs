//! Selects the command for one cycle of a robot loop from those that arrived.

use tangent_actuation::lease::Source;
use tangent_schemas::tangent::ArmCommand;

use crate::bus::{Received, Subscription};

/// Capacity of a robot loop's subscription to `arm/command`: the number of commands from all
/// sources together that may be queued for one cycle.
pub const COMMANDS_MAX: usize = 64;

/// Takes all queued commands out of `commands`, and returns the newest one from a source that
/// `admit` accepts.
///
/// `admit` gets the source and the activation of each command, in order of arrival. It sees all of
/// them, so that a command of another source cannot hide that of the lease holder. Takes no lock
/// and allocates nothing.
pub fn newest_command(
    commands: &Subscription<ArmCommand>,
    admit: impl FnMut(&Source, u64) -> bool,
) -> Option<ArmCommand> {
    newest_of(|| commands.try_recv(), admit)
}

fn newest_of(
    mut next: impl FnMut() -> Option<Received<ArmCommand>>,
    mut admit: impl FnMut(&Source, u64) -> bool,
) -> Option<ArmCommand> {
    let mut newest = None;
    // The loop is bounded: a flood of commands must not delay the cycle.
    for _ in 0..COMMANDS_MAX {
        let Some(received) = next() else {
            break;
        };
        let source = Source {
            name: received.message.source,
            publisher: received.publisher,
        };
        if admit(&source, received.message.activation) {
            newest = Some(received.message);
        }
    }
    newest
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;

    fn received(publisher: u8, cycle: u64) -> Received<ArmCommand> {
        Received {
            message: ArmCommand {
                cycle,
                activation: 7,
                ..ArmCommand::default()
            },
            sequence: cycle,
            source_time_ns: 0,
            received: Instant::now(),
            publisher: [publisher; 16],
        }
    }

    #[test]
    fn another_source_does_not_hide_the_holders_newest_command() {
        let mut waiting = [(1, 1), (1, 2), (2, 3)]
            .map(|(who, cycle)| received(who, cycle))
            .into_iter();
        let mut asked = Vec::new();
        let newest = newest_of(
            || waiting.next(),
            |source, activation| {
                assert_eq!(activation, 7);
                asked.push(source.publisher[0]);
                source.publisher == [1; 16]
            },
        );
        assert_eq!(newest.unwrap().cycle, 2);
        assert_eq!(asked, [1, 1, 2]);
    }

    #[test]
    fn a_flood_ends_with_the_capacity_of_the_subscription() {
        let mut taken = 0;
        let newest = newest_of(
            || {
                taken += 1;
                Some(received(1, taken))
            },
            |_, _| true,
        );
        assert_eq!(taken, COMMANDS_MAX as u64);
        assert_eq!(newest.unwrap().cycle, taken);
    }
}
