//! Estimators by name, as tasks, cells and the command line speak of them.

use crate::on_moving_base::OnMovingBase;
use crate::{
    Blend, EstimationError, EstimatorConfig, GaussianProcess, GaussianProcessPaper,
    NormalEstimator, Quadratic, QuadraticPaper, Reactive, ReactivePaper,
};

type Maker = fn(&EstimatorConfig) -> Box<dyn NormalEstimator>;

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

/// Names of all estimators, the sound ones first.
pub fn estimator_names() -> [&'static str; MAKERS.len()] {
    MAKERS.map(|(name, _)| name)
}

/// Makes an estimator by name. Its memory stays with the floor when the base moves
/// ([`ContactSample::base`]).
///
/// [`ContactSample::base`]: crate::ContactSample::base
///
/// # Errors
/// [`EstimationError::Unknown`] lists the names there are; [`EstimationError::OutOfRange`] names
/// the setting.
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
