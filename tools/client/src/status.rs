//! State that the services of a cell report: rates, ages, losses, faults, clocks.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use serde::Serialize;
use tangent_mechanics::names::did_you_mean;
use tangent_runtime::clock_offset::{self, ClockOffset};
use tangent_runtime::{Bus, CellConfig};
use tangent_schemas::tangent::Health;
use tangent_schemas::{cdr, topics};

use crate::error::ClientError;
use crate::session;

/// Health is published once a second: within this time, every instance has been received.
const LISTEN: Duration = Duration::from_millis(1500);

/// Limit of instances, more than any network of cells has.
const INSTANCES_MAX: usize = 4096;

/// Longest wait for the answer of one service's clock.
const PING_PATIENCE: Duration = Duration::from_millis(600);

/// All services of one cell.
#[derive(Clone, Debug, Serialize)]
pub struct Status {
    /// Name of the cell.
    pub cell: String,
    /// Its services, by name and instance.
    pub services: Vec<Service>,
}

impl Status {
    /// Whether any service reports a fault, or hangs.
    pub fn is_faulty(&self) -> bool {
        self.services.iter().any(|service| service.fault.is_some())
    }
}

/// One instance of a service.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Service {
    /// Name of the service.
    pub name: String,
    /// `HOST-PID` of its process.
    pub instance: String,
    /// Host on which it runs.
    pub host: String,
    /// Whether its liveliness token exists.
    pub alive: bool,
    /// Its state in words, see [`state_text`].
    pub state: &'static str,
    /// Messages per second by topic, Hz.
    pub rates_hz: BTreeMap<String, f64>,
    /// Age of the newest message of each input, ms.
    pub ages_ms: BTreeMap<String, f64>,
    /// Number of cycles in which it was late.
    pub missed_cycles: u64,
    /// Number of messages or records lost.
    pub lost: u64,
    /// Its fault, if there is one.
    pub fault: Option<String>,
    /// Remarks that are no faults.
    pub remarks: Vec<String>,
    /// How its loop is scheduled.
    pub realtime: String,
    /// Further figures by name.
    pub figures: BTreeMap<String, f64>,
    /// Its clock minus this host's, ms; null if it does not answer.
    pub clock_offset_ms: Option<f64>,
    /// Round-trip time of the measurement, ms. The offset may be wrong by half of it.
    pub round_trip_ms: Option<f64>,
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

/// Status of the services of one cell; `bus` is a session on its network. A cell without services
/// has an empty status. Each service's clock is measured against this host's.
///
/// # Errors
/// The bus refuses.
pub fn of_cell(config: &CellConfig, bus: &Bus) -> Result<Status, ClientError> {
    let name = config.cell.name.clone();
    let mut services = gather(bus)?.remove(&name).unwrap_or_default();
    measure_clocks(bus, &mut services);
    Ok(Status {
        cell: name,
        services,
    })
}

/// Status of the services of every cell on the network. `network` is a session from
/// [`session::join_all`].
///
/// # Errors
/// The bus refuses.
pub fn of_network(network: &Bus) -> Result<Vec<Status>, ClientError> {
    let status = |(cell, services)| Status { cell, services };
    Ok(gather(network)?.into_iter().map(status).collect())
}

/// The error for a cell without services: names the nearest cell on the network, and all of them.
/// `None` if the cell has services, or if nobody else is there either.
///
/// # Errors
/// The network cannot be reached.
pub fn no_such_cell(config: &CellConfig) -> Result<Option<ClientError>, ClientError> {
    let cell = &config.cell.name;
    let there = of_network(&session::join_all(config)?)?;
    let names: Vec<&str> = there.iter().map(|status| status.cell.as_str()).collect();
    if names.is_empty() || names.contains(&cell.as_str()) {
        return Ok(None);
    }
    Ok(Some(ClientError::NoSuchCell {
        cell: cell.clone(),
        suggestion: did_you_mean(cell, names.iter().copied()),
        known: format!("there are: {}", names.join(", ")),
    }))
}

/// Reports received from every cell on this bus, by cell.
fn gather(bus: &Bus) -> Result<BTreeMap<String, Vec<Service>>, ClientError> {
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
            // The key is CELL/health/SERVICE from outside, health/SERVICE from inside a cell.
            let cell = match bus.cell() {
                "" => message.key.split('/').next().unwrap_or_default(),
                name => name,
            };
            let who = (
                cell.to_owned(),
                h.service.to_string(),
                h.instance.to_string(),
            );
            // The limit keeps forged instances from filling this program's memory.
            if newest.len() < INSTANCES_MAX || newest.contains_key(&who) {
                newest.insert(who, h);
            }
        }
    }
    let mut cells: BTreeMap<String, Vec<Service>> = BTreeMap::new();
    for ((cell, ..), h) in newest {
        cells.entry(cell).or_default().push(Service::from(h));
    }
    // A liveliness token without health belongs to a service that hangs.
    for alive in bus.alive(Duration::from_millis(500))? {
        let services = cells.entry(alive.cell).or_default();
        let known = services
            .iter()
            .any(|s| s.name == alive.service && s.instance == alive.instance);
        if !known {
            services.push(Service::silent(alive.service, alive.instance));
        }
    }
    for services in cells.values_mut() {
        services.sort_by(|a, b| (&a.name, &a.instance).cmp(&(&b.name, &b.instance)));
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

/// Measures the clock offset of every instance.
fn measure_clocks(bus: &Bus, services: &mut [Service]) {
    for service in services {
        let found = clock_offset::measure(bus, &service.name, &service.instance, PING_PATIENCE);
        let ms = |of: fn(ClockOffset) -> f64| found.map(|clock| 1e3 * of(clock));
        service.clock_offset_ms = ms(|clock| clock.offset_s);
        service.round_trip_ms = ms(|clock| clock.round_trip_s);
    }
}
