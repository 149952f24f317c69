//! The estimators of a task, by name, and the choice among them.
//!
//! Called by the torque laws in each cycle, live and in `evaluate` alike. The law itself moves to a
//! new estimate at its bounded speed.

use nalgebra::{Matrix3, Vector3};
use tangent_estimation::object_pose::ImplicitSurface;
use tangent_estimation::{NormalEstimate, ObjectEstimate};
use tangent_sensing::Validity;

use super::switching::{ChoiceRules, SwitchRefusal};
use super::{EstimateStatus, EstimatorChoice};
use crate::inputs::{EstimateInput, MAX_ESTIMATORS, ObjectInput};
use crate::law::EstimatorInUse;
use crate::task::program::{EstimatorName, EstimatorNames};

/// Deviation of a unit vector's length from 1 that counts as rounding.
const UNIT_ROUNDING: f64 = 1e-12;

/// Estimators of a task with the one in use.
#[derive(Clone, Debug)]
pub struct EstimatorList {
    names: EstimatorNames,
    rules: ChoiceRules,
    choice: EstimatorChoice,
    /// Estimates of this cycle, in the order of the names.
    estimates: [Option<EstimateInput>; MAX_ESTIMATORS],
    /// Normal in use in the cycle before, base axes; `None` before the first.
    normal: Option<Vector3<f64>>,
}

impl EstimatorList {
    /// Choice among `names`, in the order of the task's list.
    pub fn new(names: impl IntoIterator<Item = EstimatorName>, rules: ChoiceRules) -> Self {
        Self {
            names: names.into_iter().take(MAX_ESTIMATORS).collect(),
            rules,
            choice: EstimatorChoice::default(),
            estimates: [None; MAX_ESTIMATORS],
            normal: None,
        }
    }

