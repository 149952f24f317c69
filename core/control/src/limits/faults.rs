//! Faults: why a task ended early, and what to do about it.

use tangent_schemas::Text;
use tangent_schemas::convert::{cut, cut_format};

/// A load that exceeds its limit, N or Nm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Excess {
    load: f64,
    limit: f64,
}

impl Excess {
    /// A load and its limit, to a thousandth.
    pub fn new(load: f64, limit: f64) -> Self {
        let [load, limit] = [load, limit].map(|x| (x * 1e3).round() * 1e-3);
        Self { load, limit }
    }

    /// The excess of `load` over `limit`, if it is beyond.
    pub(super) fn over(load: f64, limit: f64) -> Option<Self> {
        (load > limit).then(|| Self::new(load, limit))
    }
}

/// Why a task ended early.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// The wrench is missing, old, not finite, saturated or the sensor reports an error.
    Wrench(tangent_sensing::Validity),
    /// No estimator in the task's list gave a usable normal for too long.
    Estimate(tangent_sensing::Validity),
    /// The motion of the base was not known for too long.
    Base(tangent_sensing::BaseTrouble),
    /// The arm cannot compensate the motion of its base.
    OutOfReach,
    /// The approach ended without contact.
    NoSurface,
    /// The surface was lost and not found again.
    SurfaceLost,
    /// The surface ends, or falls away more sharply than the tool can follow.
    SurfaceEnds,
    /// The normal in use turned further than the tool's way over a surface explains.
    NormalAstray,
    /// Contact was lost too often.
    ContactUnstable,
    /// The arm does not follow the path.
    PathBlocked,
    /// The force exceeds the cell's limit.
    ForceLimit(Excess),
    /// The torque exceeds the cell's limit.
    TorqueLimit(Excess),
    /// The tool leaves the cell's workspace.
    Workspace,
    /// The force did not settle in time.
    ForceNotReached,
    /// No tare arrived in time.
    NoTare,
    /// The arm does not accept commands.
    ArmNotReady,
    /// The arm's state is not finite.
    ArmState,
    /// The motion tank is empty: the path needs more energy than the task's budget.
    TankEmpty,
    /// The task exceeded its time limit.
    TaskTimeout,
    /// Moving off before the tare met an obstacle, or did not end in free space.
    NotClear,
    /// The retraction met an obstacle.
    RetractOpposed,
    /// The tool touched at the place where the sensor was tared: the zero hides a contact.
    ZeroInContact,
    /// The zero that the law took exceeds the possible error of the robot's estimate.
    ZeroTooLarge,
    /// The sensor has lost its zero.
    ZeroLost,
    /// The zero is so old that its drift may exceed what the task allows.
    ZeroOld,
    /// The untared reading exceeds the cell's limit.
    UntaredLimit,
    /// The arm feels a force that the sensor does not show.
    ForceUnread,
    /// The tool touched something on the way to the start pose or home.
    TravelTouched,
    /// The arm did not get to the start pose or home.
    TravelBlocked,
    /// The arm does not stand in the start pose, and the law does not move it there.
    StartAway,
}

impl Fault {
    /// What happened, with the load where there is a limit of it, and what to do, as text.
    pub fn text(self) -> Text {
        let words = self.words();
        match self {
            Self::ForceLimit(Excess { load, limit }) => cut_format(format_args!(
                "force of {load:.1} N, limits.force_max_n is {limit:.1}: {words}"
            )),
            Self::TorqueLimit(Excess { load, limit }) => cut_format(format_args!(
                "torque of {load:.1} Nm, limits.torque_max_nm is {limit:.1}: {words}"
            )),
            _ => cut(words),
        }
    }

