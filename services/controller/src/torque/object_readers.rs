//! Estimates of an object's pose that a task may use: which one is used, when the next is chosen,
//! when a switch is refused.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Matrix6, Vector3};
use tangent_control::{
    ChoiceRules, EstimateInput, EstimatorName, MAX_ESTIMATORS, SwitchCause, SwitchRefusal,
};
use tangent_estimation::object_pose::{ImplicitSurface, ObjectShape};
use tangent_estimation::{NormalEstimate, ObjectEstimate};
use tangent_mechanics::{Base, Object, Pose, Twist};
use tangent_runtime::Latest;
use tangent_schemas::tangent::ObjectEstimate as Message;
use tangent_sensing::Validity;

use super::choice::Choice;
use super::program::TorqueInput;
use crate::age::CycleAge;

struct Reader {
    newest: Latest<Message>,
    age: CycleAge,
    /// Estimate as read in this cycle, with its age, s.
    now: Option<(ObjectEstimate, f64)>,
}

/// Reads the estimates of an object's pose and chooses which one a torque law uses. The pose in use
/// moves to the new estimate at the law's bounded speed.
pub struct ObjectReaders {
    readers: ArrayVec<Reader, MAX_ESTIMATORS>,
    shape: ObjectShape,
    choice: Choice,
}

impl ObjectReaders {
    /// Readers in the order of the task's list, with the rules of the choice.
    pub fn new(
        readers: impl IntoIterator<Item = (EstimatorName, Latest<Message>)>,
        shape: ObjectShape,
        rules: ChoiceRules,
    ) -> Self {
        let (names, readers): (Vec<_>, Vec<_>) = readers
            .into_iter()
            .take(MAX_ESTIMATORS)
            .map(|(name, newest)| {
                let reader = Reader {
                    newest,
                    age: CycleAge::default(),
                    now: None,
                };
                (name, reader)
            })
            .unzip();
        Self {
            readers: readers.into_iter().collect(),
            shape,
            choice: Choice::new(names, rules),
        }
    }

    /// The estimate to use in this cycle, and its age, s; marked as invalid if it must not be used.
    /// `normal` is the one in use, base axes; `way_m` is the distance slid since the cycle before.
    pub fn read(
        &mut self,
        input: &TorqueInput<'_>,
        normal: Option<Vector3<f64>>,
        way_m: f64,
    ) -> Option<(ObjectEstimate, f64)> {
        let arm = input.arm;
        for reader in &mut self.readers {
            reader.now = reader.newest.get().map(|received| {
                let message = &received.message;
                let said = (received.publisher, message.header.stamp.to_ns());
                let age = received.age();
                let age_s = reader
                    .age
                    .of(said, message.cycle, age, arm, input.since_packet);
                (estimate(message), age_s)
            });
        }
        // Estimates are compared by their normals at the tip.
        let tip = (&arm.tool_pose.position).into();
        let shape = &self.shape;
        let normals = self.readers.iter().map(|reader| {
            reader.now.map(|(estimate, age_s)| EstimateInput {
                estimate: normal_at(&estimate, shape, &tip),
                age_s,
            })
        });
        let used = self.choice.step(normals, normal, way_m, input.dt_s)?;
        let (mut estimate, age_s) = self.readers.get(self.choice.active())?.now?;
        estimate.validity = used.estimate.validity;
        Some((estimate, age_s))
    }

    /// All estimators of the list, each with the age of its newest estimate in this cycle, s; -1
    /// without one.
    pub fn ages(&self) -> impl Iterator<Item = (EstimatorName, f64)> {
        self.choice.ages()
    }

    /// Switches to another estimator of the list.
    ///
    /// # Errors
    /// The estimator is unknown, silent, invalid, or too far from the normal in use.
    pub fn select(&mut self, name: &EstimatorName, force: bool) -> Result<(), SwitchRefusal> {
        self.choice.select(name, force)
    }

    /// Name of the estimator in use, number of changes since the task started, and cause of the
    /// last one.
    pub fn in_use(&self) -> (EstimatorName, u32, SwitchCause) {
        self.choice.in_use()
    }
}

