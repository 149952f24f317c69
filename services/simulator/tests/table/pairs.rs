//! Two faults at the same time, and the state after one fault: checks the true pressing force, and
//! that no motion restarts by itself.

use std::fmt;

use tangent_control::Phase;

use super::{TableCell, TableFault};

/// Phases in which a fault can begin.
pub const PHASES: [Phase; 7] = [
    Phase::Tare,
    Phase::Clear,
    Phase::Approach,
    Phase::Contact,
    Phase::Slide,
    Phase::Hold,
    Phase::Retract,
];

/// Type that selects a variant of a cell; `()` for a cell without variants.
pub trait Setup: Copy {
    /// Adds the variant to a play's text.
    fn add_to(&self, text: &mut fmt::DebugStruct<'_, '_>);
}

impl Setup for () {
    fn add_to(&self, _: &mut fmt::DebugStruct<'_, '_>) {}
}

/// Sequence of faults of a cell: `first` begins some cycles into the phase and, `apart` cycles
/// later, `second` begins as well; then both end.
#[derive(Clone, Copy)]
pub struct Play<S, F> {
    pub setup: S,
    pub phase: Phase,
    pub first: F,
    pub second: F,
    /// Cycles from the first to the second, in the table's own unit.
    pub apart: u64,
    /// Cycles from the begin of the phase to the first fault.
    pub offset: u64,
}

/// A play of a cell.
pub type PlayOf<C> = Play<<C as TableCell>::Setup, <C as TableCell>::Fault>;

impl<S: Setup, F: fmt::Debug> fmt::Debug for Play<S, F> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut text = f.debug_struct("Play");
        self.setup.add_to(&mut text);
        text.field("phase", &self.phase)
            .field("first", &self.first)
            .field("second", &self.second)
            .field("apart", &self.apart)
            .field("offset", &self.offset)
            .finish()
    }
}

impl<S: Copy, F: TableFault> Play<S, F> {
    /// A play with one fault alone.
    pub fn alone(setup: S, phase: Phase, fault: F, offset: u64) -> Self {
        Self {
            setup,
            phase,
            first: fault,
            second: fault,
            apart: 0,
            offset,
        }
    }

    /// Whether one of both is this fault.
    pub fn has(&self, fault: F) -> bool {
        [self.first, self.second].contains(&fault)
    }

    /// Whether these faults end every task.
    pub fn ends_task(&self) -> bool {
        !(self.first.is_tolerated() && self.second.is_tolerated())
    }
}

/// Times for which a cell is observed with two faults and after them. All numbers are of the cell's
/// own cycles.
pub trait PairCell: TableCell {
    /// Time in which the arm comes to rest after the faults, and time for which it must rest,
    /// cycles.
    fn rest(&self) -> (u64, u64);
    /// Converts a number in a play to cycles.
    fn cycles(&self, of_play: u64) -> u64 {
        of_play
    }
    /// Duration of both faults, cycles: their effects are decided by then.
    fn lasts(&self, play: &PlayOf<Self>) -> u64;
    /// Whether the law can detect the faults.
    fn can_be_known(_: &PlayOf<Self>) -> bool {
        true
    }
    /// Whether the arm rests, and bridge and robot are in their normal state.
    fn rests(&self) -> bool {
        !self.phase().is_active() && self.robot_speed() < Self::AT_REST
    }
    /// Lets the rest of the task come to its end.
    fn finish(&mut self, play: &PlayOf<Self>) {
        if play.phase != Phase::Slide || !play.ends_task() {
            // A task that could wait for the fault's end continues.
            self.steps(500);
            self.stop_task();
        }
        come_to_rest(self, play);
    }
    /// Actions of a person before another start: the cell is ready afterwards.
    fn make_ready(&mut self);
    /// Difference between shown and true force after a new start, N.
    fn shown_off_n(&mut self) -> f64 {
        self.steps(500);
        let (mut off_n, n) = (0.0, 500);
        for _ in 0..n {
            self.step();
            off_n += (self.shown_n() - true_n(self)) / f64::from(n);
        }
        off_n.abs()
    }
}

/// True force along the normal, N.
pub fn true_n(cell: &impl TableCell) -> f64 {
    let truth = cell.truth();
    truth.wrench.force.dot(&truth.normal)
}

/// The law cannot react to a reading that is zero, varies, and is marked valid: it seeks a surface
/// on which the tool already is. `limits.blind_distance_max_m` bounds that.
pub fn faults<C: TableCell>() -> impl Iterator<Item = C::Fault> + Clone {
    let all = C::Fault::ALL.iter().copied();
    all.filter(|fault| *fault != C::Fault::CONTACT_LOST)
}

fn run<C: PairCell>(play: &PlayOf<C>) -> C {
    let mut cell = C::in_phase(play.setup, play.phase);
    cell.steps(cell.cycles(play.offset));
    cell.trial_mut().faults = vec![play.first];
    cell.steps(cell.cycles(play.apart));
    cell.trial_mut().faults.push(play.second);
    cell.steps(cell.lasts(play));
    cell.trial_mut().faults.clear();
    cell
}

