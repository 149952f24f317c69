//! Queries other services for data that are stored with their messages, without delaying the disk.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use serde::Deserialize;
use tangent_runtime::Bus;
use tangent_schemas::tangent::Request;
use tangent_schemas::topics::queries;

use crate::RecorderError;

/// Time that services have to answer.
const PATIENCE: Duration = Duration::from_millis(800);

/// What to query.
enum Question {
    Parameters,
    Task { prefix: String, activation: u64 },
}

/// Result of a query.
#[derive(Debug, PartialEq)]
pub(crate) enum Finding {
    /// Value with unit, by `SERVICE/NAME`; with several cells, the cell's name comes first.
    Parameters(BTreeMap<String, String>),
    /// The task of an activation, as TOML.
    Task {
        /// Prefix of the cell's keys.
        prefix: String,
        activation: u64,
        toml: String,
    },
}

/// Thread that sends the queries; it ends when this value is dropped.
pub(crate) struct Inquirer {
    questions: Option<Sender<Question>>,
    findings: Receiver<Finding>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Inquirer {
    /// `prefixes` are those of each cell's keys.
    pub(crate) fn start(bus: Bus, prefixes: Vec<String>) -> Result<Self, RecorderError> {
        let (questions, asked) = channel();
        let (found, findings) = channel();
        let thread = std::thread::Builder::new()
            .name("recorder-ask".to_owned())
            .spawn(move || {
                for question in asked {
                    if let Some(finding) = find_out(&bus, &prefixes, &question)
                        && found.send(finding).is_err()
                    {
                        return;
                    }
                }
            })
            .map_err(|source| RecorderError::Thread { source })?;
        Ok(Self {
            questions: Some(questions),
            findings,
            thread: Some(thread),
        })
    }

    pub(crate) fn ask_parameters(&self) {
        self.ask(Question::Parameters);
    }

    pub(crate) fn ask_task(&self, prefix: String, activation: u64) {
        self.ask(Question::Task { prefix, activation });
    }

    fn ask(&self, question: Question) {
        if let Some(questions) = &self.questions {
            // If the thread has ended, nothing is queried; the recording continues without.
            let _ = questions.send(question);
        }
    }

    /// Results since the last call.
    pub(crate) fn findings(&self) -> impl Iterator<Item = Finding> + '_ {
        self.findings.try_iter()
    }

    /// Waits until every query is answered or given up.
    pub(crate) fn finish(&mut self) -> Vec<Finding> {
        self.questions = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the recorder's query thread panicked");
        }
        self.findings.try_iter().collect()
    }
}

fn find_out(bus: &Bus, prefixes: &[String], question: &Question) -> Option<Finding> {
    match question {
        Question::Parameters => {
            let request = Request {
                action: "list".to_owned(),
                argument: String::new(),
            };
            let mut table = BTreeMap::new();
            for prefix in prefixes {
                let key = format!("{prefix}{}", queries::parameters("*"));
                let answers = bus
                    .ask_all(&key, &request, PATIENCE)
                    .map_err(|error| tracing::warn!("parameters are not recorded: {error}"))
                    .ok()?;
                let listed = answers
                    .iter()
                    .flat_map(|(_, answer)| parameters(&answer.data));
                table.extend(listed.map(|(name, value)| (format!("{prefix}{name}"), value)));
            }
            Some(Finding::Parameters(table))
        }
        Question::Task { prefix, activation } => {
            let request = Request {
                action: "show".to_owned(),
                argument: String::new(),
            };
            let answer = bus
                .ask(
                    &format!("{prefix}{}", queries::CONTROL_SHOW),
                    &request,
                    PATIENCE,
                )
                .ok()?;
            let toml = task(&answer.data).filter(|_| answer.done)?;
            Some(Finding::Task {
                prefix: prefix.clone(),
                activation: *activation,
                toml,
            })
        }
    }
}

/// Parameters of one service, from its list.
fn parameters(json: &str) -> Vec<(String, String)> {
    #[derive(Deserialize)]
    struct Listed {
        service: String,
        name: String,
        value: f64,
        #[serde(default)]
        unit: String,
    }
    let listed: Vec<Listed> = serde_json::from_str(json).unwrap_or_default();
    listed
        .into_iter()
        .map(|p| {
            let value = if matches!(p.unit.as_str(), "" | "1") {
                p.value.to_string()
            } else {
                format!("{} {}", p.value, p.unit)
            };
            (format!("{}/{}", p.service, p.name), value)
        })
        .collect()
}

/// Text of the task, from the controller's answer to `show`.
fn task(json: &str) -> Option<String> {
    #[derive(Deserialize)]
    struct Shown {
        task_toml: String,
    }
    serde_json::from_str::<Shown>(json)
        .ok()
        .map(|shown| shown.task_toml)
        .filter(|text| !text.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_services_answer_becomes_a_table() {
        let json = r#"[{"service":"netft","name":"cutoff_hz","value":50.0,"default":50.0,"minimum":1.0,
            "maximum":100.0,"unit":"Hz","description":"d"},{"service":"a","name":"b","value":2.5}]"#;
        let expected = [("netft/cutoff_hz", "50 Hz"), ("a/b", "2.5")];
        assert_eq!(
            parameters(json),
            expected.map(|(n, v)| (n.to_owned(), v.to_owned()))
        );
        assert_eq!(parameters("nonsense"), []);
        assert_eq!(
            task(r#"{"task_toml":"name = 'x'"}"#).as_deref(),
            Some("name = 'x'")
        );
        assert_eq!(task(r#"{"phase":"idle"}"#), None);
    }
}
