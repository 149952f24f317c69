//! Whether the reading follows the reference of the force: tells a dead sensor from a surface that
//! recedes.
//!
//! Both need the tool to go deeper at the same force. A tool that has gone deeper, while the mean
//! of the reading has not moved, therefore lowers its reference by a ramp. On a surface the force
//! follows, and the ramp ends after a few percent. A dead reading stays, while the tool moves out.
//!
//! Called by `response_guard` in each cycle in which the tool presses.

use nalgebra::Vector3;

/// Time constants of the mean of the reading, and of the slow mean with which it is compared, s: a
/// dead reading changes slowly, by the weight that is taken off while the tool turns.
const MEAN_S: f64 = 0.04;
const SLOW_S: f64 = 0.3;
/// Force that may build up undetected before the reference is lowered, N, or this share of the
/// reference, and the stiffness assumed until it is measured, N/m.
const UNPROVED_N: f64 = 5.0;
const UNPROVED_SHARE: f64 = 0.5;
const STIFFNESS_N_PER_M: f64 = 10_000.0;
/// Bounds of the depth that follows from that, m: above what the arm's own ripple does, and what a
/// soft contact may hide.
const DEPTH_M: [f64; 2] = [2e-4, 2e-3];
/// Displacement after which it must be proved whatever the depth, m: a dead reading lets a normal
/// wander that is found by touch alone, and the tool moves in sideways.
const UNPROVED_M: f64 = 0.005;
/// Time between a proof and the next time that the reference is lowered, s: for the depth, and for
/// the displacement.
const BETWEEN_S: [f64; 2] = [0.5, 3.0];
/// Change of the mean, within [`SLOW_S`], that proves a live reading: share of the reference, N,
/// and standard errors.
const MOVED_SHARE: f64 = 0.06;
const MOVED_N: f64 = 0.15;
const LEAST_N: f64 = 0.03;
const ERRORS: f64 = 6.0;
/// Share of a lower reference by which the mean must follow: more than the weight of a tool that
/// turns.
const FOLLOWED: f64 = 0.35;
/// Share of the reference that is taken off: this rate, 1/s, and this growth of it, 1/s². A live
/// reading shows itself while that is little.
const RAMP_PER_S: f64 = 0.1;
const RAMP_PER_S2: f64 = 0.4;
/// Time after which the path stands, and from which a missing answer is judged, s.
const STANDS_S: f64 = 0.4;
const JUDGED_S: f64 = 1.5;
/// Time for which a reading may go on falling as it did before, s: the path stands, and the tool
/// turns no more.
const TREND_S: f64 = 0.5;
/// Time without a verdict after which the reference is lowered anew from the reading as it is then,
/// s: the path must not stand for ever.
const ANEW_S: f64 = 4.0;
/// Part of the ramp that must be in effect by then, and share of the reference that must be in
/// effect before: one that still builds up shows by itself whether the reading follows.
const IN_EFFECT: f64 = 0.9;
const BUILT_UP: f64 = 0.95;
/// Motion along the normal without which nothing is judged: m, and as the share of the reference
/// that it changes at the stiffness in use. An arm that is held still shows nothing.
const WAY_M: f64 = 1e-4;
const WAY_SHARE: f64 = 0.5;

/// How the reference may be lowered.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ProbeRule {
    /// Share of the reference by which it is lowered at most.
    pub down_share: f64,
    /// Reference in effect, N.
    pub in_effect_n: f64,
    /// Whether touch alone finds the normal, so that a dead reading lets it wander: no earlier pass
    /// has shown the surface.
    pub wanders: bool,
}

/// Measurements of one cycle in which the tool presses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Held {
    /// Motion since the last cycle, m, and the normal in use.
    pub step: Vector3<f64>,
    pub normal: Vector3<f64>,
    /// Reading along the tool's own axis, pressing positive, N: a dead one does not change while
    /// the tool turns. And the standard error of a mean over [`MEAN_S`].
    pub axial_n: f64,
    pub error_n: f64,
    /// Reference asked for, N.
    pub reference_n: f64,
    pub rule: ProbeRule,
    /// Measured stiffness of the contact, N/m.
    pub stiffness_n_per_m: Option<f64>,
    /// Whether the depth says that the reading should have followed: it must be proved at once.
    pub doubted: bool,
    /// Period, s.
    pub dt_s: f64,
}

impl Held {
    /// Change of the mean that is more than noise, N.
    fn least_n(&self) -> f64 {
        LEAST_N.max(ERRORS * self.error_n)
    }

