//! The URScript program that the bridge uploads, and the register map both sides agree on.
//!
//! The text is `program.script`; [`ProgramConfig::render`] fills in numbers and leaves out
//! comments.

use crate::codec::Series;

const TEMPLATE: &str = include_str!("program.script");

/// Version of the program's text and of the meaning of its registers; part of [`IDENT`].
pub const PROGRAM_VERSION: i32 = 2;
/// Value that the program writes into its identity register: `0x55520000` plus the version.
pub const IDENT: i32 = IDENT_BASE + PROGRAM_VERSION;
const IDENT_BASE: i32 = 0x5552_0000;
/// First version with which a hand can guide the arm.
pub const GUIDING_VERSION: i32 = 2;
/// The program's name on the controller, as in its `PROGRAM_XXX_STARTED` messages.
pub const PROGRAM_NAME: &str = "tangent_bridge";

/// Version that an identity register states; `None` if no program of the bridge wrote it, or a
/// newer one. All versions up to this one read and write the registers of a task alike.
pub fn version(ident: i32) -> Option<i32> {
    let version = ident.checked_sub(IDENT_BASE)?;
    (1..=PROGRAM_VERSION).contains(&version).then_some(version)
}

/// Mode that the bridge requests, input register int B+0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(i32)]
pub enum CommandCode {
    /// Zero velocity, stay armed.
    #[default]
    Hold = 0,
    /// Stream joint velocity.
    Stream = 1,
    /// Decelerate and latch.
    SoftStop = 2,
    /// Decelerate and end the program.
    Exit = 3,
    /// Let a hand guide the arm (freedrive).
    Guide = 4,
}

/// State of the program, output register int B+0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ProgramState {
    /// Waits for its bridge.
    #[default]
    Booting,
    /// Holds still and accepts commands.
    Ready,
    /// Moves as commanded.
    Streaming,
    /// Decelerates.
    Stopping,
    /// Stands still until it is re-armed.
    Stopped,
    /// The arm is free: a hand guides it.
    Guided,
    /// Ends.
    Exiting,
}

impl ProgramState {
    /// State with this number; `None` for a number that the program never writes.
    pub fn from_number(number: i32) -> Option<Self> {
        Some(match number {
            0 => Self::Booting,
            1 => Self::Ready,
            2 => Self::Streaming,
            3 => Self::Stopping,
            4 => Self::Stopped,
            5 => Self::Guided,
            9 => Self::Exiting,
            _ => return None,
        })
    }

    /// Number of the state in the register.
    pub fn number(self) -> u8 {
        match self {
            Self::Booting => 0,
            Self::Ready => 1,
            Self::Streaming => 2,
            Self::Stopping => 3,
            Self::Stopped => 4,
            Self::Guided => 5,
            Self::Exiting => 9,
        }
    }
}

/// Text for the cause in output register int B+4: why the program stopped.
pub fn cause_text(cause: i32) -> &'static str {
    match cause {
        0 => "no stop",
        1 => "no new command from the bridge (stale sequence)",
        2 => "a command beyond the compiled speed limit was scaled down",
        3 => "stop requested",
        4 => "another session wrote the registers",
        5 => "a command that is not a number, or far out of range",
        _ => "unknown cause",
    }
}

/// Register numbers, which all follow from one base.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RegisterMap {
    base: u8,
}

impl RegisterMap {
    /// Allowed bases: registers 0 to 23 belong to a PLC, and there are 48 registers.
    pub const BASES: std::ops::RangeInclusive<u8> = 24..=40;

    /// Creates the register map; refuses a base outside [`Self::BASES`].
    pub fn new(base: u8) -> Result<Self, ProgramError> {
        if Self::BASES.contains(&base) {
            Ok(Self { base })
        } else {
            Err(ProgramError::Base { base })
        }
    }

    /// First register number.
    pub fn base(&self) -> u8 {
        self.base
    }

    /// Fields that the bridge writes, in the order of its input recipe: command, sequence, session
    /// and flags (INT32), six joint velocities and the acceleration (DOUBLE).
    pub fn input_names(&self) -> Vec<String> {
        let b = self.base;
        (0..4)
            .map(|i| format!("input_int_register_{}", b + i))
            .chain((0..7).map(|i| format!("input_double_register_{}", b + i)))
            .collect()
    }

    /// Fields that the program writes: state, sequence used, identity, session, cause, loops and
    /// longest stale run (INT32), six joint velocities given to `speedj` (DOUBLE).
    pub fn output_names(&self) -> Vec<String> {
        let b = self.base;
        (0..7)
            .map(|i| format!("output_int_register_{}", b + i))
            .chain((0..6).map(|i| format!("output_double_register_{}", b + i)))
            .collect()
    }
}

