//! A cell of processes on loopback, one per service, with one cell file and an observer on its bus.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde_json::Value;
use tangent_runtime::{Bus, CellConfig, Handle, Received, Role, clock};
use tangent_schemas::tangent::{ArmState, ContactTruth, ControlState};
use tangent_schemas::topics;
use tempfile::TempDir;

use crate::common::{Process, json, port_offset, root, run, stderr, wait_for};
use tangent_live::{Places, alone, beside_others, half};

/// Longest wait for any step that takes seconds at most on an idle machine; a machine that also
/// builds is slow.
pub const PATIENCE: Duration = Duration::from_secs(40);

/// A cell's processes by name, and its files.
pub struct Cell {
    folder: TempDir,
    port_offset: u16,
    processes: BTreeMap<String, Process>,
    // Released after the processes have ended.
    _places: Places,
}

impl Cell {
    /// Writes the cell file, after `change` has altered it; starts no process.
    pub fn new(change: impl FnOnce(&mut toml::Table)) -> Self {
        // The shipped scenario, with the tool closer to the surface: the approach is not tested
        // here.
        let nearer = ("clearance_m = 0.01", "clearance_m = 0.003");
        Self::shipped(
            "cell.toml",
            "scenarios/pipe_realistic.toml",
            &[nearer],
            beside_others(),
            |cell| {
                // Most of the processor time of a cell goes into passing records on.
                set(cell, "sensor.rate_hz", 500.0);
                change(cell);
            },
        )
    }

    /// A cell with an e-Series arm at 500 Hz, whose own sensor is used, above this surface: its
    /// lines of the scenario.
    #[allow(dead_code, reason = "only tests/ui.rs has such a cell")]
    pub fn with_e_series(surface: &str, change: impl FnOnce(&mut toml::Table)) -> Self {
        let plane = "shape = \"plane\"\nposition_m = [0.0, 0.0, 0.1]";
        let scenario = "scenarios/plane.toml";
        Self::shipped(
            "cell.ur5e.toml",
            scenario,
            &[(plane, surface)],
            half(),
            change,
        )
    }

    /// A cell with the torque-controlled arm over an object of known shape, with a camera.
    pub fn with_object() -> Self {
        let nearer = ("clearance_m = 0.15", "clearance_m = 0.08");
        let scenario = "scenarios/lippiello/lippiello_realistic.toml";
        Self::shipped("cell.lippiello.toml", scenario, &[nearer], alone(), |_| {})
    }

    /// A cell with a UR and a depth camera, which looks at a pipe.
    pub fn with_depth_camera() -> Self {
        let scenario = "scenarios/pipe_scan.toml";
        Self::shipped("cell.scan.toml", scenario, &[], half(), |_| {})
    }

    /// A cell with a Franka over a wave, with a depth camera.
    pub fn with_franka() -> Self {
        let nearer = ("clearance_m = 0.04", "clearance_m = 0.02");
        // Rendering images takes most of the processor time of such a cell.
        let fewer = ("rate_hz = 30.0", "rate_hz = 10.0");
        let scenario = "scenarios/karacan/karacan_depth.toml";
        Self::shipped(
            "cell.karacan.toml",
            scenario,
            &[nearer, fewer],
            half(),
            |_| {},
        )
    }

