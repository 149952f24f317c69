//! `tangent status`: what the cell says of itself.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::Result;
use serde::Serialize;
use tangent_runtime::clock_offset::{self, ClockOffset};
use tangent_runtime::{Bus, CellConfig};
use tangent_schemas::tangent::Health;
use tangent_schemas::{cdr, topics};

use crate::output::{Outcome, print_json};
use crate::{cell, cli};

/// Health comes once a second; this is long enough to hear everybody.
const LISTEN: Duration = Duration::from_millis(1500);

/// More instances than a network of cells has.
const INSTANCES_MAX: usize = 4096;

/// How long one service's clock is asked for; one that does not answer costs no more than this.
const PING_PATIENCE: Duration = Duration::from_millis(600);

#[derive(Serialize)]
struct Status {
    cell: String,
    services: Vec<Service>,
}

#[derive(Default, Serialize)]
struct Service {
    name: String,
    instance: String,
    host: String,
    alive: bool,
    state: &'static str,
    rates_hz: BTreeMap<String, f64>,
    ages_ms: BTreeMap<String, f64>,
    missed_cycles: u64,
    lost: u64,
    fault: Option<String>,
    /// What to know though nothing has failed.
    remarks: Vec<String>,
    realtime: String,
    figures: BTreeMap<String, f64>,
    /// Its clock less this host's, ms; null when it does not answer.
    clock_offset_ms: Option<f64>,
    /// Way there and back, ms: the offset may be wrong by half of it.
    round_trip_ms: Option<f64>,
}

/// A health state in words.
pub fn state_text(state: u8) -> &'static str {
    match state {
        0 => "starting",
        1 => "running",
        2 => "degraded",
        3 => "fault",
        4 => "stopping",
        _ => "unknown",
    }
}

fn table(names: &[String], values: &[f64], scale: f64) -> BTreeMap<String, f64> {
    names
        .iter()
        .cloned()
        .zip(values.iter().map(|v| v * scale))
        .collect()
}

/// Services, rates, ages and faults, of this cell or of every cell on the network.
///
/// # Errors
/// When the cell or the network cannot be reached.
pub fn run(args: &cli::Status, config: &CellConfig, json: bool) -> Result<Outcome> {
    let cells = if args.all {
        gather(&cell::join_all(config)?)?
    } else {
        let bus = cell::join(config)?;
        let mut cells = gather(&bus)?;
        let name = config.cell.name.clone();
        // A cell without services is still this cell.
        let mut services = cells.remove(&name).unwrap_or_default();
        measure_clocks(&bus, &mut services);
        BTreeMap::from([(name, services)])
    };
    let all: Vec<Status> = cells
        .into_iter()
        .map(|(cell, services)| Status { cell, services })
        .collect();
    let faulty = all
        .iter()
        .flat_map(|status| &status.services)
        .any(|s| s.fault.is_some());
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
    Ok(if faulty {
        Outcome::Failed
    } else {
        Outcome::Done
    })
}

/// What every cell that this bus hears says of itself, by cell.
fn gather(bus: &Bus) -> Result<BTreeMap<String, Vec<Service>>> {
    let pattern = match bus.cell() {
        "" => topics::HEALTHS.of_cell("*").key().to_owned(),
        _ => topics::HEALTHS.key().to_owned(),
    };
    let healths = bus.subscribe_raw(&pattern, 1024)?;
    let mut newest: BTreeMap<(String, String, String), Health> = BTreeMap::new();
    let until = Instant::now() + LISTEN;
    while let Some(left) = until.checked_duration_since(Instant::now()) {
        let Some(message) = healths.recv_timeout(left) else {
            continue;
        };
        if let Ok(h) = cdr::decode::<Health>(&message.payload) {
            // CELL/health/SERVICE from outside, health/SERVICE from inside a cell.
            let cell = match bus.cell() {
                "" => message.key.split('/').next().unwrap_or_default(),
                name => name,
            };
            let who = (
                cell.to_owned(),
                h.service.to_string(),
                h.instance.to_string(),
            );
            // Invented instances must not fill this program's memory.
            if newest.len() < INSTANCES_MAX || newest.contains_key(&who) {
                newest.insert(who, h);
            }
        }
    }
    let mut cells: BTreeMap<String, Vec<Service>> = BTreeMap::new();
    for ((cell, ..), h) in newest {
        cells.entry(cell).or_default().push(Service::from(h));
    }
    // A token without health is a service that hangs.
    for alive in bus.alive(Duration::from_millis(500))? {
        let services = cells.entry(alive.cell).or_default();
        let known = services
            .iter()
            .any(|s| s.name == alive.service && s.instance == alive.instance);
        if !known {
            services.push(Service::silent(alive.service, alive.instance));
        }
    }
    Ok(cells)
}

impl From<Health> for Service {
    fn from(h: Health) -> Self {
        Self {
            alive: true,
            name: h.service.to_string(),
            instance: h.instance.to_string(),
            host: h.host.to_string(),
            state: state_text(h.state),
            rates_hz: table(&h.rate_names, &h.rates_hz, 1.0),
            ages_ms: table(&h.age_names, &h.ages_s, 1e3),
            missed_cycles: h.missed_cycles,
            lost: h.lost,
            fault: (!h.fault.is_empty()).then_some(h.fault),
            remarks: h.remarks,
            realtime: h.realtime,
            figures: table(&h.figure_names, &h.figures, 1.0),
            clock_offset_ms: None,
            round_trip_ms: None,
        }
    }
}

impl Service {
    fn silent(name: String, instance: String) -> Self {
        Self {
            name,
            instance,
            alive: true,
            state: "silent",
            fault: Some("alive, but sends no health message: it may hang".to_owned()),
            ..Self::default()
        }
    }
}

/// Asks every instance for its time.
fn measure_clocks(bus: &Bus, services: &mut [Service]) {
    for service in services {
        let found = clock_offset::measure(bus, &service.name, &service.instance, PING_PATIENCE);
        let ms = |of: fn(ClockOffset) -> f64| found.map(|clock| 1e3 * of(clock));
        service.clock_offset_ms = ms(|clock| clock.offset_s);
        service.round_trip_ms = ms(|clock| clock.round_trip_s);
    }
}

fn print(status: &Status) {
    println!("cell {}: {} services", status.cell, status.services.len());
    for s in &status.services {
        println!(
            "{:<12} {:<9} on {} ({})",
            s.name, s.state, s.host, s.instance
        );
        if let (Some(offset), Some(way)) = (s.clock_offset_ms, s.round_trip_ms) {
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
            println!("    {}", s.realtime);
        }
        for remark in &s.remarks {
            println!("    NOTE: {remark}");
        }
        if let Some(fault) = &s.fault {
            println!("    FAULT: {fault}");
        }
    }
}
