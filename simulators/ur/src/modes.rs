//! The controller's modes by their numbers and names.

/// State of the arm's power and brakes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RobotMode {
    /// Starting up.
    Booting,
    /// No power.
    PowerOff,
    /// Powering on.
    PowerOn,
    /// Power on, brakes engaged.
    Idle,
    /// Brakes released.
    Running,
}

impl RobotMode {
    /// As in `robot_mode`.
    pub fn number(self) -> i32 {
        match self {
            Self::Booting => 2,
            Self::PowerOff => 3,
            Self::PowerOn => 4,
            Self::Idle => 5,
            Self::Running => 7,
        }
    }

    /// As on the dashboard.
    pub fn name(self) -> &'static str {
        match self {
            Self::Booting => "BOOTING",
            Self::PowerOff => "POWER_OFF",
            Self::PowerOn => "POWER_ON",
            Self::Idle => "IDLE",
            Self::Running => "RUNNING",
        }
    }
}

/// State of the safety system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SafetyMode {
    /// No stop and no restriction.
    Normal,
    /// Reduced mode, with lower limits.
    Reduced,
    /// Stopped until it is unlocked.
    ProtectiveStop,
    /// Stopped until the safeguard input clears.
    SafeguardStop,
    /// Emergency stop of the cell.
    SystemEmergencyStop,
    /// Emergency stop of the robot.
    RobotEmergencyStop,
    /// A safety limit was exceeded.
    Violation,
    /// Something is broken.
    Fault,
}

impl SafetyMode {
    /// As in `safety_mode`.
    pub fn number(self) -> i32 {
        match self {
            Self::Normal => 1,
            Self::Reduced => 2,
            Self::ProtectiveStop => 3,
            Self::SafeguardStop => 5,
            Self::SystemEmergencyStop => 6,
            Self::RobotEmergencyStop => 7,
            Self::Violation => 8,
            Self::Fault => 9,
        }
    }

    /// As in `safety_status_bits`.
    pub fn bits(self) -> u32 {
        let stopped = 1 << 10;
        match self {
            Self::Normal => 1,
            Self::Reduced => 1 << 1,
            Self::ProtectiveStop => 1 << 2 | stopped,
            Self::SafeguardStop => 1 << 4 | stopped,
            Self::SystemEmergencyStop => 1 << 5 | 1 << 7 | stopped,
            Self::RobotEmergencyStop => 1 << 6 | 1 << 7 | stopped,
            Self::Violation => 1 << 8 | stopped,
            Self::Fault => 1 << 9 | stopped,
        }
    }

    /// As on the dashboard.
    pub fn name(self) -> &'static str {
        match self {
            Self::Normal => "NORMAL",
            Self::Reduced => "REDUCED",
            Self::ProtectiveStop => "PROTECTIVE_STOP",
            Self::SafeguardStop => "SAFEGUARD_STOP",
            Self::SystemEmergencyStop => "SYSTEM_EMERGENCY_STOP",
            Self::RobotEmergencyStop => "ROBOT_EMERGENCY_STOP",
            Self::Violation => "VIOLATION",
            Self::Fault => "FAULT",
        }
    }

    /// Whether programs may move the arm.
    pub fn allows_motion(self) -> bool {
        matches!(self, Self::Normal | Self::Reduced)
    }

    /// Whether this mode switches the power off.
    pub fn cuts_power(self) -> bool {
        matches!(
            self,
            Self::SystemEmergencyStop | Self::RobotEmergencyStop | Self::Violation | Self::Fault
        )
    }
}

/// State of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RuntimeState {
    /// Ending.
    Stopping,
    /// No program runs.
    Stopped,
    /// Runs.
    Playing,
    /// About to pause.
    Pausing,
    /// Paused.
    Paused,
    /// About to resume.
    Resuming,
}

impl RuntimeState {
    /// As in `runtime_state`.
    pub fn number(self) -> u32 {
        match self {
            Self::Stopping => 0,
            Self::Stopped => 1,
            Self::Playing => 2,
            Self::Pausing => 3,
            Self::Paused => 4,
            Self::Resuming => 5,
        }
    }
}
