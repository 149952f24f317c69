//! One run from its recording: the messages that the figures and plots need, decoded and in order.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::mpsc::sync_channel;

use tangent_recorder::{Contents, RecordedMessage, RecorderError, Recording};
use tangent_schemas::standard::{Header, PoseStamped};
use tangent_schemas::tangent::{
    ArmState, ContactTruth, ControlState, Health, NormalEstimate, ObjectEstimate, ShapingState,
    WrenchStatus,
};
use tangent_schemas::{Message, cdr};

use crate::error::ReportError;
use crate::tasks::{TaskEntry, tasks};

/// Time before and after a task whose messages belong to it, ns.
pub(crate) const BESIDE_NS: i64 = 1_000_000_000;

/// Messages that are passed on from unpacking to decoding together, and how often that many may
/// wait.
const SENT_TOGETHER: usize = 512;
const QUEUED: usize = 8;
/// Types of the messages that [`Run::take`] decodes.
const TAKEN: [&str; 9] = [
    ArmState::NAME,
    ControlState::NAME,
    ShapingState::NAME,
    NormalEstimate::NAME,
    ObjectEstimate::NAME,
    PoseStamped::NAME,
    ContactTruth::NAME,
    WrenchStatus::NAME,
    Health::NAME,
];

/// Contents of the recording of one run, from one file or several.
#[derive(Default)]
pub struct Run {
    /// Files, in order.
    pub files: Vec<PathBuf>,
    /// Files that lack their end.
    pub truncated: Vec<PathBuf>,
    /// Damage inside a file; the rest of that file was not read.
    pub damages: Vec<String>,
    /// Tables stored in the recording, by name; if a name occurs repeatedly, the last one counts.
    pub tables: BTreeMap<String, BTreeMap<String, String>>,
    /// Files stored in the recording, by name.
    pub attachments: BTreeMap<String, String>,
    /// `arm/state`
    pub arm: Vec<ArmState>,
    /// `control/state`
    pub control: Vec<ControlState>,
    /// `control/shaping`
    pub shaping: Vec<ShapingState>,
    /// `estimate/NAME/normal` by estimator.
    pub estimates: BTreeMap<String, Vec<NormalEstimate>>,
    /// Age of each estimator's newest estimate at use, s, as the controller reported in each of its
    /// cycles.
    pub ages_s: BTreeMap<String, Vec<f64>>,
    /// `estimate/NAME/object` by estimator.
    pub objects: BTreeMap<String, Vec<ObjectEstimate>>,
    /// `truth/contact`
    pub truth: Vec<ContactTruth>,
    /// `truth/object`
    pub object_truth: Vec<PoseStamped>,
    /// Number of sensor records lost during the recording.
    pub wrench_records_lost: Option<u64>,
    /// Last health message of each service.
    pub health: BTreeMap<String, Health>,
    /// Faults with their time (ns since the Unix epoch): each text once per occurrence.
    pub faults: Vec<(i64, String)>,
    /// Type and number of messages by topic.
    pub topics: BTreeMap<String, (String, u64)>,
    /// Number of messages that could not be decoded.
    pub undecodable: u64,
    /// All tasks, in order.
    pub tasks: Vec<TaskEntry>,
    /// Number of the only task whose messages are kept, see [`Run::keep_task`].
    pub kept: Option<usize>,
}

impl Run {
    /// Reads the files of one run.
    ///
    /// # Errors
    /// A file cannot be read, is not a recording, or holds no messages of a tangent cell.
    pub fn read(paths: &[PathBuf], cell: Option<&str>) -> Result<Self, ReportError> {
        let mut run = Self::default();
        let mut wrench_lost = Growth::default();
        let mut said = BTreeMap::new();
        for path in paths {
            run.read_file(path, cell, &mut wrench_lost, &mut said)?;
        }
        if run.arm.is_empty() && run.control.is_empty() {
            let topics: Vec<&str> = run.topics.keys().take(8).map(String::as_str).collect();
            let found = if topics.is_empty() {
                "no message at all".to_owned()
            } else {
                format!("these topics: {}", topics.join(", "))
            };
            let names: Vec<_> = paths.iter().map(|p| p.display().to_string()).collect();
            return Err(ReportError::NoCell {
                files: names.join(", "),
                found,
            });
        }
        run.wrench_records_lost = wrench_lost.seen.then_some(wrench_lost.total);
        run.sort();
        Ok(run)
    }

