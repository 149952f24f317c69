//! Live parameters: the service reads them without a lock; clients get and set them through queries
//! on `param/SERVICE/NAME`, and list them through `parameters/SERVICE`.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use serde::{Deserialize, Serialize};
use tangent_mechanics::names::did_you_mean;
use tangent_schemas::tangent::{Answer, Request};
use tangent_schemas::topics::queries;

use crate::bus::{Bus, BusError, Handle, answer};

/// One live number. Clones share it.
#[derive(Clone, Debug)]
pub struct Parameter(Arc<AtomicU64>);

impl Parameter {
    /// The present value. No lock: for real-time threads.
    pub fn get(&self) -> f64 {
        f64::from_bits(self.0.load(Ordering::Relaxed))
    }

    /// Sets the value from within the service, for instance when a task contains it. It is not
    /// checked against the range. No lock.
    pub fn set(&self, value: f64) {
        self.0.store(value.to_bits(), Ordering::Relaxed);
    }
}

/// Description of a parameter, for a person or a program.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParameterInfo {
    /// Service that owns it.
    pub service: String,
    /// Name, with its unit at the end.
    pub name: String,
    /// Present value.
    pub value: f64,
    /// Value at start.
    pub default: f64,
    /// Smallest value allowed.
    pub minimum: f64,
    /// Largest value allowed.
    pub maximum: f64,
    /// Unit; `1` for a plain number.
    pub unit: String,
    /// Description, one sentence.
    pub description: String,
}

struct Entry {
    info: ParameterInfo,
    value: Parameter,
}

type Entries = Arc<Mutex<Vec<Entry>>>;

/// The live parameters of one service. They can be set as long as this value lives.
pub struct Parameters {
    service: String,
    entries: Entries,
    _handles: [Handle; 2],
}

impl Parameters {
    /// Starts to answer queries on `param/SERVICE/*` and `parameters/SERVICE`.
    ///
    /// # Errors
    /// The bus refused the queryable.
    pub fn new(bus: &Bus, service: &str) -> Result<Self, BusError> {
        let entries = Entries::default();
        let (answering, listing) = (Arc::clone(&entries), Arc::clone(&entries));
        let handles = [
            bus.answer(&queries::settable(service), move |key, request| {
                respond(&answering, key, &request)
            })?,
            bus.answer(&queries::parameters(service), move |_, _| {
                let entries = lock(&listing);
                answer::done_with(format!("{} parameters", entries.len()), &list(&entries))
            })?,
        ];
        Ok(Self {
            service: service.to_owned(),
            entries,
            _handles: handles,
        })
    }

    /// Adds a number with its range (inclusive). A default outside the range is moved to the
    /// nearest limit. If the name already exists, the existing parameter is returned.
    pub fn number(
        &self,
        name: &str,
        default: f64,
        range: std::ops::RangeInclusive<f64>,
        unit: &str,
        description: &str,
    ) -> Parameter {
        let mut entries = lock(&self.entries);
        if let Some(known) = entries.iter().find(|entry| entry.info.name == name) {
            return known.value.clone();
        }
        let (minimum, maximum) = range.into_inner();
        let default = default.max(minimum).min(maximum);
        let value = Parameter(Arc::new(AtomicU64::new(default.to_bits())));
        entries.push(Entry {
            info: ParameterInfo {
                service: self.service.clone(),
                name: name.to_owned(),
                value: default,
                default,
                minimum,
                maximum,
                unit: unit.to_owned(),
                description: description.to_owned(),
            },
            value: value.clone(),
        });
        value
    }

    /// All parameters with their present values.
    pub fn list(&self) -> Vec<ParameterInfo> {
        list(&lock(&self.entries))
    }
}

fn lock(entries: &Entries) -> std::sync::MutexGuard<'_, Vec<Entry>> {
    entries.lock().unwrap_or_else(PoisonError::into_inner)
}

fn list(entries: &[Entry]) -> Vec<ParameterInfo> {
    entries
        .iter()
        .map(|entry| ParameterInfo {
            value: entry.value.get(),
            ..entry.info.clone()
        })
        .collect()
}