    /// A cell from a cell file of `deploy/` and a scenario in which each first text is replaced by
    /// the second.
    fn shipped(
        file: &str,
        scenario: &str,
        replaced: &[(&str, &str)],
        places: Places,
        change: impl FnOnce(&mut toml::Table),
    ) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let port_offset = port_offset();
        let offset = i64::from(port_offset);
        let mut scenario = fs::read_to_string(root().join(scenario)).unwrap();
        for (text, other) in replaced {
            assert!(scenario.contains(text), "{text}");
            scenario = scenario.replace(text, other);
        }
        fs::write(folder.path().join("scenario.toml"), scenario).unwrap();
        let shipped = fs::read_to_string(root().join("deploy").join(file)).unwrap();
        let mut cell: toml::Table = shipped.parse().unwrap();
        let endpoint = format!("tcp/127.0.0.1:{}", 7447 + offset);
        set(&mut cell, "cell.name", format!("cell{offset}"));
        set(&mut cell, "robot.port_offset", offset);
        set(&mut cell, "sensor.port_offset", offset);
        set(&mut cell, "zenoh.connect", vec![endpoint.clone()]);
        set(&mut cell, "zenoh.listen", vec![endpoint]);
        set(&mut cell, "simulator.scenario", "scenario.toml");
        let recordings = folder.path().join("recordings");
        set(&mut cell, "recorder.folder", recordings.to_str().unwrap());
        change(&mut cell);
        fs::write(folder.path().join("cell.toml"), cell.to_string()).unwrap();
        Self {
            folder,
            port_offset,
            processes: BTreeMap::new(),
            _places: places,
        }
    }

    /// Offset that is added to all ports.
    pub fn port_offset(&self) -> u16 {
        self.port_offset
    }

    /// Path of the cell file.
    pub fn file(&self) -> PathBuf {
        self.folder.path().join("cell.toml")
    }

    /// Folder of the recordings.
    pub fn recordings(&self) -> PathBuf {
        self.folder.path().join("recordings")
    }

    /// Writes a task file: 3 N along the given path, with or without a tare. The tool retracts by
    /// as little as it starts above the surface: the next approach takes its time.
    pub fn task(&self, tare: bool, path: &str) -> PathBuf {
        let text = format!(
            "name = \"test\"\ntare = {tare}\nforce.reference_n = 3.0\n\
             end.retract_distance_m = 0.005\n[path]\n{path}\n"
        );
        let file = self.folder.path().join("task.toml");
        fs::write(&file, text).unwrap();
        file
    }

    /// Writes a task file: a slow line of 0.6 m in strokes of 0.1 m, longer than any test slides.
    pub fn long_task(&self) -> PathBuf {
        self.task(
            true,
            "kind = \"line\"\nto_m = [0.1, 0.0]\nspeed_m_per_s = 0.02\nstrokes = 20",
        )
    }

    /// Starts one process with the services in `name`, separated by spaces. It replaces an earlier
    /// process of that name.
    pub fn start(&mut self, name: &str) {
        let log = fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(self.log_file(name))
            .unwrap();
        self.start_into(name, log);
    }

    fn log_file(&self, name: &str) -> PathBuf {
        self.folder.path().join(format!("{name}.log"))
    }

    /// Starts one process with the services in `name`, separated by spaces, with its log to `log`.
    /// It replaces an earlier process of that name.
    pub fn start_into(&mut self, name: &str, log: impl Into<std::process::Stdio>) {
        let file = self.file();
        let mut args = vec!["run"];
        args.extend(name.split(' '));
        args.extend(["--cell", file.to_str().unwrap()]);
        let process = Process::start_with_log(name, &args, log);
        self.processes.insert(name.to_owned(), process);
    }

    /// Starts one process for each name.
    pub fn start_all(&mut self, names: &[&str]) {
        for name in names {
            self.start(name);
        }
    }

    /// Log of the processes of that name.
    pub fn log(&self, name: &str) -> String {
        // Empty if the log was sent elsewhere.
        fs::read_to_string(self.log_file(name)).unwrap_or_default()
    }

    /// The current process of that name.
    pub fn process(&mut self, name: &str) -> &mut Process {
        self.processes.get_mut(name).expect("it was started")
    }

    /// Process ids by name.
    pub fn ids(&self) -> BTreeMap<String, u32> {
        self.processes
            .iter()
            .map(|(name, process)| (name.clone(), process.id()))
            .collect()
    }

    /// Checks that none of these processes has ended.
    pub fn assert_running(&mut self, names: &[&str]) {
        for name in names {
            let ended = self.process(name).code();
            assert_eq!(ended, None, "{name} has ended");
        }
    }

    /// Writes a task file: a circle on the object, with this number of turns.
    pub fn object_task(&self, turns: u32) -> PathBuf {
        let text = fs::read_to_string(root().join("deploy/tasks/object_circle.toml")).unwrap();
        let text = text.replace(
            "kind = \"circle\"",
            &format!("kind = \"circle\"\nturns = {turns}"),
        );
        let file = self.folder.path().join("task.toml");
        fs::write(&file, text).unwrap();
        file
    }

    /// Writes a task file: loops on the wave for so long, s. The tool retracts by less than in the
    /// shipped task: the next approach takes its time.
    pub fn loops_task(&self, duration_s: f64) -> PathBuf {
        let mut text = fs::read_to_string(root().join("deploy/tasks/loops.toml")).unwrap();
        for (from, to) in [
            ("duration_s = 20.0", format!("duration_s = {duration_s:?}")),
            (
                "retract_distance_m = 0.05",
                "retract_distance_m = 0.02".to_owned(),
            ),
        ] {
            assert!(text.contains(from), "{from}");
            text = text.replace(from, &to);
        }
        let file = self.folder.path().join("task.toml");
        fs::write(&file, text).unwrap();
        file
    }

    /// Provokes a fault in the simulator, as `tangent faults` does.
    pub fn provoke(&self, fault: &str, argument: &str) {
        let config = CellConfig::load(&self.file()).unwrap();
        let bus = Bus::open_within(&config, Role::Client, PATIENCE).unwrap();
        let request = tangent_schemas::tangent::Request {
            action: fault.to_owned(),
            argument: argument.to_owned(),
        };
        let answer = bus.ask("simulator/fault", &request, PATIENCE).unwrap();
        assert!(answer.done, "{}", answer.message);
    }

    /// Runs a `tangent` command on this cell.
    pub fn cli(&self, args: &[&str]) -> Output {
        let file = self.file();
        let mut all = args.to_vec();
        all.extend(["--cell", file.to_str().unwrap()]);
        run(&all)
    }

    /// Runs a `tangent` command with `--json` on this cell, and returns its output. It must end
    /// with `code`.
    pub fn cli_json(&self, args: &[&str], code: i32) -> Value {
        let mut all = args.to_vec();
        all.push("--json");
        let output = self.cli(&all);
        assert_eq!(
            output.status.code(),
            Some(code),
            "{args:?}: {}{}",
            String::from_utf8_lossy(&output.stdout),
            stderr(&output)
        );
        json(&output)
    }

    /// Starts a task as soon as the cell accepts one.
    pub fn start_task(&self, file: &Path) {
        let file = file.to_str().unwrap();
        wait_for("the task starts", PATIENCE, || {
            let output = self.cli(&["task", "start", file]);
            let said = String::from_utf8_lossy(&output.stdout).into_owned() + &stderr(&output);
            match output.status.code() {
                Some(0) => Some(()),
                // The answer to an earlier attempt came too late: the task already runs.
                Some(1) if said.contains("stop the running task first") => Some(()),
                // Not ready yet, with the reason.
                Some(1) => {
                    eprintln!("{}", said.trim());
                    None
                }
                other => panic!("{other:?}: {said}"),
            }
        });
    }

    /// Recordings in the cell's folder, in order.
    pub fn files(&self) -> Vec<PathBuf> {
        mcap_files(&self.recordings())
    }
}

