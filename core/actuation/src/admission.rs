//! Admission of commands, by their age and order, their kind, and the task to which they belong.
//!
//! Shared by all gates. A gate passes each command with a function that checks its values, and
//! receives the target to be followed in this cycle, if any.

use tangent_schemas::CommandKind;

use crate::command::Command;
use crate::refusal::Refusal;

/// Limits on the delay of a command and on silence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdmissionRules {
    /// Kind of command that moves this arm.
    pub moves: CommandKind,
    /// Number of cycles without a valid command for which the last one is followed; an older
    /// command is refused.
    pub patience_cycles: u32,
    /// Time without commands after which the activation is latched out, s.
    pub silence_latch_s: f64,
    /// Whether a refused command that is more than a repeated answer ends the current task; if not,
    /// the next valid command continues it.
    pub refusal_ends_task: bool,
}

/// Effect of a command in the cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Heard {
    /// Whether the robot itself must stop.
    pub soft_stop: bool,
    /// Whether the command was wrong: nothing is followed in this cycle.
    pub bad: bool,
}

/// Admission of commands, with its state. `T` is the target that a command requests.
///
/// ```
/// use tangent_actuation::admission::{Admission, AdmissionRules};
/// use tangent_actuation::Command;
/// use tangent_schemas::CommandKind;
///
/// let mut admission = Admission::new(AdmissionRules {
///     moves: CommandKind::JointTorque,
///     patience_cycles: 2,
///     silence_latch_s: 0.1,
///     refusal_ends_task: false,
/// });
/// let command = Command {
///     cycle: 1,
///     kind: CommandKind::JointTorque.number(),
///     values: &[3.0],
///     acceleration: 0.0,
///     activation: 1,
/// };
/// let heard = admission.begin(1, true, Some(&command), |command| Ok(command.values[0]));
/// assert_eq!(admission.followed(heard), Some(3.0));
/// // Without a command it is followed for two more cycles.
/// for (cycle, followed) in [(2, Some(3.0)), (3, Some(3.0)), (4, None)] {
///     let heard = admission.begin(cycle, true, None, |_| Ok(0.0));
///     assert_eq!(admission.followed(heard), followed);
/// }
/// ```
#[derive(Clone, Debug)]
pub struct Admission<T> {
    rules: AdmissionRules,
    target: Option<T>,
    silent_cycles: u32,
    cycle_stepped: u64,
    cycle_accepted: u64,
    activation_seen: u64,
    activation_latched: u64,
    refused: u64,
    refusal: Option<Refusal>,
    missed: u64,
}

impl<T: Copy> Admission<T> {
    /// State before the first command.
    pub fn new(rules: AdmissionRules) -> Self {
        Self {
            rules,
            target: None,
            silent_cycles: 0,
            cycle_stepped: 0,
            cycle_accepted: 0,
            activation_seen: 0,
            activation_latched: 0,
            refused: 0,
            refusal: None,
            missed: 0,
        }
    }

