//! What the simulated cell is made of: plain data, one TOML section.

use std::net::{IpAddr, Ipv4Addr};

use serde::{Deserialize, Serialize};
use tangent_rtde::codec::{ControllerVersion, Series};
use tangent_simulation::PlantConfig;

/// A simulated cell: controller, sensor box and what they stand in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Address to listen on: loopback unless others shall reach the cell.
    #[serde(default = "loopback")]
    pub address: IpAddr,
    /// Where to listen.
    #[serde(default)]
    pub ports: Ports,
    /// The UR controller.
    #[serde(default)]
    pub controller: ControllerConfig,
    /// Arm, tool, surface and sensor.
    pub plant: PlantConfig,
    /// Seed of all randomness.
    #[serde(default)]
    pub seed: u64,
    /// SCHED_FIFO priority of the threads that stand for robot and sensor box, whose clocks no load
    /// on this machine would delay; `None` for normal scheduling.
    #[serde(default)]
    pub realtime_priority: Option<u8>,
}

fn loopback() -> IpAddr {
    IpAddr::V4(Ipv4Addr::LOCALHOST)
}

/// Which ports the servers take.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ports {
    /// The real ones plus this: 0 for a client that cannot be told another port.
    Offset(u16),
    /// Whatever is free; the handle says which.
    Ephemeral,
}

impl Default for Ports {
    fn default() -> Self {
        Self::Offset(0)
    }
}

impl Ports {
    /// Port to bind instead of `port`; `None` when the offset leads past the last one.
    pub fn of(self, port: u16) -> Option<u16> {
        match self {
            Self::Offset(offset) => port.checked_add(offset),
            Self::Ephemeral => Some(0),
        }
    }
}

/// Which controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Flavour {
    /// CB3, software 3.15.8, 125 Hz.
    #[default]
    Cb3,
    /// e-Series, software 5.11, 500 Hz.
    ESeries,
}

impl Flavour {
    /// Its software.
    pub fn version(self) -> ControllerVersion {
        match self {
            Self::Cb3 => ControllerVersion {
                major: 3,
                minor: 15,
                bugfix: 8,
                build: 106_339,
            },
            Self::ESeries => ControllerVersion {
                major: 5,
                minor: 11,
                bugfix: 0,
                build: 108_249,
            },
        }
    }

    /// What `PolyscopeVersion` answers.
    pub fn polyscope_version(self) -> &'static str {
        match self {
            Self::Cb3 => "URSoftware 3.15.8.106339 (Jun 20 2022)",
            Self::ESeries => "URSoftware 5.11.0.108249 (Feb 03 2021)",
        }
    }

    /// Its series.
    pub fn series(self) -> Series {
        self.version().series()
    }

    /// Control period, s.
    pub fn period_s(self) -> f64 {
        self.series().period_s()
    }
}

/// How the controller behaves where real ones differ or are undocumented.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControllerConfig {
    /// Which controller.
    pub flavour: Flavour,
    /// Inputs that arrive within this share of a period after the state was sent count in that
    /// period.
    pub input_window: f64,
    /// Starts with the brakes released, as after a shift's first minutes; else powered off.
    pub running: bool,
    /// Time since boot that clients see at the start, s. Under 40 s some clients wait for the
    /// boot's end.
    pub timestamp_s: f64,
    /// From power on to idle, and from idle to running, s.
    pub power_step_s: f64,
    /// From reset to ports open after a restart, s.
    pub boot_s: f64,
    /// From the last byte of a program to its first frame, s.
    pub program_start_s: f64,
    /// And this much more per line of program, s.
    pub compile_s_per_line: f64,
    /// A program that ends (or leaves the arm without a motion) above this joint speed ends in a
    /// protective stop, rad/s.
    pub program_end_speed_max_rad_per_s: f64,
    /// `speedj` stops the arm when its time is over and no motion follows; else it goes on at that
    /// speed.
    pub speedj_stops_after_t: bool,
    /// A protective stop pauses the program instead of ending it.
    pub protective_stop_pauses: bool,
    /// Programs go on by themselves when a safeguard stop clears.
    pub safeguard_resumes: bool,
    /// e-Series: scripts and dashboard commands are taken.
    pub remote_control: bool,
    /// A client that does not read for so long is cut off, s.
    pub unread_limit_s: f64,
    /// Inputs stay owned for so long after their client is gone, s.
    pub ownership_linger_s: f64,
    /// `safetymode` on the dashboard tells what was so long ago, s.
    pub dashboard_lag_s: f64,
    /// Name on the dashboard and in serial number queries.
    pub serial_number: String,
}

impl Default for ControllerConfig {
    fn default() -> Self {
        Self {
            flavour: Flavour::Cb3,
            input_window: 0.25,
            running: true,
            timestamp_s: 60.0,
            power_step_s: 0.5,
            boot_s: 1.0,
            program_start_s: 0.035,
            compile_s_per_line: 0.0003,
            program_end_speed_max_rad_per_s: 0.3,
            speedj_stops_after_t: false,
            protective_stop_pauses: false,
            safeguard_resumes: true,
            remote_control: true,
            unread_limit_s: 2.0,
            ownership_linger_s: 0.0,
            dashboard_lag_s: 0.6,
            serial_number: "20195599999".to_owned(),
        }
    }
}