    /// Change of the mean that proves it at any time, N.
    fn change_n(&self) -> f64 {
        self.least_n()
            .max(MOVED_N)
            .max(MOVED_SHARE * self.reference_n)
    }

    fn stiffness(&self) -> f64 {
        self.stiffness_n_per_m.unwrap_or(STIFFNESS_N_PER_M)
    }

    /// Depth from which a reading must be proved, m.
    fn unproved_m(&self) -> f64 {
        let unproved_n = UNPROVED_N.max(UNPROVED_SHARE * self.reference_n);
        (unproved_n / self.stiffness()).clamp(DEPTH_M[0], DEPTH_M[1])
    }
}

/// A reference that is being lowered.
#[derive(Clone, Copy, Debug)]
struct Lowered {
    since_s: f64,
    down_share: f64,
    /// Whether the path stands from the first.
    doubted: bool,
    /// Mean of the reading at its begin, N. The reference goes down from there: a force that lags
    /// behind its reference rises when the path stands.
    mean_n: f64,
    /// That mean as a share of the reference.
    from_share: f64,
    /// Rate at which the reading already fell, N/s: zero or negative.
    trend_n_per_s: f64,
    /// Least and greatest depth since, m.
    depths_m: [f64; 2],
}

/// State for one contact. A new one is the reset.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReferenceProbe {
    /// Normal in use when the reading was last proved. It does not turn with the estimate, which
    /// takes the way of a dead sensor for a slope.
    normal: Vector3<f64>,
    /// Since then: time, s, displacement, m, and least depth along that normal, m.
    since_s: f64,
    moved_m: Vector3<f64>,
    least_m: f64,
    /// Means of the reading, N.
    mean_n: f64,
    slow_n: f64,
    lowered: Option<Lowered>,
}

impl ReferenceProbe {
    /// Starts with a reading that counts as proved.
    pub fn new(held: &Held) -> Self {
        Self {
            normal: held.normal,
            since_s: 0.0,
            moved_m: Vector3::zeros(),
            least_m: 0.0,
            mean_n: held.axial_n,
            slow_n: held.axial_n,
            lowered: None,
        }
    }

    /// Share of the reference that the law should hold.
    pub fn share(&self) -> f64 {
        self.lowered.map_or(1.0, |lowered| {
            let off = lowered.since_s * (RAMP_PER_S + RAMP_PER_S2 * lowered.since_s);
            lowered.from_share * (1.0 - off.min(lowered.down_share))
        })
    }

    /// Whether the path should stand until the reading is proved.
    pub fn stands(&self) -> bool {
        self.lowered
            .is_some_and(|lowered| lowered.doubted || lowered.since_s > STANDS_S)
    }

    /// Whether the reading was proved in this cycle.
    pub fn is_proved(&self) -> bool {
        self.since_s == 0.0
    }

    /// Processes one cycle; returns whether the reading does not follow the reference.
    pub fn is_missed(&mut self, held: &Held) -> bool {
        self.since_s += held.dt_s;
        let share = |time_s: f64| held.dt_s / (held.dt_s + time_s);
        self.mean_n += (held.axial_n - self.mean_n) * share(MEAN_S);
        self.slow_n += (self.mean_n - self.slow_n) * share(SLOW_S);
        self.moved_m += held.step;
        // The chord of a surface that turns evenly is square to the mean of the normals at its
        // ends.
        let depth_m = -self.moved_m.dot(&self.normal.lerp(&held.normal, 0.5));
        self.least_m = self.least_m.min(depth_m);
        let changed = (self.mean_n - self.slow_n).abs() >= held.change_n();
        let Some(lowered) = &mut self.lowered else {
            let deep = depth_m - self.least_m > held.unproved_m();
            let far = self.moved_m.norm() > UNPROVED_M;
            let [of_depth_s, of_displacement_s] = BETWEEN_S;
            let due = held.rule.wanders
                && (deep && self.since_s >= of_depth_s || far && self.since_s >= of_displacement_s);
            if changed && !held.doubted {
                self.prove(held);
            } else if held.doubted || due && held.rule.in_effect_n >= BUILT_UP * held.reference_n {
                self.lower(held, held.doubted, depth_m);
            }
            return false;
        };
        let from_n = lowered.from_share * held.reference_n;
        let due_n = FOLLOWED * (from_n - held.rule.in_effect_n);
        let trend_n = lowered.trend_n_per_s * lowered.since_s.min(TREND_S);
        let fallen_n = lowered.mean_n + trend_n - self.mean_n;
        if changed || fallen_n >= due_n.max(held.least_n()) {
            self.prove(held);
            return false;
        }
        lowered.since_s += held.dt_s;
        let [least_m, most_m] = &mut lowered.depths_m;
        *least_m = least_m.min(depth_m);
        *most_m = most_m.max(depth_m);
        let way_m = WAY_M.max(WAY_SHARE * from_n / held.stiffness());
        let lowered_to_n = from_n * (1.0 - IN_EFFECT * lowered.down_share);
        let missed = lowered.since_s >= JUDGED_S
            && held.rule.in_effect_n <= lowered_to_n
            && *most_m - *least_m >= way_m;
        if !missed && lowered.since_s >= ANEW_S {
            self.lower(held, true, depth_m);
        }
        missed
    }

