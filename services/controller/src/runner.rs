//! What the loop runs: a law, the inputs it reads, and its live parameters.

use tangent_control::{Clearance, ControlError, EstimatorName, Law, Parameter, Phase, Program};
use tangent_control::{LawConfig, LawInput, LawOutput, Start, SwitchRefusal};
use tangent_runtime::Parameter as LiveParameter;

use crate::inputs::{EstimateReader, Inputs, Packet, Readers};

/// A task made ready outside the loop, with the readers of its estimators.
pub struct Prepared<C> {
    /// The program; after a start, the previous one.
    pub program: Option<Program<C>>,
    /// Readers that replace those of the previous task; `None` if the loop keeps its own.
    pub readers: Option<Readers>,
}

/// Live parameters of a law, each with the value last seen.
pub struct Live(Vec<(Parameter, LiveParameter, f64)>);

impl Live {
    /// Live parameters with their current values.
    pub fn new(parameters: impl IntoIterator<Item = (Parameter, LiveParameter)>) -> Self {
        let with_value = |(parameter, live): (Parameter, LiveParameter)| {
            let value = live.get();
            (parameter, live, value)
        };
        Self(parameters.into_iter().map(with_value).collect())
    }
}

/// A law with its inputs, called by the loop in each cycle. Nothing in it locks or allocates.
pub struct Runner<L, const N: usize> {
    /// The law.
    pub law: L,
    /// Its inputs.
    pub inputs: Inputs,
    /// Its live parameters.
    pub live: Live,
}

impl<C: LawConfig, L: Law<N, Config = C>, const N: usize> Runner<L, N> {
    /// Phase after the last step.
    pub fn phase(&self) -> Phase {
        self.law.phase()
    }

    /// Number of task starts.
    pub fn activation(&self) -> u64 {
        self.law.activation()
    }

    /// Whether the tool may touch something.
    pub fn clearance(&self) -> Clearance {
        self.law.clearance()
    }

    /// Starts a task. What is left in `prepared` is dropped outside the loop. Called only while no
    /// task is active.
    ///
    /// # Errors
    /// The task may not start here. Nothing has changed then.
    pub fn start(
        &mut self,
        prepared: &mut Option<Prepared<C>>,
        start: &Start,
    ) -> Result<(), ControlError> {
        let Some(task) = prepared else {
            return Ok(());
        };
        self.law.start(&mut task.program, start)?;
        if let Some(readers) = &mut task.readers {
            self.inputs.swap(readers);
        }
        for (parameter, live, seen) in &mut self.live.0 {
            *seen = self.law.get(*parameter);
            live.set(*seen);
        }
        Ok(())
    }

    /// Switches to another estimator.
    ///
    /// # Errors
    /// The estimator cannot be used now.
    pub fn select(&mut self, name: &EstimatorName, force: bool) -> Result<(), SwitchRefusal> {
        self.law.select(name, force)
    }

    /// Also reads this estimator; returns a reader that is not needed.
    pub fn listen(&mut self, reader: EstimateReader) -> Option<EstimateReader> {
        self.inputs.listen(reader)
    }

    /// Takes the live parameters that were set since the last cycle. The law moves to a new value
    /// on a ramp.
    pub fn take_parameters(&mut self) {
        for (parameter, live, seen) in &mut self.live.0 {
            let value = live.get();
            if value != *seen {
                *seen = value;
                self.law.set(*parameter, value);
            }
        }
    }

    /// Runs the law for one packet; `None` if the arm's state is not usable. The arm then comes to
    /// rest by itself.
    pub fn step(&mut self, packet: &Packet<'_>) -> Option<(LawInput<N>, LawOutput<N>)> {
        let input = self.inputs.gather(packet, self.law.estimators())?;
        let output = self.law.step(&input);
        Some((input, output))
    }
}
