//! Which estimator's normal is used, when to fall back to the next, and when a switch is refused.

use nalgebra::Vector3;
use tangent_estimation::NormalEstimate;
use tangent_sensing::Validity;

use crate::alignment::angle_between;
use crate::{ControlError, EstimateInput, MAX_ESTIMATORS, NormalConfig, PatienceConfig};

/// Why a switch was refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SwitchRefusal {
    /// No task runs.
    NoTask,
    /// Not among the estimators that the controller listens to.
    Unknown,
    /// Nothing received, or too old.
    Silent,
    /// Says itself that it has no normal now.
    Invalid(Validity),
    /// Too far from the normal in use.
    Disagrees {
        /// Angle between the two, rad.
        angle_rad: f64,
        /// Allowed, rad.
        allowed_rad: f64,
    },
}

impl SwitchRefusal {
    /// The refusal as an error about `name`, in words.
    pub fn error(self, name: &str) -> ControlError {
        let reason = match self {
            Self::NoTask => {
                "no task runs; name it first in the task's `estimators` instead".to_owned()
            }
            Self::Unknown => "nobody publishes it, or the task's list is full".to_owned(),
            Self::Silent => "no fresh estimate from it: is it running?".to_owned(),
            Self::Invalid(validity) => format!(
                "it has no normal now ({}); try while sliding, or with --force",
                validity.reason()
            ),
            Self::Disagrees {
                angle_rad,
                allowed_rad,
            } => format!(
                "its normal is {:.1} deg from the one in use, allowed are {:.1}; --force switches all the same",
                angle_rad.to_degrees(),
                allowed_rad.to_degrees()
            ),
        };
        ControlError::SwitchRefused {
            name: name.to_owned(),
            reason,
        }
    }
}

/// What the choice has to offer this cycle.
#[derive(Clone, Copy, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "lives on the stack for one cycle; a step does not allocate"
)]
pub enum EstimateStatus {
    /// A normal to use.
    Usable(NormalEstimate),
    /// Alive, but without a normal now (standing still, no contact): keep the last one.
    Waiting,
    /// Nobody in the list can be used.
    None(Validity),
}

/// The estimator in use.
#[derive(Clone, Copy, Debug, Default)]
pub struct EstimatorChoice {
    /// Index in the task's list.
    pub index: usize,
    blind_m: f64,
}

type Estimates = [Option<EstimateInput>; MAX_ESTIMATORS];

impl EstimatorChoice {
    /// One cycle, in which the tool slid `way_m`. `normal` is the one in use.
    pub fn step(
        &mut self,
        config: &NormalConfig,
        patience: &PatienceConfig,
        estimates: &Estimates,
        normal: &Vector3<f64>,
        way_m: f64,
    ) -> EstimateStatus {
        match judge(
            estimates[self.index].as_ref(),
            patience,
            config.gate_rad,
            normal,
        ) {
            Ok(estimate) => {
                self.blind_m = 0.0;
                EstimateStatus::Usable(estimate)
            }
            Err(reason) => {
                self.blind_m += way_m;
                let silent = matches!(reason, Validity::Missing | Validity::Stale);
                if !silent && self.blind_m < config.blind_distance_m {
                    return EstimateStatus::Waiting;
                }
                for (index, other) in estimates.iter().enumerate() {
                    if let Ok(estimate) =
                        judge(other.as_ref(), patience, config.switch_gate_rad, normal)
                    {
                        self.index = index;
                        self.blind_m = 0.0;
                        return EstimateStatus::Usable(estimate);
                    }
                }
                // Before the first slide nobody can have a normal; one that is alive will do.
                if silent && self.blind_m < config.blind_distance_m {
                    let alive = |other: &Option<EstimateInput>| {
                        !matches!(
                            judge(other.as_ref(), patience, config.switch_gate_rad, normal),
                            Err(Validity::Missing | Validity::Stale)
                        )
                    };
                    if let Some(index) = estimates.iter().position(alive) {
                        self.index = index;
                        return EstimateStatus::Waiting;
                    }
                }
                EstimateStatus::None(reason)
            }
        }
    }

    /// Switches to `index` if it is fresh, valid and near `normal`; `force` waives the last two.
    pub fn select(
        &mut self,
        config: &NormalConfig,
        patience: &PatienceConfig,
        estimates: &Estimates,
        normal: &Vector3<f64>,
        index: usize,
        force: bool,
    ) -> Result<(), SwitchRefusal> {
        match judge(
            estimates.get(index).and_then(Option::as_ref),
            patience,
            f64::INFINITY,
            normal,
        ) {
            Err(Validity::Missing | Validity::Stale) => return Err(SwitchRefusal::Silent),
            Err(reason) if !force => return Err(SwitchRefusal::Invalid(reason)),
            Ok(estimate) if !force => {
                let angle_rad = angle_between(&estimate.normal, normal);
                if angle_rad > config.switch_gate_rad {
                    return Err(SwitchRefusal::Disagrees {
                        angle_rad,
                        allowed_rad: config.switch_gate_rad,
                    });
                }
            }
            _ => {}
        }
        self.index = index;
        self.blind_m = 0.0;
        Ok(())
    }
}

/// An estimate that can be used, or the reason why not.
fn judge(
    input: Option<&EstimateInput>,
    patience: &PatienceConfig,
    gate_rad: f64,
    normal: &Vector3<f64>,
) -> Result<NormalEstimate, Validity> {
    let input = input.ok_or(Validity::Missing)?;
    if input.age_s.is_nan() || input.age_s > patience.estimate_s {
        return Err(Validity::Stale);
    }
    let estimate = &input.estimate;
    if !estimate.validity.is_valid() {
        return Err(estimate.validity);
    }
    let norm = estimate.normal.norm();
    if norm.is_nan() || (norm - 1.0).abs() >= 1e-3 {
        return Err(Validity::NotFinite);
    }
    let mut estimate = *estimate;
    estimate.normal /= norm;
    if let Some(curvature) = estimate.curvature
        && !curvature.iter().all(|x| x.is_finite())
    {
        estimate.curvature = None;
    }
    if angle_between(&estimate.normal, normal) > gate_rad {
        return Err(Validity::Disagrees);
    }
    Ok(estimate)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tangent_mechanics::Pose;

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
        choice.step(
            &NormalConfig::default(),
            &PatienceConfig::default(),
            &list(entries),
            &Vector3::z(),
            way,
        )
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
        let mut select = |index, force| {
            choice.select(
                &NormalConfig::default(),
                &PatienceConfig::default(),
                &entries,
                &Vector3::z(),
                index,
                force,
            )
        };
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
        assert_eq!(choice.index, 3);
    }
}
