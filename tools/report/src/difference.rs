//! Two runs side by side: their figures, and the settings that differ.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use serde::Serialize;
use tangent_simulation::metrics::Spread;

use crate::figures::Report;
use crate::run::Run;
use crate::task_run::TaskRun;

/// A figure of both runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Compared {
    /// Name of the figure.
    pub name: &'static str,
    /// Its unit; empty for a number.
    pub unit: &'static str,
    /// Value of the first run; null if it was not measured.
    pub a: Option<f64>,
    /// Value of the second run.
    pub b: Option<f64>,
}

impl Compared {
    /// Name and unit.
    pub(crate) fn title(&self) -> String {
        match self.unit {
            "" => self.name.to_owned(),
            unit => format!("{}, {unit}", self.name),
        }
    }

    /// Both values and their difference; `-` for what was not measured.
    pub(crate) fn shown(&self) -> [String; 3] {
        let number = |v: f64| format!("{v:.3}");
        let change = self.a.zip(self.b).map(|(a, b)| format!("{:+.3}", b - a));
        [self.a.map(number), self.b.map(number), change]
            .map(|text| text.unwrap_or_else(|| "-".to_owned()))
    }
}

/// A setting that differs between the runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Setting {
    /// File or table that holds it.
    pub place: String,
    /// Its key.
    pub key: String,
    /// Value in the first run; null if the setting is not there.
    pub a: Option<String>,
    /// Value in the second run.
    pub b: Option<String>,
}

impl Setting {
    /// Both values; `-` where the setting is not there.
    pub(crate) fn shown(&self) -> [&str; 2] {
        [&self.a, &self.b].map(|value| value.as_deref().unwrap_or("-"))
    }
}

/// Output of `report A B --json`.
#[derive(Clone, Debug, Serialize)]
pub struct Difference {
    /// The first run.
    pub a: Report,
    /// The second run.
    pub b: Report,
    /// Figures of both.
    pub figures: Vec<Compared>,
    /// Settings that differ.
    pub settings: Vec<Setting>,
}

impl Difference {
    /// Compares two runs, each with its task.
    pub fn between(a: (&Run, &TaskRun<'_>), b: (&Run, &TaskRun<'_>)) -> Self {
        let (report_a, report_b) = (Report::of(a.0, a.1), Report::of(b.0, b.1));
        Self {
            figures: figures(&report_a, &report_b),
            settings: settings(&places(a.0, a.1), &places(b.0, b.1)),
            a: report_a,
            b: report_b,
        }
    }

    /// The comparison as text for a terminal.
    pub fn words(&self) -> String {
        let mut text = String::new();
        for (letter, report) in [("A", &self.a), ("B", &self.b)] {
            let _ = writeln!(text, "{letter}: {}", run_words(report));
        }
        let _ = writeln!(text, "\n{:<36}{:>13}{:>13}{:>13}", "", "A", "B", "B - A");
        for one in &self.figures {
            let [a, b, change] = one.shown();
            let _ = writeln!(text, "{:<36}{a:>13}{b:>13}{change:>13}", one.title());
        }
        if self.settings.is_empty() {
            text += "\nno setting differs\n";
        } else {
            text += "\nsettings that differ\n";
        }
        for setting in &self.settings {
            let [a, b] = setting.shown();
            let (place, key) = (&setting.place, &setting.key);
            let _ = writeln!(text, "  {place}: {key}\n    A {a}\n    B {b}");
        }
        text
    }
}

/// The run in one line: its file, its task, and how that ended.
pub(crate) fn run_words(report: &Report) -> String {
    let file = report.recording.files.first();
    let task = report.task_entry();
    format!(
        "{}, task {}",
        file.map_or("", String::as_str),
        task.map_or_else(|| "-".to_owned(), |task| task.words())
    )
}

