//! One pass with a memory: records the surface while the tool slides, and feeds forward what
//! earlier passes learnt. Allocated at the start of the task; a step allocates nothing.

use nalgebra::Vector3;

use super::memory::{Memory, SurfacePoint};
use super::pass::Pass;
use super::spec::LearningSpec;
use super::trust::Trust;
use crate::contact::alignment::tangential;
use crate::limits::clamp_norm;

/// Largest distance between two passes' places of the same point of the path, m.
const SHIFT_MAX_M: f64 = 0.006;
/// Time in which the feedforward is ramped in after the tool begins to slide, s.
const RAMP_S: f64 = 0.3;
/// Distance to either side over which the rotation of the learnt normal is taken, m.
const TURN_OVER_M: f64 = 0.004;
/// Largest rotation rate of the learnt normal that is fed forward, rad/s.
const TURN_RATE_MAX_RAD_PER_S: f64 = 0.5;
/// Distance before and after a lost contact from which nothing is learnt, m.
const FORGET_AROUND_M: f64 = 0.006;
/// Largest lift of a recorded point to the reference force, m.
const LIFT_MAX_M: f64 = 0.001;

/// Inputs of one cycle in which the tool slides along the path.
#[derive(Clone, Copy, Debug)]
pub struct PassSample {
    /// Index of the stroke.
    pub stroke: usize,
    /// Distance of the path's clock along it, m.
    pub distance_m: f64,
    /// Measured position of the tool's origin, base axes, m.
    pub position: Vector3<f64>,
    /// Normal in use, base axes.
    pub normal: Vector3<f64>,
    /// Normal from this pass's estimates alone, base axes.
    pub estimated: Vector3<f64>,
    /// Commanded velocity in the tangent plane, base axes, m/s.
    pub along: Vector3<f64>,
    /// Measured force minus its reference, N; `None` without a usable wrench.
    pub error_n: Option<f64>,
    /// Contact stiffness in use, N/m.
    pub stiffness_n_per_m: f64,
    /// Age of the measured force, with the delay of its filter, s.
    pub force_age_s: f64,
    /// Delay from a command to the tool's motion, s.
    pub lead_s: f64,
    /// Period, s.
    pub dt_s: f64,
}

impl PassSample {
    /// Whether all of it is finite and possible: a position within 100 m, a force error within
    /// 1 kN.
    fn is_plausible(&self) -> bool {
        let within = |x: f64, limit: f64| x.abs() <= limit;
        let vectors = [
            (&self.position, 100.0),
            (&self.normal, 2.0),
            (&self.estimated, 2.0),
            (&self.along, 10.0),
        ];
        (vectors.iter()).all(|(v, limit)| v.iter().all(|x| within(*x, *limit)))
            && within(self.error_n.unwrap_or(0.0), 1e3)
            && within(self.distance_m, 1e4)
            && [self.force_age_s, self.lead_s]
                .iter()
                .all(|t| within(*t, 10.0))
            && self.stiffness_n_per_m.is_finite()
    }
}

/// Motion that the memory expects of the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Feedforward {
    /// Along the normal in use, out of the material, m/s.
    pub speed_m_per_s: f64,
    /// Learnt normal under the tool, unit, out of the material, base axes.
    pub normal: Vector3<f64>,
    /// Rotation of the surface under the tool, base axes, rad/s.
    pub turn_rate: Vector3<f64>,
    /// Weight of both, 0 to 1: they replace that share of what the law has from estimates.
    pub turn_weight: f64,
}

/// One pass with a memory.
#[derive(Clone, Debug)]
pub struct Learner {
    spec: LearningSpec,
    memory: Memory,
    pass: Pass,
    trust: Trust,
    ramp: f64,
    stroke: usize,
    distance_m: f64,
    /// Stroke and place at which the command of this cycle takes effect.
    command_at: Option<(usize, f64)>,
    /// Place of the path's clock in the cycle before.
    clock_at: Option<(usize, f64)>,
}

impl Learner {
    /// Starts a pass. Allocates.
    pub fn new(spec: LearningSpec, memory: Memory) -> Self {
        Self {
            pass: Pass::new(&memory),
            spec,
            memory,
            trust: Trust::default(),
            ramp: 0.0,
            stroke: 0,
            distance_m: 0.0,
            command_at: None,
            clock_at: None,
        }
    }

    /// Name of the part.
    pub fn part(&self) -> &str {
        &self.spec.part
    }

    /// Whether earlier passes have shown the surface.
    pub fn knows_surface(&self) -> bool {
        self.memory.passes() > 0
    }

