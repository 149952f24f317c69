//! One light for each part of the cell: a level, and a code that the page turns into a sentence.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Serialize;
use serde_json::{Value, json};
use tangent_control::Phase;
use tangent_runtime::State;
use tangent_schemas::tangent::{ArmState, ControlState, Health};

/// Age from which a stream at the rate of the robot counts as silent.
const SILENT: Duration = Duration::from_millis(500);
/// Age from which a health message, of 1 Hz, counts as missing.
const MISSING: Duration = Duration::from_secs(3);

/// How well a part works.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// As it should.
    Good,
    /// Something needs attention.
    Warn,
    /// It does not work.
    Bad,
}

/// The light of one part.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Light {
    /// `robot`, `sensor`, `controller`, `estimate`, or the name of a service.
    pub part: String,
    /// Whether it is a service, by its own report.
    pub is_service: bool,
    /// Its colour.
    pub level: Level,
    /// Key of its sentence: `light.CODE` in the texts.
    pub code: &'static str,
    /// Values in the sentence.
    pub values: BTreeMap<&'static str, Value>,
}

impl Light {
    fn new<const N: usize>(
        part: &str,
        level: Level,
        code: &'static str,
        values: [(&'static str, Value); N],
    ) -> Self {
        Self {
            part: part.to_owned(),
            is_service: false,
            level,
            code,
            values: values.into(),
        }
    }

    fn of_service(mut self) -> Self {
        self.is_service = true;
        self
    }
}

/// Newest messages and their ages.
pub struct Seen<'a> {
    pub arm: Option<(&'a ArmState, Duration)>,
    pub control: Option<(&'a ControlState, Duration)>,
    pub healths: &'a [(&'a Health, Duration)],
}

impl Seen<'_> {
    /// The lights, the parts that move the arm first.
    pub fn lights(&self) -> Vec<Light> {
        let mut lights = vec![
            self.robot(),
            self.sensor(),
            self.estimate(),
            self.controller(),
        ];
        let recorder = self.healths.iter().any(|(h, _)| &*h.service == "recorder");
        lights.extend(
            self.healths
                .iter()
                .map(|(health, age)| of_health(health, *age)),
        );
        if !recorder {
            lights.push(Light::new("recorder", Level::Warn, "no_recorder", []).of_service());
        }
        lights
    }

    fn robot(&self) -> Light {
        match self.arm {
            None => Light::new("robot", Level::Bad, "robot.never", []),
            Some((_, age)) if age > SILENT => {
                Light::new("robot", Level::Bad, "robot.silent", [("s", seconds(age))])
            }
            Some((arm, _)) if !arm.ready => {
                let why = arm.not_ready_reason.as_str();
                Light::new(
                    "robot",
                    Level::Warn,
                    "robot.not_ready",
                    [("why", json!(why))],
                )
            }
            Some((_, age)) => match self.rate_of(&["rtde", "franka"]) {
                Some(hz) => {
                    let values = [("ms", millis(age)), ("hz", hertz(hz))];
                    Light::new("robot", Level::Good, "robot.ready_at", values)
                }
                None => Light::new("robot", Level::Good, "robot.ready", [("ms", millis(age))]),
            },
        }
    }

    /// Rate at which the first of these services that reports it handles the robot's states, Hz.
    fn rate_of(&self, services: &[&str]) -> Option<f64> {
        let of = |name: &&str| {
            let health = self.health_of(name)?;
            let names = health.rate_names.iter();
            let (_, hz) = names
                .zip(&health.rates_hz)
                .find(|(n, _)| *n == "arm_state")?;
            (hz.is_finite() && *hz > 0.0).then_some(*hz)
        };
        services.iter().find_map(of)
    }

    /// Newest health of a service, unless it is old.
    fn health_of(&self, name: &str) -> Option<&Health> {
        let fresh = |(health, age): &&(&Health, Duration)| {
            health.service.as_str() == name && *age <= MISSING
        };
        self.healths.iter().find(fresh).map(|(health, _)| *health)
    }

    fn fresh_control(&self) -> Option<&ControlState> {
        let fresh = |(control, age): (_, Duration)| (age <= SILENT).then_some(control);
        self.control.and_then(fresh)
    }

    fn sensor(&self) -> Light {
        let Some(control) = self.fresh_control() else {
            return Light::new("sensor", Level::Warn, "unknown", []);
        };
        let age = Duration::try_from_secs_f64(control.wrench_age_s).ok();
        match age {
            None => Light::new("sensor", Level::Bad, "sensor.never", []),
            Some(age) if age > SILENT => {
                Light::new("sensor", Level::Bad, "sensor.silent", [("s", seconds(age))])
            }
            Some(_) if control.wrench_validity != 0 => {
                let code = json!(control.wrench_validity);
                Light::new("sensor", Level::Bad, "sensor.invalid", [("code", code)])
            }
            Some(_) if control.zero_age_s < 0.0 => {
                Light::new("sensor", Level::Warn, "sensor.no_zero", [])
            }
            Some(age) => {
                let zero = json!((control.zero_age_s / 60.0).round());
                let values = [("ms", millis(age)), ("min", zero)];
                Light::new("sensor", Level::Good, "sensor.good", values)
            }
        }
    }