fn respond(entries: &Entries, key: &str, request: &Request) -> Answer {
    let entries = lock(entries);
    let name = key.rsplit('/').next().unwrap_or_default();
    let Some(entry) = entries.iter().find(|entry| entry.info.name == name) else {
        let names: Vec<&str> = entries.iter().map(|e| e.info.name.as_str()).collect();
        return answer::refused(format!(
            "this service has no parameter `{name}`{}; there are: {}",
            did_you_mean(name, names.iter().copied()),
            names.join(", ")
        ));
    };
    let info = &entry.info;
    match request.action.as_str() {
        "get" => answer::done_with(
            format!("{name} = {} {}", entry.value.get(), info.unit),
            &ParameterInfo {
                value: entry.value.get(),
                ..info.clone()
            },
        ),
        "set" => match request.argument.trim().parse::<f64>() {
            Ok(value) if value >= info.minimum && value <= info.maximum => {
                let before = entry.value.get();
                entry.value.0.store(value.to_bits(), Ordering::Relaxed);
                tracing::info!("{}/{name}: {before} -> {value} {}", info.service, info.unit);
                answer::done_with(
                    format!("{name} = {value} {} (was {before})", info.unit),
                    &ParameterInfo {
                        value,
                        ..info.clone()
                    },
                )
            }
            Ok(value) => answer::refused(format!(
                "{name} = {value} is out of range: {} to {} {}",
                info.minimum, info.maximum, info.unit
            )),
            Err(_) => answer::refused(format!("`{}` is not a number", request.argument)),
        },
        other => answer::refused(format!("unknown action `{other}`: get or set")),
    }
}

/// Follows a target at a bounded rate, so that a new setting does not jerk the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ramp {
    /// Present value.
    pub value: f64,
    /// Largest rate of change, in the value's unit per second.
    pub rate_per_s: f64,
}

impl Ramp {
    /// Starts at `value`.
    pub fn new(value: f64, rate_per_s: f64) -> Self {
        Self { value, rate_per_s }
    }

    /// Moves towards `target` for `dt_s` seconds, and returns the new value. A target that is not
    /// finite is ignored.
    pub fn step(&mut self, target: f64, dt_s: f64) -> f64 {
        let reach = self.rate_per_s * dt_s;
        let change = target - self.value;
        if change.is_finite() {
            self.value = if change.abs() <= reach {
                target
            } else {
                self.value + reach.copysign(change)
            };
        }
        self.value
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    const PATIENCE: Duration = Duration::from_secs(5);

    fn request(action: &str, argument: &str) -> Request {
        Request {
            action: action.into(),
            argument: argument.into(),
        }
    }

    #[test]
    fn a_set_is_seen_by_the_service_and_a_bad_one_refused_with_the_reason() {
        let bus = Bus::in_process("test");
        let parameters = Parameters::new(&bus, "controller").unwrap();
        let mass = parameters.number("mass_kg", 2.0, 0.5..=10.0, "kg", "Mass of the admittance.");
        assert_eq!(mass.get(), 2.0);

        let key = queries::parameter("controller", "mass_kg");
        let ask = |request: &Request| bus.ask(&key, request, PATIENCE).unwrap();
        assert!(ask(&request("set", "4")).done);
        assert_eq!(mass.get(), 4.0);
        let refused = ask(&request("set", "40"));
        assert!(!refused.done);
        assert_eq!(
            refused.message,
            "mass_kg = 40 is out of range: 0.5 to 10 kg"
        );
        assert_eq!(
            ask(&request("set", "heavy")).message,
            "`heavy` is not a number"
        );
        assert!(!ask(&request("set", "NaN")).done);
        assert_eq!(mass.get(), 4.0);

        let info: ParameterInfo = serde_json::from_str(&ask(&request("get", "")).data).unwrap();
        assert_eq!((info.value, info.default), (4.0, 2.0));
    }

    #[test]
    fn all_services_list_theirs() {
        let bus = Bus::in_process("test");
        let one = Parameters::new(&bus, "one").unwrap();
        let two = Parameters::new(&bus, "two").unwrap();
        one.number("a", 1.0, 0.0..=2.0, "1", "");
        two.number("b", 9.0, 0.0..=2.0, "1", "");
        let answers = bus
            .ask_all(&queries::parameters("*"), &request("list", ""), PATIENCE)
            .unwrap();
        let mut all: Vec<ParameterInfo> = answers
            .iter()
            .flat_map(|(_, answer)| serde_json::from_str::<Vec<_>>(&answer.data).unwrap())
            .collect();
        all.sort_by(|a, b| a.service.cmp(&b.service));
        assert_eq!(all.len(), 2);
        assert_eq!((all[1].name.as_str(), all[1].value), ("b", 2.0));
    }

    #[test]
    fn a_ramp_neither_jumps_nor_overshoots() {
        let mut ramp = Ramp::new(0.0, 2.0);
        assert_eq!(ramp.step(1.0, 0.25), 0.5);
        assert_eq!(ramp.step(1.0, 0.25), 1.0);
        assert_eq!(ramp.step(1.0, 0.25), 1.0);
        assert_eq!(ramp.step(-1.0, 0.25), 0.5);
        assert_eq!(ramp.step(f64::NAN, 0.25), 0.5);
    }
}