/// Why a program cannot be rendered.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ProgramError {
    /// The registers would overlap a PLC's, or run past the last one.
    #[error(
        "register base {base} does not fit: allowed are 24 to 40 (0-23 belong to a PLC, and the bridge needs 7)"
    )]
    Base {
        /// Configured base.
        base: u8,
    },
    /// A number that the program cannot be compiled with.
    #[error("{name} = {value} cannot be compiled into the robot program: {allowed}")]
    Value {
        /// Name of the number.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
}

/// Everything compiled into the program.
#[derive(Clone, Debug, PartialEq)]
pub struct ProgramConfig {
    /// Register numbers.
    pub registers: RegisterMap,
    /// Session token: random, positive, new for each upload, so that an old register value never
    /// matches it.
    pub session: i32,
    /// Series of the controller, which determines the control period.
    pub series: Series,
    /// Largest joint speed that the program passes on, rad/s.
    pub speed_max_rad_per_s: f64,
    /// Largest joint acceleration that the program passes on, rad/s².
    pub acceleration_max_rad_per_s2: f64,
    /// Deceleration of the program's own stops, rad/s².
    pub stop_deceleration_rad_per_s2: f64,
    /// Whether the controller's own watchdog is armed; on CB3 it ends in a protective stop.
    pub watchdog: bool,
}

/// Longest silence during which the last command is still executed, s.
pub const HOLD_S: f64 = 0.016;
/// Silence after which the ramp has reached zero and the program stops, s.
pub const STALE_S: f64 = 0.040;
/// Silence after which the program ends itself, s. It is below 60 % of the watchdog's period, since
/// the watchdog was seen to trip from there on.
pub const EXIT_S: f64 = 0.7;
/// Least rate of packages that the controller's watchdog requires, Hz.
pub const WATCHDOG_HZ: f64 = 0.8;
/// Longest time for which the program waits for its bridge, s.
pub const WAIT_S: f64 = 2.0;
/// Least acceleration that the program passes to `speedj`, rad/s².
const ACCELERATION_MIN: f64 = 0.05;

impl ProgramConfig {
    /// The program's text: ASCII, no comments, ends with a newline.
    pub fn render(&self) -> Result<String, ProgramError> {
        self.check()?;
        let step = self.series.period_s();
        let cycles = |seconds: f64| (seconds / step).round() as u32;
        let (hold, stale) = (cycles(HOLD_S), cycles(STALE_S));
        let b = u32::from(self.registers.base);
        let watchdog = if self.watchdog {
            format!(
                "rtde_set_watchdog(\"input_int_register_{}\", {WATCHDOG_HZ:?}, \"stop\")",
                b + 1
            )
        } else {
            String::new()
        };
        let mut values = vec![
            ("IN_CMD", b.to_string()),
            ("IN_SEQ", (b + 1).to_string()),
            ("IN_SESSION", (b + 2).to_string()),
            ("IN_FLAGS", (b + 3).to_string()),
            ("IN_ACC", (b + 6).to_string()),
            ("OUT_STATE", b.to_string()),
            ("OUT_SEQ", (b + 1).to_string()),
            ("OUT_IDENT", (b + 2).to_string()),
            ("OUT_SESSION", (b + 3).to_string()),
            ("OUT_CAUSE", (b + 4).to_string()),
            ("OUT_LOOPS", (b + 5).to_string()),
            ("OUT_STALE_MAX", (b + 6).to_string()),
            ("SESSION", self.session.to_string()),
            ("IDENT", IDENT.to_string()),
            ("STEP", format!("{step:?}")),
            ("WAIT_CYCLES", cycles(WAIT_S).to_string()),
            ("HOLD_CYCLES", hold.to_string()),
            ("STALE_CYCLES", stale.to_string()),
            ("RAMP_STEP", format!("{:.9}", 1.0 / f64::from(stale - hold))),
            ("EXIT_S", format!("{EXIT_S:?}")),
            ("SPEED_MAX", format!("{:?}", self.speed_max_rad_per_s)),
            ("ACC_MAX", format!("{:?}", self.acceleration_max_rad_per_s2)),
            ("ACC_MIN", format!("{ACCELERATION_MIN:?}")),
            (
                "STOP_DECEL",
                format!("{:?}", self.stop_deceleration_rad_per_s2),
            ),
            ("WATCHDOG", watchdog),
        ];
        const JOINTS: [(&str, &str); 6] = [
            ("IN_QD0", "OUT_QD0"),
            ("IN_QD1", "OUT_QD1"),
            ("IN_QD2", "OUT_QD2"),
            ("IN_QD3", "OUT_QD3"),
            ("IN_QD4", "OUT_QD4"),
            ("IN_QD5", "OUT_QD5"),
        ];
        for (i, (input, output)) in (b..).zip(JOINTS) {
            values.push((input, i.to_string()));
            values.push((output, i.to_string()));
        }

        let mut text = String::with_capacity(TEMPLATE.len());
        for line in TEMPLATE.lines() {
            if line.trim_start().starts_with('#') {
                continue;
            }
            let mut line = line.to_owned();
            for (name, value) in &values {
                line = line.replace(&format!("{{{{{name}}}}}"), value);
            }
            if !line.trim().is_empty() {
                text.push_str(line.trim_end());
                text.push('\n');
            }
        }
        Ok(text)
    }

