//! Losses of contact by place: one that repeats where it happened before changes the approach, and
//! then ends the task.
//!
//! Called by the phase machine at each touch and loss, and by the motion.

use nalgebra::Vector3;

use crate::contact::alignment::{angle_between, depth_and_across};
use crate::phase_machine::Phase;

/// Distance within which losses are at one place, m.
const PLACE_M: f64 = 0.01;
/// Losses at one place from which the tool moves slower there, by this factor for each more.
const SLOWER_FROM: u32 = 2;
const SLOWER_FACTOR: f64 = 0.6;
/// Slowest share of the speed.
const SHARE_MIN: f64 = 0.1;

/// Largest number of touches in sequence that may be none.
const UNREAL_MAX: u32 = 10;

/// Depth by which the tool gets further in from loss to loss where a surface ends, m.
const DEEPER_M: f64 = 1e-3;
/// Turn of the normal at one place where a surface ends, rad: more than a normal that was wrong by
/// 25 degrees and a curvature of 40 per metre over [`PLACE_M`].
const TURNS_AWAY_RAD: f64 = 0.9;
/// Distance from a loss, m, within which a tool further in is beside a wall below it: how many
/// times as far in as aside it is there, and the turn of the normal, rad, both more than those of a
/// body with a diameter of 50 mm and a normal that was wrong by 25 degrees.
const BELOW_M: f64 = 0.03;
const STEEP: f64 = 2.0;
const UPRIGHT_RAD: f64 = 1.1;
/// Time for which a tool slides unhindered after a loss where the surface goes on, s.
const GOES_ON_S: f64 = 0.5;
/// Share of that time which a tool gains while it explores, because it goes to and fro, and how far
/// the normal may have turned since the loss, rad: behind a step it has not, at a rim it does.
const EXPLORES_SHARE: f64 = 0.25;
const SAME_NORMAL_RAD: f64 = 0.2;

/// What the tool felt from a touch to a loss.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Felt {
    pressing_n_s: f64,
    aside_n_s: f64,
    pressing_most_n: f64,
    /// Whether the tool moved along the surface.
    pub moved: bool,
}

impl Felt {
    /// Adds one cycle with a pressing force and one along the surface, N.
    pub fn add(&mut self, pressing_n: f64, aside_n: f64, dt_s: f64) {
        self.pressing_n_s += pressing_n.max(0.0) * dt_s;
        self.aside_n_s += aside_n * dt_s;
        self.pressing_most_n = self.pressing_most_n.max(pressing_n);
    }

    /// Whether the tool was held aside more than it pressed: by a rim.
    pub fn is_aside(&self) -> bool {
        self.aside_n_s > self.pressing_n_s
    }
}

/// A touch, with what it interrupted: where the force then vanishes without having grown, there was
/// no surface, and that goes on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Touch {
    /// The approach, or the way back to a lost surface.
    pub from: Phase,
    /// Where that began, m.
    pub start: Vector3<f64>,
    /// Whether the tool had touched before.
    pub touched: bool,
    /// Where the zero in force was taken, m; `None` if the tool had touched after it.
    pub tared_at: Option<Vector3<f64>>,
    /// Whether the tool touches there.
    pub at_tare: bool,
    /// Whether the surface was known where the tool lands.
    pub knows_landing: bool,
    /// Touches before this one that were none, in sequence.
    pub unreal: u32,
}

impl Default for Touch {
    fn default() -> Self {
        Self {
            from: Phase::Approach,
            start: Vector3::zeros(),
            touched: false,
            tared_at: None,
            at_tare: false,
            knows_landing: false,
            unreal: 0,
        }
    }
}

impl Touch {
    /// Whether the zero in force was taken in contact: the tool has touched where it was taken,
    /// with at least `real_n`, N.
    pub fn denies_zero(&self, felt: &Felt, real_n: f64) -> bool {
        self.at_tare && felt.pressing_most_n >= real_n
    }

    /// Whether a touch that has ended was none, by what the tool `felt`: less than `real_n`, N.
    /// Many in sequence are real: a tool that bounces.
    pub fn was_none(&mut self, felt: &Felt, real_n: f64) -> bool {
        let none = felt.pressing_most_n < real_n && self.unreal < UNREAL_MAX;
        self.unreal = if none { self.unreal + 1 } else { 0 };
        none
    }
}

/// State for one run. A new one is the reset.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Losses {
    /// Position (m) and normal in use at the first loss at the present place.
    place: Option<(Vector3<f64>, Vector3<f64>)>,
    here: u32,
    aside: u32,
    /// How many of them while the tool moved along the surface.
    slid: u32,
    /// How often the tool has felt the surface around this place since.
    rounds: u32,
    deeper_m: f64,
    /// Position (m) and normal in use where contact was lost first since the tool slid on
    /// unhindered, and for how long it does, s.
    last: Option<(Vector3<f64>, Vector3<f64>)>,
    slid_s: f64,
}

