//! Detects a wrench that does not respond to the tool's motion, independent of the sensor's own
//! status.
//!
//! Every law calls it each cycle beside the wrench guard, before it uses the wrench. Three
//! observations rule out a working sensor: the tool goes deeper or comes out while the reading does
//! not change (`standstill`); the tool goes deeper while the reading's mean does not rise
//! (`answer`: a dead sensor that still produces noise); the tool leaves the surface while the
//! pressing force remains. A dead sensor, and a surface that recedes no more steeply than the
//! possible error of the normal, both need more motion at the same force: only a lower reference
//! tells them apart (`reference_probe`).

use nalgebra::Vector3;
use tangent_sensing::Validity;

use crate::contact::alignment::depth_and_across;
use crate::limits::answer::{Answer, Pressed};
use crate::limits::direction::{Aimed, Direction};
use crate::limits::falling_away::{FallingAway, Felt};
use crate::limits::lateness::Lateness;
use crate::limits::reference_probe::{Held, ReferenceProbe};
use crate::limits::standstill::{Judgement, Standstill, UNFELT_N, WAY_M};
use crate::limits::touch::{Doing, Touch};

/// Stiffness of the softest surface that releases its force over the distance of a retraction, N/m.
const SOFTEST_N_PER_M: f64 = 1000.0;
/// Share of the pressing force that may remain after the tool has covered its indentation and
/// [`WAY_M`] more.
const LEFT_SHARE: f64 = 0.8;
/// Share of the reference below which a force is no contact: the loss of contact is handled
/// elsewhere.
const PRESSED_SHARE: f64 = 0.1;
/// Share of the reference from which the mean is compared with the depth: a sensor may die at the
/// first touch.
const TOUCHED_SHARE: f64 = 0.02;
/// Share of the reference from which a tool that gives way presses as it should.
const HELD_SHARE: f64 = 0.5;

/// State of the guard for one task. A new one is the reset.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ResponseGuard {
    still: Option<Standstill>,
    answer: Option<Answer>,
    lateness: Option<Lateness>,
    probe: Option<ReferenceProbe>,
    /// Whether the reading does not follow the reference.
    missed: bool,
    /// Whether the reading must be proved, because it changes too little.
    doubted: bool,
    direction: Option<Direction>,
    /// Stiffness measured in the last contact, N/m.
    stiffness_n_per_m: Option<f64>,
    /// Time since the last fresh reading, s.
    since_s: f64,
    /// Pressing force, N, and position, m, when the tool began to leave.
    left: Option<(f64, Vector3<f64>)>,
    last: Option<Vector3<f64>>,
    tripped: Option<Validity>,
    fall: FallingAway,
}

impl ResponseGuard {
    /// Processes one cycle. Once the reading has failed to respond, or has pointed where no contact
    /// can press, returns that fault for the rest of the task.
    pub fn step(&mut self, touch: &Touch) -> Validity {
        self.since_s += touch.dt_s;
        let sound = touch.fresh
            && touch.wrench.iter().all(|x| x.is_finite())
            && touch.position.iter().all(|x| x.is_finite());
        if sound {
            let step = touch.position - self.last.replace(touch.position).unwrap_or(touch.position);
            let touch = &Touch {
                dt_s: std::mem::take(&mut self.since_s),
                ..*touch
            };
            let presses_less = self.fall.presses_less(&Felt {
                pressing: touch.doing == Doing::Pressing,
                force_n: touch.force_n,
                whole_n: touch.wrench.fixed_rows::<3>(0).norm(),
                reference_n: touch.reference_n,
                step,
                normal: touch.normal,
                dt_s: touch.dt_s,
            });
            let dead = self.stands_still(touch, &step)
                | self.does_not_follow(touch, &step)
                | self.is_late(touch, &step)
                | self.stays_while_leaving(touch);
            let aside = self.points_aside(touch, &step);
            let found = match (dead, aside) {
                _ if std::mem::take(&mut self.missed) => Some(Validity::Unresponsive),
                // The tool moved in, and what was pressed is no longer there: the surface's doing.
                _ if presses_less && touch.depth.is_some() => {
                    if self.fall.looks_again(dead || aside, touch.dt_s) {
                        (self.still, self.direction) = (None, None);
                        self.end_answer();
                    }
                    None
                }
                (true, _) => Some(Validity::Unresponsive),
                (_, true) => Some(Validity::Misdirected),
                _ => None,
            };
            self.tripped = self.tripped.or(found);
        }
        self.tripped.unwrap_or(Validity::Valid)
    }