    fn check(&self) -> Result<(), ProgramError> {
        let wrong = |name, value, allowed| {
            Err(ProgramError::Value {
                name,
                value,
                allowed,
            })
        };
        if self.session <= 0 {
            return wrong(
                "session",
                f64::from(self.session),
                "a positive number is needed",
            );
        }
        // UR joints do 3.14 rad/s; at 0.01 nothing would move.
        if !(0.01..=7.0).contains(&self.speed_max_rad_per_s) {
            return wrong(
                "speed_max_rad_per_s",
                self.speed_max_rad_per_s,
                "0.01 to 7 rad/s",
            );
        }
        if !(ACCELERATION_MIN..=100.0).contains(&self.acceleration_max_rad_per_s2) {
            return wrong(
                "acceleration_max_rad_per_s2",
                self.acceleration_max_rad_per_s2,
                "0.05 to 100 rad/s2",
            );
        }
        if !(0.5..=40.0).contains(&self.stop_deceleration_rad_per_s2) {
            return wrong(
                "stop_deceleration_rad_per_s2",
                self.stop_deceleration_rad_per_s2,
                "0.5 to 40 rad/s2",
            );
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config() -> ProgramConfig {
        ProgramConfig {
            registers: RegisterMap::new(24).unwrap(),
            session: 123_456_789,
            series: Series::Cb3,
            speed_max_rad_per_s: 1.0,
            acceleration_max_rad_per_s2: 8.0,
            stop_deceleration_rad_per_s2: 4.0,
            watchdog: true,
        }
    }

    #[test]
    fn everything_is_filled_in_and_it_is_ascii() {
        for series in [Series::Cb3, Series::ESeries] {
            let text = ProgramConfig { series, ..config() }.render().unwrap();
            assert!(!text.contains("{{") && !text.contains("}}") && !text.contains('#'));
            assert!(text.is_ascii() && text.ends_with("end\n"));
            assert!(text.starts_with("def tangent_bridge():\n"));
            // A controller starts it at a column-1 `end`; there must be one, the last line.
            assert_eq!(text.lines().filter(|l| !l.starts_with(' ')).count(), 2);
            assert!(text.len() < 8000, "{} bytes compile slowly", text.len());
        }
    }

    #[test]
    fn blocks_are_balanced() {
        let text = config().render().unwrap();
        let mut depth = 0;
        for line in text.lines() {
            let line = line.trim();
            if line == "end" {
                depth -= 1;
            } else if line.ends_with(':') && !line.starts_with("el") {
                depth += 1;
            }
            assert!(depth >= 0);
        }
        assert_eq!(depth, 0);
    }

    #[test]
    fn the_stale_sequence_is_the_same_time_on_both_series() {
        let text = config().render().unwrap();
        assert!(text.contains("if stale > 5:") || text.contains("elif stale > 5:"));
        assert!(text.contains("elif stale > 2:"));
        assert!(text.contains("(5 - stale) * 0.333333333"));
        let text = ProgramConfig {
            series: Series::ESeries,
            ..config()
        }
        .render()
        .unwrap();
        assert!(text.contains("elif stale > 20:") && text.contains("elif stale > 8:"));
        assert!(text.contains(", 0.002)"));
    }

    #[test]
    fn registers_follow_the_base() {
        let mut c = config();
        c.registers = RegisterMap::new(40).unwrap();
        let text = c.render().unwrap();
        assert!(text.contains("rtde_set_watchdog(\"input_int_register_41\", 0.8, \"stop\")"));
        assert!(text.contains("read_input_float_register(46)"));
        assert!(text.contains("write_output_integer_register(46, 0)"));
        assert_eq!(
            c.registers.output_names().last().map(String::as_str),
            Some("output_double_register_45")
        );
        for base in [0, 23, 41, 255] {
            assert_eq!(RegisterMap::new(base), Err(ProgramError::Base { base }));
        }
        c.watchdog = false;
        assert!(!c.render().unwrap().contains("watchdog"));
    }

    #[test]
    fn numbers_that_cannot_be_compiled_are_named() {
        let c = ProgramConfig {
            speed_max_rad_per_s: f64::NAN,
            ..config()
        };
        let error = c.render().unwrap_err().to_string();
        assert!(error.starts_with("speed_max_rad_per_s = NaN"), "{error}");
        assert!(
            ProgramConfig {
                session: 0,
                ..config()
            }
            .render()
            .is_err()
        );
    }
}