impl Losses {
    /// Counts a loss at `position` (m) on a surface with this `normal`; returns how many were at
    /// this place.
    pub fn count(&mut self, position: &Vector3<f64>, normal: &Vector3<f64>, felt: &Felt) -> u32 {
        if !self.is_near(position) {
            *self = Self {
                place: Some((*position, *normal)),
                last: self.last,
                ..Self::default()
            };
        }
        self.last.get_or_insert((*position, *normal));
        self.slid_s = 0.0;
        self.here += 1;
        self.aside += u32::from(felt.is_aside());
        self.slid += u32::from(felt.moved);
        self.deeper_m = self
            .place
            .map_or(0.0, |(place, _)| (place - position).dot(normal));
        self.here
    }

    /// Whether the losses at this place are those of a surface that ends, and not of a tool that
    /// bounces.
    pub fn is_rim(&self) -> bool {
        2 * self.aside >= self.here || self.deeper_m > DEEPER_M
    }

    /// Whether the last losses were at `position` (m), and are those of a surface that ends.
    pub fn is_rim_at(&self, position: &Vector3<f64>) -> bool {
        self.is_near(position) && self.is_rim()
    }

    /// Whether the normal in use at `position` (m) has turned further than a surface can turn:
    /// since the first loss at this place, or, straight down from there, since the tool last slid
    /// on. The tool goes round a rim.
    pub fn turns_away(&self, position: &Vector3<f64>, normal: &Vector3<f64>) -> bool {
        let here = self.place.is_some_and(|(_, first)| {
            self.is_near(position) && angle_between(&first, normal) > TURNS_AWAY_RAD
        });
        let below = self.last.is_some_and(|(last, first)| {
            let (deeper_m, aside_m) = depth_and_across(&(position - last), &first);
            deeper_m.hypot(aside_m) < BELOW_M
                && deeper_m > STEEP * aside_m
                && angle_between(&first, normal) > UPRIGHT_RAD
        });
        here || below
    }

    /// Records that the tool has felt the surface around this place: the losses before say nothing
    /// of the normal that it has found.
    pub fn felt_around(&mut self) {
        self.here = 0;
        self.aside = 0;
        self.slid = 0;
        self.rounds += 1;
    }

    /// Losses at this place while the tool moved along the surface, which it has felt around this
    /// place so often before.
    pub fn slid(&self) -> (u32, u32) {
        (self.slid, self.rounds)
    }

    /// Records that the tool slides on unhindered: the surface goes on.
    pub fn slides_on(&mut self, dt_s: f64) {
        self.slid_s += dt_s;
        if self.slid_s > GOES_ON_S {
            self.last = None;
        }
    }

    /// Records that the tool explores unhindered with this `normal` in use.
    pub fn explores(&mut self, normal: &Vector3<f64>, dt_s: f64) {
        if self
            .last
            .is_some_and(|(_, first)| angle_between(&first, normal) < SAME_NORMAL_RAD)
        {
            self.slides_on(EXPLORES_SHARE * dt_s);
        }
    }

    /// Whether the tool at `position` (m) is further in than where contact was lost, and has not
    /// slid on since: beside a surface that ends there.
    pub fn is_beside(&self, position: &Vector3<f64>, normal: &Vector3<f64>) -> bool {
        self.last.is_some_and(|(last, _)| {
            let (deeper_m, aside_m) = depth_and_across(&(position - last), normal);
            aside_m < PLACE_M && deeper_m > DEEPER_M
        })
    }

    /// Share of a speed, of the path or towards the surface, that is left at `position` (m).
    pub fn speed_share(&self, position: &Vector3<f64>) -> f64 {
        if self.here <= SLOWER_FROM || !self.is_near(position) {
            return 1.0;
        }
        let more = i32::try_from(self.here - SLOWER_FROM).unwrap_or(i32::MAX);
        SLOWER_FACTOR.powi(more).max(SHARE_MIN)
    }

