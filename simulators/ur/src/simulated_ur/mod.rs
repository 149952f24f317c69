//! The running controller: one thread that paces controller, plant and all TCP servers by absolute
//! deadlines.
//!
//! A cycle sends the state, waits a moment for the clients' answers, reads what they have sent, and
//! steps controller and plant by one period. An answer in time therefore takes effect in the period
//! that it answers, as in the closed loop of `evaluate`. A late cycle is not made up for: simulated
//! time then runs slowly, but no client ever gets two states in a burst.

mod disturbance;
mod listeners;
mod servers;

use std::io;
use std::net::{IpAddr, Ipv4Addr};
use std::ops::Deref;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

use tangent_mechanics::{ModelData, ModelError};
use tangent_runtime::clock::DeadlineClock;
use tangent_simulated_device::{DeviceLink, DeviceThread, PastLastPort, Ports};
use tangent_simulation::Truth;

use crate::config::{ControllerConfig, Flavour};
use crate::controller::{Controller, Summary};
use crate::fault::Fault;
use crate::own_sensor::OwnSensor;
use crate::plant::ArmPlant;
use crate::primary::Geometry;

use disturbance::Disturbance;
pub use listeners::{FlangeListener, Listeners, OdometryListener, TruthListener};
pub use servers::Endpoints;
use servers::{Servers, Wanted};

/// Why a cell cannot start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The robot's model is wrong.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A port is not available.
    #[error(
        "cannot listen on {address} for {server}: {reason}; another simulator may hold it: use another address or port offset"
    )]
    Port {
        /// Address and port.
        address: String,
        /// Name of the server.
        server: &'static str,
        /// Reason given by the system.
        reason: io::Error,
    },
    /// The port offset leads beyond the last port.
    #[error(transparent)]
    Offset(#[from] PastLastPort),
    /// A thread could not be started.
    #[error("cannot start the cell's thread: {0}")]
    Thread(io::Error),
}

/// State of the controller and its servers, updated once per cycle.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// Number of cycles since the start.
    pub cycles: u64,
    /// Number of deadlines that passed without a cycle.
    pub missed: u64,
    /// State of the controller.
    pub summary: Summary,
    /// Name of the running program.
    pub program: Option<String>,
    /// Number of RTDE clients.
    pub rtde_clients: usize,
    /// True state of the contact, if there is a surface.
    pub truth: Option<Truth>,
}

/// Where the controller listens, and how its thread is scheduled.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Address to listen on.
    pub address: IpAddr,
    /// Ports of the servers.
    pub ports: Ports,
    /// SCHED_FIFO priority of the controller's thread; `None` for normal scheduling.
    pub realtime_priority: Option<u8>,
}

impl Default for Place {
    /// Any free ports of 127.0.0.1, with normal scheduling.
    fn default() -> Self {
        Self {
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            ports: Ports::Ephemeral,
            realtime_priority: None,
        }
    }
}

/// A running UR controller with its arm: the [`DeviceThread`] of its faults and snapshots, and its
/// servers. Dropping it stops it.
pub struct SimulatedUr {
    endpoints: Endpoints,
    log_requests: Sender<Sender<Vec<String>>>,
    thread: DeviceThread<Fault, Snapshot>,
}

impl std::fmt::Debug for SimulatedUr {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SimulatedUr")
            .field("endpoints", &self.endpoints)
            .finish_non_exhaustive()
    }
}

impl SimulatedUr {
    /// Starts all servers and the thread that moves `plant`. `robot` names the built-in model that
    /// the controller uses. `listeners` are called once per cycle, in that thread.
    ///
    /// # Errors
    /// The model is unknown, or a port is taken.
    pub fn start(
        place: Place,
        config: &ControllerConfig,
        robot: &str,
        plant: Box<dyn ArmPlant>,
        listeners: Listeners,
    ) -> Result<Self, StartError> {
        let wanted = Wanted::new(place.address, place.ports)?;
        let controller = Controller::new(config, robot, plant.arm())?;
        let model = ModelData::builtin(robot)?;
        let servers = Servers::bind(&wanted)?;
        let endpoints = servers.endpoints;
        let (log_requests, log_receiver) = channel();
        let own_sensor =
            (config.flavour == Flavour::ESeries).then(|| OwnSensor::new(&config.own_sensor));
        let priority = place.realtime_priority;
        let thread = DeviceThread::start("simulated cell", priority, move |link| {
            let mut cell = Cell {
                geometry: Geometry::of(&model),
                controller,
                plant,
                servers: Some(servers),
                wanted: endpoints.into(),
                booted: None,
                log_requests: log_receiver,
                link,
                listeners,
                cycles: 0,
                missed: 0,
                disturbance: Disturbance::default(),
                own_sensor,
            };
            cell.run();
        })
        .map_err(StartError::Thread)?;
        Ok(Self {
            endpoints,
            log_requests,
            thread,
        })
    }

    /// Endpoints of the servers.
    pub fn endpoints(&self) -> &Endpoints {
        &self.endpoints
    }

    /// The newest lines of the controller's log, oldest first.
    pub fn log(&self) -> Vec<String> {
        let (sender, receiver) = channel();
        let _ = self.log_requests.send(sender);
        receiver
            .recv_timeout(Duration::from_secs(5))
            .unwrap_or_default()
    }
}

impl Deref for SimulatedUr {
    type Target = DeviceThread<Fault, Snapshot>;

    fn deref(&self) -> &Self::Target {
        &self.thread
    }
}

