//! `tangent status --watch`: one line per service, refreshed in place.

use anyhow::{Context, Result};
use console::Term;
use serde_json::json;
use tangent_client::session;
use tangent_client::status::{Service, Status, no_such_cell, of_cell, of_network};
use tangent_runtime::{Bus, CellConfig, Stop};

use crate::cli::Status as Args;
use crate::output::Outcome;
use crate::table::{Columns, wrapped};

/// Shows the state until Ctrl-C. On a terminal, it replaces the one before and is cut to one
/// screen; elsewhere, each is printed after the one before. With `--json`, each is one line.
///
/// # Errors
/// The cell or the network cannot be reached, or standard output is not usable.
pub fn run(args: &Args, config: &CellConfig, as_json: bool) -> Result<Outcome> {
    let stop = Stop::on_signals().context("registering for SIGINT and SIGTERM")?;
    let bus = if args.all {
        session::join_all(config)?
    } else {
        session::join(config)?
    };
    let term = Term::stdout();
    let mut shown = 0;
    // Of a cell without services: whether others have some. Looked up once, since it takes a second.
    let mut others: Option<String> = None;
    while !stop.is_stopped() {
        let all = look(args, config, &bus)?;
        if stop.is_stopped() {
            break;
        }
        if as_json {
            println!("{}", json!({ "cells": all }));
            continue;
        }
        let mut lines = screen(&all);
        if !args.all && all.iter().all(|status| status.services.is_empty()) {
            if others.is_none() {
                let wrong = no_such_cell(config)?;
                others = Some(wrong.map(|error| error.to_string()).unwrap_or_default());
            }
            let told = others.as_deref().unwrap_or_default();
            lines.extend(wrapped(0, told).lines().map(str::to_owned));
        }
        if term.is_term() {
            cut(&mut lines, usize::from(term.size().0));
            term.clear_last_lines(shown)?;
        }
        shown = lines.len();
        term.write_line(&lines.join("\n"))?;
    }
    Ok(Outcome::Done)
}

/// Observes the bus for about two seconds.
fn look(args: &Args, config: &CellConfig, bus: &Bus) -> Result<Vec<Status>> {
    Ok(if args.all {
        of_network(bus)?
    } else {
        vec![of_cell(config, bus)?]
    })
}

/// Keeps what fits on a screen of `height` lines, with a line that counts the rest.
fn cut(lines: &mut Vec<String>, height: usize) {
    // The cursor stands below the last line.
    let room = height.saturating_sub(1).max(2);
    if lines.len() > room {
        let more = lines.len() - room + 1;
        lines.truncate(room - 1);
        lines.push(format!("... {more} more lines"));
    }
}

fn screen(all: &[Status]) -> Vec<String> {
    let mut lines = Vec::new();
    for status in all {
        let faults = status.services.iter().filter(|s| s.fault.is_some()).count();
        lines.push(format!(
            "cell {}: {} services, {faults} with a fault; Ctrl-C ends",
            status.cell,
            status.services.len()
        ));
        let mut table = Columns::new(&[
            "service", "state", "host", ">Hz", ">ms old", ">missed", ">lost", "fault",
        ]);
        status.services.iter().for_each(|s| table.row(cells(s)));
        lines.extend(table.text(0).lines().map(str::to_owned));
    }
    if all.is_empty() {
        lines.push("no cell on this network; Ctrl-C ends".to_owned());
    }
    lines
}

/// One row: the highest of its rates, and the age of its oldest input.
fn cells(s: &Service) -> [String; 8] {
    let greatest = |values: &mut dyn Iterator<Item = f64>, digits: usize| {
        let found = values.filter(|value| value.is_finite()).reduce(f64::max);
        found.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
    };
    [
        s.name.clone(),
        s.state.to_owned(),
        s.host.clone(),
        greatest(&mut s.rates_hz.values().copied(), 1),
        greatest(&mut s.ages_ms.values().copied(), 1),
        s.missed_cycles.to_string(),
        s.lost.to_string(),
        s.fault.clone().unwrap_or_default(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn service(name: &str, fault: Option<&str>) -> Service {
        Service {
            name: name.to_owned(),
            state: "running",
            host: "cell-pc".to_owned(),
            rates_hz: [("arm/state".to_owned(), 125.0)].into(),
            fault: fault.map(str::to_owned),
            ..Service::default()
        }
    }

    #[test]
    fn a_screen_has_one_line_per_service_and_fits_eighty_columns() {
        let status = Status {
            cell: "cell1".to_owned(),
            services: vec![service("controller", None), service("rtde", None)],
        };
        let lines = screen(&[status]);
        assert_eq!(lines.len(), 4, "{lines:#?}");
        assert!(lines[2].contains("controller") && lines[2].contains("125.0"));
        let long =
            "the robot does not answer: is it on, and is its address right in the cell file?";
        let status = Status {
            cell: "cell1".to_owned(),
            services: vec![service("rtde", Some(long))],
        };
        let lines = screen(&[status]);
        assert!(
            lines.iter().all(|line| line.chars().count() <= 80),
            "{lines:#?}"
        );
        assert!(lines[0].contains("1 with a fault"));
    }

    #[test]
    fn what_does_not_fit_on_the_screen_is_counted() {
        let mut lines: Vec<String> = (0..30).map(|n| n.to_string()).collect();
        cut(&mut lines, 24);
        assert_eq!(lines.len(), 23);
        assert_eq!(lines[22], "... 8 more lines");
    }
}
