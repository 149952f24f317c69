//! A cell of its own for the faults: the simulator in this process, each service in one that can be
//! killed.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Write;
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use tangent_control::Phase;
use tangent_runtime::{Bus, CellConfig, Role, Stop, clock};
use tangent_schemas::tangent::Request;
use tangent_schemas::topics::queries;
use tangent_simulator::service::FAULT_KEY;

use super::evidence::{Control, Evidence};
use super::host_clock::{Host, HostClock};
use super::wire::{Link, SensorWire};
use crate::compose::{self, Running};
use crate::scenarios::{self, Played};

/// Longest wait for the cell to come up, or to be itself again.
const PATIENCE: Duration = Duration::from_secs(40);
const LOOK: Duration = Duration::from_millis(10);
/// What was said longer ago says nothing of now.
const FRESH_NS: i64 = 300_000_000;
/// Pressing force of the task, N.
pub const REFERENCE_N: f64 = 3.0;
/// How fast it slides, m/s.
const SPEED_M_PER_S: f64 = 0.02;
/// How long it has slid before a fault comes, ns.
const SLID_NS: i64 = 300_000_000;

/// How the services are spread over processes, and what the tool slides on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Layout {
    /// The hard loop in one process, as it is meant to be.
    Composed,
    /// Bridge and controller apart.
    Apart,
    /// Composed, and each process on a host whose clock can be set: its messages come through this
    /// process.
    Relayed,
    /// Composed, and the surface has an edge.
    Ledge,
}

impl Layout {
    fn processes(self) -> &'static [&'static str] {
        match self {
            Self::Composed | Self::Relayed | Self::Ledge => &[
                "router",
                "recorder",
                "netft",
                "rtde controller",
                "estimator",
            ],
            Self::Apart => &[
                "router",
                "recorder",
                "netft",
                "rtde",
                "controller",
                "estimator",
            ],
        }
    }

    /// The hard loop's process, or the bridge's.
    pub fn bridge(self) -> &'static str {
        match self {
            Self::Composed | Self::Relayed | Self::Ledge => "rtde controller",
            Self::Apart => "rtde",
        }
    }
}

/// The cell under test.
pub struct PrivateCell {
    folder: PathBuf,
    layout: Layout,
    processes: BTreeMap<&'static str, Child>,
    hogs: Vec<Child>,
    /// A shell that waits to send signals: starting one takes longer than what is to be measured.
    signals: ChildStdin,
    shell: Child,
    simulator: Option<Running>,
    /// The sensor's cable.
    pub sensor: SensorWire,
    /// The estimator's cable to the router.
    pub estimator: Link,
    /// The clocks of the hosts, in the layout that has them.
    pub clocks: BTreeMap<Host, HostClock>,
    /// This process on the cell's network.
    pub bus: Bus,
    /// Everything heard.
    pub evidence: Evidence,
    /// Where the tool hung at first along x, base axes, m.
    start_x_m: Option<f64>,
}

impl PrivateCell {
    /// Writes its files into `folder` and starts everything.
    ///
    /// # Errors
    /// Busy ports, or a process that cannot be started.
    pub fn start(folder: &Path, port_offset: u16, layout: Layout, seed: u64) -> Result<Self> {
        fs::create_dir_all(folder.join("recordings"))
            .with_context(|| format!("making {}", folder.display()))?;
        let loopback = |port: u16| SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let router = port_offset
            .checked_add(7447)
            .filter(|_| port_offset <= 16_383)
            .ok_or_else(|| crate::output::bad_usage("--port-offset: 0 to 16383 is allowed"))?;
        let sensor = SensorWire::start(loopback(49_152 + port_offset))?;
        let estimator = Link::start(loopback(router))?;
        let file = |name: &str| folder.join(name);
        let text = |router: u16| cell_text(folder, port_offset, router, sensor.port());
        fs::write(file("cell.toml"), text(router)?)?;
        for host in Host::ALL {
            let own = match layout {
                // This process is the router of that host's network: the cell's own carries no more
                // than without it.
                Layout::Relayed => {
                    text(free_port()?)?.replace(&cell_name(), &format!("{}-{host:?}", cell_name()))
                }
                _ if host == Host::Estimator => text(estimator.port())?,
                _ => text(router)?,
            };
            fs::write(file(&host_file(host)), own)?;
        }

        let mut shell = Command::new("sh")
            .stdin(Stdio::piped())
            .spawn()
            .context("starting sh, which sends the signals")?;
        let signals = shell.stdin.take().context("sh has no standard input")?;
        let config = CellConfig::load(&file("cell.toml"))?;
        let mut processes = BTreeMap::new();
        processes.insert("router", start_process(folder, "router")?);
        let bus = Bus::open_within(&config, Role::Client, PATIENCE)?;
        let evidence = Evidence::gather(&bus)?;
        let mut clocks = BTreeMap::new();
        if layout == Layout::Relayed {
            for host in Host::ALL {
                let config = CellConfig::load(&file(&host_file(host)))?;
                let far = Bus::open_within(&config, Role::Router, PATIENCE)?;
                clocks.insert(host, HostClock::start(host, &far, &bus)?);
            }
        }
        let played = Played::Normals(Box::new(scenario(layout, seed)?));
        let simulator = compose::simulator(&config, Some(&played), &bus, &Stop::new())?;
        let mut cell = Self {
            folder: folder.to_owned(),
            layout,
            processes,
            hogs: Vec::new(),
            signals,
            shell,
            simulator: Some(simulator),
            sensor,
            estimator,
            clocks,
            bus,
            evidence,
            start_x_m: None,
        };
        cell.restart_dead()?;
        Ok(cell)
    }

