//! `tangent status`: what the cell says of itself.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::Result;
use serde::Serialize;
use tangent_runtime::clock_offset::{self, ClockOffset};
use tangent_runtime::{Bus, CellConfig};
use tangent_schemas::tangent::Health;
use tangent_schemas::topics;

use crate::cell;
use crate::output::{Outcome, print_json};

/// Health comes once a second; this is long enough to hear everybody.
const LISTEN: Duration = Duration::from_millis(1500);

/// How long one service's clock is asked for; one that does not answer costs no more than this.
const PING_PATIENCE: Duration = Duration::from_millis(600);

#[derive(Serialize)]
struct Status {
    cell: String,
    services: Vec<Service>,
}

#[derive(Serialize)]
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
    realtime: String,
    figures: BTreeMap<String, f64>,
    /// Its clock less this host's, ms; null when it does not answer.
    clock_offset_ms: Option<f64>,
    /// Way there and back, ms: the offset may be wrong by half of it.
    round_trip_ms: Option<f64>,
}

/// `Health.state` in words.
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

/// Services, rates, ages and faults.
///
/// # Errors
/// When the cell cannot be reached.
pub fn run(config: &CellConfig, json: bool) -> Result<Outcome> {
    let bus = cell::join(config)?;
    let healths = bus.subscribe(&topics::HEALTHS, 256)?;
    let mut newest: BTreeMap<(String, String), Health> = BTreeMap::new();
    let until = Instant::now() + LISTEN;
    while let Some(left) = until.checked_duration_since(Instant::now()) {
        if let Some(received) = healths.recv_timeout(left) {
            let h = received.message;
            newest.insert((h.service.to_string(), h.instance.to_string()), h);
        }
    }
    let mut services: Vec<Service> = newest
        .into_values()
        .map(|h| Service {
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
            realtime: h.realtime,
            figures: table(&h.figure_names, &h.figures, 1.0),
            clock_offset_ms: None,
            round_trip_ms: None,
        })
        .collect();
    // A token without health is a service that hangs.
    for alive in bus.alive(Duration::from_millis(500))? {
        let known = services
            .iter()
            .any(|s| s.name == alive.service && s.instance == alive.instance);
        if !known {
            services.push(Service {
                name: alive.service,
                instance: alive.instance,
                host: String::new(),
                alive: true,
                state: "silent",
                rates_hz: BTreeMap::new(),
                ages_ms: BTreeMap::new(),
                missed_cycles: 0,
                lost: 0,
                fault: Some("alive, but sends no health message: it may hang".to_owned()),
                realtime: String::new(),
                figures: BTreeMap::new(),
                clock_offset_ms: None,
                round_trip_ms: None,
            });
        }
    }
    measure_clocks(&bus, &mut services);
    let status = Status {
        cell: config.cell.name.clone(),
        services,
    };
    let outcome = if status.services.iter().any(|s| s.fault.is_some()) {
        Outcome::Failed
    } else {
        Outcome::Done
    };
    if json {
        print_json(&status)?;
    } else {
        print(&status);
    }
    Ok(outcome)
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
        if let Some(fault) = &s.fault {
            println!("    FAULT: {fault}");
        }
    }
}
