//! Creates estimators by the names that tasks, cells and the command line use.

use crate::blend::Blend;
use crate::gaussian_process::GaussianProcess;
use crate::gaussian_process_paper::GaussianProcessPaper;
use crate::on_moving_base::OnMovingBase;
use crate::quadratic::Quadratic;
use crate::quadratic_paper::QuadraticPaper;
use crate::reactive::Reactive;
use crate::reactive_paper::ReactivePaper;
use crate::world_estimator::WorldEstimator;
use crate::{EstimationError, EstimatorConfig, NormalEstimator};

type Maker = fn(&EstimatorConfig) -> Box<dyn WorldEstimator>;

const MAKERS: [(&str, Maker); 7] = [
    ("reactive", |c| Box::new(Reactive::new(c))),
    ("quadratic", |c| Box::new(Quadratic::new(c))),
    ("gaussian_process", |c| Box::new(GaussianProcess::new(c))),
    ("blend", |c| Box::new(Blend::new(c))),
    ("reactive_paper", |c| Box::new(ReactivePaper::new(c))),
    ("quadratic_paper", |c| Box::new(QuadraticPaper::new(c))),
    ("gaussian_process_paper", |c| {
        Box::new(GaussianProcessPaper::new(c))
    }),
];

/// Names of all surface-normal estimators. Those of the published forms, `*_paper`, come last.
///
/// ```
/// assert!(tangent_estimation::estimator_names().contains(&"blend"));
/// ```
pub fn estimator_names() -> [&'static str; MAKERS.len()] {
    MAKERS.map(|(name, _)| name)
}

/// Creates a surface-normal estimator by name. Its memory is in world axes, so that it stays valid
/// when the base moves ([`ContactSample::base`](crate::ContactSample::base)).
///
/// # Errors
/// [`EstimationError::Unknown`] lists the known names. [`EstimationError::OutOfRange`] names the
/// setting.
///
/// ```
/// use tangent_estimation::{EstimatorConfig, build};
/// let estimator = build("reactive", &EstimatorConfig::default())?;
/// assert_eq!(estimator.name(), "reactive");
/// # Ok::<(), tangent_estimation::EstimationError>(())
/// ```
pub fn build(
    name: &str,
    config: &EstimatorConfig,
) -> Result<Box<dyn NormalEstimator>, EstimationError> {
    config.check()?;
    let maker = MAKERS.iter().find(|(known, _)| *known == name);
    let (_, make) = maker.ok_or_else(|| EstimationError::Unknown {
        name: name.to_owned(),
        allowed: estimator_names().join(", "),
    })?;
    Ok(Box::new(OnMovingBase::new(make(config))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_builds_an_estimator_of_that_name() {
        for name in estimator_names() {
            assert_eq!(
                build(name, &EstimatorConfig::default()).unwrap().name(),
                name
            );
        }
    }

    #[test]
    fn an_unknown_name_is_answered_with_the_known_ones() {
        let error = build("kalman", &EstimatorConfig::default()).err().unwrap();
        let text = error.to_string();
        assert!(text.contains("\"kalman\"") && text.contains("gaussian_process_paper"));
    }

    #[test]
    fn a_value_out_of_range_is_named() {
        let mut config = EstimatorConfig::default();
        config.gaussian_process.length_m = f64::NAN;
        let error = build("blend", &config).err().unwrap().to_string();
        assert!(error.contains("gaussian_process.length_m"), "{error}");
    }
}