    /// The tool does not slide: the feedforward ramps in again. `lost`: contact was lost here, and
    /// nothing is learnt around.
    pub fn rest(&mut self, lost: bool) {
        if lost && self.ramp > 0.0 {
            self.pass
                .forget(self.stroke, self.distance_m, FORGET_AROUND_M);
        }
        self.ramp = 0.0;
        self.command_at = None;
        self.clock_at = None;
        self.trust.interrupt();
    }

    /// Records the velocity of the tool's origin that was commanded in this cycle, base axes, m/s.
    pub fn commanded(&mut self, linear: &Vector3<f64>, dt_s: f64) {
        let is_finite = linear.iter().all(|x| x.is_finite()) && dt_s.is_finite();
        if let Some((stroke, distance_m)) = self.command_at.take().filter(|_| is_finite) {
            self.pass.command(stroke, distance_m, &(linear * dt_s));
        }
    }

    /// Processes one cycle. Returns the feedforward, `None` where nothing is known. Allocates
    /// nothing.
    pub fn step(&mut self, sample: &PassSample) -> Option<Feedforward> {
        if !sample.is_plausible() {
            return None;
        }
        // While the path's clock stands, the tool explores or waits: it is not on the path.
        let clock = Some((sample.stroke, sample.distance_m));
        if std::mem::replace(&mut self.clock_at, clock) == clock {
            self.command_at = None;
            return self.standing(sample);
        }
        if sample.stroke != self.stroke {
            self.stroke = sample.stroke;
            self.trust.interrupt();
        }
        self.ramp = (self.ramp + sample.dt_s / RAMP_S).min(1.0);
        let known = self.memory.at(sample.stroke, sample.distance_m);
        let place_m = known.map_or(Some(sample.distance_m), |point| registered(&point, sample));
        let lift_m = sample.error_n.map(|error_n| {
            (error_n / sample.stiffness_n_per_m.max(100.0)).clamp(-LIFT_MAX_M, LIFT_MAX_M)
        });
        let now = place_m
            .filter(|_| known.is_some())
            .and_then(|place_m| self.memory.at(sample.stroke, place_m));
        if let Some(now) = now {
            let point = sample.position + sample.normal * lift_m.unwrap_or(0.0);
            self.trust.step(&point, &sample.estimated, &now.tangent);
        }
        let ahead = place_m.filter(|_| known.is_some()).and_then(|place_m| {
            let speed = now.map_or(0.0, |now| sample.along.dot(&now.tangent));
            self.ahead(sample, place_m, speed)
        });
        // A part in another place is recorded where the path's clock is.
        let recorded_m = place_m.unwrap_or(sample.distance_m);
        let takes_effect_m = recorded_m + sample.along.norm() * sample.lead_s;
        self.command_at = Some((sample.stroke, takes_effect_m));
        self.distance_m = recorded_m;
        self.pass.place(
            sample.stroke,
            recorded_m,
            &sample.position,
            &sample.estimated,
        );
        if let (Some(error_n), Some(lift_m)) = (sample.error_n, lift_m) {
            let felt_m = recorded_m - sample.along.norm() * sample.force_age_s;
            let weight = ahead.map_or(0.0, |ahead| ahead.turn_weight);
            self.pass
                .felt(sample.stroke, felt_m, error_n, lift_m, weight);
        }
        ahead
    }

    /// Share of the estimates' normal that the memory's normal at `point` replaces.
    fn turn_weight(&self, point: &SurfacePoint) -> f64 {
        point.weight * self.trust.confirmed_share() * self.ramp
    }

    /// What is fed forward while the path's clock stands: the tool keeps to the learnt normal.
    fn standing(&self, sample: &PassSample) -> Option<Feedforward> {
        let point = self.memory.at(sample.stroke, sample.distance_m)?;
        Some(Feedforward {
            speed_m_per_s: 0.0,
            normal: point.normal,
            turn_rate: Vector3::zeros(),
            turn_weight: self.turn_weight(&point),
        })
    }

    /// What is fed forward with the tool at `here_m`, moving along the path at `speed` (m/s).
    fn ahead(&self, sample: &PassSample, here_m: f64, speed: f64) -> Option<Feedforward> {
        let place_m = here_m + speed * sample.lead_s;
        let point = self.memory.at(sample.stroke, place_m)?;
        let weight = point.weight * self.trust.share() * self.ramp;
        let flat = tangential(&point.tangent, &sample.normal);
        let square = flat.norm_squared();
        if square < 0.25 || weight <= 0.0 {
            return None;
        }
        let slope = flat * (point.tangent.dot(&sample.normal) / square)
            + flat * (point.correction / square.sqrt());
        let slope = clamp_norm(slope, self.spec.slope_max);
        // At the ends of a stroke, from one side.
        let beside = |way_m: f64| {
            let there = self.memory.at(sample.stroke, place_m + way_m);
            there.map_or((0.0, point.normal), |there| (way_m, there.normal))
        };
        let (before, after) = (beside(-TURN_OVER_M), beside(TURN_OVER_M));
        let speed = sample.along.dot(&point.tangent);
        let turn = before.1.cross(&after.1) * (speed / (after.0 - before.0).max(TURN_OVER_M));
        Some(Feedforward {
            speed_m_per_s: slope.dot(&sample.along) * weight,
            normal: (self.memory.at(sample.stroke, here_m)).map_or(point.normal, |p| p.normal),
            turn_rate: clamp_norm(turn, TURN_RATE_MAX_RAD_PER_S),
            turn_weight: self.turn_weight(&point),
        })
    }

