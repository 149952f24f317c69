//! Two faults at once, and what comes after one: how hard the tool truly presses, and that nothing
//! goes on by itself.

use tangent_control::Phase;
use tangent_simulator::Flavour;

use crate::cell::Cell;
use crate::fault::Fault;

/// Twice the reference, or this: what the tool may press with whatever happens, N.
const PEAK_N: f64 = 10.0;
/// How long the faults last, s: what follows from them is decided by then. Of a silent estimate
/// that takes a second.
const LASTS_S: f64 = 0.5;
const BLIND_S: f64 = 1.2;
/// Time in which the arm is at rest after them, s: a protective stop is unlocked after 5 s, and the
/// program is sent again after that.
const REST_S: f64 = 12.0;
/// Time over which it is seen to rest, s.
const RESTS_S: f64 = 0.2;
/// Cycles at 125 Hz between two faults, and of the first one after the phase's begin.
const TIMES: [(u64, u64); 5] = [(0, 0), (1, 7), (3, 13), (14, 21), (60, 5)];
/// Where a fault can begin.
const PHASES: [Phase; 7] = [
    Phase::Tare,
    Phase::Clear,
    Phase::Approach,
    Phase::Contact,
    Phase::Slide,
    Phase::Hold,
    Phase::Retract,
];

/// Cycles of a robot for so many at 125 Hz.
fn cycles(cell: &Cell, at_125_hz: u64) -> u64 {
    (at_125_hz as f64 * 0.008 / cell.period_s()).round() as u64
}

fn seconds(cell: &Cell, s: f64) -> u64 {
    (s / cell.period_s()) as u64
}

/// What the law cannot answer by itself is left out: with a reading that is zero, alive, and said
/// to be valid, it seeks a surface that it is on. `limits.blind_distance_max_m` bounds that.
fn faults() -> impl Iterator<Item = Fault> + Clone {
    Fault::ALL.into_iter().filter(|f| *f != Fault::ContactLost)
}

/// What happens to the cell: `first` so many cycles into the phase and, `apart` later, `second` as
/// well; then neither.
#[derive(Clone, Copy, Debug)]
struct Play {
    flavour: Flavour,
    phase: Phase,
    first: Fault,
    second: Fault,
    /// Cycles at 125 Hz.
    apart: u64,
    /// Cycles at 125 Hz.
    offset: u64,
}

impl Play {
    fn run(&self) -> Cell {
        let mut cell = Cell::in_phase(self.flavour, self.phase);
        cell.steps(cycles(&cell, self.offset));
        cell.faults = vec![self.first];
        cell.steps(cycles(&cell, self.apart));
        cell.faults.push(self.second);
        let blind = [self.first, self.second].contains(&Fault::EstimateSilent);
        cell.steps(seconds(&cell, if blind { BLIND_S } else { LASTS_S }));
        cell.faults.clear();
        cell
    }
}

/// Until the arm rests, with a bridge that would move it or waits for a person.
fn come_to_rest(cell: &mut Cell, what: &Play) {
    let (most, wanted) = (seconds(cell, REST_S), seconds(cell, RESTS_S));
    let mut rested = 0;
    for _ in 0..most {
        cell.step();
        let rests = !cell.phase().is_active() && cell.robot_speed() < 1e-6;
        rested = if rests && cell.bridge().is_ready() {
            rested + 1
        } else {
            0
        };
        if rested >= wanted {
            return;
        }
    }
    let phase = cell.phase();
    assert!(!phase.is_active(), "{what:?}: still in {phase:?}");
    assert!(cell.robot_speed() < 1e-6, "{what:?}: moves on");
}

/// What is left of a task in any phase: it is over and the arm at rest, or it goes on as it should
/// and leaves the surface when it is told.
fn judge(play: &Play, worst: &mut (f64, Option<Play>)) {
    let mut cell = play.run();
    let only_another = play.first == Fault::SecondSource && play.second == play.first;
    if play.phase == Phase::Slide {
        if only_another {
            assert_eq!(cell.phase(), Phase::Slide, "{play:?}");
        } else {
            come_to_rest(&mut cell, play);
        }
    } else {
        // A task that could wait for the fault's end goes on.
        for _ in 0..seconds(&cell, 2.0) {
            cell.step();
        }
        cell.stop_task();
        come_to_rest(&mut cell, play);
    }
    if cell.peak_n > worst.0 {
        *worst = (cell.peak_n, Some(*play));
    }
    assert!(cell.peak_n <= PEAK_N, "{play:?}: {} N", cell.peak_n);
}