impl Drop for Cell {
    /// Prints the logs of the processes if the test has failed.
    fn drop(&mut self) {
        if !std::thread::panicking() {
            return;
        }
        for name in self.processes.keys() {
            let text = self.log(name);
            let from = text.len().saturating_sub(4000);
            let from = (from..text.len()).find(|&i| text.is_char_boundary(i));
            eprintln!("---- {name}\n{}", &text[from.unwrap_or(0)..]);
        }
    }
}

/// Recordings in a folder, in order.
pub fn mcap_files(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = fs::read_dir(folder)
        .into_iter()
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|e| e == "mcap"))
        .collect();
    files.sort();
    files
}

/// Sets the value of `section.key`.
pub fn set(cell: &mut toml::Table, path: &str, value: impl Into<toml::Value>) {
    let (section, key) = path.split_once('.').unwrap();
    let table = cell
        .entry(section)
        .or_insert_with(|| toml::Table::new().into());
    table
        .as_table_mut()
        .unwrap()
        .insert(key.to_owned(), value.into());
}

/// One message with the time it was published, ns since the Unix epoch.
#[derive(Clone, Debug)]
pub struct Seen<M> {
    pub at_ns: i64,
    pub message: M,
}

type Log<M> = Arc<Mutex<Vec<Seen<M>>>>;

