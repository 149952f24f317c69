//! History of the requests to a cell, their outcomes, and the cell's behaviour meanwhile; outcomes
//! and behaviour are checked against each other.
//!
//! A refused request has no effect. One that was done has its effect. For one without an answer,
//! the effect is unknown, but it can only occur within the request's budget.

use std::collections::{BTreeMap, BTreeSet};

use tangent_schemas::tangent::{ContactTruth, ControlState};

use crate::cell::{Seen, seconds, speed};

/// Kind of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    Start,
    Stop,
    Pause,
    Resume,
    Select,
    Set,
    Tare,
}

/// Outcome as the client received it.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// With the number of the task start, where the answer holds one.
    Done(Option<u64>),
    Refused(String),
    Unknown(String),
}

/// One request with its outcome. Times on the clock of this host, ns.
#[derive(Clone, Debug)]
pub struct Operation {
    pub number: usize,
    pub kind: Kind,
    pub asked_ns: i64,
    pub told_ns: i64,
    pub outcome: Outcome,
    /// Time after the request within which it may have an effect, ns.
    pub budget_ns: i64,
}

impl Operation {
    fn is_refused(&self) -> bool {
        matches!(self.outcome, Outcome::Refused(_))
    }

    fn is_done(&self) -> bool {
        matches!(self.outcome, Outcome::Done(_))
    }

    /// Until when it may have had an effect.
    fn until_ns(&self) -> i64 {
        match self.outcome {
            Outcome::Refused(_) => i64::MIN,
            Outcome::Done(_) => self.told_ns,
            Outcome::Unknown(_) => self.asked_ns + self.budget_ns,
        }
    }

    /// It may have had an effect at this time.
    fn explains(&self, at_ns: i64) -> bool {
        self.asked_ns <= at_ns && at_ns <= self.until_ns().saturating_add(SLACK_NS)
    }
}

/// Name of the task of a start.
pub fn task_name(number: usize) -> String {
    format!("r{number}")
}

/// Force that a request sets, N: each its own. Near 3 N, so that it does not matter for the
/// contact.
pub fn force_n(number: usize) -> f64 {
    3.0 + 1e-5 * (number + 1) as f64
}

/// Additional time of a process that was stopped between accepting a request and reporting it, ns.
const SLACK_NS: i64 = 1_500_000_000;
/// Time around a fault in which an effect may not have been observed, ns.
const NEAR_NS: i64 = 2_500_000_000;
/// Time in which a change is published on a loaded machine.
const SEEN_NS: i64 = 500_000_000;
/// Time in which the arm comes to rest after a pause.
const REST_NS: i64 = 500_000_000;

/// Everything that was recorded.
pub struct History {
    pub operations: Vec<Operation>,
    /// Start and end of each time in which a process was stopped or absent.
    pub faults: Vec<(i64, i64)>,
    pub states: Vec<Seen<ControlState>>,
    pub truths: Vec<Seen<ContactTruth>>,
    /// Times at which the sensor's zero changed, ns.
    pub zeros: Vec<i64>,
}

/// How much was checked.
#[derive(Debug, Default)]
pub struct Checked {
    pub operations: usize,
    pub done: usize,
    pub refused: usize,
    pub unknown: usize,
    pub effects: usize,
    pub excused: usize,
    pub pauses: usize,
    pub rests: usize,
}

impl History {
    /// Every violation as text, and the number of checks.
    pub fn check(&self) -> (Vec<String>, Checked) {
        let mut wrong = Vec::new();
        let mut checked = Checked {
            operations: self.operations.len(),
            done: self.operations.iter().filter(|o| o.is_done()).count(),
            refused: self.operations.iter().filter(|o| o.is_refused()).count(),
            ..Checked::default()
        };
        checked.unknown = checked.operations - checked.done - checked.refused;
        self.check_starts(&mut wrong, &mut checked);
        self.check_forces(&mut wrong, &mut checked);
        self.check_changes(&mut wrong, &mut checked);
        self.check_pauses(&mut wrong, &mut checked);
        self.check_rest(&mut wrong, &mut checked);
        (wrong, checked)
    }

    fn of(&self, kind: Kind) -> impl Iterator<Item = &Operation> {
        self.operations.iter().filter(move |o| o.kind == kind)
    }

    fn near_a_fault(&self, from_ns: i64, until_ns: i64) -> bool {
        self.faults
            .iter()
            .any(|(from, until)| *from < until_ns + NEAR_NS && *until + NEAR_NS > from_ns)
    }

    /// Each start has a task of its own name.
    fn check_starts(&self, wrong: &mut Vec<String>, checked: &mut Checked) {
        let mut seen: BTreeMap<&str, BTreeSet<u64>> = BTreeMap::new();
        for state in &self.states {
            let message = &state.message;
            seen.entry(message.task.as_str())
                .or_default()
                .insert(message.activation);
        }
        for start in self.of(Kind::Start) {
            let name = task_name(start.number);
            let activations = seen.get(name.as_str());
            match (&start.outcome, activations) {
                (Outcome::Refused(why), Some(_)) => {
                    wrong.push(format!("start {name} ran, but was refused: {why}"));
                }
                (Outcome::Done(Some(told)), Some(ran)) => {
                    checked.effects += 1;
                    if !ran.contains(told) {
                        wrong.push(format!("start {name} was told {told} and ran as {ran:?}"));
                    }
                }
                (Outcome::Done(_), None) => {
                    if self.near_a_fault(start.asked_ns, start.told_ns) {
                        checked.excused += 1;
                    } else {
                        wrong.push(format!("start {name} was done and never ran"));
                    }
                }
                _ => {}
            }
        }
    }

