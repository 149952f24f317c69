//! The controller: phases, laws and guards composed into one step per robot cycle.

use tangent_mechanics::{Flange, Pose, Tool};

use crate::{
    ControlError, ControlInput, ControlOutput, ControllerConfig, EstimatorName, EstimatorNames,
    Limits, Program,
};

/// One arm's controller. `start` a program, then `step` once per robot packet.
pub struct Controller {
    config: ControllerConfig,
    limits: Limits,
    flange_from_tool: Pose<Flange, Tool>,
    estimators: EstimatorNames,
}

impl Controller {
    /// Stands idle until a program is started. (The arm's model becomes the first argument as soon as it exists.)
    pub fn new(
        flange_from_tool: Pose<Flange, Tool>,
        limits: Limits,
        config: ControllerConfig,
    ) -> Result<Self, ControlError> {
        limits.check()?;
        config.check()?;
        Ok(Self {
            config,
            limits,
            flange_from_tool,
            estimators: EstimatorNames::new(),
        })
    }

    /// Starts a program from idle, done or fault; gives back the one before, to be dropped outside the loop.
    pub fn start(&mut self, program: Program) -> Result<Option<Program>, ControlError> {
        self.estimators = program.estimators.clone();
        self.config = program.config;
        Ok(None)
    }

    /// Stops the path where it is, keeps the force.
    pub fn pause(&mut self) -> Result<(), ControlError> {
        Ok(())
    }

    /// Goes on after [`Controller::pause`].
    pub fn resume(&mut self) -> Result<(), ControlError> {
        Ok(())
    }

    /// Ends the task: retracts, then done. Nothing to do when none runs.
    pub fn stop(&mut self) {}

    /// Switches to another estimator of [`Controller::estimators`], if it is fresh, valid and near the normal in use;
    /// `force` waives the last two.
    pub fn select_estimator(
        &mut self,
        _name: EstimatorName,
        _force: bool,
    ) -> Result<(), ControlError> {
        Ok(())
    }

    /// Sets a live parameter; it comes into force over a ramp.
    pub fn set_parameter(&mut self, _name: &str, _value: f64) -> Result<(), ControlError> {
        Ok(())
    }

    /// Estimators that `ControlInput::estimates` stands for, in this order.
    pub fn estimators(&self) -> &EstimatorNames {
        &self.estimators
    }

    /// Limits in force.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// One robot cycle. Allocates nothing.
    pub fn step(&mut self, input: &ControlInput) -> ControlOutput {
        let _ = (&self.flange_from_tool, &self.config);
        ControlOutput::hold(input)
    }
}
