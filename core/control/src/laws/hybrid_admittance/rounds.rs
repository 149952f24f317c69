//! Rounds of a task with coverage: the dose is added up, and the path of the next round begins
//! where the path has ended.
//!
//! Called by the controller each cycle.

use super::percept::Percept;
use super::run::Run;
use crate::coverage::Coverage;
use crate::phase_machine::Phase;
use crate::task::path::Path;
use crate::task::program::Program;

impl Run {
    /// Puts the next round in place of a path that has ended, and adds a stroke to one that is
    /// being planned. The tool lifts off first, and waits above the surface for its route.
    pub(super) fn next_round(&mut self, coverage: &mut Coverage, path: &mut Path) {
        if coverage.is_planning() {
            return coverage.plan(path);
        }
        if self.phase != Phase::Slide || self.paused || !self.tracking.is_finished(path) {
            return;
        }
        let from = self
            .tracking
            .in_plane(path, &self.tracking.reference, &self.surface.normal);
        if coverage.end_round(from, path) {
            self.tracking.restart();
        }
    }

    /// Adds the force of a cycle to the dose.
    pub(super) fn record_dose(
        &self,
        program: &Program,
        coverage: &mut Coverage,
        percept: &Percept,
        dt_s: f64,
    ) {
        if let (true, true, Some(force_n)) =
            (self.phase.is_pressing(), self.in_contact, percept.force_n)
        {
            let in_plane =
                self.tracking
                    .in_plane(&program.path, &percept.position, &self.surface.normal);
            let slope = self.tracking.slope(&self.surface.normal);
            coverage.press(&in_plane, &slope, force_n, self.elapsed_s, dt_s);
        }
    }
}