    /// Builds a run from the messages of a live cell, in the order of arrival.
    pub fn heard(messages: &[RecordedMessage]) -> Self {
        let mut run = Self::default();
        let mut said = BTreeMap::new();
        for message in messages {
            if run
                .take(message, &mut Growth::default(), &mut said)
                .is_err()
            {
                run.undecodable += 1;
            }
        }
        run.sort();
        run
    }

    fn sort(&mut self) {
        let run = self;
        run.arm.sort_by_key(|m| m.header.stamp.to_ns());
        run.control.sort_by_key(|m| m.header.stamp.to_ns());
        run.shaping.sort_by_key(|m| m.header.stamp.to_ns());
        run.truth.sort_by_key(|m| m.header.stamp.to_ns());
        run.object_truth.sort_by_key(|m| m.header.stamp.to_ns());
        for objects in run.objects.values_mut() {
            objects.sort_by_key(|m| m.header.stamp.to_ns());
        }
        for estimates in run.estimates.values_mut() {
            estimates.sort_by_key(|m| m.header.stamp.to_ns());
        }
        run.tasks = tasks(&run.control);
    }

    /// Keeps only the messages of one task, by its number from 1, and of a second before and after
    /// it. Counts of the recording as a whole are not changed.
    ///
    /// # Errors
    /// The recording has no such task.
    pub fn keep_task(&mut self, number: usize) -> Result<(), ReportError> {
        let place = number.checked_sub(1).and_then(|i| self.tasks.get(i));
        let Some(states) = place.map(|task| task.states.clone()) else {
            let known: Vec<String> = self.tasks.iter().map(TaskEntry::words).collect();
            return Err(ReportError::NoTask {
                number,
                tasks: if known.is_empty() {
                    "no task".to_owned()
                } else {
                    known.join(", ")
                },
            });
        };
        self.control.truncate(states.end);
        self.control.drain(..states.start);
        let stamp = |state: Option<&ControlState>| state.map_or(0, |s| s.header.stamp.to_ns());
        let from_ns = stamp(self.control.first()) - BESIDE_NS;
        let to_ns = stamp(self.control.last()) + BESIDE_NS;
        let within = |header: &Header| (from_ns..=to_ns).contains(&header.stamp.to_ns());
        self.arm.retain(|m| within(&m.header));
        self.shaping.retain(|m| within(&m.header));
        self.truth.retain(|m| within(&m.header));
        self.object_truth.retain(|m| within(&m.header));
        for objects in self.objects.values_mut() {
            objects.retain(|m| within(&m.header));
        }
        for estimates in self.estimates.values_mut() {
            estimates.retain(|m| within(&m.header));
        }
        self.ages_s.clear();
        for state in &self.control {
            note_ages(&mut self.ages_s, state);
        }
        self.kept = Some(number);
        Ok(())
    }

