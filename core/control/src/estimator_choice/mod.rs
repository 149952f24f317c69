//! Chooses the estimator in use, falls back to the next one, and refuses switches.

pub mod list;
pub mod switching;

use nalgebra::Vector3;
use tangent_sensing::Validity;

use crate::contact::alignment::angle_between;
use crate::estimator_choice::switching::{ChoiceRules, SwitchCause, SwitchRefusal};
use crate::inputs::{EstimateInput, MAX_ESTIMATORS};

/// Result of the choice in this cycle.
#[derive(Clone, Copy, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "lives on the stack for one cycle; a step does not allocate"
)]
pub enum EstimateStatus {
    /// A normal to use, and its age.
    Usable(EstimateInput),
    /// The estimator publishes, but has no normal now (standing still, no contact, a single
    /// outlier): keep the last one.
    Waiting,
    /// No estimator of the list can be used.
    None(Validity),
}

/// The estimator in use.
#[derive(Clone, Copy, Debug, Default)]
pub struct EstimatorChoice {
    /// Index in the task's list.
    pub index: usize,
    /// Cause of the last change.
    pub cause: SwitchCause,
    /// Number of changes since the task started.
    pub switches: u32,
    /// Index of the preferred estimator: the task's first, or the one requested.
    preferred: usize,
    blind_m: f64,
    nonsense_s: f64,
    preferred_good_s: f64,
}

type Estimates = [Option<EstimateInput>; MAX_ESTIMATORS];

impl EstimatorChoice {
    /// Processes one cycle of `dt_s`, s, in which the tool slid `way_m`, m. `normal` is the one in
    /// use.
    pub fn step(
        &mut self,
        rules: &ChoiceRules,
        estimates: &Estimates,
        normal: &Vector3<f64>,
        way_m: f64,
        dt_s: f64,
    ) -> EstimateStatus {
        self.return_when_good(rules, estimates, normal, dt_s);
        let active = estimates[self.index].as_ref();
        let reason = match judge(active, rules.patience_s, rules.gate_rad, normal) {
            Ok(estimate) => {
                self.blind_m = 0.0;
                self.nonsense_s = 0.0;
                return EstimateStatus::Usable(estimate);
            }
            Err(reason) => reason,
        };
        self.blind_m += way_m;
        let gone = match reason {
            // The timeout is already included in their age.
            Validity::Missing | Validity::Stale => true,
            // A single outlier does not cause a switch; invalid estimates that persist do.
            Validity::NotFinite | Validity::Disagrees => self.bear(rules, dt_s),
            _ => !rules.felt_by_sliding && self.bear(rules, dt_s),
        };
        if !gone && self.blind_m < rules.blind_distance_m {
            return EstimateStatus::Waiting;
        }
        for (index, other) in estimates.iter().enumerate() {
            let judged = judge(
                other.as_ref(),
                rules.patience_s,
                rules.switch_gate_rad,
                normal,
            );
            if let Ok(estimate) = judged
                && index != self.index
            {
                self.switch(index, SwitchCause::FellBack(reason));
                return EstimateStatus::Usable(estimate);
            }
        }
        // Before the first slide no estimator has a normal; one that publishes is enough.
        if gone && self.blind_m < rules.blind_distance_m {
            let alive = |other: &Option<EstimateInput>| {
                matches!(
                    judge(other.as_ref(), rules.patience_s, f64::INFINITY, normal),
                    Err(Validity::NoContact | Validity::NotSliding | Validity::Degenerate)
                )
            };
            if let Some(index) = estimates.iter().position(alive) {
                let blind_m = self.blind_m;
                self.switch(index, SwitchCause::FellBack(reason));
                self.blind_m = blind_m;
                return EstimateStatus::Waiting;
            }
        }
        EstimateStatus::None(reason)
    }

    /// Counts another cycle of invalid estimates; true once they have lasted longer than the
    /// timeout.
    fn bear(&mut self, rules: &ChoiceRules, dt_s: f64) -> bool {
        self.nonsense_s += dt_s;
        self.nonsense_s > rules.patience_s
    }

