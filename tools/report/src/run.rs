//! One run from its recording: the messages that the figures and plots need, decoded and in order.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use tangent_recorder::{Contents, RecordedMessage, Recording, Stored};
use tangent_schemas::standard::{Header, PoseStamped};
use tangent_schemas::tangent::{
    ArmState, ContactTruth, ControlState, CoverageState, Health, NormalEstimate, ObjectEstimate,
    ShapingState, WrenchStatus,
};
use tangent_schemas::{Message, cdr};

use crate::error::ReportError;
use crate::tasks::{TaskEntry, tasks};

/// Time before and after a task whose messages belong to it, ns.
pub(crate) const BESIDE_NS: i64 = 1_000_000_000;

/// Messages of which a report is made.
enum Taken {
    Arm(Box<ArmState>),
    Control(Box<ControlState>),
    Shaping(Box<ShapingState>),
    Coverage(Box<CoverageState>),
    Estimate(Box<NormalEstimate>),
    Object(Box<ObjectEstimate>),
    ObjectTruth(Box<PoseStamped>),
    Truth(Box<ContactTruth>),
    Wrench(Box<WrenchStatus>),
    Health(Box<Health>),
}

/// Decodes a message of a type in [`Taken`].
type Decode = fn(&[u8]) -> Result<Taken, cdr::CdrError>;

impl Taken {
    /// How the messages of this type on this key of a cell are decoded; `None` if no report needs
    /// them.
    fn decoder(key: &str, type_name: &str) -> Option<Decode> {
        Some(match type_name {
            ArmState::NAME => |bytes| Ok(Self::Arm(cdr::decode(bytes)?)),
            ControlState::NAME => |bytes| Ok(Self::Control(cdr::decode(bytes)?)),
            ShapingState::NAME => |bytes| Ok(Self::Shaping(cdr::decode(bytes)?)),
            CoverageState::NAME => |bytes| Ok(Self::Coverage(cdr::decode(bytes)?)),
            NormalEstimate::NAME => |bytes| Ok(Self::Estimate(cdr::decode(bytes)?)),
            ObjectEstimate::NAME => |bytes| Ok(Self::Object(cdr::decode(bytes)?)),
            PoseStamped::NAME if key == "truth/object" => {
                |bytes| Ok(Self::ObjectTruth(cdr::decode(bytes)?))
            }
            ContactTruth::NAME => |bytes| Ok(Self::Truth(cdr::decode(bytes)?)),
            WrenchStatus::NAME => |bytes| Ok(Self::Wrench(cdr::decode(bytes)?)),
            Health::NAME => |bytes| Ok(Self::Health(cdr::decode(bytes)?)),
            _ => return None,
        })
    }
}

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
    /// `control/coverage`
    pub coverage: Vec<CoverageState>,
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
            let key = message.topic.trim_start_matches('/');
            if let Some(decode) = Taken::decoder(key, &message.type_name) {
                let taken = decode(&message.bytes);
                run.take_or_count(
                    message.log_time_ns,
                    taken,
                    &mut Growth::default(),
                    &mut said,
                );
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
        run.coverage.sort_by_key(|m| m.header.stamp.to_ns());
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
        self.coverage.retain(|m| within(&m.header));
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
        let key_of = |topic: &str| {
            let topic = topic.trim_start_matches('/');
            topic.strip_prefix(&prefix).map(str::to_owned)
        };
        let select = |held: &Contents<'_>| {
            let key = key_of(held.topic)?;
            Taken::decoder(&key, held.type_name)
        };
        let decode =
            |decode: &Decode, stored: &Stored<'_>| (stored.log_time_ns, decode(stored.bytes));
        let all = recording.decode_selected(select, decode, |read| match read {
            Ok((log_time_ns, taken)) => self.take_or_count(log_time_ns, taken, wrench_lost, said),
            // It is the last one.
            Err(error) => self.damages.push(error.to_string()),
        });
        for held in all {
            if let Some(key) = key_of(&held.topic) {
                let entry = self.topics.entry(format!("/{key}"));
                entry.or_insert((held.type_name, 0)).1 += held.count;
            }
        }
        Ok(())
    }

    /// Takes a message of the cell, or counts one that could not be decoded.
    fn take_or_count(
        &mut self,
        log_time_ns: u64,
        taken: Result<Taken, cdr::CdrError>,
        wrench_lost: &mut Growth,
        said: &mut BTreeMap<String, String>,
    ) {
        match taken {
            Ok(taken) => self.take(log_time_ns, taken, wrench_lost, said),
            Err(_) => self.undecodable += 1,
        }
    }

    fn take(
        &mut self,
        log_time_ns: u64,
        taken: Taken,
        wrench_lost: &mut Growth,
        said: &mut BTreeMap<String, String>,
    ) {
        match taken {
            Taken::Arm(state) => {
                let why = state.not_ready_reason.as_str();
                note(&mut self.faults, said, log_time_ns, "robot", why);
                self.arm.push(*state);
            }
            Taken::Control(state) => {
                let fault = state.fault.as_str();
                note(&mut self.faults, said, log_time_ns, "controller", fault);
                note_ages(&mut self.ages_s, &state);
                self.control.push(*state);
            }
            Taken::Shaping(state) => self.shaping.push(*state),
            Taken::Coverage(state) => self.coverage.push(*state),
            Taken::Estimate(estimate) => {
                list_of(&mut self.estimates, estimate.estimator.as_str()).push(*estimate);
            }
            Taken::Object(estimate) => {
                list_of(&mut self.objects, estimate.estimator.as_str()).push(*estimate);
            }
            Taken::ObjectTruth(pose) => self.object_truth.push(*pose),
            Taken::Truth(truth) => self.truth.push(*truth),
            Taken::Wrench(status) => wrench_lost.add(status.records_lost),
            Taken::Health(health) => {
                let source = health.service.to_string();
                note(&mut self.faults, said, log_time_ns, &source, &health.fault);
                self.health.insert(source, *health);
            }
        }
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
            list_of(ages_s, name.as_str()).push(*age_s);
        }
    }
}

/// The list of this name, without a copy of the name if there is one.
fn list_of<'a, T>(lists: &'a mut BTreeMap<String, Vec<T>>, name: &str) -> &'a mut Vec<T> {
    if !lists.contains_key(name) {
        lists.insert(name.to_owned(), Vec::new());
    }
    lists.get_mut(name).expect("it was just inserted")
}

fn note(
    faults: &mut Vec<(i64, String)>,
    said: &mut BTreeMap<String, String>,
    log_time_ns: u64,
    source: &str,
    text: &str,
) {
    if said.get(source).map_or("", String::as_str) != text {
        said.insert(source.to_owned(), text.to_owned());
        if !text.is_empty() {
            let at = i64::try_from(log_time_ns).unwrap_or(i64::MAX);
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