    fn read_file(
        &mut self,
        path: &Path,
        cell: Option<&str>,
        wrench_lost: &mut Growth,
        said: &mut BTreeMap<String, String>,
    ) -> Result<(), ReportError> {
        let recording = Recording::open(path).map_err(ReportError::NotARecording)?;
        self.files.push(path.to_owned());
        if recording.is_truncated() {
            self.truncated.push(path.to_owned());
        }
        self.tables.extend(recording.metadata().clone());
        let prefix = prefix_of(path, &recording, cell)?;
        for (name, text) in recording.attachments() {
            let name = name.strip_prefix(&prefix).unwrap_or(name);
            self.attachments.insert(name.to_owned(), text.clone());
        }
        // Unpacking and decoding take about the same time: each has a thread.
        let (send, received) = sync_channel::<Vec<_>>(QUEUED);
        std::thread::scope(|scope| {
            let (recording, prefix) = (&recording, prefix.as_str());
            let reading = scope.spawn(move || {
                let mut topics = BTreeMap::<String, (String, u64)>::new();
                let wanted = |held: &Contents<'_>| {
                    let topic = held.topic.trim_start_matches('/');
                    let Some(key) = topic.strip_prefix(prefix) else {
                        return false;
                    };
                    match topics.get_mut(key) {
                        Some((_, count)) => *count += held.count,
                        None => {
                            topics.insert(key.to_owned(), (held.type_name.to_owned(), held.count));
                        }
                    }
                    TAKEN.contains(&held.type_name)
                };
                let mut messages = recording.try_messages_where(wanted);
                loop {
                    let some: Vec<_> = messages.by_ref().take(SENT_TOGETHER).collect();
                    if some.is_empty() || send.send(some).is_err() {
                        break;
                    }
                }
                drop(messages);
                topics
            });
            for message in received.into_iter().flatten() {
                self.take_or_count(message, prefix, wrench_lost, said);
            }
            let joined = reading.join();
            for (key, (type_name, count)) in
                joined.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            {
                let entry = self.topics.entry(format!("/{key}"));
                entry.or_insert((type_name, 0)).1 += count;
            }
        });
        Ok(())
    }

    /// Takes a message of the cell with this prefix, or notes why not.
    fn take_or_count(
        &mut self,
        message: Result<RecordedMessage, RecorderError>,
        prefix: &str,
        wrench_lost: &mut Growth,
        said: &mut BTreeMap<String, String>,
    ) {
        match message {
            Ok(mut message) => {
                if !prefix.is_empty() {
                    let topic = message.topic.trim_start_matches('/');
                    let key = topic.strip_prefix(prefix).unwrap_or(topic);
                    message.topic = format!("/{key}");
                }
                if self.take(&message, wrench_lost, said).is_err() {
                    self.undecodable += 1;
                }
            }
            // It is the last one.
            Err(error) => self.damages.push(error.to_string()),
        }
    }

    fn take(
        &mut self,
        message: &RecordedMessage,
        wrench_lost: &mut Growth,
        said: &mut BTreeMap<String, String>,
    ) -> Result<(), cdr::CdrError> {
        let bytes = &message.bytes;
        let mut fault = None;
        match message.type_name.as_str() {
            ArmState::NAME => {
                let state: ArmState = cdr::decode(bytes)?;
                fault = Some(("robot", state.not_ready_reason.to_string()));
                self.arm.push(state);
            }
            ControlState::NAME => {
                let state: ControlState = cdr::decode(bytes)?;
                fault = Some(("controller", state.fault.to_string()));
                note_ages(&mut self.ages_s, &state);
                self.control.push(state);
            }
            ShapingState::NAME => self.shaping.push(cdr::decode(bytes)?),
            NormalEstimate::NAME => {
                let estimate: NormalEstimate = cdr::decode(bytes)?;
                let name = estimate.estimator.to_string();
                self.estimates.entry(name).or_default().push(estimate);
            }
            ObjectEstimate::NAME => {
                let estimate: ObjectEstimate = cdr::decode(bytes)?;
                let name = estimate.estimator.to_string();
                self.objects.entry(name).or_default().push(estimate);
            }
            PoseStamped::NAME if message.topic == "/truth/object" => {
                self.object_truth.push(cdr::decode(bytes)?);
            }
            ContactTruth::NAME => self.truth.push(cdr::decode(bytes)?),
            WrenchStatus::NAME => {
                let status: WrenchStatus = cdr::decode(bytes)?;
                wrench_lost.add(status.records_lost);
            }
            Health::NAME => {
                let health: Health = cdr::decode(bytes)?;
                let source = health.service.to_string();
                note(&mut self.faults, said, message, &source, &health.fault);
                self.health.insert(source, health);
            }
            _ => {}
        }
        if let Some((source, text)) = fault {
            note(&mut self.faults, said, message, source, &text);
        }
        Ok(())
    }

    /// Value of a fact that was given to the recorder, for instance `scenario`.
    pub fn fact(&self, name: &str) -> Option<&str> {
        self.tables
            .get("tangent")?
            .get(name)
            .map(String::as_str)
            .filter(|value| !value.is_empty())
    }

    /// Last value of a figure in a service's health.
    pub fn figure(&self, service: &str, name: &str) -> Option<f64> {
        let health = self.health.get(service)?;
        let at = health.figure_names.iter().position(|n| n == name)?;
        health.figures.get(at).copied()
    }

    /// Number of messages missing in the recording, by the recorder's own count.
    pub fn messages_dropped(&self) -> Option<u64> {
        let counted = self.tables.get("losses").map(|losses| {
            // Older recorders, which did not request messages again, counted losses in the queue
            // separately.
            let apart = if losses.contains_key("recovered") {
                &["disk_refused", "missing"][..]
            } else {
                &["queue_dropped", "disk_refused", "missing"]
            };
            apart
                .iter()
                .filter_map(|name| losses.get(*name)?.parse::<u64>().ok())
                .sum()
        });
        // A recorder that was killed reported its count last in its health message.
        counted.or_else(|| self.health.get("recorder").map(|health| health.lost))
    }
}

