//! Limit on the number of keys that a reader of patterns follows. Any publisher can invent keys;
//! each costs its reader memory, and a recorder a channel of its file.

use std::collections::{BTreeMap, HashSet};

/// Largest number of keys under each topic of a cell, such as `estimate/`, and under all unknown
/// first words together.
pub(crate) const KEYS_MAX: usize = 256;

/// First words of a cell's own topics. Unknown first words are counted apart, so that invented keys
/// cannot use up the limit of these topics.
const TOPICS: [&str; 16] = [
    "arm",
    "base",
    "camera",
    "control",
    "driver",
    "estimate",
    "health",
    "joint_states",
    "markers",
    "robot_description",
    "simulator",
    "tf",
    "tf_static",
    "truth",
    "wrench",
    "param",
];

/// The keys that a reader follows.
#[derive(Debug, Default)]
pub(crate) struct Keys {
    known: HashSet<Box<str>>,
    /// Number of keys in each group.
    groups: BTreeMap<Box<str>, usize>,
    /// Whether the keys begin with a cell's name.
    outside: bool,
    refused: u64,
    /// The key that was refused last.
    last: Option<Box<str>>,
}

impl Keys {
    /// For a bus within a cell, or outside any.
    pub(crate) fn new(outside: bool) -> Self {
        Self {
            outside,
            ..Self::default()
        }
    }

    /// Whether a message on this key is taken.
    pub(crate) fn admit(&mut self, key: &str) -> bool {
        if self.known.contains(key) {
            return true;
        }
        let group = self.group(key);
        let count = self.groups.entry(group.into()).or_default();
        if *count >= KEYS_MAX {
            if self.refused == 0 {
                tracing::warn!(
                    "`{key}` and further new keys are refused: {KEYS_MAX} keys under `{group}/` are already followed (logged once)"
                );
            }
            self.refused += 1;
            self.last = Some(key.into());
            return false;
        }
        *count += 1;
        self.known.insert(key.into());
        true
    }

    /// Group of a key: the topic's first word, with the cell's name if the keys have one; one group
    /// for all unknown words.
    fn group<'k>(&self, key: &'k str) -> &'k str {
        let cell = match self.outside {
            true => key.find('/').map_or(0, |at| at + 1),
            false => 0,
        };
        let word = key[cell..].split('/').next().unwrap_or_default();
        match TOPICS.contains(&word) {
            true => word,
            false => "*",
        }
    }

    /// Number of messages refused.
    pub(crate) fn refused(&self) -> u64 {
        self.refused
    }

    /// Text for a person; `None` while no message was refused.
    pub(crate) fn remark(&self) -> Option<String> {
        let last = self.last.as_ref()?;
        Some(format!(
            "{} messages on keys that are not followed were refused, the last on `{last}`: which program publishes there?",
            self.refused
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_of_keys_takes_no_place_of_others() {
        let mut keys = Keys::new(false);
        let taken = (0..70_000)
            .filter(|i| keys.admit(&format!("estimate/e{i}/normal")))
            .count();
        assert_eq!(taken, KEYS_MAX);
        let taken = (0..70_000)
            .filter(|i| keys.admit(&format!("x{i}/y")))
            .count();
        assert_eq!(taken, KEYS_MAX);
        assert_eq!(keys.refused(), 140_000 - 2 * KEYS_MAX as u64);
        assert!(keys.remark().unwrap().contains("`x69999/y`"));
        // Known keys are still admitted, and so are new keys of other topics.
        assert!(keys.admit("estimate/e0/normal") && keys.admit("arm/state"));
        assert!(keys.known.len() <= 2 * KEYS_MAX + 1 && keys.groups.len() <= 3);

        let mut keys = Keys::new(true);
        assert!((0..KEYS_MAX).all(|i| keys.admit(&format!("cell1/estimate/e{i}/normal"))));
        assert!(!keys.admit("cell1/estimate/more/normal") && keys.admit("cell1/wrench/tool"));
    }
}
