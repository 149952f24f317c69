//! Accepts one publisher at a time on topics that have one; any other is refused, counted and
//! named.
//!
//! A sample from the same process is always accepted, as services of one process trust each other.
//! Of the publishers on the network, the first one is accepted as long as it sends. Another one is
//! accepted after [`SILENCE`], unless the reader is held to its publisher. Any reader can copy an
//! id. A publisher of this bus is therefore never accepted from the network, and two publishers
//! that count separately under one id are both refused until only one is left.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tangent_actuation::lease::SILENCE_S;
use tangent_schemas::topics::Sources;

use super::attachment::BusId;

/// A publisher that is silent for this long counts as ended.
const SILENCE: Duration = Duration::from_millis((1e3 * SILENCE_S) as u64);
/// A refused publisher is reported for this long after its last sample.
const REMEMBERED: Duration = Duration::from_secs(2);

/// A publisher that is refused now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rival {
    /// Id in its samples.
    pub publisher: [u8; 16],
    /// Whether it uses the id of the accepted publisher, or of one in this process.
    pub forged: bool,
}

/// Judges the publishers of one reader.
pub(crate) struct Admission {
    kind: Sources,
    own: BusId,
    began: Instant,
    /// Time of the last sample from a publisher of this process, ns since `began`; 0: never.
    near_ns: AtomicU64,
    held: AtomicBool,
    far: Mutex<Far>,
    refused: AtomicU64,
}

/// State of the publishers on the network.
#[derive(Debug, Default)]
struct Far {
    holder: Option<([u8; 16], Instant)>,
    rival: Option<(Rival, Instant)>,
    /// Time of the last evidence that two publishers use one id.
    contested: Option<Instant>,
}

