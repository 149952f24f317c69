//! Result of a check: level, what was found, what it means, what to do.

use std::fmt;

use serde::Serialize;

/// Severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// No problem was found.
    Ok,
    /// The cell works, with less margin than possible.
    Warning,
    /// The cell does not work, or not reliably in time.
    Problem,
}

/// Result of one check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Name of the check.
    pub check: &'static str,
    /// Severity.
    pub level: Level,
    /// What was found.
    pub found: String,
    /// Consequence for a cell; empty if there is no problem.
    pub meaning: String,
    /// What to do; empty if there is no problem.
    pub advice: String,
}

impl Finding {
    /// A finding without a problem.
    pub fn ok(check: &'static str, found: impl Into<String>) -> Self {
        Self {
            check,
            level: Level::Ok,
            found: found.into(),
            meaning: String::new(),
            advice: String::new(),
        }
    }

    /// A finding of less margin than possible.
    pub fn warning(
        check: &'static str,
        found: impl Into<String>,
        meaning: impl Into<String>,
        advice: impl Into<String>,
    ) -> Self {
        Self {
            check,
            level: Level::Warning,
            found: found.into(),
            meaning: meaning.into(),
            advice: advice.into(),
        }
    }

    /// A finding that keeps the cell from working.
    pub fn problem(
        check: &'static str,
        found: impl Into<String>,
        meaning: impl Into<String>,
        advice: impl Into<String>,
    ) -> Self {
        Self {
            level: Level::Problem,
            ..Self::warning(check, found, meaning, advice)
        }
    }
}

/// Everything that was found on one machine for one cell. Its text has one paragraph per check.
#[derive(Clone, Debug, Serialize)]
pub struct Diagnosis {
    /// Name of the cell.
    pub cell: String,
    /// The worst level of all findings.
    pub verdict: Level,
    /// Results of the checks, in the order in which they ran.
    pub findings: Vec<Finding>,
}

impl Diagnosis {
    /// Collects findings; the verdict is the worst level among them.
    pub(crate) fn of(cell: &str, findings: Vec<Finding>) -> Self {
        Self {
            cell: cell.to_owned(),
            verdict: findings.iter().map(|f| f.level).max().unwrap_or(Level::Ok),
            findings,
        }
    }

    fn count(&self, level: Level) -> usize {
        self.findings.iter().filter(|f| f.level == level).count()
    }
}

impl fmt::Display for Diagnosis {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for f in &self.findings {
            let level = match f.level {
                Level::Ok => "ok",
                Level::Warning => "warning",
                Level::Problem => "PROBLEM",
            };
            writeln!(out, "{level:<8} {:<20} {}", f.check, f.found)?;
            for line in [&f.meaning, &f.advice]
                .into_iter()
                .filter(|l| !l.is_empty())
            {
                writeln!(out, "{:29}{line}", "")?;
            }
        }
        writeln!(
            out,
            "cell {}: {} checks, {} warnings, {} problems",
            self.cell,
            self.findings.len(),
            self.count(Level::Warning),
            self.count(Level::Problem)
        )
    }
}
