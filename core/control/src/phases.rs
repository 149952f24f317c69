//! Phases of a task, and the faults that end one.

/// Where a task stands. The numeric value is `ControlState.phase`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Phase {
    /// Nothing to do.
    #[default]
    Idle = 0,
    /// Moving towards the surface.
    Approach = 1,
    /// Touched it; the force settles.
    Contact = 2,
    /// Following the path.
    Slide = 3,
    /// Moving off the surface.
    Retract = 4,
    /// Ended as it should.
    Done = 5,
    /// Ended by a fault.
    Fault = 6,
    /// Pressing, standing still: paused, at the path's end, or without an estimate or a wrench.
    Hold = 7,
    /// Lost the surface; moving towards it again.
    Seek = 8,
    /// Standing still while the sensor's bias is taken.
    Tare = 9,
    /// Moving off what the tool may touch, before the sensor's bias is taken.
    Clear = 10,
}

impl Phase {
    /// All of them.
    pub const ALL: [Self; 11] = [
        Self::Idle,
        Self::Approach,
        Self::Contact,
        Self::Slide,
        Self::Retract,
        Self::Done,
        Self::Fault,
        Self::Hold,
        Self::Seek,
        Self::Tare,
        Self::Clear,
    ];

    /// From `ControlState.phase`.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.get(usize::from(code)).copied()
    }

    /// As in `ControlState.phase_text`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Approach => "approach",
            Self::Contact => "contact",
            Self::Slide => "slide",
            Self::Retract => "retract",
            Self::Done => "done",
            Self::Fault => "fault",
            Self::Hold => "hold",
            Self::Seek => "seek",
            Self::Tare => "tare",
            Self::Clear => "clear",
        }
    }

    /// A task is under way.
    pub fn is_active(self) -> bool {
        !matches!(self, Self::Idle | Self::Done | Self::Fault)
    }

    /// The tool is meant to press on the surface.
    pub fn is_pressing(self) -> bool {
        matches!(self, Self::Contact | Self::Slide | Self::Hold)
    }
}

/// Why a task ended before its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The wrench is missing, old, not finite, saturated or the sensor reports an error.
    Wrench(tangent_sensing::Validity),
    /// No estimator in the task's list gave a usable normal for too long.
    Estimate(tangent_sensing::Validity),
    /// How the base moves was not known for too long.
    Base(tangent_sensing::BaseTrouble),
    /// The arm cannot make up for the motion of its base.
    OutOfReach,
    /// The approach found nothing.
    NoSurface,
    /// The surface was lost and not found again.
    SurfaceLost,
    /// Contact was lost too often.
    ContactUnstable,
    /// The force exceeds the cell's limit.
    ForceLimit,
    /// The torque exceeds the cell's limit.
    TorqueLimit,
    /// The tool leaves the cell's workspace.
    Workspace,
    /// The force did not settle in time.
    ForceNotReached,
    /// No tare in time.
    NoTare,
    /// The arm does not take commands.
    ArmNotReady,
    /// The arm's state is not finite.
    ArmState,
    /// The motion tank is empty: the path takes more energy than the task was given.
    TankEmpty,
    /// The task took longer than it may.
    TaskTimeout,
    /// Moving off before the tare met something, or never came free.
    NotClear,
    /// The retraction met something.
    RetractOpposed,
    /// A touch right where the sensor was tared: the zero hides a contact.
    ZeroInContact,
    /// The zero that the law took is larger than the robot's estimate can be off.
    ZeroTooLarge,
    /// The sensor has no zero any more.
    ZeroLost,
    /// The zero is so old that its drift may exceed what the task allows.
    ZeroOld,
    /// The reading before any zero is taken off exceeds the cell's limit.
    UntaredLimit,
}

impl Fault {
    /// What happened and what to do, in words.
    pub fn text(self) -> &'static str {
        use tangent_sensing::Validity;
        match self {
            Self::Wrench(Validity::Missing) => "no wrench: is netft running?",
            Self::Wrench(Validity::Stale) => {
                "wrench fell silent: check the sensor's cable and netft"
            }
            Self::Wrench(Validity::Saturated) => "sensor saturated: too much force or torque",
            Self::Wrench(Validity::NotFinite) => "wrench is not a finite number",
            Self::Wrench(Validity::Frozen) => {
                "sensor frozen: its records repeat; restart the sensor, check its cable and transducer"
            }
            Self::Wrench(Validity::AxisStuck) => {
                "one axis of the sensor is stuck: restart the sensor, check its cable and transducer"
            }
            Self::Wrench(Validity::Unresponsive) => {
                "the wrench does not answer to the tool's motion: check the sensor, its mounting, its delay, and that the surface stays in its place"
            }
            Self::Wrench(Validity::Implausible) => {
                "the wrench jumps as no load can: check the network and the sensor for damaged records"
            }
            Self::Wrench(_) => "sensor reports an error: see wrench/status",
            Self::Estimate(Validity::Missing) => "no normal estimate: is the estimator running?",
            Self::Estimate(Validity::Stale) => {
                "normal estimate fell silent, no other to fall back to"
            }
            Self::Estimate(_) => "normal estimate unusable, no other to fall back to",
            Self::Base(trouble) => trouble.reason(),
            Self::OutOfReach => {
                "the base carries the arm out of its reach: stop the platform, or start nearer"
            }
            Self::NoSurface => "no surface within approach.distance_max_m",
            Self::SurfaceLost => {
                "surface lost and not found again within limits.blind_distance_max_m"
            }
            Self::ContactUnstable => {
                "contact lost too often: more damping or a lower approach speed for this stiffness"
            }
            Self::ForceLimit => "force beyond limits.force_max_n",
            Self::TorqueLimit => "torque beyond limits.torque_max_nm",
            Self::Workspace => "tool at the edge of the workspace (limits.workspace_min_m, _max_m)",
            Self::ForceNotReached => "force did not settle within timeouts.contact_s",
            Self::NoTare => "no tare within timeouts.tare_s: is netft running?",
            Self::ArmNotReady => "arm does not take commands: see arm/state",
            Self::ArmState => "arm state is not a finite number",
            Self::TankEmpty => {
                "motion tank empty: give the task more energy in control.tanks.motion, or less force or path"
            }
            Self::TaskTimeout => "task took longer than timeouts.task_s",
            Self::NotClear => {
                "moving off before the tare met something or never came free: move the tool clear, then start with --clear"
            }
            Self::RetractOpposed => {
                "retraction met something and stopped: move the tool clear, then start with --clear"
            }
            Self::ZeroInContact => {
                "touched right where it was tared: the zero was taken in contact and is withdrawn; start again"
            }
            Self::ZeroTooLarge => {
                "wrench beyond touch.zero_max_n at rest: the tool touches something, or the robot's load is set wrong"
            }
            Self::ZeroLost => "sensor lost its zero: did netft restart? start again",
            Self::ZeroOld => {
                "zero too old for zero.error_max_n: start again, or zero.at_limit = \"retare\""
            }
            Self::UntaredLimit => {
                "untared reading beyond limits.untared_force_max_n or untared_share_max"
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_distinct_and_numbers_fixed() {
        for (i, a) in Phase::ALL.iter().enumerate() {
            assert_eq!(*a as usize, i);
            assert_eq!(Phase::from_code(i as u8), Some(*a));
            for b in &Phase::ALL[..i] {
                assert_ne!(a.name(), b.name());
            }
        }
    }
}