    /// Runs one cycle with the estimates of the list. `normal` is the one in use, base axes;
    /// `way_m` is the distance slid since the cycle before, `dt_s` ago. An estimate that reports
    /// itself valid but must not be used is returned with the reason.
    pub fn step(
        &mut self,
        estimates: impl IntoIterator<Item = Option<EstimateInput>>,
        normal: Option<Vector3<f64>>,
        way_m: f64,
        dt_s: f64,
    ) -> Option<EstimateInput> {
        self.estimates = [None; MAX_ESTIMATORS];
        for (place, said) in self.estimates.iter_mut().zip(estimates) {
            *place = said;
        }
        self.normal = normal.filter(|n| n.iter().all(|x| x.is_finite()));
        // Either can be NaN if the arm's state is invalid. `max` then returns the other argument.
        #[expect(
            clippy::manual_clamp,
            reason = "NaN becomes 0 here; `clamp` would keep it"
        )]
        let (way_m, dt_s) = (way_m.max(0.0).min(1.0), dt_s.max(0.0).min(1.0));
        let (rules, normal) = self.rules_now();
        let status = self
            .choice
            .step(&rules, &self.estimates, &normal, way_m, dt_s);
        match status {
            EstimateStatus::Usable(judged) => Some(self.unchanged(judged)),
            EstimateStatus::Waiting => self.withheld(Validity::Disagrees),
            EstimateStatus::None(reason) => self.withheld(reason),
        }
    }

    /// Runs one cycle with estimates of an object's pose, as [`Self::step`] does with normals.
    /// They are compared by the normals of `surface` (object axes) at `tip`, base axes, m.
    pub fn step_objects(
        &mut self,
        objects: &[Option<ObjectInput>; MAX_ESTIMATORS],
        surface: &dyn ImplicitSurface,
        tip: &Vector3<f64>,
        normal: Option<Vector3<f64>>,
        way_m: f64,
        dt_s: f64,
    ) -> Option<ObjectInput> {
        let normals = objects.iter().map(|input| {
            input.map(|ObjectInput { estimate, age_s }| EstimateInput {
                estimate: normal_at(&estimate, surface, tip),
                age_s,
            })
        });
        let used = self.step(normals, normal, way_m, dt_s)?;
        let mut chosen = objects[self.active()]?;
        chosen.estimate.validity = used.estimate.validity;
        Some(chosen)
    }

    /// Switches to another estimator of the list; `force` waives the checks of validity and
    /// agreement.
    ///
    /// # Errors
    /// The estimator is unknown, silent, invalid, or too far from the normal in use.
    pub fn select(&mut self, name: &EstimatorName, force: bool) -> Result<(), SwitchRefusal> {
        let index = self
            .names
            .iter()
            .position(|known| known == name)
            .ok_or(SwitchRefusal::Unknown)?;
        let (rules, normal) = self.rules_now();
        self.choice
            .select(&rules, &self.estimates, &normal, index, force)
    }

    /// The estimator in use.
    pub fn in_use(&self) -> EstimatorInUse {
        EstimatorInUse {
            name: self
                .names
                .get(self.choice.index)
                .copied()
                .unwrap_or_default(),
            switches: self.choice.switches,
            cause: self.choice.cause,
        }
    }

    /// Names of all estimators, in the order of the task's list.
    pub fn names(&self) -> &[EstimatorName] {
        &self.names
    }

    /// Index of the estimator in use.
    pub fn active(&self) -> usize {
        self.choice.index
    }

    /// The rules and the normal in use. Before there is a normal in use, no angle is limited.
    fn rules_now(&self) -> (ChoiceRules, Vector3<f64>) {
        match self.normal {
            Some(normal) => (self.rules, normal),
            None => {
                let open = ChoiceRules {
                    gate_rad: f64::INFINITY,
                    switch_gate_rad: f64::INFINITY,
                    ..self.rules
                };
                (open, Vector3::z())
            }
        }
    }

    /// The usable estimate `judged`, with the normal as it was given if that is a unit vector: one
    /// estimator alone is then used as if there was no choice.
    fn unchanged(&self, mut judged: EstimateInput) -> EstimateInput {
        if let Some(given) = &self.estimates[self.choice.index] {
            let normal = given.estimate.normal;
            if (normal.norm() - 1.0).abs() < UNIT_ROUNDING {
                judged.estimate.normal = normal;
            }
        }
        judged
    }

    /// The estimate of the active estimator, marked as invalid for `reason`.
    fn withheld(&self, reason: Validity) -> Option<EstimateInput> {
        let mut said = self.estimates[self.choice.index]?;
        if said.estimate.validity.is_valid() {
            said.estimate.validity = reason;
        }
        Some(said)
    }
}

