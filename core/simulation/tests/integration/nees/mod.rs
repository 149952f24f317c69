//! Consistency of every estimator, while one of them is in use: normalised squared error by phase.
#![allow(dead_code)]

use tangent_control::Phase;
use tangent_simulation::metrics::{angle_deg, nees_of_normal};
use tangent_simulation::{AdmittanceScenario, ScenarioError, evaluate_admittance_with};

/// `blend` is in use; the others run in parallel.
pub const ESTIMATORS: [&str; 4] = ["blend", "reactive", "quadratic", "gaussian_process"];

/// Sums over the cycles of one phase.
#[derive(Clone, Copy, Default)]
pub struct Tally {
    nees: f64,
    square_deg: f64,
    variance_deg: f64,
    count: f64,
}

impl Tally {
    pub fn merge(&mut self, other: &Self) {
        self.nees += other.nees;
        self.square_deg += other.square_deg;
        self.variance_deg += other.variance_deg;
        self.count += other.count;
    }

    /// Normalised squared error per degree of freedom; 0 without data.
    pub fn nees(&self) -> f64 {
        self.nees / self.count.max(1.0)
    }

    /// Root mean square of the stated standard deviation per axis, degrees.
    pub fn claim_deg(&self) -> f64 {
        (0.5 * self.variance_deg / self.count.max(1.0)).sqrt()
    }

    /// NEES, and per axis the error and the stated standard deviation, degrees.
    pub fn text(&self) -> String {
        if self.count == 0.0 {
            return "-".to_owned();
        }
        let per_axis = |sum: f64| (0.5 * sum / self.count).sqrt();
        let (error, claim) = (per_axis(self.square_deg), per_axis(self.variance_deg));
        format!("{:.2} ({error:.2}/{claim:.2})", self.nees())
    }
}

/// Sums for one estimator: touchdown, sliding, standing.
#[derive(Clone, Copy, Default)]
pub struct Phases(pub [Tally; 3]);

impl Phases {
    pub fn merge(&mut self, other: &Self) {
        for (sum, part) in self.0.iter_mut().zip(&other.0) {
            sum.merge(part);
        }
    }

    pub fn all(&self) -> Tally {
        let mut sum = Tally::default();
        self.0.iter().for_each(|part| sum.merge(part));
        sum
    }
}

/// Runs a scenario and compares each estimate in contact with the true state of its cycle.
pub fn measure(scenario: &AdmittanceScenario) -> Result<[Phases; 4], ScenarioError> {
    let mut found = [Phases::default(); 4];
    evaluate_admittance_with(scenario, |cycle| {
        let phase = match cycle.output.phase {
            Phase::Contact => 0,
            Phase::Slide => 1,
            Phase::Hold => 2,
            _ => return,
        };
        if !cycle.truth.in_contact {
            return;
        }
        for (phases, estimate) in found.iter_mut().zip(cycle.estimates) {
            let Some(e) = estimate.filter(|e| e.validity.is_valid()) else {
                continue;
            };
            let truth = &cycle.truth.normal;
            if let Some(nees) = nees_of_normal(&e.normal, &e.covariance, truth) {
                phases.0[phase].merge(&Tally {
                    nees,
                    square_deg: angle_deg(&e.normal, truth).powi(2),
                    variance_deg: e.covariance.trace() * 1f64.to_degrees().powi(2),
                    count: 1.0,
                });
            }
        }
    })?;
    Ok(found)
}