    /// What happened and what to do, without the load.
    fn words(self) -> &'static str {
        use tangent_sensing::Validity;
        match self {
            Self::Wrench(Validity::Missing) => "no wrench: is netft running?",
            Self::Wrench(Validity::Stale) => {
                "wrench no longer received: check the sensor's cable and netft"
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
                "the wrench does not answer to the tool's motion: check the sensor, its delay, and that the surface does not move"
            }
            Self::Wrench(Validity::Implausible) => {
                "the wrench jumps as no load can: check the network and the sensor for damaged records"
            }
            Self::Wrench(Validity::Misdirected) => {
                "the force points along the surface: check what stands in the way, the sensor's zero and mounting, and the normal"
            }
            Self::Wrench(Validity::ZeroJumped) => {
                "the sensor's zero jumped: look for another program that sets it, check its cable and transducer, then tare and start again"
            }
            Self::Wrench(_) => "sensor reports an error: see wrench/status",
            Self::Estimate(Validity::Missing) => "no normal estimate: is the estimator running?",
            Self::Estimate(Validity::Stale) => {
                "normal estimate no longer received, no other to fall back to"
            }
            Self::Estimate(_) => "normal estimate unusable, no other to fall back to",
            Self::Base(trouble) => trouble.reason(),
            Self::OutOfReach => {
                "the base moves the surface out of the arm's reach: stop the platform, or start nearer"
            }
            Self::NoSurface => "no surface within approach.distance_max_m",
            Self::SurfaceLost => {
                "surface lost, not found again within contact.seek_distance_max_m or limits.blind_distance_max_m: does it end here?"
            }
            Self::SurfaceEnds => {
                "surface ends or falls away here: keep the path off its edges, or take a larger tip"
            }
            Self::NormalAstray => {
                "the normal turned further than the way over a surface explains: check the sensor's zero and mounting, and [tool.tip]"
            }
            Self::PathBlocked => {
                "the arm does not follow the path: it is near a singularity or a joint's limit, or something is in the way"
            }
            Self::ContactUnstable => {
                "contact lost too often: more damping or a lower approach speed for this stiffness"
            }
            Self::ForceLimit(_) => "is something in the way? else move slower or press less",
            Self::TorqueLimit(_) => "does the tool catch on something? else press less",
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
                "moving off the surface met something or never came free: move the tool clear, then start with --clear"
            }
            Self::RetractOpposed => {
                "retraction met something and gave way to it: move the tool clear, then start with --clear"
            }
            Self::ZeroInContact => {
                "touched at the position of the tare: the zero was measured in contact and is withdrawn; start again"
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
            Self::ForceUnread => {
                "the arm feels a force that the sensor does not show: check the sensor, the robot's payload, and what touches the arm"
            }
            Self::TravelTouched => {
                "touched something on the way to start or home: clear the way, start with --clear; if nothing is there, calibrate payload"
            }
            Self::TravelBlocked => {
                "the arm does not get to the start or home: see arm/state, and the limits of the cell"
            }
            Self::StartAway => {
                "the arm does not stand at start.joints_rad, and this law does not move it there: guide the arm there by hand"
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tangent_sensing::Validity;

    const LARGEST: Excess = Excess {
        load: 99_999.999,
        limit: 10_000.0,
    };

    /// `control/state` cuts a reason off at 128 bytes, and what to do stands at its end.
    #[test]
    fn a_fault_says_what_to_do_within_the_length_of_a_reason() {
        let sensor = (0..=u8::MAX).map(Validity::from);
        let estimator = sensor.clone().map(Fault::Estimate);
        let others = [
            Fault::OutOfReach,
            Fault::NoSurface,
            Fault::SurfaceLost,
            Fault::SurfaceEnds,
            Fault::ContactUnstable,
            Fault::PathBlocked,
            Fault::ForceLimit(LARGEST),
            Fault::TorqueLimit(LARGEST),
            Fault::Workspace,
            Fault::ForceNotReached,
            Fault::NoTare,
            Fault::ArmNotReady,
            Fault::ArmState,
            Fault::TankEmpty,
            Fault::TaskTimeout,
            Fault::NotClear,
            Fault::RetractOpposed,
            Fault::ZeroInContact,
            Fault::ZeroTooLarge,
            Fault::ZeroLost,
            Fault::ZeroOld,
            Fault::UntaredLimit,
            Fault::ForceUnread,
            Fault::TravelTouched,
            Fault::TravelBlocked,
            Fault::StartAway,
        ];
        for fault in sensor.map(Fault::Wrench).chain(estimator).chain(others) {
            let (text, words) = (fault.text(), fault.words());
            assert!(text.ends_with(words), "{text}: cut off of {words}");
        }
    }

    #[test]
    fn a_load_beyond_its_limit_is_named_with_the_limit() {
        let excess = Excess::over(47.26, 40.0).unwrap();
        let text = Fault::ForceLimit(excess).text();
        assert!(
            text.starts_with("force of 47.3 N, limits.force_max_n is 40.0: "),
            "{text}"
        );
        assert_eq!(Excess::over(40.0, 40.0), None);
        assert_eq!(Excess::over(f64::NAN, 40.0), None);
    }
}
