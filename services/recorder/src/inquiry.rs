//! Asks the other services what a recording should hold beside their messages, without keeping the
//! disk waiting.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use serde::Deserialize;
use tangent_runtime::Bus;
use tangent_schemas::tangent::Request;
use tangent_schemas::topics::queries;

use crate::RecorderError;

/// Services have this long to answer.
const PATIENCE: Duration = Duration::from_millis(800);

/// What to find out.
enum Question {
    Parameters,
    Task { prefix: String, activation: u64 },
}

/// What was found out.
#[derive(Debug, PartialEq)]
pub(crate) enum Finding {
    /// `SERVICE/NAME`, behind the cell where there are several, to value with unit.
    Parameters(BTreeMap<String, String>),
    /// The task of an activation, as TOML.
    Task {
        /// What stands before its cell's keys.
        prefix: String,
        activation: u64,
        toml: String,
    },
}

/// A thread that asks; it ends with this value.
pub(crate) struct Inquirer {
    questions: Option<Sender<Question>>,
    findings: Receiver<Finding>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Inquirer {
    /// `prefixes`: what stands before the keys of each cell.
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
            // A thread that is gone asks nothing; the recording goes on without.
            let _ = questions.send(question);
        }
    }

    /// What has come in since the last call.
    pub(crate) fn findings(&self) -> impl Iterator<Item = Finding> + '_ {
        self.findings.try_iter()
    }

    /// Waits until everything that was asked is answered or given up.
    pub(crate) fn finish(&mut self) -> Vec<Finding> {
        self.questions = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the recorder's asking thread panicked");
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

/// Parameters of one service as it lists them.
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

/// The task's text in the controller's answer to `show`.
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
