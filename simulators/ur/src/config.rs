//! The series and the behaviour of the simulated controller: plain data, one TOML section.

use serde::{Deserialize, Serialize};
use tangent_rtde::codec::{ControllerVersion, Series};

use crate::own_sensor::OwnSensorConfig;

/// Series of the controller.
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
    /// Software version of this series.
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

    /// Answer to the dashboard command `PolyscopeVersion`.
    pub fn polyscope_version(self) -> &'static str {
        match self {
            Self::Cb3 => "URSoftware 3.15.8.106339 (Jun 20 2022)",
            Self::ESeries => "URSoftware 5.11.0.108249 (Feb 03 2021)",
        }
    }

    /// Series in the terms of the bridge.
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
    /// Series of the controller.
    pub flavour: Flavour,
    /// Share of a period after the state was sent within which arriving inputs take effect in the
    /// same period.
    pub input_window: f64,
    /// Whether it starts with the brakes released; otherwise powered off.
    pub running: bool,
    /// Time since boot that clients see at the start, s. Below 40 s, some clients wait for the end
    /// of the boot.
    pub timestamp_s: f64,
    /// Time from power on to idle, and from idle to running, s.
    pub power_step_s: f64,
    /// Time from reset to open ports after a restart, s.
    pub boot_s: f64,
    /// Time from the last byte of a program to its first frame, s.
    pub program_start_s: f64,
    /// Additional time per line of program, s.
    pub compile_s_per_line: f64,
    /// Joint speed, rad/s, above which the end of a program (or leaving the arm without a motion)
    /// causes a protective stop.
    pub program_end_speed_max_rad_per_s: f64,
    /// Whether `speedj` stops the arm when its time is over and no motion follows; otherwise the
    /// arm continues at that speed.
    pub speedj_stops_after_t: bool,
    /// Whether a protective stop pauses the program instead of ending it.
    pub protective_stop_pauses: bool,
    /// Whether programs continue by themselves when a safeguard stop clears.
    pub safeguard_resumes: bool,
    /// e-Series: whether scripts and dashboard commands are accepted.
    pub remote_control: bool,
    /// Time after which an RTDE client that does not read is disconnected, s. Clients of the script
    /// ports are never: packages that they do not read are left out.
    pub unread_limit_s: f64,
    /// Time for which inputs stay owned after their client has disconnected, s.
    pub ownership_linger_s: f64,
    /// Delay of `safetymode` on the dashboard, s.
    pub dashboard_lag_s: f64,
    /// Name on the dashboard and in serial number queries.
    pub serial_number: String,
    /// e-Series: the force/torque sensor in the flange.
    pub own_sensor: OwnSensorConfig,
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
            own_sensor: OwnSensorConfig::default(),
        }
    }
}
