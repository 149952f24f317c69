//! `tangent faults`: provokes every failure of the table on a private simulated cell, and measures
//! the answers.
//!
//! The services are processes of their own, so that they can be killed and stopped; simulator,
//! cables and clock are this process's. What is safe is judged by the simulator's truth, what is
//! lost by the recording.

mod catalogue;
mod disk;
mod evidence;
mod host_clock;
mod impostor;
mod losses;
mod play;
pub mod private_cell;
mod processors;
mod row;
mod stage;
mod wire;

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde_json::{Value, json};

use crate::cli::Faults;
use crate::output::{Outcome, bad_usage, print_json};
use catalogue::{Case, catalogue};
use play::play;
use private_cell::Layout;
use row::{FORCE_MAX_N, Row, SHOWN_MAX_N, attribute, without_figures};
use stage::Stage;

/// Provokes the faults, all or those named.
///
/// # Errors
/// An unknown name, or a cell that does not come up.
pub fn run(args: &Faults, json: bool) -> Result<Outcome> {
    if args.list {
        return list(json);
    }
    let cases = chosen(&args.faults)?;
    let (folder, kept) = match &args.folder {
        Some(folder) => (folder.clone(), true),
        None => {
            let name = format!("tangent-faults-{}", std::process::id());
            (std::env::temp_dir().join(name), false)
        }
    };
    let rows = play_all(args, &cases, &folder)?;
    if !kept && let Err(error) = fs::remove_dir_all(&folder) {
        tracing::warn!("{}: {error}", folder.display());
    }
    if json {
        print_json(&json!({
            "allow_ms": args.allow_ms,
            "force_max_n": FORCE_MAX_N,
            "shown_minus_true_max_n": SHOWN_MAX_N,
            "rows": rows.iter().map(row_json).collect::<Vec<_>>(),
        }))?;
    } else {
        print(&rows, args.allow_ms);
    }
    Ok(if rows.iter().any(|row| !row.met && !row.skipped) {
        Outcome::Failed
    } else if rows.iter().any(|row| row.skipped) {
        Outcome::Lossy
    } else {
        Outcome::Done
    })
}

fn list(json: bool) -> Result<Outcome> {
    let all = catalogue();
    if json {
        let names: Vec<&str> = all.iter().map(|case| case.name).collect();
        print_json(&json!({ "faults": names }))?;
    } else {
        for case in all {
            println!("{:<34} {}", case.name, case.what);
        }
    }
    Ok(Outcome::Done)
}

fn chosen(names: &[String]) -> Result<Vec<Case>> {
    let mut all = catalogue();
    for name in names {
        if !all.iter().any(|case| case.name == name) {
            let known: Vec<&str> = all.iter().map(|case| case.name).collect();
            return Err(bad_usage(format!(
                "no fault is called \"{name}\"; there are {}",
                known.join(", ")
            )));
        }
    }
    if !names.is_empty() {
        all.retain(|case| names.iter().any(|name| name == case.name));
    }
    Ok(all)
}

fn play_all(args: &Faults, cases: &[Case], folder: &Path) -> Result<Vec<Row>> {
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
        rows.extend(play_layout(args, &own, layout, &folder)?);
    }
    // In the catalogue's order again.
    rows.sort_by_key(|row| cases.iter().position(|case| case.name == row.fault));
    Ok(rows)
}

fn play_layout(args: &Faults, cases: &[&Case], layout: Layout, folder: &Path) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    let mut left = cases.iter();
    // A cell that a fault has broken for good is left behind, and the next fault gets another.
    for number in 1.. {
        let folder = folder.join(number.to_string());
        let mut stage = Stage::start(&folder, args.port_offset, layout, args.seed)
            .with_context(|| logs_are_in(&folder))?;
        let begun = rows.len();
        let mut broken = false;
        for case in left.by_ref() {
            eprintln!("{}: {}", case.name, case.what);
            match play(&mut stage, case, args.allow_ms) {
                Ok(row) => rows.push(row),
                Err(error) => {
                    let remark = format!("{error:#}; {}", logs_are_in(&folder));
                    eprintln!("{}: {remark}", case.name);
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

fn logs_are_in(folder: &Path) -> String {
    let folder: PathBuf = folder.to_owned();
    format!("the services' logs are in {}", folder.display())
}

fn row_json(row: &Row) -> Value {
    json!({
        "fault": row.fault,
        "what": row.what,
        "notices": row.notices,
        "outcome": row.outcome.name(),
        "noticed_ms": row.noticed_ms,
        "noticed_bound_ms": row.noticed_bound_ms,
        "safe_ms": row.safe_ms,
        "bound_ms": row.bound_ms,
        "peak_force_n": row.peak_force_n,
        "messages_lost": row.lost.values().sum::<u64>(),
        "lost_by_topic": row.lost,
        "messages_lost_outside": row.lost_outside.values().sum::<u64>(),
        "lost_outside_by_topic": row.lost_outside,
        "again_peak_force_n": row.again.map(|again| again.peak_force_n),
        "again_shown_minus_true_n": row.again.map(|again| again.shown_minus_true_n),
        "again_retracted": row.again.map(|again| again.retracted),
        "met": row.met,
        "skipped": row.skipped,
        "remark": row.remark,
    })
}

fn print(rows: &[Row], allow_ms: f64) {
    let ms = |x: Option<f64>| x.map_or_else(|| "-".to_owned(), |x| format!("{x:.0}"));
    let newtons = |x: Option<f64>| x.map_or_else(|| "-".to_owned(), |x| format!("{x:.2}"));
    println!(
        "{:<34} {:>10} {:>6} {:>8} {:>6} {:>7} {:>6} {:>13} {:>12}",
        "fault",
        "noticed ms",
        "bound",
        "safe ms",
        "bound",
        "peak N",
        "lost",
        "again, peak N",
        "shown-true N"
    );
    for row in rows {
        println!(
            "{:<34} {:>10} {:>6} {:>8} {:>6} {:>7.2} {:>6} {:>13} {:>12}  {}",
            row.fault,
            ms(row.noticed_ms),
            ms(row.noticed_bound_ms),
            ms(row.safe_ms),
            ms(row.bound_ms),
            row.peak_force_n,
            row.lost.values().sum::<u64>(),
            newtons(row.again.map(|again| again.peak_force_n)),
            newtons(row.again.map(|again| again.shown_minus_true_n)),
            match (row.met, row.remark.as_str()) {
                (true, _) => "met",
                (false, remark) => remark,
            }
        );
    }
    println!(
        "Bounds are allowed {allow_ms:.0} ms more (--allow-ms); no fault may press harder than {FORCE_MAX_N:.0} N. Lost: \
         messages that the recording lacks within the fault. Again: the task after it, which may show {SHOWN_MAX_N} N more or less \
         than is true in the mean, and has to leave the surface."
    );
}
