//! `tangent status`: prints the state that the services of a cell report.

mod watch;

use anyhow::Result;
use tangent_client::session;
use tangent_client::status::{Status, no_such_cell, of_cell, of_network};
use tangent_runtime::CellConfig;

use crate::cli::Status as Args;
use crate::output::{Outcome, print_json};
use crate::table::paragraph;

/// Prints services, rates, ages and faults of this cell, or of every cell on the network.
///
/// # Errors
/// The cell or the network cannot be reached, or this cell has no services while others have.
pub fn run(args: &Args, config: &CellConfig, json: bool) -> Result<Outcome> {
    if args.watch {
        return watch::run(args, config, json);
    }
    let all = if args.all {
        of_network(&session::join_all(config)?)?
    } else {
        vec![of_cell(config, &session::join(config)?)?]
    };
    if !args.all
        && all.iter().all(|status| status.services.is_empty())
        && let Some(error) = no_such_cell(config)?
    {
        return Err(error.into());
    }
    match (json, args.all) {
        (true, true) => print_json(&serde_json::json!({ "cells": all }))?,
        (true, false) => print_json(&all[0])?,
        (false, _) => {
            if all.is_empty() {
                println!("no cell on this network");
            }
            all.iter().for_each(print);
        }
    }
    Ok(if all.iter().any(Status::is_faulty) {
        Outcome::Failed
    } else {
        Outcome::Done
    })
}

fn print(status: &Status) {
    println!("cell {}: {} services", status.cell, status.services.len());
    for s in &status.services {
        println!(
            "{:<12} {:<9} on {} ({})",
            s.name, s.state, s.host, s.instance
        );
        if let (Some(offset), Some(way)) = (s.clock_offset_ms, s.round_trip_ms) {
            // Rounded as shown; adding 0 turns -0 into 0.
            let offset = (offset * 1e3).round() * 1e-3 + 0.0;
            println!(
                "    clock {offset:+.3} ms from this host's, known to {:.3} ms",
                0.5 * way
            );
        }
        for (name, hz) in &s.rates_hz {
            println!("    {name:<32} {hz:9.1} Hz");
        }
        for (name, ms) in &s.ages_ms {
            println!("    {name:<32} {ms:9.2} ms old");
        }
        for (name, value) in &s.figures {
            println!("    {name:<32} {value:9.3}");
        }
        if s.missed_cycles + s.lost > 0 {
            println!("    missed cycles {}, lost {}", s.missed_cycles, s.lost);
        }
        if !s.realtime.is_empty() {
            paragraph(4, &s.realtime);
        }
        for remark in &s.remarks {
            paragraph(4, &format!("NOTE: {remark}"));
        }
        if let Some(fault) = &s.fault {
            paragraph(4, &format!("FAULT: {fault}"));
        }
    }
}