fn figures(a: &Report, b: &Report) -> Vec<Compared> {
    let mean = |spread: Option<Spread>| spread.map(|s| s.mean);
    type Pick<'p> = &'p dyn Fn(&Report) -> Option<f64>;
    let picks: [(&'static str, &'static str, Pick<'_>); 23] = [
        ("duration", "s", &|r| Some(r.duration_s)),
        ("progress", "%", &|r| r.events.progress.map(|p| 100.0 * p)),
        ("force reference", "N", &|r| {
            Some(r.figures.force.reference_n)
        }),
        ("force, mean", "N", &|r| r.figures.force.mean_n),
        ("force error, RMS", "N", &|r| r.figures.force.rmse_n),
        ("force error, 95 %", "N", &|r| {
            r.figures.force.p95_abs_error_n
        }),
        ("force, highest", "N", &|r| r.figures.force.peak_n),
        ("touchdown, overshoot", "%", &|r| {
            r.figures.force.overshoot_percent
        }),
        ("touchdown, settled after", "s", &|r| {
            r.figures.force.settling_s
        }),
        ("path error, RMS", "mm", &|r| {
            r.figures.path.rmse_m.map(|m| 1e3 * m)
        }),
        ("path error, largest", "mm", &|r| {
            r.figures.path.max_m.map(|m| 1e3 * m)
        }),
        ("contact", "%", &|r| {
            r.figures.contact.fraction.map(|x| 100.0 * x)
        }),
        ("contact lost, times", "", &|r| {
            Some(r.figures.contact.lost_count as f64)
        }),
        ("coverage, within the band", "%", &|r| {
            r.coverage.as_ref().map(|c| 100.0 * c.share)
        }),
        ("manipulability, least", "", &|r| {
            r.figures.joints.manipulability_min
        }),
        ("packet to command, median", "us", &|r| {
            r.r#loop.packet_to_command_us.map(|q| q.p50)
        }),
        ("packet to command, 99 %", "us", &|r| {
            r.r#loop.packet_to_command_us.map(|q| q.p99)
        }),
        ("cycles missed", "", &|r| {
            r.r#loop.missed_cycles.map(|n| n as f64)
        }),
        ("normal error, mean", "deg", &|r| {
            mean(r.figures.normal_error_deg)
        }),
        ("normal error settled, mean", "deg", &|r| {
            mean(r.figures.normal_error_settled_deg)
        }),
        ("tool against surface, mean", "deg", &|r| {
            mean(r.figures.tool_error_deg)
        }),
        ("tool against estimate, mean", "deg", &|r| {
            mean(r.figures.alignment_error_deg)
        }),
        ("NEES per degree of freedom", "", &|r| {
            r.figures.normal_nees_per_dof
        }),
    ];
    picks
        .map(|(name, unit, pick)| Compared {
            name,
            unit,
            a: pick(a),
            b: pick(b),
        })
        .into_iter()
        .filter(|one| one.a.is_some() || one.b.is_some())
        .collect()
}

type Settings = BTreeMap<(String, String), String>;

/// Every setting that the recording holds: the task file of this task, other files, parameters, and
/// facts such as the version.
fn places(run: &Run, task: &TaskRun<'_>) -> Settings {
    let mut found = Settings::new();
    let activation = task.cycles.last().map(|c| c.control.activation);
    let own = activation.map(|n| format!("task-{n}.toml"));
    for (name, text) in &run.attachments {
        let is_task = name.starts_with("task-");
        if is_task && Some(name) != own.as_ref() {
            continue;
        }
        let place = if is_task { "task file" } else { name };
        match text.parse::<toml::Table>() {
            Ok(table) => flatten(place, "", &toml::Value::Table(table), &mut found),
            Err(_) => {
                found.insert((place.to_owned(), "text".to_owned()), text.clone());
            }
        }
    }
    for place in ["parameters", "tangent"] {
        for (key, value) in run.tables.get(place).into_iter().flatten() {
            found.insert((place.to_owned(), key.clone()), value.clone());
        }
    }
    found
}

fn flatten(place: &str, prefix: &str, value: &toml::Value, found: &mut Settings) {
    match value {
        toml::Value::Table(table) => {
            for (key, value) in table {
                let dot = if prefix.is_empty() { "" } else { "." };
                flatten(place, &format!("{prefix}{dot}{key}"), value, found);
            }
        }
        other => {
            found.insert((place.to_owned(), prefix.to_owned()), other.to_string());
        }
    }
}

fn settings(a: &Settings, b: &Settings) -> Vec<Setting> {
    let keys: BTreeSet<&(String, String)> = a.keys().chain(b.keys()).collect();
    keys.into_iter()
        .filter(|key| a.get(*key) != b.get(*key))
        .map(|key| Setting {
            place: key.0.clone(),
            key: key.1.clone(),
            a: a.get(key).cloned(),
            b: b.get(key).cloned(),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> Settings {
        let mut found = Settings::new();
        let table: toml::Table = text.parse().unwrap();
        flatten("cell.toml", "", &toml::Value::Table(table), &mut found);
        found
    }

    #[test]
    fn only_what_differs_is_named_by_its_key() {
        let a = parsed("name = 'a'\nlimits.force_max_n = 20.0\nlimits.speed = 1.0");
        let b = parsed("name = 'a'\nlimits.force_max_n = 30.0\nextra = [1, 2]");
        let found = settings(&a, &b);
        let keys: Vec<&str> = found.iter().map(|s| s.key.as_str()).collect();
        assert_eq!(keys, ["extra", "limits.force_max_n", "limits.speed"]);
        assert_eq!(found[1].a.as_deref(), Some("20.0"));
        assert_eq!(found[1].b.as_deref(), Some("30.0"));
        assert_eq!((found[0].a.as_ref(), found[2].b.as_ref()), (None, None));
        assert!(settings(&a, &a).is_empty());
    }
}
