//! Lease on the arm: which source may command it, one at a time, whatever the others send.
//!
//! A pure state machine; a robot bridge consults it for every command that arrives, before the
//! guard. The first source that sends a command takes the lease, and keeps it while it sends
//! commands, whether the arm moves or not. Other sources are refused, by name, and counted. The
//! lease changes hands only when its holder has been silent and the arm is at rest. The bridge then
//! rejects the activation of the new holder, so that a task has to be started again.

use std::fmt;

use sha2::{Digest, Sha256};
use tangent_schemas::convert::cut_format;
use tangent_schemas::{Name, Text};

/// Time without commands after which the holder counts as gone, s: well above the delay of a late
/// packet, well below a person's patience.
pub const SILENCE_S: f64 = 0.5;
/// Time for which a refused source is reported after its last command, s.
const REMEMBERED_S: f64 = 2.0;

/// Mark of the holder's publisher that `arm/state` shows. The holder recognises itself by it, while
/// the id that the lease is judged by stays secret. All zero for an id of zeros.
pub fn mark(publisher: &[u8; 16]) -> [u8; 16] {
    let mut mark = [0; 16];
    if *publisher != mark {
        let digest = Sha256::digest(publisher);
        mark.copy_from_slice(&digest[..16]);
    }
    mark
}

/// Source of commands: the name that it states, and the id of its publisher, which no two
/// publishers share.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Source {
    /// `SERVICE/INSTANCE`.
    pub name: Name,
    /// Id from the message's attachment; all zero for a publisher without one.
    pub publisher: [u8; 16],
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.name.is_empty() {
            f.write_str("a source without a name")
        } else {
            f.write_str(&self.name)
        }
    }
}

/// Decision on a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeaseDecision {
    /// The command is from the holder.
    Held,
    /// The source of the command holds the lease from now on.
    Taken,
    /// Another source holds the lease, or the arm is not at rest.
    Refused,
}

/// Lease on the arm and its current or last holder.
///
/// ```
/// use tangent_actuation::lease::{Lease, LeaseDecision, SILENCE_S, Source};
///
/// let [first, second] = [1, 2].map(|id| Source {
///     publisher: [id; 16],
///     ..Source::default()
/// });
/// let mut lease = Lease::default();
/// assert_eq!(lease.admit(&first, 0.0, true), LeaseDecision::Taken);
/// assert_eq!(lease.admit(&second, 0.1, true), LeaseDecision::Refused);
/// // It changes hands after silence, and only while the arm rests.
/// let later_s = 0.1 + SILENCE_S;
/// assert_eq!(lease.admit(&second, later_s, false), LeaseDecision::Refused);
/// assert_eq!(lease.admit(&second, later_s, true), LeaseDecision::Taken);
/// ```
#[derive(Clone, Debug, Default)]
pub struct Lease {
    /// Holder, and the time of its last command, s.
    holder: Option<(Source, f64)>,
    rival: Option<(Source, f64)>,
    refused: u64,
}

impl Lease {
    /// Decides on one command by its source. `rests`: the arm neither moves nor is about to.
    pub fn admit(&mut self, source: &Source, now_s: f64, rests: bool) -> LeaseDecision {
        match &mut self.holder {
            Some((holder, heard_s)) if holder == source => {
                *heard_s = now_s;
                return LeaseDecision::Held;
            }
            Some((_, heard_s)) if now_s - *heard_s <= SILENCE_S || !rests => {
                self.rival = Some((*source, now_s));
                self.refused += 1;
                return LeaseDecision::Refused;
            }
            None if !rests => {
                self.rival = Some((*source, now_s));
                self.refused += 1;
                return LeaseDecision::Refused;
            }
            _ => {}
        }
        self.holder = Some((*source, now_s));
        if self.rival.is_some_and(|(rival, _)| rival == *source) {
            self.rival = None;
        }
        LeaseDecision::Taken
    }

    /// The source that holds the lease, or held it last.
    pub fn holder(&self) -> Option<&Source> {
        self.holder.as_ref().map(|(source, _)| source)
    }

    /// The source that was refused last, if that was within the last seconds.
    pub fn rival(&self, now_s: f64) -> Option<&Source> {
        self.rival
            .as_ref()
            .filter(|(_, heard_s)| now_s - heard_s <= REMEMBERED_S)
            .map(|(source, _)| source)
    }

    /// Why `rival` is refused, in words.
    pub fn refusal_of(&self, rival: &Source) -> Text {
        match self.holder() {
            Some(holder) => {
                cut_format(format_args!("{rival} is refused: {holder} drives this arm"))
            }
            None => cut_format(format_args!("{rival} is refused until the arm is at rest")),
        }
    }

    /// Number of commands refused since the start.
    pub fn refused(&self) -> u64 {
        self.refused
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source(name: &str, id: u8) -> Source {
        Source {
            name: Name::from(name).unwrap(),
            publisher: [id; 16],
        }
    }

    #[test]
    fn the_second_is_refused_by_name_while_the_first_speaks() {
        let (a, b) = (source("controller/a-1", 1), source("controller/b-2", 2));
        let mut lease = Lease::default();
        assert_eq!(lease.admit(&a, 0.0, true), LeaseDecision::Taken);
        for cycle in 1..100 {
            let now_s = 0.008 * f64::from(cycle);
            assert_eq!(lease.admit(&b, now_s, true), LeaseDecision::Refused);
            assert_eq!(lease.admit(&a, now_s, false), LeaseDecision::Held);
        }
        assert_eq!(lease.holder(), Some(&a));
        assert_eq!(lease.rival(0.8), Some(&b));
        assert_eq!(lease.rival(3.0), None);
        assert_eq!(lease.refused(), 99);
    }

    #[test]
    fn it_passes_on_after_silence_and_at_rest_only() {
        let (a, b) = (source("controller/a-1", 1), source("controller/b-2", 2));
        let mut lease = Lease::default();
        assert_eq!(lease.admit(&b, 0.0, false), LeaseDecision::Refused);
        assert_eq!(lease.admit(&a, 0.0, true), LeaseDecision::Taken);
        assert_eq!(lease.admit(&b, SILENCE_S, true), LeaseDecision::Refused);
        assert_eq!(
            lease.admit(&b, SILENCE_S + 0.01, false),
            LeaseDecision::Refused
        );
        assert_eq!(
            lease.admit(&b, SILENCE_S + 0.02, true),
            LeaseDecision::Taken
        );
        assert_eq!(lease.rival(SILENCE_S + 0.02), None);
        // The first source returns: it is now the second one.
        assert_eq!(
            lease.admit(&a, SILENCE_S + 0.03, true),
            LeaseDecision::Refused
        );
        assert_eq!(lease.holder(), Some(&b));
    }

    #[test]
    fn a_mark_tells_publishers_apart_and_is_not_the_id() {
        let (a, b) = (mark(&[1; 16]), mark(&[2; 16]));
        assert_ne!(a, b);
        assert_ne!(a, [1; 16]);
        assert_eq!(a, mark(&[1; 16]));
        assert_eq!(mark(&[0; 16]), [0; 16]);
    }

    #[test]
    fn one_name_on_two_publishers_is_two_sources() {
        let (a, b) = (source("controller/x-1", 1), source("controller/x-1", 2));
        let mut lease = Lease::default();
        assert_eq!(lease.admit(&a, 0.0, true), LeaseDecision::Taken);
        assert_eq!(lease.admit(&b, 0.1, true), LeaseDecision::Refused);
    }
}