    /// Lowers the reference from the present reading on. `doubted`: the path stands from the first.
    fn lower(&mut self, held: &Held, doubted: bool, depth_m: f64) {
        self.lowered = Some(Lowered {
            since_s: 0.0,
            down_share: held.rule.down_share,
            doubted,
            mean_n: self.mean_n,
            trend_n_per_s: ((self.mean_n - self.slow_n) / SLOW_S).min(0.0),
            from_share: (self.mean_n / held.reference_n).clamp(0.0, 1.0),
            depths_m: [depth_m; 2],
        });
    }

    /// Begins anew, with a reading that is alive now.
    fn prove(&mut self, held: &Held) {
        *self = Self {
            mean_n: self.mean_n,
            slow_n: self.slow_n,
            ..Self::new(held)
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f64 = 0.002;
    const REFERENCE_N: f64 = 3.0;
    const SPEED_M_PER_S: f64 = 0.02;
    /// Damping of the law over the stiffness, s: as the law schedules it for a delay of 40 ms.
    const DAMPING_S: f64 = 0.09;
    /// Longer than any interval between two proofs, s.
    const WATCHED_S: f64 = 12.0;

    /// A tool that is dragged along a surface, while an admittance holds the force.
    struct Bench {
        /// Stiffness, N/m: the true one, and the one that the law and the probe take for it.
        stiffness: f64,
        assumed: f64,
        /// Share of a command that the arm carries out.
        moves: f64,
        /// Slope of the surface against the normal in use.
        slope: f64,
    }

    impl Default for Bench {
        fn default() -> Self {
            Self {
                stiffness: 1e4,
                assumed: 1e4,
                moves: 1.0,
                slope: 0.0,
            }
        }
    }

    /// What came of it.
    struct Outcome {
        /// Time at which the answer was missed, s.
        missed_s: Option<f64>,
        /// Largest true force, and lowest one after the first second, N.
        most_n: f64,
        least_n: f64,
        /// Number of times that the reference was lowered.
        lowered: u32,
    }

    impl Bench {
        /// `read` makes a reading of the true force, N, and the time, s.
        fn run(&self, read: impl Fn(f64, f64) -> f64) -> Outcome {
            let damping = self.assumed * DAMPING_S;
            let (mut true_n, mut reading_n, mut in_effect_n) =
                (REFERENCE_N, REFERENCE_N, REFERENCE_N);
            let mut probe: Option<ReferenceProbe> = None;
            let mut outcome = Outcome {
                missed_s: None,
                most_n: 0.0,
                least_n: REFERENCE_N,
                lowered: 0,
            };
            for k in 0..(WATCHED_S / DT_S) as usize {
                let time_s = k as f64 * DT_S;
                let (share, stands) = probe.map_or((1.0, false), |p| (p.share(), p.stands()));
                let aim_n = share * REFERENCE_N;
                in_effect_n += (aim_n - in_effect_n).clamp(-8.0 * DT_S, 8.0 * DT_S);
                let along = if stands { 0.0 } else { SPEED_M_PER_S * DT_S };
                let inward = self.moves * (in_effect_n - reading_n) / damping * DT_S;
                true_n = (true_n + self.stiffness * (inward - self.slope * along)).max(0.0);
                reading_n += (read(true_n, time_s) - reading_n) * DT_S / (DT_S + 0.02);
                let held = Held {
                    step: Vector3::new(along, 0.0, -inward),
                    normal: Vector3::z(),
                    axial_n: reading_n,
                    error_n: 0.0,
                    reference_n: REFERENCE_N,
                    rule: ProbeRule {
                        down_share: 0.5,
                        in_effect_n,
                        wanders: true,
                    },
                    stiffness_n_per_m: Some(self.assumed),
                    doubted: false,
                    dt_s: DT_S,
                };
                let probe = probe.get_or_insert(ReferenceProbe::new(&held));
                let before = probe.share() < 1.0;
                if probe.is_missed(&held) {
                    outcome.missed_s = Some(time_s);
                    return outcome;
                }
                outcome.lowered += u32::from(probe.share() < 1.0 && !before);
                outcome.most_n = outcome.most_n.max(true_n);
                if time_s > 1.0 {
                    outcome.least_n = outcome.least_n.min(true_n);
                }
            }
            outcome
        }
    }

    #[test]
    fn a_live_reading_is_proved_after_a_small_dip() {
        for stiffness in [500.0, 2e3, 1e4, 5e4] {
            for behind_n in [0.0, 0.2] {
                let bench = Bench {
                    stiffness,
                    assumed: stiffness,
                    slope: behind_n / (DAMPING_S * stiffness * SPEED_M_PER_S),
                    ..Bench::default()
                };
                let outcome = bench.run(|true_n, _| true_n);
                assert!(outcome.missed_s.is_none(), "{stiffness}, {behind_n}");
                assert!(outcome.lowered > 0, "{stiffness}, {behind_n}");
                let least_n = 0.88 * (REFERENCE_N - behind_n);
                assert!(outcome.least_n > least_n, "{} N", outcome.least_n);
            }
        }
    }

    #[test]
    fn a_loop_that_is_slower_than_thought_is_still_alive() {
        for (stiffness, assumed, moves) in [(1e3, 1e4, 1.0), (5e3, 5e4, 1.0), (1e4, 1e4, 0.1)] {
            let bench = Bench {
                stiffness,
                assumed,
                moves,
                ..Bench::default()
            };
            let outcome = bench.run(|true_n, _| true_n);
            assert!(
                outcome.missed_s.is_none(),
                "{stiffness}, {assumed}, {moves}"
            );
        }
    }

    #[test]
    fn an_arm_that_is_held_still_shows_nothing() {
        let bench = Bench {
            moves: 0.0,
            ..Bench::default()
        };
        assert!(bench.run(|_, _| REFERENCE_N).missed_s.is_none());
    }

    #[test]
    fn a_soft_contact_that_falls_slowly_and_then_follows_is_proved() {
        // The law takes it for fifteen times stiffer than it is, so that it follows in seconds.
        let (stiffness, follows_s, reference_n) = (1300.0, 1.3, 9.0);
        for falling_n_per_s in [0.3, 0.7, 1.2, 1.7] {
            let (mut reading_n, mut in_effect_n) = (reference_n, reference_n);
            let (mut probe, mut stood) = (None::<ReferenceProbe>, false);
            for _ in 0..(2.0 * WATCHED_S / DT_S) as usize {
                let (share, stands) = probe.map_or((1.0, false), |p| (p.share(), p.stands()));
                stood |= stands;
                in_effect_n += (share * reference_n - in_effect_n).clamp(-8.0 * DT_S, 8.0 * DT_S);
                let gained_n = (in_effect_n - reading_n) / follows_s * DT_S;
                reading_n += if stood {
                    gained_n
                } else {
                    -falling_n_per_s * DT_S
                };
                let held = Held {
                    step: Vector3::new(0.0, 0.0, -gained_n / stiffness),
                    normal: Vector3::z(),
                    axial_n: reading_n,
                    error_n: 0.0,
                    reference_n,
                    rule: ProbeRule {
                        down_share: 0.5,
                        in_effect_n,
                        wanders: false,
                    },
                    stiffness_n_per_m: Some(stiffness),
                    doubted: !stood && reading_n < 0.7 * reference_n,
                    dt_s: DT_S,
                };
                let probe = probe.get_or_insert(ReferenceProbe::new(&held));
                assert!(!probe.is_missed(&held), "at {reading_n} N");
            }
            assert!(stood);
            assert!(
                reading_n > 0.9 * reference_n,
                "{falling_n_per_s} N/s: {reading_n} N"
            );
        }
    }

    #[test]
    fn a_dead_reading_is_missed_whatever_its_level() {
        for level_n in [REFERENCE_N, 0.95 * REFERENCE_N, 0.7 * REFERENCE_N] {
            // The weight that is taken off changes while the tool turns.
            for drift in [0.0, 0.1, -0.1] {
                let outcome = Bench::default().run(|_, time_s| level_n + drift * time_s);
                let missed_s = outcome.missed_s.expect("missed");
                assert!(missed_s < 6.0, "{level_n}, {drift}: {missed_s} s");
                assert!(
                    outcome.most_n < 45.0,
                    "{level_n}, {drift}: {} N",
                    outcome.most_n
                );
            }
        }
    }
}