/// Normal of the surface at `tip` (base axes, m) according to an estimate of the object.
fn normal_at(estimate: &ObjectEstimate, shape: &ObjectShape, tip: &Vector3<f64>) -> NormalEstimate {
    let pose = &estimate.base_from_object;
    NormalEstimate {
        point: *tip,
        normal: pose.rotate(&shape.normal(&pose.inverse().transform_point(tip))),
        covariance: Matrix3::zeros(),
        validity: estimate.validity,
        friction: None,
        curvature: None,
    }
}

/// Estimate from a message; invalid if its pose or another number is not valid.
fn estimate(message: &Message) -> ObjectEstimate {
    let pose: Result<Pose<Base, Object>, _> = (&message.pose).try_into();
    let twist = Twist::from(&message.twist);
    let covariance = Matrix6::from_row_slice(&message.covariance.0);
    let sound = twist.is_finite() && covariance.iter().all(|x| x.is_finite());
    let Some(base_from_object) = pose.ok().filter(|_| sound) else {
        return ObjectEstimate::invalid(Validity::NotFinite);
    };
    ObjectEstimate {
        base_from_object,
        twist,
        covariance,
        validity: Validity::from(message.validity),
        vision_age_s: if message.vision_age_s >= 0.0 {
            message.vision_age_s
        } else {
            f64::INFINITY
        },
        in_contact: message.in_contact,
        force_n: message.force_n,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inputs::WrenchNow;
    use crate::torque::choice::rules;
    use std::time::Duration;
    use tangent_control::{PatienceConfig, SwitchingSpec};
    use tangent_runtime::{Bus, Publisher};
    use tangent_schemas::Covariance;
    use tangent_schemas::standard::Header;
    use tangent_schemas::tangent::ArmState;
    use tangent_schemas::topics;

    const PATIENCE_S: f64 = 20.0;
    const PERIOD_S: f64 = 0.1;

    fn patient(return_after_good_s: Option<f64>) -> ChoiceRules {
        let patience = PatienceConfig {
            estimate_s: PATIENCE_S,
            ..PatienceConfig::default()
        };
        let switching = SwitchingSpec {
            disagreement_max_rad: Some(0.1),
            return_after_good_s,
        };
        rules(&patience, &switching, false)
    }

    struct Bench {
        readers: ObjectReaders,
        speakers: [Publisher<Message>; 2],
        arm: ArmState,
    }

    impl Bench {
        fn new(name: &str) -> Self {
            Self::with(name, patient(None))
        }

        fn with(name: &str, rules: ChoiceRules) -> Self {
            let bus = Bus::in_process(name);
            let names = ["a", "b"];
            let newest = names.map(|n| {
                let topic = topics::estimate_object(n);
                (EstimatorName::from(n).unwrap(), bus.latest(&topic).unwrap())
            });
            let speakers = names.map(|n| bus.publisher(&topics::estimate_object(n)).unwrap());
            let mut arm = ArmState {
                period_s: PERIOD_S,
                cycle: 100,
                ..ArmState::default()
            };
            arm.tool_pose.orientation.w = 1.0;
            Self {
                readers: ObjectReaders::new(newest, ObjectShape::Plane, rules),
                speakers,
                arm,
            }
        }

        /// Publishes an estimate that is rotated about x by `tilt`.
        fn say(&self, who: usize, tilt: f64, validity: Validity) {
            let mut message = Message {
                header: Header::new(self.arm.cycle as i64, "base"),
                cycle: self.arm.cycle,
                validity: validity as u8,
                covariance: Covariance([1e-6; 36]),
                ..Message::default()
            };
            message.pose.orientation.w = (tilt / 2.0).cos();
            message.pose.orientation.x = (tilt / 2.0).sin();
            self.speakers[who].publish(&message);
        }

        fn next(&mut self) -> Option<f64> {
            self.arm.cycle += 1;
            let input = TorqueInput {
                arm: &self.arm,
                dt_s: PERIOD_S,
                since_packet: Duration::ZERO,
                time_s: 0.0,
                arm_ready: true,
                wrench: WrenchNow::missing(),
            };
            let read = self.readers.read(&input, Some(Vector3::z()), 0.0);
            read.filter(|(e, _)| e.validity.is_valid())
                .map(|(e, _)| e.base_from_object.rotation().angle())
        }

        /// Number of cycles with these validities until `name` is in use.
        fn until(&mut self, name: &str, said: [Validity; 2]) -> f64 {
            for cycle in 0..10_000 {
                if self.readers.in_use().0.as_str() == name {
                    return f64::from(cycle);
                }
                self.say(0, 0.01, said[0]);
                self.say(1, 0.02, said[1]);
                self.next();
            }
            panic!("never {name}");
        }

        fn select(&mut self, name: &str, force: bool) -> Result<(), SwitchRefusal> {
            self.readers
                .select(&EstimatorName::from(name).unwrap(), force)
        }
    }

    #[test]
    fn the_first_is_used_while_it_is_good_and_the_next_when_it_is_not() {
        let mut bench = Bench::new("object-fallback");
        assert_eq!(bench.next(), None);
        bench.say(0, 0.01, Validity::Valid);
        bench.say(1, 0.02, Validity::Valid);
        assert!((bench.next().unwrap() - 0.01).abs() < 1e-12);
        // One estimate that disagrees does not cause a switch.
        bench.say(0, 0.01, Validity::Disagrees);
        assert_eq!(bench.next(), None);
        assert_eq!(bench.readers.in_use().1, 0);
        let borne = bench.until("b", [Validity::Disagrees, Validity::Valid]);
        assert!((borne - PATIENCE_S / PERIOD_S).abs() < 3.0, "{borne}");
        let (name, switches, cause) = bench.readers.in_use();
        assert_eq!((name.as_str(), switches), ("b", 1));
        assert_eq!(cause, SwitchCause::FellBack(Validity::Disagrees));
    }

    #[test]
    fn the_first_comes_back_after_being_good_for_as_long_as_the_task_says() {
        let mut bench = Bench::with("object-return", patient(Some(5.0)));
        bench.until("b", [Validity::Degenerate, Validity::Valid]);
        let good = bench.until("a", [Validity::Valid; 2]);
        assert!((good - 5.0 / PERIOD_S).abs() < 3.0, "{good}");
        assert_eq!(bench.readers.in_use().2, SwitchCause::Returned);
    }

    #[test]
    fn a_pose_far_from_the_one_in_use_is_not_gone_by() {
        let mut bench = Bench::new("object-gate");
        bench.say(0, 1.5, Validity::Valid);
        assert_eq!(bench.next(), None);
        bench.say(0, 0.1, Validity::Valid);
        assert!(bench.next().is_some());
    }

    #[test]
    fn a_switch_is_refused_with_the_reason_and_forced_all_the_same() {
        let mut bench = Bench::new("object-switch");
        bench.say(0, 0.0, Validity::Valid);
        bench.next();
        assert_eq!(bench.select("c", false), Err(SwitchRefusal::Unknown));
        assert_eq!(bench.select("b", true), Err(SwitchRefusal::Silent));
        bench.say(1, 0.3, Validity::Valid);
        bench.next();
        assert!(matches!(
            bench.select("b", false),
            Err(SwitchRefusal::Disagrees { .. })
        ));
        bench.select("b", true).unwrap();
        assert_eq!(bench.readers.in_use().2, SwitchCause::Forced);
        bench.say(0, 0.05, Validity::Valid);
        bench.next();
        bench.select("a", false).unwrap();
        assert_eq!(bench.readers.in_use().1, 2);
    }

    #[test]
    fn an_estimate_that_stands_still_grows_old_and_nonsense_is_none() {
        let mut bench = Bench::new("object-old");
        bench.say(0, 0.0, Validity::Valid);
        assert!(bench.next().is_some());
        bench.arm.cycle += 20_000;
        assert_eq!(bench.next(), None);
        let mut nonsense = Message::default();
        nonsense.pose.position.x = f64::NAN;
        assert_eq!(estimate(&nonsense).validity, Validity::NotFinite);
    }
}
