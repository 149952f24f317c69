//! The robot's modes in words, and what each means for motion.

/// RTDE `robot_mode` in words.
pub fn robot_mode_text(mode: i32) -> &'static str {
    match mode {
        -1 => "no controller",
        0 => "disconnected",
        1 => "waiting for the safety set-up to be confirmed",
        2 => "booting",
        3 => "powered off",
        4 => "powered on, not started",
        5 => "idle, brakes on",
        6 => "backdrive",
        7 => "running",
        8 => "updating firmware",
        _ => "in an unknown mode",
    }
}

/// RTDE `safety_mode` in words.
pub fn safety_mode_text(mode: i32) -> &'static str {
    match mode {
        1 => "normal",
        2 => "reduced",
        3 => "protective stop",
        4 => "recovery",
        5 => "safeguard stop",
        6 => "system emergency stop",
        7 => "robot emergency stop",
        8 => "safety violation",
        9 => "safety fault",
        10 => "validating joint ids",
        12 => "safeguard stop (automatic mode)",
        13 => "three-position enabling stop",
        _ => "undefined safety mode",
    }
}

/// The arm may move in this `safety_mode`.
pub fn safety_allows_motion(mode: i32) -> bool {
    matches!(mode, 1 | 2)
}

/// RTDE `runtime_state` in words.
pub fn runtime_state_text(state: u32) -> &'static str {
    match state {
        0 => "stopping",
        1 => "stopped",
        2 => "playing",
        3 => "pausing",
        4 => "paused",
        5 => "resuming",
        _ => "unknown",
    }
}