struct Cell {
    controller: Controller,
    plant: Box<dyn ArmPlant>,
    geometry: Geometry,
    /// Servers; `None` while the controller boots.
    servers: Option<Servers>,
    wanted: Wanted,
    booted: Option<Instant>,
    log_requests: Receiver<Sender<Vec<String>>>,
    link: DeviceLink<Fault, Snapshot>,
    listeners: Listeners,
    cycles: u64,
    missed: u64,
    disturbance: Disturbance,
    /// The sensor in the flange, which an e-Series arm has.
    own_sensor: Option<OwnSensor>,
}

impl Cell {
    fn run(&mut self) {
        let config = self.controller.config();
        let period = Duration::from_secs_f64(config.flavour.period_s());
        let window = period.mul_f64(config.input_window.clamp(0.0, 0.9));
        let mut clock = DeadlineClock::new(period);
        while !self.link.is_stopped() {
            self.missed += clock.wait();
            let now = Instant::now();
            self.tell(now);
            std::thread::sleep(window);
            self.read_clients();
            self.step(now);
        }
    }

    /// Applies requests, then publishes the state after the last period.
    fn tell(&mut self, now: Instant) {
        while let Some(fault) = self.link.next_fault() {
            self.apply(fault, now);
        }
        while let Ok(reply) = self.log_requests.try_recv() {
            let _ = reply.send(self.controller.log().map(str::to_owned).collect());
        }
        self.finish_boot(now);
        let truth = self.plant.truth();
        let force = truth
            .as_ref()
            .map_or([0.0; 6], |t| t.wrench.vector().into());
        self.controller.observe(self.plant.arm(), force);
        if let Some(sensor) = &mut self.own_sensor {
            let reading = sensor.read(
                &self.plant.flange_load(),
                &self.controller.base_from_flange(),
                self.controller.time_s(),
                self.controller.is_playing(),
            );
            self.controller.feel(&reading);
        }
        self.cycles += 1;
        let faults = self.disturbance.of_cycle(now);
        let messages = self.controller.take_messages();
        if let Some(servers) = &mut self.servers {
            servers
                .rtde
                .publish(&self.controller, self.cycles, now, &faults);
            for port in &mut servers.ports {
                port.publish(&self.controller, &messages, &self.geometry, now);
            }
        }
        self.listeners.tell(&*self.plant, truth.as_ref());
        self.show(truth);
    }

    /// Reads what clients have sent.
    fn read_clients(&mut self) {
        let now = Instant::now();
        if let Some(servers) = &mut self.servers {
            servers.rtde.poll(&mut self.controller, now);
            servers.dashboard.poll(&mut self.controller, now);
            for port in &mut servers.ports {
                port.poll(&mut self.controller, now);
            }
        }
    }

    /// Steps the period that began at `start`, and hands over its sensor records.
    fn step(&mut self, start: Instant) {
        let command = self.controller.act();
        let before = self.plant.arm().time_s;
        self.plant.step(&command);
        self.listeners
            .hand_over(start, before, self.plant.sensor_samples());
    }

    fn finish_boot(&mut self, now: Instant) {
        if self.servers.is_some() || self.booted.is_some_and(|at| now < at) {
            return;
        }
        match Servers::bind(&self.wanted) {
            Ok(servers) => {
                self.controller.restart();
                self.servers = Some(servers);
            }
            Err(error) => tracing::debug!(target: "simulator", "still booting: {error}"),
        }
    }

    fn apply(&mut self, fault: Fault, now: Instant) {
        let controller = &mut self.controller;
        match fault {
            Fault::ProtectiveStop => controller.protective_stop(157, 0, "provoked"),
            Fault::EmergencyStop { robot, pressed } => controller.emergency_stop(robot, pressed),
            Fault::Safeguard(open) => controller.safeguard(open),
            Fault::Reduced(on) => controller.reduced(on),
            Fault::SafetyFault { violation } => controller.safety_fault(violation),
            Fault::PowerOff => controller.power_off(),
            Fault::PowerOn => controller.release_brakes(),
            Fault::SpeedSlider(fraction) => controller.set_slider(fraction),
            Fault::StopProgram => controller.stop_program(),
            Fault::PauseProgram => controller.pause(),
            Fault::ResumeProgram => {
                controller.resume();
            }
            Fault::DropPackets { probability, burst } => {
                self.disturbance.probability = probability;
                self.disturbance.burst = burst;
            }
            Fault::Delay(s) => self.disturbance.delay_s = s,
            Fault::Freeze(s) => {
                self.disturbance.frozen_until =
                    Some(now + Duration::from_secs_f64(s.clamp(0.0, 3600.0)));
            }
            Fault::Push([x, y, z]) => controller.push([x, y, z, 0.0, 0.0, 0.0]),
            Fault::Disconnect => {
                if let Some(servers) = &mut self.servers {
                    servers.disconnect_all();
                }
            }
            Fault::Restart => {
                controller.stop_program();
                self.servers = None;
                let boot = self.controller.config().boot_s.clamp(0.0, 600.0);
                self.booted = Some(now + Duration::from_secs_f64(boot));
            }
        }
    }

    fn show(&mut self, truth: Option<Truth>) {
        let snapshot = Snapshot {
            cycles: self.cycles,
            missed: self.missed,
            summary: self.controller.summary(),
            program: self.controller.program_name().map(str::to_owned),
            rtde_clients: self.servers.as_ref().map_or(0, |s| s.rtde.clients()),
            truth,
        };
        self.link.show(snapshot);
    }
}