    /// Returns to the preferred estimator by the task's rule.
    fn return_when_good(
        &mut self,
        rules: &ChoiceRules,
        estimates: &Estimates,
        normal: &Vector3<f64>,
        dt_s: f64,
    ) {
        let Some(after_s) = rules.return_after_good_s else {
            return;
        };
        let preferred = estimates[self.preferred].as_ref();
        let gate_rad = rules.switch_gate_rad;
        if self.index == self.preferred
            || judge(preferred, rules.patience_s, gate_rad, normal).is_err()
        {
            self.preferred_good_s = 0.0;
            return;
        }
        self.preferred_good_s += dt_s;
        if self.preferred_good_s >= after_s {
            self.switch(self.preferred, SwitchCause::Returned);
        }
    }

    fn switch(&mut self, index: usize, cause: SwitchCause) {
        if index != self.index {
            self.switches = self.switches.saturating_add(1);
        }
        self.index = index;
        self.cause = cause;
        self.blind_m = 0.0;
        self.nonsense_s = 0.0;
        self.preferred_good_s = 0.0;
    }

    /// Switches to `index` if it is fresh, valid and near `normal`; `force` waives the last two
    /// conditions.
    pub fn select(
        &mut self,
        rules: &ChoiceRules,
        estimates: &Estimates,
        normal: &Vector3<f64>,
        index: usize,
        force: bool,
    ) -> Result<(), SwitchRefusal> {
        let candidate = estimates.get(index).and_then(Option::as_ref);
        match judge(candidate, rules.patience_s, f64::INFINITY, normal) {
            Err(Validity::Missing | Validity::Stale) => return Err(SwitchRefusal::Silent),
            Err(reason) if !force => return Err(SwitchRefusal::Invalid(reason)),
            Ok(candidate) if !force => {
                let angle_rad = angle_between(&candidate.estimate.normal, normal);
                if angle_rad > rules.switch_gate_rad {
                    return Err(SwitchRefusal::Disagrees {
                        angle_rad,
                        allowed_rad: rules.switch_gate_rad,
                    });
                }
            }
            _ => {}
        }
        let cause = if force {
            SwitchCause::Forced
        } else {
            SwitchCause::Asked
        };
        self.switch(index, cause);
        self.preferred = index;
        Ok(())
    }
}