/// Normal of the surface at `tip` (base axes, m) according to an estimate of the object.
fn normal_at(
    estimate: &ObjectEstimate,
    surface: &dyn ImplicitSurface,
    tip: &Vector3<f64>,
) -> NormalEstimate {
    let pose = &estimate.base_from_object;
    NormalEstimate {
        point: *tip,
        normal: pose.rotate(&surface.normal(&pose.inverse().transform_point(tip))),
        covariance: Matrix3::zeros(),
        validity: estimate.validity,
        friction: None,
        curvature: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimator_choice::switching::SwitchCause;
    use crate::parameters::PatienceConfig;
    use crate::task::SwitchingSpec;
    use tangent_mechanics::Pose;

    const DT_S: f64 = 0.001;

    fn name(text: &str) -> EstimatorName {
        EstimatorName::from(text).unwrap()
    }

    fn said(validity: Validity, tilt_rad: f64) -> Option<EstimateInput> {
        let mut estimate = NormalEstimate::invalid(&Pose::identity(), validity);
        estimate.normal = Vector3::new(tilt_rad.sin(), 0.0, tilt_rad.cos());
        Some(EstimateInput {
            estimate,
            age_s: 0.0,
        })
    }

    fn choice(switching: &SwitchingSpec) -> EstimatorList {
        let rules = ChoiceRules::of_torques(&PatienceConfig::default(), switching, true);
        EstimatorList::new(["a", "b", "c"].map(name), rules)
    }

    fn step(
        choice: &mut EstimatorList,
        estimates: [Option<EstimateInput>; 3],
    ) -> Option<EstimateInput> {
        choice.step(estimates, Some(Vector3::z()), 0.0, DT_S)
    }

    fn used(choice: &EstimatorList) -> (EstimatorName, u32, SwitchCause) {
        let used = choice.in_use();
        (used.name, used.switches, used.cause)
    }

    /// Number of cycles until `index` is in use.
    fn cycles_until(
        choice: &mut EstimatorList,
        index: usize,
        estimates: [Option<EstimateInput>; 3],
    ) -> usize {
        for cycle in 0..5000 {
            if choice.active() == index {
                return cycle;
            }
            step(choice, estimates);
        }
        panic!("never {index}");
    }

    #[test]
    fn the_first_comes_back_by_the_tasks_rule_only() {
        let good = said(Validity::Valid, 0.0);
        for (after_s, comes_back) in [(None, false), (Some(0.5), true)] {
            let mut choice = choice(&SwitchingSpec {
                return_after_good_s: after_s,
                ..SwitchingSpec::default()
            });
            step(&mut choice, [None, good, None]);
            assert_eq!(choice.active(), 1);
            if comes_back {
                let cycles = cycles_until(&mut choice, 0, [good, good, None]);
                assert!((500..=502).contains(&cycles), "{cycles}");
                assert_eq!(choice.in_use().cause, SwitchCause::Returned);
            } else {
                for _ in 0..5000 {
                    step(&mut choice, [good, good, None]);
                }
                assert_eq!(choice.active(), 1);
            }
        }
    }

    #[test]
    fn who_is_far_from_the_normal_in_use_is_neither_used_nor_fallen_back_to() {
        let mut choice = choice(&SwitchingSpec::default());
        let (far, near) = (said(Validity::Valid, 1.5), said(Validity::Valid, 0.01));
        let used = step(&mut choice, [far, near, None]).unwrap();
        assert_eq!(used.estimate.validity, Validity::Disagrees);
        assert_eq!(choice.active(), 0);
        let cycles = cycles_until(&mut choice, 1, [far, near, None]);
        // Tolerated for the patience of an estimate, 0.1 s.
        assert!((98..=102).contains(&cycles), "{cycles}");
        // Largest angle for a switch to another estimator: that of the task, otherwise 0.2 rad.
        let half = said(Validity::Valid, 0.3);
        step(&mut choice, [half, None, None]);
        assert_eq!(choice.active(), 1);
        let near = said(Validity::Valid, 0.1);
        step(&mut choice, [near, None, None]);
        assert_eq!(choice.active(), 0);
    }

    #[test]
    fn a_newcomer_must_be_known_fresh_valid_and_near() {
        let mut choice = choice(&SwitchingSpec::default());
        let good = said(Validity::Valid, 0.0);
        step(&mut choice, [good, None, said(Validity::NotSliding, 0.0)]);
        let refused = |choice: &mut EstimatorList, n: &str, force| choice.select(&name(n), force);
        assert_eq!(refused(&mut choice, "x", true), Err(SwitchRefusal::Unknown));
        assert_eq!(refused(&mut choice, "b", true), Err(SwitchRefusal::Silent));
        assert_eq!(
            refused(&mut choice, "c", false),
            Err(SwitchRefusal::Invalid(Validity::NotSliding))
        );
        step(&mut choice, [good, None, said(Validity::Valid, 0.3)]);
        assert!(matches!(
            refused(&mut choice, "c", false),
            Err(SwitchRefusal::Disagrees { .. })
        ));
        assert_eq!(choice.in_use().switches, 0);
        choice.select(&name("c"), true).unwrap();
        assert_eq!(used(&choice), (name("c"), 1, SwitchCause::Forced));
        choice.select(&name("a"), false).unwrap();
        assert_eq!(used(&choice), (name("a"), 2, SwitchCause::Asked));
    }

    #[test]
    fn before_there_is_a_normal_in_use_nobody_is_far_from_it() {
        let mut choice = choice(&SwitchingSpec::default());
        let tilted = said(Validity::Valid, 1.4);
        let used = choice.step([tilted, None, None], None, f64::NAN, f64::NAN);
        assert!(used.unwrap().estimate.validity.is_valid());
    }
}