    /// Ends the pass and returns the memory for the next one. `completed`: the path was followed to
    /// its end without a fault; nothing is learnt otherwise. Allocates nothing, but takes
    /// milliseconds: not for the robot's cycle.
    pub fn finish(mut self, completed: bool) -> Memory {
        if completed {
            self.memory.learn(&self.pass, &self.spec);
        }
        self.memory
    }
}

/// A pass that has ended.
#[derive(Clone, Debug)]
pub struct EndedPass {
    /// Its record.
    pub learner: Box<Learner>,
    /// Whether the path was followed to its end without a fault.
    pub completed: bool,
}

impl EndedPass {
    /// The memory for the next pass, see [`Learner::finish`].
    pub fn finish(self) -> Memory {
        self.learner.finish(self.completed)
    }
}

/// Place along the stroke at which earlier passes were where the tool is now, m; `None` if the tool
/// is elsewhere.
fn registered(point: &SurfacePoint, sample: &PassSample) -> Option<f64> {
    let away = sample.position - point.position;
    let shift_m = away.dot(&point.tangent);
    let across = tangential(&(away - point.tangent * shift_m), &point.normal);
    (shift_m.abs() <= SHIFT_MAX_M && across.norm() <= SHIFT_MAX_M)
        .then_some(sample.distance_m + shift_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::path::{Path, PathSpec};
    use proptest::prelude::*;

    const SPEED: f64 = 0.02;
    const DT: f64 = 0.008;

    fn path() -> Path {
        let text = "kind = \"line\"\nto_m = [0.1, 0.0]\nspeed_m_per_s = 0.02";
        let spec: PathSpec = toml::from_str(text).unwrap();
        Path::new(&spec, 0.1, 1.0).unwrap()
    }

    fn sample(distance_m: f64, height_m: f64) -> PassSample {
        PassSample {
            stroke: 0,
            distance_m,
            position: Vector3::new(distance_m, 0.0, height_m),
            normal: Vector3::z(),
            estimated: Vector3::z(),
            along: Vector3::x() * SPEED,
            error_n: Some(0.0),
            stiffness_n_per_m: 5000.0,
            force_age_s: 0.008,
            lead_s: 0.0,
            dt_s: DT,
        }
    }

    /// Slides over a surface of the given height, with a touchdown `shift_m` further on. Returns
    /// the memory after it and all slopes that were fed forward.
    fn slide(memory: Memory, height: impl Fn(f64) -> f64, shift_m: f64) -> (Memory, Vec<f64>) {
        let mut learner = Learner::new(LearningSpec::of("a"), memory);
        let mut slopes = Vec::new();
        let mut x = 0.0;
        while x < 0.1 {
            let mut sample = sample(x, height(x + shift_m));
            sample.position.x += shift_m;
            let ahead = learner.step(&sample);
            slopes.push(ahead.map_or(0.0, |ahead| ahead.speed_m_per_s / SPEED));
            let slope = (height(x + shift_m + 1e-4) - height(x + shift_m - 1e-4)) / 2e-4;
            let way = Vector3::new(1.0, 0.0, slope);
            learner.commanded(&(way * SPEED), DT);
            x += SPEED * DT;
        }
        (learner.finish(true), slopes)
    }

    fn learnt(passes: usize, height: impl Fn(f64) -> f64 + Copy) -> Memory {
        (0..passes).fold(Memory::new(&path()), |memory, _| {
            slide(memory, height, 0.0).0
        })
    }

    fn waves(x: f64) -> f64 {
        0.002 * (x * 60.0).sin()
    }

    fn slope_of_waves(x: f64) -> f64 {
        0.12 * (x * 60.0).cos()
    }

    #[test]
    fn the_slope_of_the_surface_is_fed_forward_after_two_passes() {
        let memory = learnt(2, waves);
        assert_eq!((memory.passes(), memory.weight_max()), (2, 1.0));
        for shift_m in [0.0, 0.002, -0.002] {
            let (_, slopes) = slide(memory.clone(), waves, shift_m);
            for (i, slope) in slopes.iter().enumerate().skip(60) {
                let x = i as f64 * SPEED * DT + shift_m;
                if x < 0.095 {
                    let wanted = slope_of_waves(x);
                    assert!(
                        (slope - wanted).abs() < 0.01,
                        "{shift_m} {x}: {slope} {wanted}"
                    );
                }
            }
        }
    }

    #[test]
    fn nothing_is_fed_forward_in_the_first_pass() {
        let (_, slopes) = slide(Memory::new(&path()), waves, 0.0);
        assert!(slopes.iter().all(|slope| *slope == 0.0));
    }

    /// A flat part after a waved one: the memory is not used after some millimetres, and is
    /// replaced.
    #[test]
    fn a_contradiction_ends_the_use_and_replaces_the_memory() {
        let memory = learnt(3, waves);
        let (memory, slopes) = slide(memory, |_| 0.0, 0.0);
        let used = slopes.iter().filter(|slope| slope.abs() > 1e-9).count();
        assert!((used as f64) * SPEED * DT < 0.02, "{used}");
        let point = memory.at(0, 0.0105).unwrap();
        assert!(
            point.tangent.z.abs() < 0.01 && point.weight == 0.0,
            "{point:?}"
        );
        let (memory, _) = slide(memory, |_| 0.0, 0.0);
        assert_eq!(memory.at(0, 0.0105).unwrap().weight, 0.5);
    }

    #[test]
    fn the_change_in_one_pass_is_bounded() {
        let spec = LearningSpec {
            change_max_rad: 0.002,
            ..LearningSpec::of("a")
        };
        let memory = learnt(3, |_| 0.0);
        let mut learner = Learner::new(spec, memory);
        let mut x = 0.0;
        while x < 0.1 {
            learner.step(&sample(x, 0.05 * x));
            x += SPEED * DT;
        }
        let point = learner.finish(true).at(0, 0.05).unwrap();
        let angle = point.tangent.z.atan2(point.tangent.x);
        assert!(angle > 0.0015 && angle < 0.0021, "{angle}");
    }

    #[test]
    fn a_lost_contact_and_a_part_elsewhere() {
        let mut learner = Learner::new(LearningSpec::of("a"), Memory::new(&path()));
        let mut x = 0.0;
        while x < 0.1 {
            learner.step(&sample(x, 0.0));
            x += SPEED * DT;
            if (x - 0.05).abs() < 0.5 * SPEED * DT {
                learner.rest(true);
            }
        }
        let memory = learner.finish(true);
        assert!(memory.at(0, 0.02).is_some() && memory.at(0, 0.0475).is_none());
        // 20 mm beside the part, nothing is fed forward.
        let mut learner = Learner::new(LearningSpec::of("a"), memory);
        for i in 0..100 {
            let mut sample = sample(f64::from(i) * SPEED * DT, 0.0);
            sample.position.y = 0.02;
            assert_eq!(learner.step(&sample), None);
        }
    }

    proptest! {
        /// Whatever is recorded, what is fed forward is finite and within its bound.
        #[test]
        fn bounded_and_finite(values in prop::collection::vec(prop::array::uniform4(prop_oneof![
            8 => -0.05f64..0.05, 1 => Just(f64::NAN), 1 => Just(f64::INFINITY), 1 => -1e9f64..1e9]), 300)) {
            let mut memory = Memory::new(&path());
            for _ in 0..3 {
                let mut learner = Learner::new(LearningSpec::of("a"), memory);
                let mut x = 0.0;
                for [a, b, c, d] in &values {
                    let mut sample = sample(x, a * 0.02);
                    sample.position.y = b * 0.02;
                    sample.error_n = Some(c * 100.0);
                    sample.stiffness_n_per_m = d * 1e5;
                    sample.normal = Vector3::new(*b, *d, 1.0).try_normalize(0.1).unwrap_or_else(Vector3::z);
                    sample.estimated = sample.normal;
                    if let Some(ahead) = learner.step(&sample) {
                        prop_assert!(ahead.speed_m_per_s.abs() <= 0.3 * SPEED + 1e-12);
                        prop_assert!(ahead.turn_rate.norm() <= TURN_RATE_MAX_RAD_PER_S + 1e-12);
                        prop_assert!((0.0..=1.0).contains(&ahead.turn_weight));
                    }
                    learner.commanded(&Vector3::new(SPEED, *a, *b), DT);
                    x += 0.1 / 300.0;
                }
                memory = learner.finish(true);
                let text = toml::to_string(&memory).unwrap();
                prop_assert_eq!(&toml::from_str::<Memory>(&text).unwrap(), &memory);
            }
        }
    }
}
