//! The estimators that one service runs, each with its publisher and its live settings.

use std::time::Instant;

use tangent_estimation::{ContactSample, EstimationError, EstimatorConfig, NormalEstimator, build};
use tangent_runtime::health::instance_name;
use tangent_runtime::{AliveToken, Bus, Parameter, Parameters, Publisher};
use tangent_schemas::tangent::{ArmState, NormalEstimate};
use tangent_schemas::topics;

use crate::message::message;
use crate::{EstimatorChoice, EstimatorError};

struct Lane {
    estimator: Box<dyn NormalEstimator>,
    settings: EstimatorConfig,
    publisher: Publisher<NormalEstimate>,
    _alive: AliveToken,
}

pub(crate) struct Host {
    lanes: Vec<Lane>,
    live: Live,
}

/// Settings that can be changed while it runs. They take effect with the next task, so that a
/// change does not jerk the arm.
struct Live {
    force_on_n: Parameter,
    force_bias_sd_n: Parameter,
    compliance_m_per_n: Parameter,
    changed_from: [f64; 3],
}

impl Live {
    fn new(first: &EstimatorConfig, parameters: &Parameters) -> Self {
        let (s, c) = (&first.sensing, &first.contact);
        let number = |name: &str, value: f64, range, unit: &str, what: &str| {
            parameters.number(name, value, range, unit, what)
        };
        let force_on_n = number(
            "force_on_n",
            c.force_on_n,
            c.force_off_n.max(0.01)..=100.0,
            "N",
            "Pressing force above which contact begins. From the next task on.",
        );
        let force_bias_sd_n = number(
            "force_bias_sd_n",
            s.force_bias_sd_n,
            0.0..=10.0,
            "N",
            "Force bias to expect after the tare, one standard deviation. From the next task on.",
        );
        let compliance_m_per_n = number(
            "compliance_m_per_n",
            s.compliance_m_per_n,
            0.0..=0.01,
            "m/N",
            "Compliance of tool, wrist and surface along the normal. From the next task on.",
        );
        let mut live = Self {
            force_on_n,
            force_bias_sd_n,
            compliance_m_per_n,
            changed_from: [0.0; 3],
        };
        live.changed_from = live.values();
        live
    }

    fn values(&self) -> [f64; 3] {
        [
            self.force_on_n.get(),
            self.force_bias_sd_n.get(),
            self.compliance_m_per_n.get(),
        ]
    }

    /// A live setting that was changed applies to every estimator; the others keep their own
    /// values.
    fn apply(&self, settings: &EstimatorConfig) -> EstimatorConfig {
        let mut new = *settings;
        let now = self.values();
        let targets = [
            &mut new.contact.force_on_n,
            &mut new.sensing.force_bias_sd_n,
            &mut new.sensing.compliance_m_per_n,
        ];
        for ((target, value), before) in targets.into_iter().zip(now).zip(self.changed_from) {
            if value != before {
                *target = value;
            }
        }
        new
    }
}

impl Host {
    pub fn new(
        choices: &[EstimatorChoice],
        bus: &Bus,
        parameters: &Parameters,
    ) -> Result<Self, EstimatorError> {
        // With object estimators only, there are no live settings.
        let first = choices.first().map(|c| c.settings).unwrap_or_default();
        let mut lanes: Vec<Lane> = Vec::with_capacity(choices.len());
        for choice in choices {
            let estimator = build(&choice.name, &choice.settings)?;
            if lanes.iter().any(|l| l.estimator.name() == estimator.name()) {
                return Err(EstimatorError::Twice(choice.name.clone()));
            }
            lanes.push(Lane {
                publisher: bus.publisher(&topics::estimate_normal(estimator.name()))?,
                _alive: bus.declare_alive(
                    &topics::estimator_service(estimator.name()),
                    &instance_name(),
                )?,
                estimator,
                settings: choice.settings,
            });
        }
        Ok(Self {
            live: Live::new(&first, parameters),
            lanes,
        })
    }

    /// Resets all estimators, and applies the live settings.
    pub fn reset(&mut self) {
        for lane in &mut self.lanes {
            let wanted = self.live.apply(&lane.settings);
            let made: Result<_, EstimationError> = build(lane.estimator.name(), &wanted);
            match made {
                Ok(estimator) => lane.estimator = estimator,
                Err(why) => {
                    tracing::warn!("{why}; the settings are unchanged");
                    lane.estimator.reset();
                }
            }
        }
    }

    pub fn step(&mut self, sample: &ContactSample, arm: &ArmState) {
        for lane in &mut self.lanes {
            let begin = Instant::now();
            let estimate = lane.estimator.update(sample);
            let update_s = begin.elapsed().as_secs_f64();
            let name = lane.estimator.name();
            lane.publisher
                .publish(&message(name, &estimate, arm, update_s));
        }
    }
}
