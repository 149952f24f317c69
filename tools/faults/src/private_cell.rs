//! A private cell for the faults: the simulator runs in this process, each group of services in a
//! process that can be killed.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Write;
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::time::{Duration, Instant};

use tangent_compose::{Running, simulators, with_causes};
use tangent_control::Phase;
use tangent_runtime::{Bus, CellConfig, Role, Stop, clock};
use tangent_schemas::tangent::Request;
use tangent_schemas::topics::queries;
use tangent_simulated_device::FAULT_KEY;

use crate::cell_files::{cell_name, cell_text, host_file, scenario};
use crate::error::{Context, FaultsError, Result, bail};
use crate::evidence::{Control, Evidence};
use crate::host_clock::{Host, HostClock};
use crate::layout::Layout;
use crate::wire::{Link, SensorWire};

/// Longest wait for the cell to start, or to recover.
const PATIENCE: Duration = Duration::from_secs(40);
const LOOK: Duration = Duration::from_millis(10);
/// Largest age of a message that still shows the present state, ns.
const FRESH_NS: i64 = 300_000_000;
/// Pressing force of the task, N.
pub const REFERENCE_N: f64 = 3.0;
/// Sliding speed of the task, m/s.
const SPEED_M_PER_S: f64 = 0.02;
/// Time for which the tool slides before a fault, ns.
const SLID_NS: i64 = 300_000_000;

/// Settings of a private cell.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The `tangent` program, whose `run` starts services.
    pub program: PathBuf,
    /// Added to every port, 0 to 16383.
    pub port_offset: u16,
    /// Seed of the simulator's noise.
    pub seed: u64,
}

/// The cell under test.
pub struct PrivateCell {
    program: PathBuf,
    folder: PathBuf,
    layout: Layout,
    processes: BTreeMap<&'static str, Child>,
    hogs: Vec<Child>,
    /// A shell that waits to send signals: starting one takes longer than the times to be measured.
    signals: ChildStdin,
    shell: Child,
    simulator: Option<Running>,
    /// Relay in the sensor's cable.
    pub sensor: SensorWire,
    /// Relay in the estimator's connection to the router.
    pub estimator: Link,
    /// Clocks of the hosts, in the layout that has them.
    pub clocks: BTreeMap<Host, HostClock>,
    /// Session of this process on the cell's bus.
    pub bus: Bus,
    /// All messages received.
    pub evidence: Evidence,
    /// First position of the tool along x, base axes, m.
    start_x_m: Option<f64>,
}