    /// Whether the surface may end here, or be steeper than the normal in use says: the path should
    /// stand until the force is back.
    pub fn doubts_surface(&self) -> bool {
        self.fall.is_doubted() || self.probe.is_some_and(|probe| probe.stands())
    }

    /// Share of the reference that the law should hold: less where only a lower reference tells a
    /// live reading from a dead one.
    pub fn reference_share(&self) -> f64 {
        self.probe.map_or(1.0, |probe| probe.share())
    }

    /// Whether the surface ends or falls away here.
    pub fn has_fallen_away(&self) -> bool {
        self.fall.has_ended()
    }

    /// Ends the comparison of force and depth, and keeps the stiffness that it has shown.
    fn end_answer(&mut self) {
        self.probe = None;
        if let Some(answer) = self.answer.take() {
            self.stiffness_n_per_m = answer.stiffness_n_per_m().or(self.stiffness_n_per_m);
        }
    }

    /// Whether the force points where no contact can press.
    pub fn is_misdirected(&self) -> bool {
        self.tripped == Some(Validity::Misdirected)
    }

    /// Records that the force points where no contact can press, found by another observation.
    pub fn misdirected(&mut self) {
        self.tripped = self.tripped.or(Some(Validity::Misdirected));
    }

    /// Whether the tool goes deeper or comes out while the reading stays constant.
    fn stands_still(&mut self, touch: &Touch, step: &Vector3<f64>) -> bool {
        if !touch.presses(PRESSED_SHARE) {
            self.still = None;
            return false;
        }
        let Some(still) = &mut self.still else {
            self.still = Some(Standstill::at(touch));
            return false;
        };
        match still.judge(touch, step) {
            Judgement::Changes => false,
            Judgement::Stands => true,
            Judgement::Doubtful => {
                self.doubted = true;
                self.still = None;
                false
            }
        }
    }

    /// Whether the tool goes deeper while the mean of the noisy reading does not rise. Where the
    /// reference may be lowered, and does not still build up, that is only a doubt.
    fn does_not_follow(&mut self, touch: &Touch, step: &Vector3<f64>) -> bool {
        let doubted = std::mem::take(&mut self.doubted);
        if !touch.presses(TOUCHED_SHARE) {
            self.end_answer();
            return false;
        }
        let Some(rule) = touch.depth else {
            return false;
        };
        let (deeper_m, across_m) = depth_and_across(step, &touch.normal);
        let pressed = Pressed {
            deeper_m,
            across_m,
            edge_m: rule.edge_speed_m_per_s * touch.dt_s,
            force_n: touch.force_n,
            reference_n: touch.reference_n,
            rule,
            dt_s: touch.dt_s,
        };
        let Some(answer) = &mut self.answer else {
            self.answer = Some(Answer::new(&pressed, self.stiffness_n_per_m));
            return false;
        };
        let missing = answer.is_missing(&pressed);
        let Some(probe_rule) = touch.probe else {
            return missing;
        };
        let held = Held {
            step: *step,
            normal: touch.normal,
            axial_n: -touch.wrench.z,
            error_n: answer.error_n(touch.dt_s),
            reference_n: touch.reference_n,
            rule: probe_rule,
            stiffness_n_per_m: answer.stiffness_n_per_m(),
            doubted: (missing || doubted) && !rule.settling,
            dt_s: touch.dt_s,
        };
        let probe = self.probe.get_or_insert(ReferenceProbe::new(&held));
        self.missed = probe.is_missed(&held);
        if probe.is_proved() {
            answer.accept();
        }
        missing && rule.settling
    }

    /// Whether the force still rises long after the tool has stopped going deeper.
    fn is_late(&mut self, touch: &Touch, step: &Vector3<f64>) -> bool {
        let Some(rule) = touch
            .depth
            .filter(|_| touch.doing == Doing::Pressing && touch.rests)
        else {
            self.lateness = None;
            return false;
        };
        let (deeper_m, across_m) = depth_and_across(step, &touch.normal);
        let most_m = deeper_m + rule.slope * across_m + rule.edge_speed_m_per_s * touch.dt_s;
        let lateness = self.lateness.get_or_insert_default();
        lateness.is_late(touch, most_m)
    }

