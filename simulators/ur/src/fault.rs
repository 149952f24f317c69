//! All faults of the simulated UR, by name for queries and as values for tests.

/// One fault or its end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// Stop with power on, as after a collision.
    ProtectiveStop,
    /// The robot's emergency button (or the cell's), pressed or released.
    EmergencyStop {
        /// The robot's own button; else the cell's.
        robot: bool,
        /// Whether it is pressed or released.
        pressed: bool,
    },
    /// The safeguard input opens (true) or closes.
    Safeguard(bool),
    /// Reduced mode.
    Reduced(bool),
    /// A safety violation (true) or fault.
    SafetyFault {
        /// Violation or fault.
        violation: bool,
    },
    /// Power off.
    PowerOff,
    /// Power on and brakes released.
    PowerOn,
    /// The operator moves the speed slider, 0 to 1.
    SpeedSlider(f64),
    /// The program is stopped at the pendant.
    StopProgram,
    /// The program is paused at the pendant.
    PauseProgram,
    /// The paused program is resumed at the pendant.
    ResumeProgram,
    /// Leaves out RTDE packages at random.
    DropPackets {
        /// Probability per package, 0 to 1.
        probability: f64,
        /// Number of packages in a row.
        burst: u32,
    },
    /// RTDE packages arrive later by this time, s.
    Delay(f64),
    /// A hand pushes the tool with this force, N at the tool centre point, base axes. It acts on
    /// the measured force, and so on force mode and freedrive. Zero ends it.
    Push([f64; 3]),
    /// All connections are cut; the ports stay open.
    Disconnect,
    /// No RTDE package is sent for this time, s; connections stay open.
    Freeze(f64),
    /// The controller restarts: connections cut, ports closed, registers cleared, time from 0.
    Restart,
}

/// A request that does not name a valid fault.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FaultError {
    /// Unknown name.
    #[error("no fault is called {name:?}; there are {}", Fault::NAMES.join(", "))]
    Name {
        /// Name as requested.
        name: String,
    },
    /// The argument does not fit the fault.
    #[error("{name}: the argument is {argument:?}, but must be {allowed}")]
    Argument {
        /// Name of the fault.
        name: String,
        /// Argument as requested.
        argument: String,
        /// Allowed arguments.
        allowed: &'static str,
    },
}

impl Fault {
    /// Names for queries.
    pub const NAMES: [&'static str; 19] = [
        "protective_stop",
        "emergency_stop",
        "system_emergency_stop",
        "safeguard",
        "reduced",
        "safety_violation",
        "safety_fault",
        "power_off",
        "power_on",
        "speed_slider",
        "stop_program",
        "pause_program",
        "resume_program",
        "drop_packets",
        "delay",
        "push",
        "disconnect",
        "freeze",
        "restart",
    ];

    /// Parses name and argument. Switches take `on` (also if empty) and `off`.
    ///
    /// # Errors
    /// The name or the argument is not valid; the message lists the valid ones.
    pub fn parse(name: &str, argument: &str) -> Result<Self, FaultError> {
        let wrong = |allowed| FaultError::Argument {
            name: name.to_owned(),
            argument: argument.to_owned(),
            allowed,
        };
        let switch = || match argument.trim() {
            "" | "on" => Ok(true),
            "off" => Ok(false),
            _ => Err(wrong("on or off")),
        };
        let number = |text: &str, max: f64, allowed| {
            let x: f64 = text.trim().parse().map_err(|_| wrong(allowed))?;
            if (0.0..=max).contains(&x) {
                Ok(x)
            } else {
                Err(wrong(allowed))
            }
        };
        Ok(match name {
            "protective_stop" => Self::ProtectiveStop,
            "emergency_stop" | "system_emergency_stop" => Self::EmergencyStop {
                robot: name == "emergency_stop",
                pressed: switch()?,
            },
            "safeguard" => Self::Safeguard(switch()?),
            "reduced" => Self::Reduced(switch()?),
            "safety_violation" => Self::SafetyFault { violation: true },
            "safety_fault" => Self::SafetyFault { violation: false },
            "power_off" => Self::PowerOff,
            "power_on" => Self::PowerOn,
            "speed_slider" => Self::SpeedSlider(number(argument, 1.0, "0 to 1")?),
            "stop_program" => Self::StopProgram,
            "pause_program" => Self::PauseProgram,
            "resume_program" => Self::ResumeProgram,
            "drop_packets" => {
                let (p, burst) = argument.trim().split_once(' ').unwrap_or((argument, "1"));
                const ALLOWED: &str =
                    "a probability from 0 to 1 and, if wanted, a burst from 1 to 1000";
                Self::DropPackets {
                    probability: number(p, 1.0, ALLOWED)?,
                    burst: number(burst, 1000.0, ALLOWED)?.max(1.0) as u32,
                }
            }
            "delay" => Self::Delay(number(argument, 60.0, "seconds from 0 to 60")?),
            "push" => {
                let numbers: Result<Vec<f64>, _> =
                    argument.split(',').map(|x| x.trim().parse()).collect();
                let force = numbers.ok().and_then(|n| <[f64; 3]>::try_from(n).ok());
                match force.filter(|f| f.iter().all(|x| x.abs() <= 1000.0)) {
                    Some(force) => Self::Push(force),
                    None => {
                        return Err(wrong("three forces from -1000 to 1000 N, such as 0,0,-20"));
                    }
                }
            }
            "disconnect" => Self::Disconnect,
            "freeze" => Self::Freeze(number(argument, 3600.0, "seconds from 0 to 3600")?),
            "restart" => Self::Restart,
            _ => {
                return Err(FaultError::Name {
                    name: name.to_owned(),
                });
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_arguments() {
        for name in Fault::NAMES {
            let argument = match name {
                "drop_packets" | "delay" | "freeze" | "speed_slider" => "0.5",
                "push" => "0, 0, -20",
                _ => "",
            };
            assert!(Fault::parse(name, argument).is_ok(), "{name}");
        }
        assert_eq!(
            Fault::parse("drop_packets", "0.1 3"),
            Ok(Fault::DropPackets {
                probability: 0.1,
                burst: 3
            })
        );
        assert!(Fault::parse("drop_packets", "2").is_err());
        let error = Fault::parse("explode", "").unwrap_err().to_string();
        assert!(
            error.contains("\"explode\"") && error.contains("restart"),
            "{error}"
        );
    }
}