/// Runs until the arm has rested long enough.
pub fn come_to_rest<C: PairCell>(cell: &mut C, play: &PlayOf<C>) {
    let ((most, wanted), mut rested) = (cell.rest(), 0);
    for _ in 0..most {
        cell.step();
        rested = if cell.rests() { rested + 1 } else { 0 };
        if rested >= wanted {
            return;
        }
    }
    let (phase, speed) = (cell.phase(), cell.robot_speed());
    assert!(!phase.is_active(), "{play:?}: still in {phase:?}");
    assert!(speed < C::AT_REST, "{play:?}: moves on, {speed} rad/s");
}

/// Judges each play: the largest force, and whether the rest of the task ends. Prints the worst
/// plays.
pub fn judge_all<C: PairCell>(plays: impl Iterator<Item = PlayOf<C>>) {
    let (mut worst, mut played) = ((0.0, None), 0);
    for play in plays.filter(C::can_be_known) {
        let mut cell: C = run(&play);
        cell.finish(&play);
        if cell.trial().peak_n > worst.0 {
            worst = (cell.trial().peak_n, Some(play));
        }
        cell.assert_force(&play);
        played += 1;
    }
    println!(
        "{played} times two faults; at most {:.2} N: {:?}",
        worst.0, worst.1
    );
}

/// Pairs of each fault with each, in both orders. `times` gives the cycles between both, and before
/// them.
pub fn both_orders<C: PairCell>(
    setup: C::Setup,
    phase: Phase,
    mut times: impl FnMut(usize) -> (u64, u64),
) -> impl Iterator<Item = PlayOf<C>> {
    let both = faults::<C>().flat_map(|first| faults::<C>().map(move |second| (first, second)));
    both.enumerate().map(move |(i, (first, second))| {
        let (apart, offset) = times(i);
        Play {
            setup,
            phase,
            first,
            second,
            apart,
            offset,
        }
    })
}

/// Every `shares`-th play, from `of` on.
pub fn share<P>(
    plays: impl Iterator<Item = P>,
    of: usize,
    shares: usize,
) -> impl Iterator<Item = P> {
    plays.skip(of).step_by(shares)
}

/// Cycles between two faults, and from the begin of the phase to the first one, at 1 kHz.
const TIMES_AT_1_KHZ: [(u64, u64); 5] = [(0, 0), (2, 7), (19, 130), (101, 21), (60, 333)];

/// Pairs of the faults in `of` while the cell slides, in one of both orders; a share of them.
pub fn one_order<C: PairCell<Setup = ()>>(of: &[C::Fault], part: usize, parts: usize) {
    let both = (0..of.len())
        .flat_map(|i| (0..=i).map(move |j| (i, j)))
        .map(|(i, j)| if (i + j) % 2 == 0 { (i, j) } else { (j, i) });
    let plays = both.enumerate().map(|(n, (i, j))| {
        let (apart, offset) = TIMES_AT_1_KHZ[n % TIMES_AT_1_KHZ.len()];
        Play {
            setup: (),
            phase: Phase::Slide,
            first: of[i],
            second: of[j],
            apart,
            offset,
        }
    });
    judge_all::<C>(share(plays, part, parts));
}

/// Plays of each fault in `of` alone, in every second phase.
pub fn every_second_phase<C: PairCell<Setup = ()>>(of: &[C::Fault]) {
    let places = PHASES.into_iter().enumerate();
    judge_all::<C>(places.flat_map(|(p, phase)| {
        let alone = of.iter().enumerate().filter(move |(i, _)| (i + p) % 2 == 0);
        alone.map(move |(i, fault)| {
            let (_, offset) = TIMES_AT_1_KHZ[i % TIMES_AT_1_KHZ.len()];
            Play::alone((), phase, *fault, offset / 2)
        })
    }));
}

/// Plays every pair in both orders and every phase, at random times below these from
/// PROPTEST_RNG_SEED, which differ in each round of .ci/search. Prints `what` before each phase.
pub fn anywhere<C: PairCell>(setup: C::Setup, what: &str, apart_max: u64, offset_max: u64) {
    let mut state: u64 = std::env::var("PROPTEST_RNG_SEED")
        .ok()
        .and_then(|seed| seed.parse().ok())
        .unwrap_or(2026);
    // SplitMix64 (Steele, Lea, Flood 2014).
    let mut below = move |most: u64| {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % most
    };
    for phase in PHASES {
        println!("{what}{phase:?}");
        let times = |_| (below(apart_max), below(offset_max));
        let plays: Vec<_> = both_orders::<C>(setup, phase, times).collect();
        judge_all::<C>(plays.into_iter());
    }
}

/// After each of these plays and a new start, the shown force must equal the true one.
pub fn a_new_start_shows_the_true_force<C: PairCell>(plays: impl Iterator<Item = PlayOf<C>>) {
    for play in plays {
        let mut cell: C = run(&play);
        come_to_rest(&mut cell, &play);
        cell.make_ready();
        cell.start_task();
        cell.until("it slides again", |c| c.phase() == Phase::Slide);
        let (off_n, fault) = (cell.shown_off_n(), play.first);
        assert!(off_n <= 0.5, "{fault:?}: shown {off_n} N beside the truth");
        cell.assert_force(&fault);
    }
}
