//! Who may command the arm: one source at a time, whatever the others send.
//!
//! Pure; a robot bridge asks it for every command that arrives, before its guard sees it. The first
//! source heard holds the lease and keeps it while it speaks, holding still or moving. Others are refused by name and
//! counted. The lease passes on only when its holder has been silent and the arm rests; the bridge then latches out what
//! the new holder brings, so that a task has to be started anew.

use std::fmt;

use sha2::{Digest, Sha256};
use tangent_schemas::Name;

/// A holder that says nothing for so long has gone, s: well beyond a late packet, well below a person's patience.
pub const SILENCE_S: f64 = 0.5;
/// A refused source is told about for so long after it was heard, s.
const REMEMBERED_S: f64 = 2.0;

/// What `arm/state` shows of the holder's publisher: by it the holder knows itself, and nobody learns the id that the
/// lease is judged by. All zero for an id of zeros.
pub fn mark(publisher: &[u8; 16]) -> [u8; 16] {
    let mut mark = [0; 16];
    if *publisher != mark {
        let digest = Sha256::digest(publisher);
        mark.copy_from_slice(&digest[..16]);
    }
    mark
}

/// Who sends commands: the name that it gives, and its publisher's id, which no two publishers share.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Source {
    /// `SERVICE/INSTANCE`.
    pub name: Name,
    /// From the message's attachment; all zero for a publisher that does not say.
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

/// What becomes of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Admission {
    /// It is the holder's.
    Held,
    /// Its source holds the lease from now on.
    Taken,
    /// Somebody else holds it.
    Refused,
}

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct Lease {
    /// And when it was last heard, s.
    holder: Option<(Source, f64)>,
    rival: Option<(Source, f64)>,
    refused: u64,
}

impl Lease {
    /// Judges one command by who sent it. `rests`: the arm neither moves nor is about to.
    pub fn admit(&mut self, source: &Source, now_s: f64, rests: bool) -> Admission {
        match &mut self.holder {
            Some((holder, heard_s)) if holder == source => {
                *heard_s = now_s;
                return Admission::Held;
            }
            Some((_, heard_s)) if now_s - *heard_s <= SILENCE_S || !rests => {
                self.rival = Some((*source, now_s));
                self.refused += 1;
                return Admission::Refused;
            }
            None if !rests => {
                self.rival = Some((*source, now_s));
                self.refused += 1;
                return Admission::Refused;
            }
            _ => {}
        }
        self.holder = Some((*source, now_s));
        if self.rival.is_some_and(|(rival, _)| rival == *source) {
            self.rival = None;
        }
        Admission::Taken
    }

    /// Who holds it, or held it last.
    pub fn holder(&self) -> Option<&Source> {
        self.holder.as_ref().map(|(source, _)| source)
    }

    /// Who was refused in the last seconds.
    pub fn rival(&self, now_s: f64) -> Option<&Source> {
        self.rival
            .as_ref()
            .filter(|(_, heard_s)| now_s - heard_s <= REMEMBERED_S)
            .map(|(source, _)| source)
    }

    /// Commands refused since the start.
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
        assert_eq!(lease.admit(&a, 0.0, true), Admission::Taken);
        for cycle in 1..100 {
            let now_s = 0.008 * f64::from(cycle);
            assert_eq!(lease.admit(&b, now_s, true), Admission::Refused);
            assert_eq!(lease.admit(&a, now_s, false), Admission::Held);
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
        assert_eq!(lease.admit(&b, 0.0, false), Admission::Refused);
        assert_eq!(lease.admit(&a, 0.0, true), Admission::Taken);
        assert_eq!(lease.admit(&b, SILENCE_S, true), Admission::Refused);
        assert_eq!(lease.admit(&b, SILENCE_S + 0.01, false), Admission::Refused);
        assert_eq!(lease.admit(&b, SILENCE_S + 0.02, true), Admission::Taken);
        assert_eq!(lease.rival(SILENCE_S + 0.02), None);
        // The first comes back: it is the second now.
        assert_eq!(lease.admit(&a, SILENCE_S + 0.03, true), Admission::Refused);
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
        assert_eq!(lease.admit(&a, 0.0, true), Admission::Taken);
        assert_eq!(lease.admit(&b, 0.1, true), Admission::Refused);
    }
}