/// Records the messages of truth, controller and bridge over the cell's router.
pub struct Observer {
    truths: Log<ContactTruth>,
    controls: Log<ControlState>,
    arms: Log<ArmState>,
    _handles: Vec<Handle>,
    _bus: Bus,
}

impl Observer {
    /// Joins the cell's network after waiting for its router.
    pub fn join(cell: &Cell) -> Self {
        let config = CellConfig::load(&cell.file()).unwrap();
        let bus = Bus::open_within(&config, Role::Client, PATIENCE).unwrap();
        let (truths, controls, arms) = (Log::default(), Log::default(), Log::default());
        let handles = vec![
            bus.on(&topics::TRUTH_CONTACT, keep(&truths)).unwrap(),
            bus.on(&topics::CONTROL_STATE, keep(&controls)).unwrap(),
            bus.on(&topics::ARM_STATE, keep(&arms)).unwrap(),
        ];
        Self {
            truths,
            controls,
            arms,
            _handles: handles,
            _bus: bus,
        }
    }

    /// True states since `since_ns`.
    pub fn truths(&self, since_ns: i64) -> Vec<Seen<ContactTruth>> {
        since(&self.truths, since_ns)
    }

    /// States of the controller since `since_ns`.
    pub fn controls(&self, since_ns: i64) -> Vec<Seen<ControlState>> {
        since(&self.controls, since_ns)
    }

    /// The newest state of the bridge.
    pub fn arm(&self) -> Option<ArmState> {
        self.arms
            .lock()
            .unwrap()
            .last()
            .map(|seen| seen.message.clone())
    }

    /// Waits until the controller has reported this phase after `since_ns`; returns the first such
    /// state.
    pub fn phase(&self, phase: &str, since_ns: i64) -> Seen<ControlState> {
        wait_for(&format!("phase {phase}"), PATIENCE, || {
            self.has_been(phase, since_ns)
        })
    }

    /// Waits until the tool slides in contact, at half its speed or faster.
    pub fn sliding(&self, since_ns: i64) {
        self.phase("slide", since_ns);
        wait_for("the tool slides", PATIENCE, || {
            self.slides_now(since_ns).then_some(())
        });
    }

    fn slides_now(&self, since_ns: i64) -> bool {
        self.truths(since_ns)
            .last()
            .is_some_and(|t| t.message.in_contact && speed(&t.message) > 0.01)
    }

    /// Starts the task and waits until its tool slides.
    pub fn slide(&self, cell: &Cell, task: &Path) {
        let slides = |since_ns| self.slides_now(since_ns);
        self.begin(cell, task, "slide", PATIENCE, slides);
    }

    /// Starts the task and waits until it is done, having slid.
    pub fn wipe(&self, cell: &Cell, task: &Path) {
        self.wipe_within(PATIENCE, cell, task);
    }

    /// Starts the task and waits until it is done, having slid, for as long as `patience`.
    pub fn wipe_within(&self, patience: Duration, cell: &Cell, task: &Path) {
        self.begin(cell, task, "done", patience, |since_ns| {
            self.has_been("slide", since_ns).is_some()
        });
    }