    /// How it is spread.
    pub fn layout(&self) -> Layout {
        self.layout
    }

    /// Where it records.
    pub fn recordings(&self) -> PathBuf {
        self.folder.join("recordings")
    }

    /// Starts whatever of the layout does not run.
    ///
    /// # Errors
    /// A process that cannot be started.
    pub fn restart_dead(&mut self) -> Result<()> {
        for name in self.layout.processes() {
            let runs = match self.processes.get_mut(name) {
                Some(child) => child.try_wait()?.is_none(),
                None => false,
            };
            if !runs {
                let child = start_process(&self.folder, name)?;
                self.processes.insert(name, child);
            }
        }
        Ok(())
    }

    /// Kills one process outright; `restart_dead` brings it back.
    ///
    /// # Errors
    /// When it does not run.
    pub fn kill(&mut self, name: &'static str) -> Result<()> {
        let child = self.child(name)?;
        child.kill()?;
        child.wait()?;
        Ok(())
    }

    /// Sends a signal by name to one process.
    ///
    /// # Errors
    /// When it does not run.
    pub fn signal(&mut self, name: &'static str, signal: &str) -> Result<()> {
        let id = self.child(name)?.id();
        writeln!(self.signals, "kill -{signal} {id}").context("sending a signal")
    }

    fn child(&mut self, name: &'static str) -> Result<&mut Child> {
        self.processes
            .get_mut(name)
            .with_context(|| format!("{name} does not run"))
    }

    /// Something goes wrong with the simulated robot.
    ///
    /// # Errors
    /// An unknown name.
    pub fn robot(&self, fault: &str, argument: &str) -> Result<()> {
        let request = Request {
            action: fault.to_owned(),
            argument: argument.to_owned(),
        };
        let answer = self.bus.ask(FAULT_KEY, &request, PATIENCE)?;
        if !answer.done {
            bail!("simulator: {}", answer.message);
        }
        Ok(())
    }

    /// Keeps every core busy, twice over.
    ///
    /// # Errors
    /// When no process can be started.
    pub fn hog(&mut self) -> Result<()> {
        let cores = std::thread::available_parallelism().map_or(2, usize::from);
        for _ in 0..2 * cores {
            let hog = Command::new("sh")
                .args(["-c", "while :; do :; done"])
                .stdin(Stdio::null())
                .spawn()?;
            self.hogs.push(hog);
        }
        Ok(())
    }

    /// Leaves the cores alone again.
    pub fn end_hogs(&mut self) {
        for mut hog in self.hogs.drain(..) {
            let _ = hog.kill();
            let _ = hog.wait();
        }
    }