    /// Each set has a value of its own.
    fn check_forces(&self, wrong: &mut Vec<String>, checked: &mut Checked) {
        let values: BTreeMap<u64, &Operation> = self
            .of(Kind::Set)
            .map(|o| (force_n(o.number).to_bits(), o))
            .collect();
        let mut seen = BTreeSet::new();
        for state in &self.states {
            let value = state.message.force_reference_n;
            if !seen.insert(value.to_bits()) || value == 0.0 || value == 3.0 {
                continue;
            }
            match values.get(&value.to_bits()) {
                Some(set) if !set.is_refused() => checked.effects += 1,
                Some(set) => wrong.push(format!("{value} N came into force, but {set:?}")),
                None => wrong.push(format!("{value} N came into force and was never asked for")),
            }
        }
    }

    /// Every change that only a request can cause has its own request that was not refused.
    fn check_changes(&self, wrong: &mut Vec<String>, checked: &mut Checked) {
        let mut used = BTreeSet::new();
        let mut expect = |kinds: &[Kind], at_ns: i64, what: String| {
            checked.effects += 1;
            // A request has one effect. Changes come in the order of time, so each takes the
            // request that can explain others for the shortest time: if there is an assignment,
            // this finds one.
            let explains = self
                .operations
                .iter()
                .filter(|o| kinds.contains(&o.kind))
                .filter(|o| o.explains(at_ns) && !used.contains(&o.number));
            match explains.min_by_key(|o| o.until_ns()) {
                Some(operation) => {
                    used.insert(operation.number);
                }
                None => wrong.push(format!(
                    "{what} at {at_ns}, and none of {kinds:?} is left that explains it"
                )),
            }
        };
        for pair in self.states.windows(2) {
            let (before, after) = (&pair[0].message, &pair[1].message);
            let at_ns = pair[1].at_ns;
            let what = |change: &str| format!("{change} in {} ({})", after.task, after.phase_text);
            if after.task != before.task || after.activation != before.activation {
                continue;
            }
            let ended = |s: &ControlState| matches!(s.phase_text.as_str(), "done" | "fault");
            let left = |s: &ControlState| matches!(s.phase_text.as_str(), "retract" | "done");
            let departs = !left(before) && !ended(before) && left(after);
            let leaves = departs && after.fault.is_empty();
            if !before.paused && after.paused {
                expect(&[Kind::Pause], at_ns, what("paused"));
            }
            if departs && before.fault.is_empty() && !after.fault.is_empty() {
                // A fault takes the tool off without a request, and a pause ends with that.
            } else if before.paused && leaves {
                // A task that is stopped, or that was paused while it left and goes on.
                expect(&[Kind::Stop, Kind::Resume], at_ns, what("left"));
            } else if before.paused && !after.paused && !ended(after) {
                expect(&[Kind::Resume], at_ns, what("resumed"));
            } else if leaves {
                expect(&[Kind::Stop], at_ns, what("stopped"));
            }
            let asked = |s: &ControlState| {
                let cause = s.estimator_cause.as_str();
                cause.starts_with("asked") || cause.starts_with("forced")
            };
            if after.estimator_switches > before.estimator_switches && asked(after) {
                expect(&[Kind::Select], at_ns, what("switched"));
            }
        }
        for at_ns in &self.zeros {
            expect(&[Kind::Tare], *at_ns, "another zero".to_owned());
        }
    }

    /// A pause that was done is seen: between the request and a moment after its answer the task is
    /// paused.
    fn check_pauses(&self, wrong: &mut Vec<String>, checked: &mut Checked) {
        for pause in self.of(Kind::Pause).filter(|o| o.is_done()) {
            let until_ns = pause.told_ns + SEEN_NS;
            // Two requests of one cycle leave one state behind.
            let undone = self.operations.iter().any(|o| {
                matches!(o.kind, Kind::Stop | Kind::Resume)
                    && o.asked_ns <= pause.told_ns
                    && o.until_ns() >= pause.asked_ns
            });
            if undone || self.near_a_fault(pause.asked_ns, until_ns) {
                continue;
            }
            checked.pauses += 1;
            let from = self.states.partition_point(|s| s.at_ns < pause.asked_ns);
            let meanwhile = self.states[from..]
                .iter()
                .take_while(|s| s.at_ns <= until_ns);
            let mut paused = meanwhile.map(|s| s.message.paused);
            if !paused.any(|paused| paused) {
                wrong.push(format!("pause {} was done and never seen", pause.number));
            }
        }
    }

    /// After a pause the arm is at rest until the next request, according to the simulator's truth.
    fn check_rest(&self, wrong: &mut Vec<String>, checked: &mut Checked) {
        for pause in self.of(Kind::Pause).filter(|o| o.is_done()) {
            let from = pause.told_ns + REST_NS;
            let until = self
                .operations
                .iter()
                .filter(|o| o.number != pause.number && !o.is_refused())
                .filter(|o| o.kind != Kind::Pause && o.until_ns() > pause.asked_ns)
                .map(|o| o.asked_ns)
                .min();
            let until = until.unwrap_or(i64::MAX).min(from + 1_000_000_000);
            if until < from || self.near_a_fault(pause.asked_ns, until) {
                continue;
            }
            let mut fastest = 0.0_f64;
            for truth in &self.truths {
                if (from..until).contains(&truth.at_ns) {
                    checked.rests += 1;
                    fastest = fastest.max(speed(&truth.message));
                }
            }
            if fastest > 3e-3 {
                wrong.push(format!(
                    "{:.4} m/s within {:.2} s after pause {}",
                    fastest,
                    seconds(until - pause.told_ns),
                    pause.number
                ));
            }
        }
    }
}