/// All of these, with how hard the tool pressed at most.
fn judge_all(plays: impl Iterator<Item = Play>) {
    let (mut worst, mut played) = ((0.0, None), 0);
    for play in plays {
        judge(&play, &mut worst);
        played += 1;
    }
    println!(
        "{played} times two faults; at most {:.2} N: {:?}",
        worst.0, worst.1
    );
}

/// All pairs in a phase, at times that `times` gives for each: cycles at 125 Hz between both, and
/// before them.
fn pairs(
    flavour: Flavour,
    phase: Phase,
    mut times: impl FnMut(usize) -> (u64, u64),
) -> impl Iterator<Item = Play> {
    let both = faults().flat_map(|first| faults().map(move |second| (first, second)));
    both.enumerate().map(move |(i, (first, second))| {
        let (apart, offset) = times(i);
        Play {
            flavour,
            phase,
            first,
            second,
            apart,
            offset,
        }
    })
}

/// The first half of the pairs, or the second: two threads share them.
fn half(second: bool) {
    let all = pairs(Flavour::Cb3, Phase::Slide, |i| TIMES[i % TIMES.len()]);
    judge_all(
        all.enumerate()
            .filter(|(i, _)| (i % 2 == 1) == second)
            .map(|(_, play)| play),
    );
}

#[test]
fn no_two_faults_at_once_press_hard_or_leave_the_arm_in_motion() {
    half(false);
}

#[test]
fn no_other_two_faults_at_once_press_hard_or_leave_the_arm_in_motion() {
    half(true);
}

/// Every pair in every phase at times from PROPTEST_RNG_SEED: others in each round of .ci/search.
fn anywhere(flavour: Flavour) {
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
        println!("{flavour:?} {phase:?}");
        let plays: Vec<Play> = pairs(flavour, phase, |_| (below(80), below(40))).collect();
        judge_all(plays.into_iter());
    }
}

#[test]
#[ignore = "every pair in every phase, minutes: .ci/search"]
fn no_two_faults_in_any_phase_at_125_hz() {
    anywhere(Flavour::Cb3);
}

#[test]
#[ignore = "every pair in every phase, minutes: .ci/search"]
fn no_two_faults_in_any_phase_at_500_hz() {
    anywhere(Flavour::ESeries);
}

/// Each fault alone, in every phase.
#[test]
fn no_fault_in_any_phase_presses_hard_or_leaves_the_arm_in_motion() {
    judge_all(PHASES.into_iter().flat_map(|phase| {
        faults().enumerate().map(move |(i, fault)| Play {
            flavour: if i % 2 == 0 {
                Flavour::Cb3
            } else {
                Flavour::ESeries
            },
            phase,
            first: fault,
            second: fault,
            apart: 0,
            offset: TIMES[i % TIMES.len()].1 / 2,
        })
    }));
}

#[test]
fn after_every_fault_a_new_start_shows_the_true_force() {
    for (i, fault) in faults().enumerate() {
        if fault == Fault::SecondSource {
            continue;
        }
        let play = Play {
            flavour: Flavour::Cb3,
            phase: Phase::Slide,
            first: fault,
            second: fault,
            apart: 0,
            offset: [0, 9][i % 2],
        };
        let mut cell = play.run();
        come_to_rest(&mut cell, &play);
        cell.reset_bridge();
        cell.until("the bridge is ready", |c| c.bridge().is_ready());
        cell.start_task();
        cell.until("it slides again", |c| c.phase() == Phase::Slide);
        let mut worst_n = 0.0_f64;
        for _ in 0..250 {
            cell.step();
            let truth = cell.truth();
            let true_n = truth.wrench.force.dot(&truth.normal);
            worst_n = worst_n.max((cell.output.unwrap().force_n.unwrap() - true_n).abs());
        }
        assert!(
            worst_n <= 0.5,
            "{fault:?}: shown {worst_n} N beside the truth"
        );
        assert!(cell.peak_n <= PEAK_N, "{fault:?}: {} N", cell.peak_n);
    }
}