    /// Starts the task and waits until it has reached this phase and `there` holds. If the machine
    /// stalls for some cycles, a task correctly ends with a fault. It is then started again, as an
    /// operator would, a few times.
    fn begin(
        &self,
        cell: &Cell,
        task: &Path,
        phase: &str,
        patience: Duration,
        there: impl Fn(i64) -> bool,
    ) {
        const STARTS: usize = 4;
        let mut faults = Vec::new();
        while faults.len() < STARTS {
            cell.start_task(task);
            let started = clock::now_ns();
            let fault = wait_for(&format!("{phase} of a task"), patience, || {
                let arrived = self.has_been(phase, started).is_some() && there(started);
                let fault = || {
                    self.has_been("fault", started)
                        .map(|seen| seen.message.fault)
                };
                if arrived {
                    Some(None)
                } else {
                    fault().map(Some)
                }
            });
            match fault {
                None => return,
                Some(fault) => {
                    eprintln!("before {phase}: {fault}; starting again");
                    faults.push(fault);
                }
            }
        }
        panic!("never in {phase}: {faults:?}");
    }

    /// The first state of the controller in this phase after `since_ns`.
    fn has_been(&self, phase: &str, since_ns: i64) -> Option<Seen<ControlState>> {
        self.controls(since_ns)
            .into_iter()
            .find(|seen| seen.message.phase_text.as_str() == phase)
    }

    /// Waits until the tool has been at rest (1 mm/s) for 0.2 s after `since_ns`; returns the time
    /// at which that began.
    pub fn at_rest(&self, since_ns: i64) -> i64 {
        wait_for("the tool stands", PATIENCE, || {
            let mut began = None;
            for truth in self.truths(since_ns) {
                if speed(&truth.message) > 1e-3 {
                    began = None;
                } else if truth.at_ns - *began.get_or_insert(truth.at_ns) > 200_000_000 {
                    return began;
                }
            }
            None
        })
    }

    /// Highest force of the surface on the tool since `since_ns`, N.
    pub fn peak_force_n(&self, since_ns: i64) -> f64 {
        self.truths(since_ns)
            .iter()
            .map(|t| {
                let f = &t.message.wrench.force;
                (f.x * f.x + f.y * f.y + f.z * f.z).sqrt()
            })
            .fold(0.0, f64::max)
    }

    /// Checks that the force on the tool has not exceeded `force_max_n` since `since_ns`.
    pub fn pressed_at_most(&self, force_max_n: f64, since_ns: i64) {
        let peak = self.peak_force_n(since_ns);
        assert!(peak <= force_max_n, "{peak} N");
    }

    /// Checks for `seconds` from now that the tool does not move by itself.
    pub fn stays_at_rest(&self, seconds: f64) {
        self.stays_slower_than(2e-3, seconds);
    }

    /// Checks for `seconds` from now that the tool stays below this speed, m/s.
    pub fn stays_slower_than(&self, speed_max_m_per_s: f64, seconds: f64) {
        let from = clock::now_ns();
        let until = from + (seconds * 1e9) as i64;
        wait_for("truths come in", PATIENCE, || {
            let truths = self.truths(from);
            for truth in &truths {
                assert!(
                    speed(&truth.message) < speed_max_m_per_s,
                    "the tool moves by itself: {} m/s",
                    speed(&truth.message)
                );
            }
            truths.last().is_some_and(|t| t.at_ns > until).then_some(())
        });
    }
}

fn keep<M: Clone + Send + 'static>(log: &Log<M>) -> impl FnMut(&Received<M>) + Send + 'static {
    let log = Arc::clone(log);
    move |received| {
        log.lock().unwrap().push(Seen {
            at_ns: received.source_time_ns,
            message: received.message.clone(),
        });
    }
}

fn since<M: Clone>(log: &Log<M>, since_ns: i64) -> Vec<Seen<M>> {
    let log = log.lock().unwrap();
    let from = log.partition_point(|seen| seen.at_ns < since_ns);
    log[from..].to_vec()
}

/// Speed of the tool, m/s.
pub fn speed(truth: &ContactTruth) -> f64 {
    let v = &truth.tool_twist.linear;
    (v.x * v.x + v.y * v.y + v.z * v.z).sqrt()
}

/// Converts ns to s.
pub fn seconds(ns: i64) -> f64 {
    ns as f64 * 1e-9
}
