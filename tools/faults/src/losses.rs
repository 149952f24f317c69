//! Finds messages missing in a recording, by their publishers' own counters, and when they were
//! lost.

use std::collections::BTreeMap;
use std::path::Path;

use tangent_recorder::Recording;

use crate::error::Result;

/// A gap in one topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Gap {
    /// Topic with its leading slash.
    pub topic: String,
    /// Time at which the last message before the gap was received, ns since the Unix epoch.
    pub from_ns: i64,
    /// Time at which the first message after the gap was received, ns since the Unix epoch.
    pub to_ns: i64,
    /// Number of missing messages.
    pub messages: u64,
}

impl Gap {
    /// Whether the gap overlaps this span.
    pub fn within(&self, from_ns: i64, to_ns: i64) -> bool {
        self.from_ns <= to_ns && self.to_ns >= from_ns
    }
}

#[derive(Default)]
struct Heard {
    sequence: u32,
    at_ns: i64,
}

/// Every gap in all recordings of a folder. A publisher that restarts counts from one, which is no
/// gap.
///
/// # Errors
/// A file cannot be read.
pub fn gaps(folder: &Path) -> Result<Vec<Gap>> {
    let mut files: Vec<_> = std::fs::read_dir(folder)?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|e| e == "mcap"))
        .collect();
    files.sort();
    let mut heard: BTreeMap<String, Heard> = BTreeMap::new();
    let mut found = Vec::new();
    for file in files {
        for message in Recording::open(&file)?.messages() {
            let at_ns = i64::try_from(message.log_time_ns).unwrap_or(i64::MAX);
            note(
                &mut heard,
                &mut found,
                &message.topic,
                message.sequence,
                at_ns,
            );
        }
    }
    Ok(found)
}

fn note(
    heard: &mut BTreeMap<String, Heard>,
    found: &mut Vec<Gap>,
    topic: &str,
    sequence: u32,
    at_ns: i64,
) {
    if let Some(before) = heard.get_mut(topic) {
        if sequence > before.sequence.saturating_add(1) {
            found.push(Gap {
                topic: topic.to_owned(),
                from_ns: before.at_ns,
                to_ns: at_ns,
                messages: u64::from(sequence - before.sequence - 1),
            });
        }
        *before = Heard { sequence, at_ns };
    } else {
        heard.insert(topic.to_owned(), Heard { sequence, at_ns });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_is_found_and_a_restart_is_no_gap() {
        let (mut heard, mut found) = (BTreeMap::new(), Vec::new());
        for (sequence, at_ns) in [(7, 10), (8, 20), (12, 60), (1, 70), (2, 80)] {
            note(&mut heard, &mut found, "/a", sequence, at_ns);
            note(&mut heard, &mut found, "/b", 5, at_ns);
        }
        let gap = Gap {
            topic: "/a".into(),
            from_ns: 20,
            to_ns: 60,
            messages: 3,
        };
        assert!(gap.within(55, 90) && gap.within(0, 20) && !gap.within(61, 90));
        assert_eq!(found, [gap]);
    }
}