impl Admission {
    pub(crate) fn new(kind: Sources, own: BusId) -> Self {
        Self {
            kind,
            own,
            began: Instant::now(),
            near_ns: AtomicU64::new(0),
            held: AtomicBool::new(false),
            far: Mutex::default(),
            refused: AtomicU64::new(0),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Far> {
        self.far.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn one_at_a_time(&self) -> bool {
        self.kind != Sources::Any
    }

    /// Notes a sample from a publisher of this process. Takes no lock and allocates nothing.
    pub(crate) fn near(&self, at: Instant) {
        if self.kind == Sources::One {
            let ns = at.saturating_duration_since(self.began).as_nanos();
            let ns = u64::try_from(ns).unwrap_or(u64::MAX).max(1);
            self.near_ns.store(ns, Ordering::Relaxed);
        }
    }

    /// While held, no other publisher is accepted, however long the present one is silent. Takes no
    /// lock and allocates nothing.
    pub(crate) fn hold(&self, held: bool) {
        self.held.store(held, Ordering::Relaxed);
    }

    /// Whether to accept a sample from the network. Call it before the check of the sequence
    /// number.
    pub(crate) fn admit(&self, publisher: [u8; 16], now: Instant) -> bool {
        if self.kind == Sources::Any {
            return true;
        }
        let mut far = self.lock();
        if self.own.made(&publisher) {
            return self.refuse(&mut far, publisher, true, now);
        }
        if self.kind == Sources::Leased {
            return true;
        }
        let held = self.held.load(Ordering::Relaxed);
        let heard = |at: Instant| now.saturating_duration_since(at) <= SILENCE;
        if let Some(near) = self.near_heard()
            && (heard(near) || held && far.holder.is_none_or(|(_, at)| at < near))
        {
            return self.refuse(&mut far, publisher, false, now);
        }
        match &mut far.holder {
            Some((holder, at)) if *holder == publisher => *at = now,
            Some((_, at)) if held || heard(*at) => {
                return self.refuse(&mut far, publisher, false, now);
            }
            _ => far.holder = Some((publisher, now)),
        }
        // The pinned publisher is not a rival.
        let own = Rival {
            publisher,
            forged: false,
        };
        if far.rival.is_some_and(|(rival, _)| rival == own) {
            far.rival = None;
        }
        true
    }

    /// Notes a sample that was overtaken by one with the same id. As the link keeps the order, two
    /// publishers must be counting separately under that id.
    pub(crate) fn overtaken(&self, publisher: [u8; 16], now: Instant) {
        if self.one_at_a_time() {
            let mut far = self.lock();
            far.contested = Some(now);
            self.refuse(&mut far, publisher, true, now);
        }
    }

    /// Whether two publishers use the id of the accepted one; then both are refused.
    pub(crate) fn is_contested(&self, publisher: [u8; 16], now: Instant) -> bool {
        if self.kind == Sources::Any {
            return false;
        }
        let mut far = self.lock();
        let contested = far
            .contested
            .is_some_and(|at| now.saturating_duration_since(at) <= SILENCE);
        if contested {
            self.refuse(&mut far, publisher, true, now);
        }
        contested
    }

    fn near_heard(&self) -> Option<Instant> {
        match self.near_ns.load(Ordering::Relaxed) {
            0 => None,
            ns => Some(self.began + Duration::from_nanos(ns)),
        }
    }

    fn refuse(&self, far: &mut Far, publisher: [u8; 16], forged: bool, now: Instant) -> bool {
        far.rival = Some((Rival { publisher, forged }, now));
        self.refused.fetch_add(1, Ordering::Relaxed);
        false
    }

    /// The publisher that was refused in the last seconds, if any.
    pub(crate) fn rival(&self, now: Instant) -> Option<Rival> {
        let far = self.lock();
        let (rival, at) = far.rival?;
        (now.saturating_duration_since(at) <= REMEMBERED).then_some(rival)
    }

    /// Number of samples refused since the reader was created.
    pub(crate) fn refused(&self) -> u64 {
        self.refused.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: [u8; 16] = [1; 16];
    const B: [u8; 16] = [2; 16];
    const MS: Duration = Duration::from_millis(1);

    fn one() -> (Admission, Instant) {
        let admission = Admission::new(Sources::One, BusId::new());
        let began = admission.began;
        (admission, began)
    }

    #[test]
    fn the_first_publisher_is_accepted_while_it_publishes() {
        let (reader, t) = one();
        for ms in 0..1000 {
            assert!(reader.admit(A, t + ms * MS));
            assert!(!reader.admit(B, t + ms * MS));
        }
        let rival = Rival {
            publisher: B,
            forged: false,
        };
        assert_eq!(reader.rival(t + 1000 * MS), Some(rival));
        assert_eq!(reader.refused(), 1000);
        // The first publisher falls silent.
        assert!(!reader.admit(B, t + 1400 * MS));
        assert!(reader.admit(B, t + 1500 * MS));
        assert!(!reader.admit(A, t + 1501 * MS));
        assert_eq!(reader.rival(t + 3502 * MS), None);
    }

    #[test]
    fn while_a_reader_is_held_no_other_publisher_replaces_a_silent_one() {
        let (reader, t) = one();
        assert!(reader.admit(A, t));
        reader.hold(true);
        for s in 1..60 {
            assert!(!reader.admit(B, t + s * 1000 * MS));
        }
        assert!(reader.admit(A, t + 60_000 * MS));
        reader.hold(false);
        assert!(!reader.admit(B, t + 60_400 * MS));
        assert!(reader.admit(B, t + 60_501 * MS));
    }

    #[test]
    fn this_process_comes_before_the_network() {
        let (reader, t) = one();
        assert!(reader.admit(A, t));
        reader.near(t + MS);
        assert!(!reader.admit(A, t + 2 * MS));
        assert!(!reader.admit(A, t + 500 * MS));
        assert!(reader.admit(A, t + 600 * MS));
        assert_eq!(reader.rival(t + 601 * MS), None, "it is taken now");
        // The reader is held to this process's own publisher.
        reader.near(t + 700 * MS);
        reader.hold(true);
        assert!(!reader.admit(A, t + 9000 * MS));
    }

    #[test]
    fn an_id_of_this_bus_never_comes_from_the_network() {
        let own = BusId::new();
        for kind in [Sources::One, Sources::Leased] {
            let reader = Admission::new(kind, own.clone());
            let forged = own.next();
            assert!(!reader.admit(forged, reader.began));
            assert!(reader.rival(reader.began).unwrap().forged);
            assert!(reader.admit(A, reader.began));
        }
        let anybody = Admission::new(Sources::Any, own.clone());
        assert!(anybody.admit(own.next(), anybody.began));
    }

    #[test]
    fn two_under_one_id_are_both_refused_until_one_is_left() {
        let (reader, t) = one();
        assert!(reader.admit(A, t) && !reader.is_contested(A, t));
        reader.overtaken(A, t + MS);
        assert!(reader.is_contested(A, t + 2 * MS) && reader.is_contested(A, t + 501 * MS));
        assert!(!reader.is_contested(A, t + 502 * MS));
        assert!(reader.rival(t + 3 * MS).unwrap().forged);
    }
}