/// A usable estimate, or the reason why it cannot be used.
fn judge(
    input: Option<&EstimateInput>,
    patience_s: f64,
    gate_rad: f64,
    normal: &Vector3<f64>,
) -> Result<EstimateInput, Validity> {
    let input = input.ok_or(Validity::Missing)?;
    if input.age_s.is_nan() || input.age_s > patience_s {
        return Err(Validity::Stale);
    }
    let mut estimate = input.estimate;
    if !estimate.validity.is_valid() {
        return Err(estimate.validity);
    }
    let norm = estimate.normal.norm();
    if norm.is_nan() || (norm - 1.0).abs() >= 1e-3 {
        return Err(Validity::NotFinite);
    }
    if !estimate.covariance.iter().all(|x| x.is_finite()) {
        return Err(Validity::NotFinite);
    }
    estimate.normal /= norm;
    if let Some(curvature) = estimate.curvature
        && !curvature.iter().all(|x| x.is_finite())
    {
        estimate.curvature = None;
    }
    if angle_between(&estimate.normal, normal) > gate_rad {
        return Err(Validity::Disagrees);
    }
    Ok(EstimateInput { estimate, ..*input })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::laws::hybrid_admittance::NormalConfig;
    use crate::parameters::PatienceConfig;
    use crate::task::SwitchingSpec;
    use tangent_estimation::NormalEstimate;
    use tangent_mechanics::Pose;

    const DT_S: f64 = 0.008;

    fn rules(return_after_good_s: Option<f64>) -> ChoiceRules {
        let switching = SwitchingSpec {
            return_after_good_s,
            ..SwitchingSpec::default()
        };
        ChoiceRules::new(
            &NormalConfig::default(),
            &PatienceConfig::default(),
            &switching,
        )
    }

    fn input(validity: Validity, age_s: f64, tilt_deg: f64) -> Option<EstimateInput> {
        let mut estimate = NormalEstimate::invalid(&Pose::identity(), validity);
        let tilt = tilt_deg.to_radians();
        estimate.normal = Vector3::new(tilt.sin(), 0.0, tilt.cos());
        Some(EstimateInput { estimate, age_s })
    }

    fn list(entries: &[Option<EstimateInput>]) -> Estimates {
        let mut all = [None; MAX_ESTIMATORS];
        all[..entries.len()].copy_from_slice(entries);
        all
    }

    fn step(
        choice: &mut EstimatorChoice,
        entries: &[Option<EstimateInput>],
        way: f64,
    ) -> EstimateStatus {
        choice.step(&rules(None), &list(entries), &Vector3::z(), way, DT_S)
    }

    #[test]
    fn silence_falls_back_to_the_next_that_agrees() {
        let mut choice = EstimatorChoice::default();
        let entries = [
            input(Validity::Valid, 0.2, 0.0),
            input(Validity::Valid, 0.0, 40.0),
            input(Validity::Valid, 0.0, 5.0),
        ];
        assert!(matches!(
            step(&mut choice, &entries, 0.0),
            EstimateStatus::Usable(_)
        ));
        assert_eq!(choice.index, 2);
        assert_eq!(choice.cause, SwitchCause::FellBack(Validity::Stale));
        assert_eq!(choice.switches, 1);
    }

    fn invalid_estimates() -> [Option<EstimateInput>; 4] {
        let mut bad = [input(Validity::Valid, 0.0, 0.0).unwrap(); 4];
        bad[0].estimate.normal.y = f64::NAN;
        bad[1].estimate.covariance[(1, 1)] = f64::INFINITY;
        bad[2].estimate.normal *= 3.0;
        bad[3].estimate.normal = -Vector3::z();
        bad.map(Some)
    }

    #[test]
    fn nonsense_is_borne_for_the_patience_and_then_the_next_takes_over() {
        let patience_s = PatienceConfig::default().estimate_s;
        for bad in invalid_estimates() {
            let mut choice = EstimatorChoice::default();
            let entries = [bad, input(Validity::Valid, 0.0, 1.0)];
            let mut borne_s = 0.0;
            while matches!(step(&mut choice, &entries, 1e-4), EstimateStatus::Waiting) {
                borne_s += DT_S;
            }
            assert_eq!(choice.index, 1);
            assert!((borne_s - patience_s).abs() < 1.5 * DT_S, "{borne_s}");
        }
    }

    #[test]
    fn one_outlier_changes_nothing() {
        let mut choice = EstimatorChoice::default();
        for turn in 0..1000 {
            let first = if turn % 4 == 0 {
                invalid_estimates()[turn / 4 % 4]
            } else {
                input(Validity::Valid, 0.0, 0.0)
            };
            step(
                &mut choice,
                &[first, input(Validity::Valid, 0.0, 0.0)],
                1e-4,
            );
        }
        assert_eq!((choice.index, choice.switches), (0, 0));
    }

    #[test]
    fn the_first_comes_back_by_the_tasks_rule_only() {
        let gone = [None, input(Validity::Valid, 0.0, 0.0)];
        let back = [input(Validity::Valid, 0.0, 1.0), gone[1]];
        let far = [input(Validity::Valid, 0.0, 30.0), gone[1]];
        let run = |after: Option<f64>, entries: &[Option<EstimateInput>], cycles: usize| {
            let mut choice = EstimatorChoice::default();
            step(&mut choice, &gone, 0.0);
            for _ in 0..cycles {
                choice.step(&rules(after), &list(entries), &Vector3::z(), 0.0, DT_S);
            }
            (choice.index, choice.cause)
        };
        let fell = SwitchCause::FellBack(Validity::Missing);
        assert_eq!(run(None, &back, 10_000), (1, fell));
        assert_eq!(run(Some(0.8), &back, 98), (1, fell));
        assert_eq!(run(Some(0.8), &back, 101), (0, SwitchCause::Returned));
        assert_eq!(run(Some(0.8), &far, 10_000), (1, fell));
    }

    #[test]
    fn the_task_sets_how_far_a_newcomer_may_be() {
        let rules = ChoiceRules::new(
            &NormalConfig::default(),
            &PatienceConfig::default(),
            &SwitchingSpec {
                disagreement_max_rad: Some(5f64.to_radians()),
                ..SwitchingSpec::default()
            },
        );
        let entries = list(&[
            input(Validity::Valid, 0.0, 0.0),
            input(Validity::Valid, 0.0, 6.0),
        ]);
        let mut choice = EstimatorChoice::default();
        let refused = choice.select(&rules, &entries, &Vector3::z(), 1, false);
        assert!(matches!(refused, Err(SwitchRefusal::Disagrees { .. })));
        assert_eq!(choice.switches, 0);
    }

    #[test]
    fn nobody_left_is_said_with_the_reason() {
        let mut choice = EstimatorChoice::default();
        assert!(matches!(
            step(&mut choice, &[input(Validity::Valid, 0.2, 0.0)], 0.0),
            EstimateStatus::None(Validity::Stale)
        ));
        assert!(matches!(
            step(&mut choice, &[], 0.0),
            EstimateStatus::None(Validity::Missing)
        ));
    }

    #[test]
    fn standing_still_is_no_fault_but_sliding_blind_is() {
        let mut choice = EstimatorChoice::default();
        let entries = [input(Validity::NotSliding, 0.0, 0.0)];
        for _ in 0..10_000 {
            assert!(matches!(
                step(&mut choice, &entries, 0.0),
                EstimateStatus::Waiting
            ));
        }
        let mut way = 0.0;
        while matches!(step(&mut choice, &entries, 0.001), EstimateStatus::Waiting) {
            way += 0.001;
        }
        assert!((way - NormalConfig::default().blind_distance_m).abs() < 0.002);
    }

    #[test]
    fn one_that_is_not_felt_by_sliding_is_given_up_after_the_patience() {
        let rules = ChoiceRules {
            felt_by_sliding: false,
            ..rules(None)
        };
        let mut choice = EstimatorChoice::default();
        let entries = list(&[
            input(Validity::Degenerate, 0.0, 0.0),
            input(Validity::Valid, 0.0, 1.0),
        ]);
        let mut borne_s = 0.0;
        while choice.index == 0 {
            choice.step(&rules, &entries, &Vector3::z(), 0.0, DT_S);
            borne_s += DT_S;
            assert!(borne_s < 1.0);
        }
        assert!((borne_s - rules.patience_s).abs() < 1.5 * DT_S, "{borne_s}");
        assert_eq!(choice.cause, SwitchCause::FellBack(Validity::Degenerate));
    }

    #[test]
    fn a_normal_that_is_no_unit_vector_is_never_used() {
        let mut choice = EstimatorChoice::default();
        let mut bad = input(Validity::Valid, 0.0, 0.0).unwrap();
        for normal in [
            Vector3::zeros(),
            Vector3::new(f64::NAN, 0.0, 1.0),
            Vector3::z() * 2.0,
        ] {
            bad.estimate.normal = normal;
            assert!(matches!(
                step(&mut choice, &[Some(bad)], 0.1),
                EstimateStatus::None(_)
            ));
        }
    }

    #[test]
    fn a_switch_is_gated() {
        let entries = list(&[
            input(Validity::Valid, 0.0, 0.0),
            input(Validity::Valid, 0.5, 0.0),
            input(Validity::NoContact, 0.0, 0.0),
            input(Validity::Valid, 0.0, 30.0),
            input(Validity::Valid, 0.0, 10.0),
        ]);
        let mut choice = EstimatorChoice::default();
        let mut select =
            |index, force| choice.select(&rules(None), &entries, &Vector3::z(), index, force);
        assert_eq!(select(7, true), Err(SwitchRefusal::Silent));
        assert_eq!(select(1, true), Err(SwitchRefusal::Silent));
        assert_eq!(
            select(2, false),
            Err(SwitchRefusal::Invalid(Validity::NoContact))
        );
        assert!(matches!(
            select(3, false),
            Err(SwitchRefusal::Disagrees { .. })
        ));
        assert_eq!(select(4, false), Ok(()));
        assert_eq!(select(3, true), Ok(()));
        assert_eq!((choice.index, choice.cause), (3, SwitchCause::Forced));
        assert_eq!(choice.switches, 2);
    }
}