/// Prefix of the requested cell's topics; empty in a recording of one cell.
fn prefix_of(
    path: &Path,
    recording: &Recording,
    cell: Option<&str>,
) -> Result<String, ReportError> {
    let cells: Vec<&str> = recording
        .metadata()
        .get("tangent")
        .and_then(|facts| facts.get("cells"))
        .map(|names| names.split(',').collect())
        .unwrap_or_default();
    match cell {
        _ if cells.is_empty() => Ok(String::new()),
        Some(name) if cells.contains(&name) => Ok(format!("{name}/")),
        None if cells.len() == 1 => Ok(format!("{}/", cells[0])),
        _ => Err(ReportError::WhichCell {
            file: path.to_owned(),
            cells: cells.join(", "),
        }),
    }
}

fn note_ages(ages_s: &mut BTreeMap<String, Vec<f64>>, state: &ControlState) {
    for (name, age_s) in state.estimators.iter().zip(&state.estimate_ages_s) {
        if *age_s >= 0.0 {
            ages_s.entry(name.to_string()).or_default().push(*age_s);
        }
    }
}

fn note(
    faults: &mut Vec<(i64, String)>,
    said: &mut BTreeMap<String, String>,
    message: &RecordedMessage,
    source: &str,
    text: &str,
) {
    if said.get(source).map_or("", String::as_str) != text {
        said.insert(source.to_owned(), text.to_owned());
        if !text.is_empty() {
            let at = i64::try_from(message.log_time_ns).unwrap_or(i64::MAX);
            faults.push((at, format!("{source}: {text}")));
        }
    }
}

/// Growth of a counter during the observation, across restarts of its service.
#[derive(Default)]
pub struct Growth {
    last: u64,
    /// Sum of all growth.
    pub total: u64,
    /// Whether there was at least one value.
    pub seen: bool,
}

impl Growth {
    /// Adds the counter's next value.
    pub fn add(&mut self, value: u64) {
        if self.seen {
            self.total += value.checked_sub(self.last).unwrap_or(value);
        }
        self.seen = true;
        self.last = value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_counter_is_followed_across_restarts() {
        let mut growth = Growth::default();
        for value in [5, 5, 7, 0, 1, 1, 4] {
            growth.add(value);
        }
        assert_eq!(growth.total, 6);
    }
}
