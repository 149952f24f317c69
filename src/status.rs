//! `tangent status` and `tangent estimator list`: what the cell says of itself.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use nalgebra::Vector3;
use serde::Serialize;
use tangent_runtime::{CellConfig, clock};
use tangent_schemas::tangent::{ControlState, Health, NormalEstimate};
use tangent_schemas::topics;

use crate::cell;
use crate::output::{Outcome, print_json};

/// Health comes once a second; this is long enough to hear everybody.
const LISTEN: Duration = Duration::from_millis(1500);

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
}

fn state_text(state: u8) -> &'static str {
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
            });
        }
    }
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

fn print(status: &Status) {
    println!("cell {}: {} services", status.cell, status.services.len());
    for s in &status.services {
        println!(
            "{:<12} {:<9} on {} ({})",
            s.name, s.state, s.host, s.instance
        );
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

#[derive(Serialize)]
struct Estimators {
    active: Option<String>,
    estimators: Vec<Estimator>,
}

#[derive(Serialize)]
struct Estimator {
    name: String,
    active: bool,
    valid: bool,
    reason: String,
    rate_hz: f64,
    age_ms: f64,
    from_active_deg: Option<f64>,
    std_deg: f64,
    friction: Option<f64>,
    update_us: f64,
}

/// Who publishes normals, how old, how far from the one in use, how sure.
///
/// # Errors
/// When the cell cannot be reached or nobody publishes.
pub fn estimators(config: &CellConfig, json: bool) -> Result<Outcome> {
    let bus = cell::join(config)?;
    let normals = bus.subscribe(&topics::ESTIMATE_NORMALS, 4096)?;
    let mut control = bus.latest(&topics::CONTROL_STATE)?;
    let mut heard: BTreeMap<String, (u32, NormalEstimate, f64)> = BTreeMap::new();
    let start = Instant::now();
    let until = start + LISTEN;
    while let Some(left) = until.checked_duration_since(Instant::now()) {
        if let Some(received) = normals.recv_timeout(left) {
            let m = received.message;
            let count = heard.get(m.estimator.as_str()).map_or(0, |h| h.0);
            let name = m.estimator.to_string();
            let age_s = clock::age_s(m.header.stamp.to_ns());
            heard.insert(name, (count + 1, m, age_s));
        }
    }
    if heard.is_empty() {
        bail!(
            "nobody publishes normals in cell {}; start `tangent run estimator`",
            config.cell.name
        );
    }
    let seconds = start.elapsed().as_secs_f64();
    let state: Option<ControlState> = control.get().map(|r| r.message.clone());
    let active = state.as_ref().map(|s| s.estimator.to_string());
    let reference = active
        .as_ref()
        .and_then(|name| heard.get(name))
        .map(|h| normal(&h.1));
    let rows = heard
        .iter()
        .map(|(name, (count, m, age_s))| Estimator {
            name: name.clone(),
            active: active.as_ref() == Some(name),
            valid: m.validity == 0,
            reason: m.reason.to_string(),
            rate_hz: f64::from(*count) / seconds,
            age_ms: age_s * 1e3,
            from_active_deg: reference.map(|r| {
                r.cross(&normal(m))
                    .norm()
                    .atan2(r.dot(&normal(m)))
                    .to_degrees()
            }),
            std_deg: (0.5 * (m.covariance[0] + m.covariance[4] + m.covariance[8]))
                .sqrt()
                .to_degrees(),
            friction: (m.friction >= 0.0).then_some(m.friction),
            update_us: m.update_s * 1e6,
        })
        .collect();
    let all = Estimators {
        active,
        estimators: rows,
    };
    if json {
        print_json(&all)?;
    } else {
        for e in &all.estimators {
            println!(
                "{} {:<26} {:7.1} Hz  {:6.1} ms old  {:>8} deg from the active  ±{:.2} deg  {}",
                if e.active { "*" } else { " " },
                e.name,
                e.rate_hz,
                e.age_ms,
                e.from_active_deg.map_or("-".into(), |d| format!("{d:.2}")),
                e.std_deg,
                if e.valid { "valid" } else { &e.reason }
            );
        }
    }
    Ok(Outcome::Done)
}

fn normal(m: &NormalEstimate) -> Vector3<f64> {
    Vector3::new(m.normal.x, m.normal.y, m.normal.z)
}