    fn estimate(&self) -> Light {
        let Some(control) = self.fresh_control() else {
            return Light::new("estimate", Level::Warn, "unknown", []);
        };
        let name = json!(control.estimator.as_str());
        let pressing = Phase::from_code(control.phase).is_some_and(Phase::is_pressing);
        match Duration::try_from_secs_f64(control.estimate_age_s) {
            Ok(age) if pressing && age <= SILENT => {
                let values = [("name", name), ("ms", millis(age))];
                Light::new("estimate", Level::Good, "estimate.good", values)
            }
            Ok(age) if pressing => {
                let values = [("name", name), ("s", seconds(age))];
                Light::new("estimate", Level::Bad, "estimate.silent", values)
            }
            // Before contact, there is nothing to estimate.
            _ => Light::new("estimate", Level::Good, "estimate.not_needed", []),
        }
    }

    fn controller(&self) -> Light {
        match self.control {
            None => Light::new("controller", Level::Bad, "controller.never", []),
            Some((_, age)) if age > SILENT => Light::new(
                "controller",
                Level::Bad,
                "controller.silent",
                [("s", seconds(age))],
            ),
            Some((control, _)) if !control.fault.is_empty() => {
                let why = json!(control.fault.as_str());
                Light::new(
                    "controller",
                    Level::Warn,
                    "controller.fault",
                    [("why", why)],
                )
            }
            Some((_, age)) => self.controller_works(age),
        }
    }

    /// A controller without a fault, whose state has this age.
    fn controller_works(&self, age: Duration) -> Light {
        let (ms, bridge) = (("ms", millis(age)), self.health_of("rtde"));
        let bridge = bridge.or_else(|| self.health_of("franka"));
        match (self.rate_of(&["controller"]), bridge) {
            (Some(hz), Some(bridge)) => {
                let missed = ("missed", json!(bridge.missed_cycles));
                let values = [ms, ("hz", hertz(hz)), missed];
                Light::new("controller", Level::Good, "controller.good_at", values)
            }
            _ => Light::new("controller", Level::Good, "controller.good", [ms]),
        }
    }
}

fn of_health(health: &Health, age: Duration) -> Light {
    let part = health.service.as_str();
    let host = json!(health.host.as_str());
    if age > MISSING {
        let values = [("host", host), ("s", seconds(age))];
        return Light::new(part, Level::Bad, "service.silent", values).of_service();
    }
    let why = if health.fault.is_empty() {
        health.remarks.first().cloned().unwrap_or_default()
    } else {
        health.fault.clone()
    };
    let is = |state: State| health.state == state as u8;
    let (level, code) = if is(State::Running) {
        (Level::Good, "service.running")
    } else if is(State::Degraded) {
        (Level::Warn, "service.degraded")
    } else if is(State::Starting) {
        (Level::Warn, "service.starting")
    } else if is(State::Stopping) {
        (Level::Warn, "service.stopping")
    } else {
        (Level::Bad, "service.fault")
    };
    Light::new(part, level, code, [("host", host), ("why", json!(why))]).of_service()
}

fn millis(age: Duration) -> Value {
    json!((age.as_secs_f64() * 1e3).round())
}

fn hertz(hz: f64) -> Value {
    json!(hz.round())
}