    /// Begins cycle `cycle` with the command that arrived in it, if any. `may_move`: the arm
    /// follows commands now. `target` returns the target of a command that moves the arm, or the
    /// reason why its values are refused.
    pub fn begin(
        &mut self,
        cycle: u64,
        may_move: bool,
        arrived: Option<&Command<'_>>,
        target: impl FnOnce(&Command<'_>) -> Result<T, Refusal>,
    ) -> Heard {
        let mut heard = Heard::default();
        self.silent_cycles = self.silent_cycles.saturating_add(1);
        if let Some(command) = arrived {
            self.activation_seen = self.activation_seen.max(command.activation);
            if !may_move {
                self.latch();
            }
            match self.accept(cycle, command, target) {
                Ok(kind) => {
                    heard.soft_stop = kind == CommandKind::SoftStop;
                    self.silent_cycles = 0;
                }
                Err(refusal) => {
                    heard.bad = refusal.is_bad();
                    self.refused += 1;
                    self.refusal = Some(refusal);
                    // During silence the arm is already coming to rest.
                    let follows =
                        self.target.is_some() && self.silent_cycles <= self.rules.patience_cycles;
                    let repeats = matches!(refusal, Refusal::Duplicate { .. });
                    if self.rules.refusal_ends_task && follows && !repeats {
                        self.latch();
                    }
                }
            }
        }
        if !may_move || heard.soft_stop {
            self.latch();
        }
        heard
    }

    /// Counts the cycle as missed if a command was due and none arrived. The same `cycle` again is
    /// a heartbeat, sent because the robot's packet is late, and not counted.
    pub fn count_missed(&mut self, cycle: u64) {
        if self.target.is_some() && cycle > self.cycle_stepped && self.silent_cycles > 0 {
            self.missed += 1;
        }
        self.cycle_stepped = self.cycle_stepped.max(cycle);
    }

    /// Latches the activation out after too long a silence; one cycle takes `period_s`, s.
    pub fn latch_after_silence(&mut self, period_s: f64) {
        let silent_s = f64::from(self.silent_cycles) * period_s;
        if self.target.is_some() && silent_s > self.rules.silence_latch_s {
            self.latch();
        }
    }

    /// Target to be followed in this cycle.
    pub fn followed(&self, heard: Heard) -> Option<T> {
        self.target
            .filter(|_| !heard.bad && self.silent_cycles <= self.rules.patience_cycles)
    }

    /// Refuses the present activation, and all older ones, from now on.
    pub fn latch(&mut self) {
        self.activation_latched = self.activation_latched.max(self.activation_seen);
        self.target = None;
    }

    /// Changes the source of the commands. The new source's current `activation` and all older ones
    /// are refused.
    pub fn change_hands(&mut self, activation: u64) {
        self.activation_seen = self.activation_seen.max(activation);
        self.latch();
    }

    /// Whether there is a command that may be followed.
    pub fn is_commanded(&self) -> bool {
        self.target.is_some()
    }

    /// Cycle of the last command accepted.
    pub fn cycle_accepted(&self) -> u64 {
        self.cycle_accepted
    }

    /// Newest activation that is refused.
    pub fn activation_latched(&self) -> u64 {
        self.activation_latched
    }

    /// Commands refused since the start.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// Reason of the last refusal.
    pub fn refusal(&self) -> Option<&Refusal> {
        self.refusal.as_ref()
    }

    /// Number of the robot's packets for which a command was due and no valid one arrived. A late
    /// packet of the robot is not counted.
    pub fn missed(&self) -> u64 {
        self.missed
    }

    fn accept(
        &mut self,
        cycle: u64,
        command: &Command<'_>,
        target: impl FnOnce(&Command<'_>) -> Result<T, Refusal>,
    ) -> Result<CommandKind, Refusal> {
        let Some(age) = cycle.checked_sub(command.cycle) else {
            return Err(Refusal::Future {
                cycle: command.cycle,
            });
        };
        if age > u64::from(self.rules.patience_cycles) {
            return Err(Refusal::Old { age });
        }
        if command.cycle <= self.cycle_accepted {
            return Err(Refusal::Duplicate {
                cycle: command.cycle,
            });
        }
        let moves = self.rules.moves;
        let (kind, target) = match CommandKind::from_number(command.kind) {
            Some(kind @ (CommandKind::Hold | CommandKind::SoftStop)) => (kind, None),
            Some(kind) if kind == moves => (kind, Some(target(command)?)),
            _ => {
                return Err(Refusal::Kind {
                    kind: command.kind,
                    moves,
                });
            }
        };
        if target.is_some() && command.activation <= self.activation_latched {
            return Err(Refusal::Latched {
                activation: command.activation,
                latched: self.activation_latched,
            });
        }
        self.cycle_accepted = command.cycle;
        self.target = target;
        Ok(kind)
    }
}
