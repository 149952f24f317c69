//! Provokes faults one after the other. Each layout has cells of its own.

use std::fs;
use std::path::{Path, PathBuf};

use tangent_compose::with_causes;
use tangent_mechanics::names::did_you_mean;

use crate::catalogue::{Case, catalogue};
use crate::error::{Context, FaultsError, Result};
use crate::layout::Layout;
use crate::play::play;
use crate::private_cell::Setup;
use crate::row::{Row, attribute, without_figures};
use crate::stage::Stage;

/// Number of lines shown of each log of a cell that a fault broke.
const LOG_LINES: usize = 8;

/// Selection of the faults, and settings of the run.
#[derive(Clone, Debug)]
pub struct Campaign {
    /// Names of the faults; empty: all of them.
    pub faults: Vec<String>,
    /// Time allowed beyond every bound, ms.
    pub allow_ms: f64,
    /// Folder for logs and recordings; without one, they are deleted at the end if every fault was
    /// answered.
    pub folder: Option<PathBuf>,
    /// Settings of the private cells.
    pub setup: Setup,
}

impl Campaign {
    /// Provokes the faults, and prints each one to standard error as it begins. The rows are in the
    /// catalogue's order.
    ///
    /// # Errors
    /// A name is unknown, or a cell does not start.
    pub fn run(&self) -> Result<Vec<Row>> {
        let cases = chosen(&self.faults)?;
        let (folder, kept) = match &self.folder {
            Some(folder) => (folder.clone(), true),
            None => {
                let name = format!("tangent-faults-{}", std::process::id());
                (std::env::temp_dir().join(name), false)
            }
        };
        let rows = play_all(self, &cases, &folder)?;
        // The remark of a fault that broke its cell names the folder.
        let needed = kept || rows.iter().any(|row| !row.met && !row.skipped);
        if !needed && let Err(error) = fs::remove_dir_all(&folder) {
            tracing::warn!("{}: {error}", folder.display());
        }
        Ok(rows)
    }
}

/// Every fault that can be provoked: its name and its description.
pub fn known() -> Vec<(&'static str, &'static str)> {
    let all = catalogue();
    all.iter().map(|case| (case.name, case.what)).collect()
}

fn chosen(names: &[String]) -> Result<Vec<Case>> {
    let mut all = catalogue();
    for name in names {
        if !all.iter().any(|case| case.name == name) {
            let known: Vec<&str> = all.iter().map(|case| case.name).collect();
            return Err(FaultsError::Usage(format!(
                "no fault is called \"{name}\"{}; there are {}",
                did_you_mean(name, known.iter().copied()),
                known.join(", ")
            )));
        }
    }
    if !names.is_empty() {
        all.retain(|case| names.iter().any(|name| name == case.name));
    }
    Ok(all)
}

fn play_all(campaign: &Campaign, cases: &[Case], folder: &Path) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for layout in [
        Layout::Composed,
        Layout::Apart,
        Layout::Relayed,
        Layout::Ledge,
    ] {
        let own: Vec<&Case> = cases.iter().filter(|case| case.layout == layout).collect();
        if own.is_empty() {
            continue;
        }
        let folder = folder.join(format!("{layout:?}").to_lowercase());
        rows.extend(play_layout(campaign, &own, layout, &folder)?);
    }
    // Restores the catalogue's order.
    rows.sort_by_key(|row| cases.iter().position(|case| case.name == row.fault));
    Ok(rows)
}

fn play_layout(
    campaign: &Campaign,
    cases: &[&Case],
    layout: Layout,
    folder: &Path,
) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    let mut left = cases.iter();
    // A fault may break its cell permanently. The next fault then gets a new cell.
    for number in 1.. {
        let folder = folder.join(number.to_string());
        let mut stage =
            Stage::start(&folder, layout, &campaign.setup).with_context(|| logs_are_in(&folder))?;
        let begun = rows.len();
        let mut broken = false;
        for case in left.by_ref() {
            eprintln!("{}: {}", case.name, case.what);
            match play(&mut stage, case, campaign.allow_ms) {
                Ok(row) => rows.push(row),
                Err(error) => {
                    let remark = format!("{}; {}", with_causes(&error), logs_are_in(&folder));
                    eprintln!("{}: {remark}", case.name);
                    eprint!("{}", last_lines(&folder));
                    rows.push(without_figures(case, false, &remark));
                    broken = true;
                    break;
                }
            }
        }
        for gap in stage.end()? {
            attribute(&gap, &mut rows[begun..]);
        }
        if !broken {
            break;
        }
    }
    Ok(rows)
}

/// Last lines of each log in the folder, after its name.
fn last_lines(folder: &Path) -> String {
    let logs = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut logs: Vec<PathBuf> = logs.map(|entry| entry.path()).collect();
    logs.retain(|path| path.extension().is_some_and(|end| end == "log"));
    logs.sort();
    let mut lines = String::new();
    for log in logs {
        let name = log.file_stem().unwrap_or_default().to_string_lossy();
        let text = fs::read_to_string(&log).unwrap_or_default();
        let last = text.lines().rev().take(LOG_LINES).collect::<Vec<_>>();
        for line in last.into_iter().rev() {
            lines.push_str(&format!("  {name}: {line}\n"));
        }
    }
    lines
}

fn logs_are_in(folder: &Path) -> String {
    let folder: PathBuf = folder.to_owned();
    format!("the services' logs are in {}", folder.display())
}
