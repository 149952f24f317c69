//! The estimates of an object's pose that a task may go by: which one is used, when the next is taken, when a switch is refused.

use arrayvec::ArrayVec;
use nalgebra::{Matrix6, Vector3};
use tangent_control::{EstimatorName, MAX_ESTIMATORS, SwitchCause, SwitchRefusal};
use tangent_estimation::ObjectEstimate;
use tangent_estimation::object_pose::{ImplicitSurface, ObjectShape};
use tangent_mechanics::{Base, Object, Pose, Twist};
use tangent_runtime::Latest;
use tangent_schemas::tangent::{ArmState, ObjectEstimate as Message};
use tangent_sensing::Validity;

use super::choice::{Choice, Judged, judge};
use crate::age::CycleAge;

struct Reader {
    newest: Latest<Message>,
    age: CycleAge,
    /// As read this cycle, with its age, s.
    now: Option<(ObjectEstimate, f64)>,
}

/// See the module. The pose in use moves on to another estimate at the law's bounded speed, whatever is chosen here.
pub struct ObjectReaders {
    readers: ArrayVec<Reader, MAX_ESTIMATORS>,
    shape: ObjectShape,
    patience_s: f64,
    choice: Choice,
    /// Where the normals of two estimates are compared, base axes, m.
    tip: Vector3<f64>,
}

impl ObjectReaders {
    /// In the order of the task's list. Silence of more than `patience_s` is no estimate; `gate_rad` is how far the normal of a
    /// chosen one may lie from that in use.
    pub fn new(
        readers: impl IntoIterator<Item = (EstimatorName, Latest<Message>)>,
        shape: ObjectShape,
        patience_s: f64,
        gate_rad: f64,
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
            patience_s,
            choice: Choice::new(names, gate_rad),
            tip: Vector3::zeros(),
        }
    }

    /// The estimate to use in this cycle and its age, s.
    pub fn read(&mut self, arm: &ArmState) -> Option<(ObjectEstimate, f64)> {
        self.tip = (&arm.tool_pose.position).into();
        for reader in &mut self.readers {
            reader.now = reader.newest.get().map(|received| {
                let message = &received.message;
                let said = (received.publisher, message.header.stamp.to_ns());
                let age_s = reader.age.of(said, message.cycle, received.age(), arm);
                (estimate(message), age_s)
            });
        }
        let judged = self.judged();
        let active = self.choice.fall_back(&judged);
        self.readers.get(active).and_then(|reader| reader.now)
    }

    /// Takes another of the list.
    ///
    /// # Errors
    /// Unknown, silent, invalid, or too far from the one in use.
    pub fn select(&mut self, name: &EstimatorName, force: bool) -> Result<(), SwitchRefusal> {
        let judged = self.judged();
        let used = self.normal(self.choice.active());
        let normals: ArrayVec<_, MAX_ESTIMATORS> =
            (0..self.readers.len()).map(|i| self.normal(i)).collect();
        self.choice.select(name, force, &judged, |index| {
            Some(used?.angle(normals.get(index)?.as_ref()?))
        })
    }

    /// Name of the one in use, changes since the task started, and why this one.
    pub fn in_use(&self) -> (EstimatorName, u32, SwitchCause) {
        self.choice.in_use()
    }

    fn judged(&self) -> Judged {
        let said = |reader: &Reader| {
            reader
                .now
                .map(|(estimate, age_s)| (estimate.validity, age_s))
        };
        self.readers
            .iter()
            .map(|reader| judge(said(reader), self.patience_s))
            .collect()
    }

    fn normal(&self, index: usize) -> Option<Vector3<f64>> {
        let (estimate, age_s) = self.readers.get(index)?.now?;
        judge(Some((estimate.validity, age_s)), self.patience_s).ok()?;
        let pose = &estimate.base_from_object;
        let tip = pose.inverse().transform_point(&self.tip);
        Some(pose.rotate(&self.shape.normal(&tip)))
    }
}

/// A pose that is none makes the estimate one that says so.
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
    use tangent_runtime::{Bus, Publisher};
    use tangent_schemas::Covariance;
    use tangent_schemas::standard::Header;
    use tangent_schemas::topics;

    const PATIENCE_S: f64 = 60.0;

    struct Bench {
        readers: ObjectReaders,
        speakers: [Publisher<Message>; 2],
        arm: ArmState,
    }

    impl Bench {
        fn new(name: &str) -> Self {
            let bus = Bus::in_process(name);
            let names = ["a", "b"];
            let newest = names.map(|n| {
                let topic = topics::estimate_object(n);
                (EstimatorName::from(n).unwrap(), bus.latest(&topic).unwrap())
            });
            let speakers = names.map(|n| bus.publisher(&topics::estimate_object(n)).unwrap());
            let mut arm = ArmState {
                period_s: 0.001,
                cycle: 100,
                ..ArmState::default()
            };
            arm.tool_pose.orientation.w = 1.0;
            Self {
                readers: ObjectReaders::new(newest, ObjectShape::Plane, PATIENCE_S, 0.1),
                speakers,
                arm,
            }
        }

        /// Turned about x by `tilt`.
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
            let read = self.readers.read(&self.arm);
            read.filter(|(e, _)| e.validity.is_valid())
                .map(|(e, _)| e.base_from_object.rotation().angle())
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
        bench.say(0, 0.01, Validity::Disagrees);
        assert!((bench.next().unwrap() - 0.02).abs() < 1e-12);
        let (name, switches, cause) = bench.readers.in_use();
        assert_eq!((name.as_str(), switches), ("b", 1));
        assert_eq!(cause, SwitchCause::FellBack(Validity::Disagrees));
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
        bench.say(0, 0.25, Validity::Valid);
        bench.next();
        bench.select("a", false).unwrap();
        assert_eq!(bench.readers.in_use().1, 2);
    }

    #[test]
    fn an_estimate_that_stands_still_grows_old_and_nonsense_is_none() {
        let mut bench = Bench::new("object-old");
        bench.readers.patience_s = 10.0;
        bench.say(0, 0.0, Validity::Valid);
        bench.next();
        bench.arm.cycle += 20_000;
        bench.next();
        assert_eq!(bench.readers.judged()[0], Err(Validity::Stale));
        let mut nonsense = Message::default();
        nonsense.pose.position.x = f64::NAN;
        assert_eq!(estimate(&nonsense).validity, Validity::NotFinite);
    }
}