fn seconds(age: Duration) -> Value {
    json!((age.as_secs_f64() * 10.0).round() / 10.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Duration = Duration::from_millis(5);
    const LATE: Duration = Duration::from_secs(4);

    fn light(lights: &[Light], part: &str) -> (Level, &'static str) {
        let found = lights.iter().find(|light| light.part == part);
        let found = found.unwrap_or_else(|| panic!("{part} in {lights:?}"));
        (found.level, found.code)
    }

    #[test]
    fn a_healthy_cell_has_green_lights_only() {
        let arm = ArmState {
            ready: true,
            ..ArmState::default()
        };
        let control = ControlState::default();
        let health = |name: &str| Health {
            service: name.try_into().unwrap(),
            state: State::Running as u8,
            ..Health::default()
        };
        let (recorder, netft) = (health("recorder"), health("netft"));
        let seen = Seen {
            arm: Some((&arm, NOW)),
            control: Some((&control, NOW)),
            healths: &[(&recorder, NOW), (&netft, NOW)],
        };
        let lights = seen.lights();
        assert_eq!(lights.len(), 6);
        assert!(lights.iter().all(|l| l.level == Level::Good), "{lights:?}");
    }

    #[test]
    fn rates_and_missed_cycles_are_those_of_the_services() {
        let arm = ArmState {
            ready: true,
            ..ArmState::default()
        };
        let control = ControlState::default();
        let health = |name: &str, hz, missed_cycles| Health {
            service: name.try_into().unwrap(),
            state: State::Running as u8,
            rate_names: vec!["other".to_owned(), "arm_state".to_owned()],
            rates_hz: vec![1.0, hz],
            missed_cycles,
            ..Health::default()
        };
        let (rtde, controller) = (health("rtde", 499.8, 3), health("controller", 500.2, 0));
        let at = |age: Duration| {
            Seen {
                arm: Some((&arm, Duration::from_millis(2))),
                control: Some((&control, Duration::from_millis(2))),
                healths: &[(&rtde, age), (&controller, age)],
            }
            .lights()
        };
        let lights = at(NOW);
        let values = |part: &str| {
            let found = lights.iter().find(|light| light.part == part).unwrap();
            json!([found.code, found.values])
        };
        let robot = json!(["robot.ready_at", { "hz": 500.0, "ms": 2.0 }]);
        assert_eq!(values("robot"), robot);
        let works = json!(["controller.good_at", { "hz": 500.0, "missed": 3, "ms": 2.0 }]);
        assert_eq!(values("controller"), works);
        // What was said long ago is not said again.
        assert_eq!(light(&at(LATE), "robot").1, "robot.ready");
    }

    #[test]
    fn what_is_silent_or_wrong_is_red_or_yellow() {
        let nothing = Seen {
            arm: None,
            control: None,
            healths: &[],
        };
        let lights = nothing.lights();
        assert_eq!(light(&lights, "robot"), (Level::Bad, "robot.never"));
        assert_eq!(light(&lights, "sensor"), (Level::Warn, "unknown"));
        assert_eq!(light(&lights, "recorder"), (Level::Warn, "no_recorder"));

        let arm = ArmState {
            not_ready_reason: "protective stop".try_into().unwrap(),
            ..ArmState::default()
        };
        let control = ControlState {
            phase: Phase::Slide as u8,
            estimate_age_s: 2.0,
            wrench_validity: 3,
            fault: "the sensor is saturated".try_into().unwrap(),
            ..ControlState::default()
        };
        let health = Health {
            service: "rtde".try_into().unwrap(),
            state: State::Fault as u8,
            ..Health::default()
        };
        let at = |age: Duration, of_health: Duration| {
            Seen {
                arm: Some((&arm, age)),
                control: Some((&control, age)),
                healths: &[(&health, of_health)],
            }
            .lights()
        };
        let lights = at(NOW, NOW);
        assert_eq!(light(&lights, "robot"), (Level::Warn, "robot.not_ready"));
        assert_eq!(light(&lights, "sensor"), (Level::Bad, "sensor.invalid"));
        assert_eq!(light(&lights, "estimate"), (Level::Bad, "estimate.silent"));
        assert_eq!(light(&lights, "rtde"), (Level::Bad, "service.fault"));
        assert_eq!(
            light(&lights, "controller"),
            (Level::Warn, "controller.fault")
        );
        let lights = at(LATE, LATE);
        assert_eq!(light(&lights, "robot"), (Level::Bad, "robot.silent"));
        let controller = light(&lights, "controller");
        assert_eq!(controller, (Level::Bad, "controller.silent"));
        assert_eq!(light(&lights, "rtde"), (Level::Bad, "service.silent"));
        // Ages before the first message are not ages.
        let never = ControlState {
            wrench_age_s: f64::NAN,
            ..ControlState::default()
        };
        let seen = Seen {
            arm: None,
            control: Some((&never, NOW)),
            healths: &[],
        };
        assert_eq!(
            light(&seen.lights(), "sensor"),
            (Level::Bad, "sensor.never")
        );
    }

    #[test]
    fn every_light_has_its_sentence() {
        let texts: Value = serde_json::from_str(include_str!("../page/texts.en.json")).unwrap();
        let source = include_str!("lights.rs");
        let source = source.split("mod tests").next().unwrap();
        let mut found = 0;
        for code in source.split('"').skip(1).step_by(2) {
            let is_code = ["robot.", "sensor.", "estimate.", "controller.", "service."];
            if is_code.iter().any(|part| code.starts_with(part)) || code == "no_recorder" {
                assert!(texts[format!("light.{code}")].is_string(), "{code}");
                found += 1;
            }
        }
        assert!(found >= 20, "{found}");
    }
}