    fn is_near(&self, position: &Vector3<f64>) -> bool {
        self.place
            .is_some_and(|(place, _)| (position - place).norm() < PLACE_M)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_at_one_place_slow_the_tool_there_and_only_there() {
        let mut losses = Losses::default();
        let (here, there) = (Vector3::zeros(), Vector3::x() * 0.02);
        let (up, felt) = (Vector3::z(), Felt::default());
        let counts: Vec<_> = (0..4).map(|_| losses.count(&here, &up, &felt)).collect();
        assert_eq!(counts, [1, 2, 3, 4]);
        assert!(losses.speed_share(&here) < 0.5);
        assert_eq!(losses.speed_share(&there), 1.0);
        assert_eq!(losses.count(&there, &up, &felt), 1);
        assert_eq!(losses.speed_share(&there), 1.0);
    }

    #[test]
    fn losses_of_a_moving_tool_count_until_it_has_felt_the_surface_around() {
        let mut losses = Losses::default();
        let (here, up) = (Vector3::zeros(), Vector3::z());
        let moved = Felt {
            moved: true,
            ..Felt::default()
        };
        // A tool that bounces where it lands shows nothing of the slope.
        losses.count(&here, &up, &Felt::default());
        losses.count(&here, &up, &moved);
        losses.count(&here, &up, &moved);
        assert_eq!(losses.slid(), (2, 0));
        losses.felt_around();
        assert_eq!(losses.slid(), (0, 1));
        assert_eq!(losses.speed_share(&here), 1.0);
        assert_eq!(losses.count(&here, &up, &moved), 1);
        losses.count(&(here + Vector3::x() * 0.02), &up, &moved);
        assert_eq!(losses.slid(), (1, 0));
    }

    #[test]
    fn a_normal_that_turns_away_at_the_place_of_a_loss_shows_a_rim() {
        let mut losses = Losses::default();
        let (here, there) = (Vector3::zeros(), Vector3::x() * 0.02);
        let up = Vector3::z();
        let turned = |rad: f64| Vector3::new(rad.sin(), 0.0, rad.cos());
        assert!(!losses.turns_away(&here, &turned(1.2)));
        losses.count(&here, &up, &Felt::default());
        assert!(!losses.turns_away(&here, &turned(0.8)));
        // Bit by bit, over losses at the same place.
        losses.count(&here, &turned(0.8), &Felt::default());
        assert!(losses.turns_away(&here, &turned(1.0)));
        assert!(!losses.turns_away(&there, &turned(1.0)));
    }

    #[test]
    fn a_wall_straight_below_a_loss_is_no_surface_that_goes_on() {
        let below = |aside: f64, deeper: f64| Vector3::new(aside, 0.0, -deeper);
        let turned = |rad: f64| Vector3::new(rad.sin(), 0.0, rad.cos());
        let mut losses = Losses::default();
        losses.count(&Vector3::zeros(), &Vector3::z(), &Felt::default());
        assert!(losses.turns_away(&below(5e-3, 0.022), &turned(1.2)));
        // Soft ground; a bend; somewhere else.
        assert!(!losses.turns_away(&below(5e-3, 0.022), &turned(1.0)));
        assert!(!losses.turns_away(&below(0.014, 0.022), &turned(1.2)));
        assert!(!losses.turns_away(&below(5e-3, 0.04), &turned(1.2)));
        // Losses on the way down are losses at the same rim.
        losses.count(&below(4e-3, 0.012), &turned(0.5), &Felt::default());
        assert!(losses.turns_away(&below(5e-3, 0.022), &turned(1.2)));
        losses.slides_on(1.0);
        assert!(!losses.turns_away(&below(5e-3, 0.025), &turned(1.2)));
    }

    #[test]
    fn a_tool_that_fell_down_a_step_and_explores_there_is_on_the_surface() {
        let (up, below) = (Vector3::z(), Vector3::z() * -1.4e-3);
        let turned = |rad: f64| Vector3::new(rad.sin(), 0.0, rad.cos());
        let explored = |normal: &Vector3<f64>, time_s: f64| {
            let mut losses = Losses::default();
            losses.count(&Vector3::zeros(), &up, &Felt::default());
            losses.explores(normal, time_s);
            losses
        };
        // A first touch there may be that of a rim.
        assert!(explored(&up, 1.0).is_beside(&below, &up));
        assert!(!explored(&turned(0.07), 2.1).is_beside(&below, &up));
        // The normal of a rim is another one.
        assert!(explored(&turned(0.4), 20.0).is_beside(&below, &up));
    }

    #[test]
    fn a_touch_whose_force_did_not_grow_was_none_but_not_for_ever() {
        let mut felt = Felt::default();
        felt.add(0.4, 0.1, 0.1);
        felt.add(0.2, 0.1, 0.1);
        let mut touch = Touch::default();
        let none = (0..12)
            .map(|_| touch.was_none(&felt, 0.6))
            .collect::<Vec<_>>();
        assert_eq!(none.iter().filter(|none| **none).count(), 11);
        assert!(!none[10]);
        felt.add(0.7, 0.1, 0.1);
        assert!(!touch.was_none(&felt, 0.6));
    }

    #[test]
    fn a_rim_holds_the_tool_aside_or_lets_it_in() {
        let (up, mut pressing, mut aside) = (Vector3::z(), Felt::default(), Felt::default());
        pressing.add(2.0, 0.8, 0.1);
        aside.add(0.4, 0.8, 0.1);
        let rim = |felt: &Felt, step_m: f64| {
            let mut losses = Losses::default();
            for k in 0..6 {
                losses.count(&(-up * step_m * f64::from(k)), &up, felt);
            }
            losses.is_rim()
        };
        assert!(!rim(&pressing, 1e-5));
        assert!(rim(&pressing, 5e-4));
        assert!(rim(&aside, 0.0));
    }
}
