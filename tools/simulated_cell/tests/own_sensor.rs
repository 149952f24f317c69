//! The closed loop on the sensor of an e-Series arm: the simulated controller over real sockets,
//! bridge, sensor service, estimator and controller on the bus of one process, with the cell file
//! that ships.

#![allow(clippy::unwrap_used)]

use std::path::Path;
use std::time::{Duration, Instant};

use tangent_compose::{RecorderExtra, Running, service};
use tangent_live::{ports, timed};
use tangent_runtime::{Bus, CellConfig, Latest, Stop};
use tangent_schemas::tangent::{ArmState, ContactTruth, ControlState, Request, WrenchStatus};
use tangent_schemas::topics::{self, queries};
use tangent_simulated_cell::{run_cell_file, scenarios, start_simulator};

const PATIENCE: Duration = Duration::from_secs(90);
const TASK: &str = r#"
    name = "short line"
    estimators = ["blend", "reactive"]
    force.reference_n = 8.0
    [path]
    kind = "line"
    to_m = [0.03, 0.0]
    speed_m_per_s = 0.02
"#;

/// A cell in this process.
struct Cell {
    bus: Bus,
    everybody: Stop,
    services: Vec<Running>,
    control: Latest<ControlState>,
    truth: Latest<ContactTruth>,
}

impl Cell {
    fn start(reading: &str) -> Self {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/cell.ur5e.toml");
        let shipped = CellConfig::load(&file).unwrap();
        let mut played = scenarios::load("plane", &[]).unwrap();
        let given = run_cell_file(&shipped, &file, &mut played, ports::offset()).unwrap();
        assert_eq!(given.config.robot.model, "ur5e");
        let config = given
            .config
            .changed("the cell of this test", |cell| {
                let set = |cell: &mut toml::Table, table: &str, key: &str, value: toml::Value| {
                    let table = cell
                        .entry(table)
                        .or_insert_with(|| toml::Table::new().into());
                    table.as_table_mut().unwrap().insert(key.to_owned(), value);
                };
                set(cell, "robot", "power_on", true.into());
                set(cell, "realtime", "enabled", false.into());
                let ur: toml::Table = format!("reading = \"{reading}\"").parse().unwrap();
                set(cell, "sensor", "ur", ur.into());
                // Other processes may hold this machine's processors for a while.
                let patience: toml::Table =
                    "patience = { wrench_retract_s = 0.4 }".parse().unwrap();
                set(cell, "controller", "settings", patience.into());
            })
            .unwrap();
        let bus = Bus::in_process("ur5e");
        let everybody = Stop::new();
        let extra = RecorderExtra::default();
        let simulator = start_simulator(&config, Some(&played), &bus, &everybody).unwrap();
        let mut services: Vec<Running> = ["controller", "estimator", "netft", "rtde"]
            .iter()
            .map(|name| service(name, &config, &bus, &everybody, &extra).unwrap())
            .collect();
        services.reverse();
        services.push(simulator);
        Self {
            control: bus.latest(&topics::CONTROL_STATE).unwrap(),
            truth: bus.latest(&topics::TRUTH_CONTACT).unwrap(),
            bus,
            everybody,
            services,
        }
    }

    /// Repeats `look` until it returns a value.
    fn until<T>(&mut self, what: &str, mut look: impl FnMut(&mut Self) -> Option<T>) -> T {
        let end = Instant::now() + PATIENCE;
        let pause = Stop::new();
        while Instant::now() < end && !self.everybody.is_stopped() {
            if let Some(found) = look(self) {
                return found;
            }
            pause.wait(Duration::from_millis(2));
        }
        let ended = self.end();
        panic!("{what} never came: {:?}, {ended:?}", self.control.get());
    }

    /// Ends every service; returns the errors of those that failed.
    fn end(&mut self) -> Vec<String> {
        let ended = self.services.drain(..).map(Running::end);
        ended
            .filter_map(|end| end.err().map(|e| format!("{e:#}")))
            .collect()
    }
}

/// Mean pressing force along the path, as the controller measures it and as it is, N.
fn wipe(reading: &str) -> (f64, f64) {
    let mut cell = Cell::start(reading);
    let mut arm: Latest<ArmState> = cell.bus.latest(&topics::ARM_STATE).unwrap();
    let mut status: Latest<WrenchStatus> = cell.bus.latest(&topics::WRENCH_STATUS).unwrap();
    cell.until("a ready arm", |_| {
        arm.refresh();
        arm.get().filter(|arm| arm.message.ready).map(drop)
    });
    cell.until("a valid wrench", |_| {
        status.refresh();
        status.get().filter(|s| s.message.validity == 0).map(drop)
    });
    let request = Request {
        action: "start".into(),
        argument: TASK.into(),
    };
    let answer = cell.bus.ask(queries::CONTROL_TASK, &request, PATIENCE);
    let answer = answer.unwrap();
    assert!(answer.done, "{}", answer.message);
    let (mut felt, mut true_force) = (Vec::new(), Vec::new());
    let ended = cell.until("the end of the task", |cell| {
        cell.control.refresh();
        cell.truth.refresh();
        let state = cell.control.get()?.message.clone();
        if state.phase_text.as_str() == "slide" {
            let truth = &cell.truth.get()?.message;
            felt.push(state.force_n);
            true_force.push(truth.wrench.force.z);
        }
        ["done", "fault", "idle"]
            .contains(&state.phase_text.as_str())
            .then_some(state)
            .filter(|state| state.phase_text.as_str() != "idle" || !felt.is_empty())
    });
    assert_eq!(ended.phase_text.as_str(), "done", "{ended:?}");
    // The tare of the task set a zero on this sensor.
    let last = status.get().unwrap().message.clone();
    assert!(last.bias_age_s >= 0.0, "{last:?}");
    assert!(cell.end().is_empty());
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    eprintln!("{reading}: {} values while sliding", felt.len());
    (mean(&felt), mean(&true_force))
}

/// The table lies flat, so that the true pressing force is the vertical one. The tare is taken just
/// before, so the drift has little time.
#[test]
fn the_arm_wipes_by_its_own_sensor() {
    timed(|| {
        for reading in ["ft_raw_wrench", "actual_TCP_force"] {
            let (felt, true_force) = wipe(reading);
            eprintln!("{reading}: felt {felt:.2} N, true {true_force:.2} N");
            assert!((felt - 8.0).abs() < 1.0, "{reading}: {felt}");
            assert!((true_force - 8.0).abs() < 1.5, "{reading}: {true_force}");
        }
    });
}
