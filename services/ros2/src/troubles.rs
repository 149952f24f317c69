//! What is wrong now, in words, for the health message.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Time for which a single event is reported.
const SHOWN: Duration = Duration::from_secs(3);
/// Troubles kept at a time; the names in them come from other programs.
const TROUBLES_MAX: usize = 32;

/// The present troubles. Clones share them.
#[derive(Clone, Debug, Default)]
pub struct Troubles {
    all: Arc<Mutex<BTreeMap<String, Trouble>>>,
}

#[derive(Clone, Debug)]
struct Trouble {
    words: String,
    /// `None`: lasts until it is ended.
    until: Option<Instant>,
}

impl Troubles {
    /// Reports an event of `subject`, for some seconds.
    pub fn event(&self, subject: &str, words: String) {
        self.put(subject, words, Some(Instant::now() + SHOWN));
    }

    /// Reports a condition of `subject`, until [`Troubles::end`].
    pub fn begin(&self, subject: &str, words: String) {
        self.put(subject, words, None);
    }

    /// Ends a condition.
    pub fn end(&self, subject: &str) {
        self.lock().remove(subject);
    }

    /// The first trouble at `now`, by the order of the subjects.
    pub fn first(&self, now: Instant) -> Option<String> {
        let mut all = self.lock();
        all.retain(|_, trouble| trouble.until.is_none_or(|until| now < until));
        all.values().next().map(|trouble| trouble.words.clone())
    }

    fn put(&self, subject: &str, words: String, until: Option<Instant>) {
        let mut all = self.lock();
        let is_new = !all.contains_key(subject);
        if is_new && all.len() >= TROUBLES_MAX {
            return;
        }
        if is_new {
            tracing::warn!("{words}");
        }
        all.insert(subject.to_owned(), Trouble { words, until });
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, Trouble>> {
        self.all.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_pass_and_conditions_stay() {
        let troubles = Troubles::default();
        let now = Instant::now();
        assert_eq!(troubles.first(now), None);
        troubles.begin("b", "lasting".into());
        troubles.event("a", "passing".into());
        assert_eq!(troubles.first(now).unwrap(), "passing");
        assert_eq!(troubles.first(now + SHOWN * 2).unwrap(), "lasting");
        troubles.end("b");
        assert_eq!(troubles.first(now), None);
        for i in 0..100 {
            troubles.event(&format!("{i}"), "many".into());
        }
        assert_eq!(troubles.lock().len(), TROUBLES_MAX);
    }
}
