//! Estimates of an object's pose.

use std::time::Duration;

use nalgebra::Matrix6;
use tangent_control::{EstimatorName, ObjectInput};
use tangent_estimation::ObjectEstimate;
use tangent_mechanics::{Base, Object, Pose, Twist};
use tangent_runtime::Latest;
use tangent_schemas::tangent::{ArmState, ObjectEstimate as Message};
use tangent_sensing::Validity;

use super::age::CycleAge;

/// Reads the topic of one estimator.
pub struct ObjectReader {
    /// As in `estimate/NAME/object`.
    pub name: EstimatorName,
    newest: Latest<Message>,
    age: CycleAge,
    /// Estimate read in this cycle.
    now: Option<ObjectInput>,
}

impl ObjectReader {
    /// Reads `newest`, the topic of the estimator of this name.
    pub fn new(name: EstimatorName, newest: Latest<Message>) -> Self {
        Self {
            name,
            newest,
            age: CycleAge::default(),
            now: None,
        }
    }

    /// Reads the newest estimate and its age, `since_packet` after the robot's newest packet `arm`
    /// came.
    pub fn read(&mut self, arm: &ArmState, since_packet: Duration) {
        let age = &mut self.age;
        self.now = self.newest.get().map(|newest| {
            let message = &newest.message;
            let said = (newest.publisher, message.header.stamp.to_ns());
            ObjectInput {
                estimate: estimate(message),
                age_s: age.of(said, message.cycle, newest.age(), arm, since_packet),
            }
        });
    }

    /// Estimate of this cycle; `None` before the first message.
    pub fn now(&self) -> Option<ObjectInput> {
        self.now
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
    use nalgebra::Vector3;
    use tangent_control::{
        ChoiceRules, EstimatorList, MAX_ESTIMATORS, PatienceConfig, SwitchCause, SwitchRefusal,
        SwitchingSpec,
    };
    use tangent_estimation::object_pose::ObjectShape;
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
        ChoiceRules::of_torques(&patience, &switching, false)
    }

    struct Bench {
        readers: Vec<ObjectReader>,
        list: EstimatorList,
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
            let readers = names.map(|n| {
                let topic = topics::estimate_object(n);
                ObjectReader::new(EstimatorName::from(n).unwrap(), bus.latest(&topic).unwrap())
            });
            let list = EstimatorList::new(readers.iter().map(|reader| reader.name), rules);
            let speakers = names.map(|n| bus.publisher(&topics::estimate_object(n)).unwrap());
            let mut arm = ArmState {
                period_s: PERIOD_S,
                cycle: 100,
                ..ArmState::default()
            };
            arm.tool_pose.orientation.w = 1.0;
            Self {
                readers: readers.into(),
                list,
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
            let mut objects = [None; MAX_ESTIMATORS];
            for (reader, object) in self.readers.iter_mut().zip(&mut objects) {
                reader.read(&self.arm, Duration::ZERO);
                *object = reader.now();
            }
            let tip = (&self.arm.tool_pose.position).into();
            let (surface, normal) = (ObjectShape::Plane {}, Some(Vector3::z()));
            let read = self
                .list
                .step_objects(&objects, &surface, &tip, normal, 0.0, PERIOD_S);
            read.map(|read| read.estimate)
                .filter(|e| e.validity.is_valid())
                .map(|e| e.base_from_object.rotation().angle())
        }

        /// Number of cycles with these validities until `name` is in use.
        fn until(&mut self, name: &str, said: [Validity; 2]) -> f64 {
            for cycle in 0..10_000 {
                if self.list.in_use().name.as_str() == name {
                    return f64::from(cycle);
                }
                self.say(0, 0.01, said[0]);
                self.say(1, 0.02, said[1]);
                self.next();
            }
            panic!("never {name}");
        }

        fn select(&mut self, name: &str, force: bool) -> Result<(), SwitchRefusal> {
            self.list.select(&EstimatorName::from(name).unwrap(), force)
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
        assert_eq!(bench.list.in_use().switches, 0);
        let tolerated = bench.until("b", [Validity::Disagrees, Validity::Valid]);
        assert!(
            (tolerated - PATIENCE_S / PERIOD_S).abs() < 3.0,
            "{tolerated}"
        );
        let used = bench.list.in_use();
        assert_eq!((used.name.as_str(), used.switches), ("b", 1));
        assert_eq!(used.cause, SwitchCause::FellBack(Validity::Disagrees));
    }

    #[test]
    fn the_first_comes_back_after_being_good_for_as_long_as_the_task_says() {
        let mut bench = Bench::with("object-return", patient(Some(5.0)));
        bench.until("b", [Validity::Degenerate, Validity::Valid]);
        let good = bench.until("a", [Validity::Valid; 2]);
        assert!((good - 5.0 / PERIOD_S).abs() < 3.0, "{good}");
        assert_eq!(bench.list.in_use().cause, SwitchCause::Returned);
    }

    #[test]
    fn a_pose_far_from_the_one_in_use_is_rejected() {
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
        assert_eq!(bench.list.in_use().cause, SwitchCause::Forced);
        bench.say(0, 0.05, Validity::Valid);
        bench.next();
        bench.select("a", false).unwrap();
        assert_eq!(bench.list.in_use().switches, 2);
    }

    #[test]
    fn an_unchanged_estimate_ages_and_an_invalid_one_is_none() {
        let mut bench = Bench::new("object-old");
        bench.say(0, 0.0, Validity::Valid);
        assert!(bench.next().is_some());
        bench.arm.cycle += 20_000;
        assert_eq!(bench.next(), None);
        let mut invalid = Message::default();
        invalid.pose.position.x = f64::NAN;
        assert_eq!(estimate(&invalid).validity, Validity::NotFinite);
    }
}