    /// Has a task under way whose tool slides, whatever it takes.
    ///
    /// # Errors
    /// When that does not come about in time; the reason is the last one heard.
    pub fn slide(&mut self) -> Result<()> {
        let until = Instant::now() + PATIENCE;
        let mut last = "nothing was heard".to_owned();
        let mut asked_ns = 0;
        while Instant::now() < until {
            self.restart_dead()?;
            let now = clock::now_ns();
            let control = self.evidence.control(now - FRESH_NS);
            if let Some(control) = control {
                if control.phase.is_active() {
                    if control.phase == Phase::Slide && self.evidence.slid_throughout(now - SLID_NS)
                    {
                        return Ok(());
                    }
                } else if now - asked_ns > FRESH_NS {
                    if !control.fault.is_empty() {
                        last = control.fault;
                    }
                    if let Some(reason) = self.start_task()? {
                        last = reason;
                    }
                    asked_ns = clock::now_ns();
                }
            }
            std::thread::sleep(LOOK);
        }
        bail!("the tool does not slide after {PATIENCE:?}: {last}")
    }

    /// Asks for a task; the reason when there is none.
    fn start_task(&mut self) -> Result<Option<String>> {
        let Some(arm) = self.evidence.arm(clock::now_ns() - FRESH_NS) else {
            return Ok(Some("nothing is heard of the arm".to_owned()));
        };
        // A path begins where the tool stands: each leads back over where the first began, so that
        // none leaves the arm's reach.
        let start_x_m = *self.start_x_m.get_or_insert(arm.tool_x_m);
        let way = if arm.tool_x_m > start_x_m { -0.1 } else { 0.1 };
        let task = format!(
            "name = \"faults\"\nestimators = [\"blend\", \"reactive\"]\n\
             force.reference_n = {REFERENCE_N:?}\nend.retract_distance_m = 0.01\n\
             [plane]\nx_axis = [1.0, 0.0, 0.0]\n[path]\nkind = \"line\"\nto_m = [{way}, 0.0]\nspeed_m_per_s = {SPEED_M_PER_S}\nstrokes = 200\n"
        );
        let request = Request {
            action: "start".to_owned(),
            argument: task,
        };
        Ok(
            match self
                .bus
                .ask(queries::CONTROL_TASK, &request, Duration::from_secs(2))
            {
                Ok(answer) if answer.done => None,
                Ok(answer) => Some(answer.message),
                Err(error) => Some(error.to_string()),
            },
        )
    }

    /// Stops the task, and waits for the end of its retraction. Whether the tool is off the surface
    /// then, and the controller's last word.
    ///
    /// # Errors
    /// When it does not end.
    pub fn stop_task(&mut self) -> Result<(bool, Control)> {
        let request = Request {
            action: "stop".to_owned(),
            argument: String::new(),
        };
        let until = Instant::now() + PATIENCE;
        let answer = self
            .bus
            .ask(queries::CONTROL_STOP, &request, Duration::from_secs(5))?;
        if !answer.done {
            bail!("the controller does not stop: {}", answer.message);
        }
        loop {
            let ended = self
                .evidence
                .control_at(clock::now_ns() - FRESH_NS)
                .filter(|(_, control)| !control.phase.is_active());
            // A truth of the moment before it would be that of the retraction.
            if let Some((at_ns, control)) = ended
                && let Some(off) = self.evidence.is_off_the_surface(at_ns)
            {
                return Ok((off, control));
            }
            if Instant::now() > until {
                bail!("the task has not ended {PATIENCE:?} after its stop");
            }
            std::thread::sleep(LOOK);
        }
    }

    /// Everybody speaks: the controller, the sensor's service, the estimator and the recorder,
    /// since `since_ns`.
    ///
    /// # Errors
    /// Who is missing, after a while.
    pub fn wait_for_all(&mut self, since_ns: i64) -> Result<()> {
        let until = Instant::now() + PATIENCE;
        loop {
            self.restart_dead()?;
            let mut missing: Vec<&str> = ["recorder", "estimator", "netft", "rtde", "controller"]
                .into_iter()
                .filter(|name| !self.evidence.heard(name, since_ns))
                .collect();
            let ready = self.evidence.arm(clock::now_ns() - FRESH_NS);
            if !ready.is_some_and(|arm| arm.ready) {
                missing.push("the robot");
            }
            if !self.evidence.is_well("recorder") {
                missing.push("a recorder that records");
            }
            if missing.is_empty() {
                return Ok(());
            }
            if Instant::now() > until {
                bail!("not back after {PATIENCE:?}: {}", missing.join(", "));
            }
            std::thread::sleep(LOOK);
        }
    }