impl PrivateCell {
    /// Writes the cell's files into `folder` and starts all processes.
    ///
    /// # Errors
    /// A port is in use, or a process cannot be started.
    pub fn start(folder: &Path, layout: Layout, setup: &Setup) -> Result<Self> {
        let (port_offset, program) = (setup.port_offset, setup.program.as_path());
        fs::create_dir_all(folder.join("recordings"))
            .with_context(|| format!("making {}", folder.display()))?;
        let loopback = |port: u16| SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let router = port_offset
            .checked_add(7447)
            .filter(|_| port_offset <= 16_383)
            .ok_or_else(|| FaultsError::Usage("--port-offset: 0 to 16383 is allowed".to_owned()))?;
        let sensor = SensorWire::start(loopback(49_152 + port_offset))?;
        let estimator = Link::start(loopback(router))?;
        let file = |name: &str| folder.join(name);
        let text = |router: u16| cell_text(folder, port_offset, router, sensor.port());
        fs::write(file("cell.toml"), text(router)?)?;
        for host in Host::ALL {
            let own = match layout {
                // This process is the router of that host's network, so the cell's own network
                // carries no additional traffic.
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
        processes.insert("router", start_process(program, folder, "router")?);
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
        let scenario = scenario(layout, setup.seed)?;
        let simulator = simulators::velocity_arm(&config, &scenario, &bus, &Stop::new())?;
        let mut cell = Self {
            program: program.to_owned(),
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

    /// Layout of the processes.
    pub fn layout(&self) -> Layout {
        self.layout
    }

    /// Folder of the recordings.
    pub fn recordings(&self) -> PathBuf {
        self.folder.join("recordings")
    }

    /// Starts the processes of the layout that do not run.
    ///
    /// # Errors
    /// A process cannot be started.
    pub fn restart_dead(&mut self) -> Result<()> {
        for name in self.layout.processes() {
            let runs = match self.processes.get_mut(name) {
                Some(child) => child.try_wait()?.is_none(),
                None => false,
            };
            if !runs {
                let child = start_process(&self.program, &self.folder, name)?;
                self.processes.insert(name, child);
            }
        }
        Ok(())
    }

    /// Kills one process with SIGKILL; `restart_dead` restarts it.
    ///
    /// # Errors
    /// The process does not run.
    pub fn kill(&mut self, name: &'static str) -> Result<()> {
        let child = self.child(name)?;
        child.kill()?;
        child.wait()?;
        Ok(())
    }

    /// Sends a signal, given by its name, to one process.
    ///
    /// # Errors
    /// The process does not run.
    pub fn signal(&mut self, name: &'static str, signal: &str) -> Result<()> {
        let id = self.child(name)?.id();
        writeln!(self.signals, "kill -{signal} {id}").context("sending a signal")
    }

    fn child(&mut self, name: &'static str) -> Result<&mut Child> {
        self.processes
            .get_mut(name)
            .with_context(|| format!("{name} does not run"))
    }

    /// Provokes a fault of the simulated robot.
    ///
    /// # Errors
    /// The name is unknown.
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

    /// Keeps every core busy, with two processes per core.
    ///
    /// # Errors
    /// No process can be started.
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

    /// Ends that load.
    pub fn end_hogs(&mut self) {
        for mut hog in self.hogs.drain(..) {
            let _ = hog.kill();
            let _ = hog.wait();
        }
    }

    /// Ensures that a task runs whose tool slides, and starts as many tasks as that needs.
    ///
    /// # Errors
    /// The tool does not slide in time; the error gives the last reason received.
    pub fn slide(&mut self) -> Result<()> {
        let until = Instant::now() + PATIENCE;
        let mut last = "nothing was received".to_owned();
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
        bail!(
            "the tool does not slide after {} s: {last}",
            PATIENCE.as_secs()
        )
    }

    /// Requests a task; returns the reason if it is refused.
    fn start_task(&mut self) -> Result<Option<String>> {
        let Some(arm) = self.evidence.arm(clock::now_ns() - FRESH_NS) else {
            return Ok(Some("no arm/state is received".to_owned()));
        };
        // A path begins at the tool's position: each leads back over the first starting point, so
        // that none leaves the arm's reach.
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

    /// Stops the task, and waits for the end of its retraction. Returns whether the tool is then
    /// off the surface, and the controller's last state.
    ///
    /// # Errors
    /// The task does not end.
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
            // A truth from before this moment would still show the retraction.
            if let Some((at_ns, control)) = ended
                && let Some(off) = self.evidence.is_off_the_surface(at_ns)
            {
                return Ok((off, control));
            }
            if Instant::now() > until {
                bail!(
                    "the task has not ended {} s after its stop",
                    PATIENCE.as_secs()
                );
            }
            std::thread::sleep(LOOK);
        }
    }

    /// Waits until the controller, the sensor's service, the estimator and the recorder have all
    /// published since `since_ns`.
    ///
    /// # Errors
    /// The services that are still missing after a while.
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
                bail!(
                    "still missing after {} s: {}",
                    PATIENCE.as_secs(),
                    missing.join(", ")
                );
            }
            std::thread::sleep(LOOK);
        }
    }

    /// Ends all processes in order, so that the recordings are complete.
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
            tracing::warn!("{}", with_causes(&error));
        }
    }
}

fn start_process(program: &Path, folder: &Path, name: &'static str) -> Result<Child> {
    let log = File::options()
        .create(true)
        .append(true)
        .open(folder.join(format!("{name}.log")))?;
    let cell = Host::ALL
        .into_iter()
        .find(|host| host.process() == name)
        .map_or_else(|| "cell.toml".to_owned(), host_file);
    Command::new(program)
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

/// Returns a free loopback port.
fn free_port() -> Result<u16> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).context("a port for a host")?;
    Ok(listener.local_addr()?.port())
}