    /// Whether the force points where no contact can press. Judged under the same law as the depth.
    fn points_aside(&mut self, touch: &Touch, step: &Vector3<f64>) -> bool {
        // A law that presses as it should, and gives way, answers to an obstacle by itself.
        let answered = touch.gives_way && touch.force_n >= HELD_SHARE * touch.reference_n;
        if touch.doing != Doing::Pressing || !touch.rests || touch.depth.is_none() || answered {
            self.direction = None;
            return false;
        }
        let aimed = Aimed {
            force: touch.wrench.fixed_rows::<3>(0).into_owned(),
            pressing_n: touch.force_n,
            reference_n: touch.reference_n,
            way_m: step.norm(),
            dt_s: touch.dt_s,
        };
        self.direction
            .get_or_insert(Direction::new(&aimed))
            .is_aside(&aimed)
    }

    /// Whether the tool has left while the force remains.
    fn stays_while_leaving(&mut self, touch: &Touch) -> bool {
        if touch.doing != Doing::Leaving || !touch.rests {
            self.left = None;
            return false;
        }
        let (force, from) = *self.left.get_or_insert((touch.force_n, touch.position));
        let way = (touch.position - from).dot(&touch.normal);
        force >= UNFELT_N
            && way >= WAY_M + force / SOFTEST_N_PER_M
            && touch.force_n >= LEFT_SHARE * force
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::answer::DepthRule;

    /// The tool at a depth (m) in the surface, after sliding `x` (m), reading `force_n`.
    fn touch(doing: Doing, depth: f64, x: f64, force_n: f64) -> Touch {
        Touch {
            doing,
            position: Vector3::new(0.4 + x, 0.0, 0.2 - depth),
            depth: Some(DepthRule {
                settling: false,
                slope: 0.36,
                edge_speed_m_per_s: 0.0,
                blind_max_m: 0.03,
                soft_tip: false,
            }),
            dt_s: 0.008,
            ..Touch::pressing(force_n)
        }
    }

    /// Depth, m, at which a constant reading is detected.
    fn unfelt_m(stiffness: Option<f64>, per_cycle_m: f64) -> f64 {
        let mut guard = ResponseGuard::default();
        for k in 0..10_000 {
            let depth = per_cycle_m * f64::from(k);
            let sample = Touch {
                stiffness_n_per_m: stiffness,
                ..touch(Doing::Pressing, depth, 0.0, 2.0)
            };
            if guard.step(&sample) == Validity::Unresponsive {
                return depth.abs();
            }
        }
        panic!("not noticed");
    }

    #[test]
    fn a_tool_that_goes_deeper_under_a_standing_reading_is_stopped_before_ten_newtons() {
        for stiffness in [1e3, 5e3, 2.5e4, 5e4] {
            for per_cycle in [5e-6, 2e-5, -2e-5] {
                for known in [Some(stiffness), None] {
                    let way = unfelt_m(known, per_cycle);
                    assert!(way <= 2e-3 + 1e-9, "{way}");
                    assert!(stiffness * way < 7.0, "{stiffness} {known:?}: {way}");
                }
            }
        }
    }

    #[test]
    fn a_reading_that_follows_is_well() {
        let mut guard = ResponseGuard::default();
        for k in 0..5000 {
            // Two newtons on 1 kN/m, up and down.
            let depth = 1e-3 * (f64::from(k) * 0.01).sin();
            let x = 2e-4 * f64::from(k);
            let sample = touch(Doing::Pressing, depth, x, 3.0 + 1000.0 * depth);
            assert_eq!(guard.step(&sample), Validity::Valid);
        }
    }

    #[test]
    fn along_a_slope_a_steady_force_is_right() {
        // 15 degrees of undetected error of the normal.
        let mut guard = ResponseGuard::default();
        for k in 0..5000 {
            let x = 2e-4 * f64::from(k);
            let sample = touch(Doing::Pressing, 0.268 * x, x, 3.0);
            assert_eq!(guard.step(&sample), Validity::Valid);
        }
    }

    #[test]
    fn a_force_that_stays_while_the_tool_leaves_is_no_force() {
        let run = |force: &dyn Fn(f64) -> f64| {
            let mut guard = ResponseGuard::default();
            (0..1000).find_map(|k| {
                let away = 2e-5 * f64::from(k);
                let sample = touch(Doing::Leaving, -away, 0.0, force(away));
                (guard.step(&sample) == Validity::Unresponsive).then_some(away)
            })
        };
        // Noise does not hide it; at 1 kN/m the force is released within 3 mm; leaving a surface
        // that was never pressed reports nothing.
        let noticed = run(&|away| 3.0 + 0.1 * (1e5 * away).sin());
        assert!(noticed.is_some_and(|way| way < 5.1e-3), "{noticed:?}");
        assert_eq!(run(&|away| (3.0 - 1000.0 * away).max(0.0)), None);
        assert_eq!(run(&|_| 0.4), None);
    }

    #[test]
    fn a_reading_that_is_used_again_is_no_standstill() {
        let mut guard = ResponseGuard::default();
        for k in 0..1000 {
            // A new reading every fourth cycle, at 25 kN/m.
            let depth = 5e-6 * f64::from(k);
            let force = 25_000.0 * 5e-6 * f64::from(k / 4 * 4);
            let sample = Touch {
                fresh: k % 4 == 0,
                ..touch(Doing::Pressing, depth, 0.0, force)
            };
            assert_eq!(guard.step(&sample), Validity::Valid);
        }
    }

    #[test]
    fn a_hand_that_lifts_the_tool_is_not_a_dead_sensor() {
        let run = |trembles_n: f64| {
            let mut guard = ResponseGuard::default();
            (0..500).find_map(|k| {
                let away = 2e-5 * f64::from(k);
                let force = 25.0 + trembles_n * f64::from(k).sin();
                let lifted = touch(Doing::Pressing, -away, 0.0, force);
                (guard.step(&lifted) == Validity::Unresponsive).then_some(away)
            })
        };
        assert_eq!(run(0.02), None);
        assert!(run(0.0).is_some_and(|way| way < 2.1e-3));
    }

    /// A guard whose tool has pressed with its reference, and has then moved in with half of it
    /// until the guard doubts the surface; and the depth then, m.
    fn doubting() -> (ResponseGuard, f64) {
        let mut guard = ResponseGuard::default();
        for k in 0..150 {
            let x = 2e-4 * f64::from(k.min(100));
            let force = if k < 100 { 3.0 } else { 1.5 };
            guard.step(&touch(Doing::Pressing, 0.0, x, force));
        }
        assert!(!guard.doubts_surface());
        for k in 1..1000 {
            let depth = 5e-5 * f64::from(k);
            let verdict = guard.step(&touch(Doing::Pressing, depth, 0.02, 1.5));
            assert_eq!(verdict, Validity::Valid);
            if guard.doubts_surface() {
                assert!(!guard.has_fallen_away());
                return (guard, depth);
            }
        }
        panic!("no doubt");
    }

    #[test]
    fn a_surface_where_the_force_comes_back_has_not_ended() {
        let (mut guard, depth) = doubting();
        for k in 1..1000 {
            let force = (1.5 + 0.02 * f64::from(k)).min(3.0);
            let deeper = depth + 2e-5 * f64::from(k.min(75));
            let verdict = guard.step(&touch(Doing::Pressing, deeper, 0.02, force));
            assert_eq!(verdict, Validity::Valid);
            assert!(!guard.has_fallen_away());
        }
        assert!(!guard.doubts_surface());
    }

    #[test]
    fn a_surface_into_which_the_tool_goes_on_when_the_path_stands_has_ended() {
        let (mut guard, depth) = doubting();
        let way = (1..1000).find_map(|k| {
            let way = 5e-5 * f64::from(k);
            let verdict = guard.step(&touch(Doing::Pressing, depth + way, 0.02, 1.5));
            assert_eq!(verdict, Validity::Valid);
            guard.has_fallen_away().then_some(way)
        });
        // 6 mm/s for 0.2 s while the path brakes, and as far again as before.
        assert!(way.is_some_and(|way| way < 2e-3), "{way:?} after {depth}");
    }

    #[test]
    fn a_contact_that_is_lost_is_not_a_dead_sensor() {
        let mut guard = ResponseGuard::default();
        for k in 0..1000 {
            let sample = touch(Doing::Pressing, 2e-5 * f64::from(k), 0.0, 0.0);
            assert_eq!(guard.step(&sample), Validity::Valid);
        }
    }

    #[test]
    fn it_stays_said_until_the_next_task_and_a_moving_base_is_not_judged() {
        let mut guard = ResponseGuard::default();
        for k in 0..100 {
            guard.step(&touch(Doing::Pressing, 2e-5 * f64::from(k), 0.0, 2.0));
        }
        let fresh = touch(Doing::Free, 0.0, 0.0, 0.1);
        assert_eq!(guard.step(&fresh), Validity::Unresponsive);
        let mut guard = ResponseGuard::default();
        for k in 0..1000 {
            let sample = Touch {
                rests: false,
                ..touch(Doing::Pressing, 2e-5 * f64::from(k), 0.0, 2.0)
            };
            assert_eq!(guard.step(&sample), Validity::Valid);
        }
    }
}