    /// Ends everything in order; the recordings are whole then.
    pub fn end(mut self) {
        self.end_hogs();
        let names: Vec<&'static str> = ["controller", "rtde controller", "rtde", "netft"]
            .into_iter()
            .chain(["estimator", "recorder", "router"])
            .filter(|name| self.processes.contains_key(name))
            .collect();
        for name in names {
            let _ = self.signal(name, "CONT");
            let _ = self.signal(name, "TERM");
            let until = Instant::now() + Duration::from_secs(15);
            while let Some(child) = self.processes.get_mut(name)
                && matches!(child.try_wait(), Ok(None))
                && Instant::now() < until
            {
                std::thread::sleep(LOOK);
            }
        }
    }
}

impl Drop for PrivateCell {
    fn drop(&mut self) {
        self.end_hogs();
        for child in self.processes.values_mut().chain([&mut self.shell]) {
            let _ = child.kill();
            let _ = child.wait();
        }
        if let Some(simulator) = self.simulator.take()
            && let Err(error) = simulator.end()
        {
            tracing::warn!("{error:#}");
        }
    }
}

fn start_process(folder: &Path, name: &'static str) -> Result<Child> {
    let log = File::options()
        .create(true)
        .append(true)
        .open(folder.join(format!("{name}.log")))?;
    let cell = Host::ALL
        .into_iter()
        .find(|host| host.process() == name)
        .map_or_else(|| "cell.toml".to_owned(), host_file);
    Command::new(std::env::current_exe()?)
        .arg("run")
        .args(name.split(' '))
        .arg("--cell")
        .arg(folder.join(cell))
        .env_remove("TANGENT_CELL")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(log)
        .spawn()
        .with_context(|| format!("starting {name}"))
}

/// A free port of loopback.
fn free_port() -> Result<u16> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).context("a port for a host")?;
    Ok(listener.local_addr()?.port())
}

/// Cell file of what runs on a host.
fn host_file(host: Host) -> String {
    format!("{host:?}.toml").to_lowercase()
}

fn cell_name() -> String {
    format!("faults-{}", std::process::id())
}

fn cell_text(folder: &Path, port_offset: u16, router: u16, rdt: u16) -> Result<String> {
    let mut cell: toml::Table = tangent_runtime::config::DEFAULT_CELL.parse()?;
    let endpoint = format!("tcp/127.0.0.1:{router}");
    let mut set = |section: &str, key: &str, value: toml::Value| {
        let table = cell
            .entry(section)
            .or_insert_with(|| toml::Table::new().into());
        if let Some(table) = table.as_table_mut() {
            table.insert(key.to_owned(), value);
        }
    };
    set("cell", "name", cell_name().into());
    set("robot", "port_offset", i64::from(port_offset).into());
    set("sensor", "rdt_port", i64::from(rdt).into());
    set("sensor", "http_port", i64::from(8080 + port_offset).into());
    set("sensor", "rate_hz", 1000.0.into());
    set("zenoh", "connect", vec![endpoint.clone()].into());
    set("zenoh", "listen", vec![endpoint].into());
    let recordings = folder.join("recordings");
    set(
        "recorder",
        "folder",
        recordings.display().to_string().into(),
    );
    Ok(cell.to_string())
}

/// The shipped pipe with its realistic sensor, the tool near it; or a plate with a ledge across the
/// way.
fn scenario(layout: Layout, seed: u64) -> Result<tangent_simulation::Scenario> {
    let near = "plant.start.clearance_m=0.002".to_owned();
    let seed = format!("seed={seed}");
    if layout != Layout::Ledge {
        return scenarios::load(scenarios::DEFAULT, &[near, seed]);
    }
    // A table of 4 cm, and 6 mm below it the floor: whichever way the tool goes, it comes to the
    // edge.
    let grid: Vec<f64> = (-35..=35).map(|i| 0.004 * f64::from(i)).collect();
    let mut rows = String::from("y\\x");
    for x in &grid {
        rows.push_str(&format!(",{x:.3}"));
    }
    for y in &grid {
        rows.push_str(&format!("\n{y:.3}"));
        for x in &grid {
            let on_table = x.abs().max(y.abs()) < 0.021;
            rows.push_str(if on_table { ",0.0" } else { ",-0.006" });
        }
    }
    scenarios::load(
        "plane",
        &[
            near,
            seed,
            format!(
                "plant.surface={{ shape = \"height_field\", csv = {rows:?}, position_m = [0.42, 0.0, 0.1] }}"
            ),
            "plant.start.near_m=[0.42, 0.0, 0.1]".to_owned(),
        ],
    )
}
