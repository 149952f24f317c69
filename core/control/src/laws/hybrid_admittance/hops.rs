//! Touches beside a place where contact was lost again and again.
//!
//! A tool that slides off a surface whose slope it does not know feels nothing of that slope: on a
//! stiff contact with little force it has slid for a tenth of a millimetre. So it lifts off, and
//! touches the surface at the corners of a triangle around the place, without sliding; the heights
//! of these places show the slope to the estimator. Then it lands where it lost contact. Called by
//! the phase machine at a loss and after each touch, and by phase `lift`.

use nalgebra::{Rotation2, Vector2, Vector3};

/// Losses at one place after which the tool hops, and how often it does at that place.
const AFTER_LOSSES: u32 = 3;
const ROUNDS_MAX: u32 = 2;
/// Most rounds of one task: a tool that slips off everywhere does not wipe.
const ROUNDS_IN_ALL: u32 = 6;
/// Corners of the triangle.
const CORNERS: u32 = 3;
/// Height above the expected surface at which the tool moves across, as a share of the distance.
const LIFT_SHARE: f64 = 0.5;
/// Distance below the expected surface at which there is none, as a share of the distance: it is
/// steeper than 40 degrees there, or ends.
const BELOW_SHARE: f64 = 0.85;
/// How often the tool may slip off a corner before it goes on to the next.
const SLIPS_MAX: u8 = 2;
const SLOWER_FACTOR: f64 = 0.5;
/// Time for which the tool presses at a corner, s: twice what an estimator waits after a touch.
pub(crate) const PRESSED_S: f64 = 0.4;

/// Where a hop lands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Landing {
    /// Where contact was lost, m, base axes.
    pub place: Vector3<f64>,
    /// Displacement of the path's reference there, m, path's plane.
    pub aside: Vector2<f64>,
    /// Displacement from there, m along the surface, axes of the path's plane.
    pub offset: Vector2<f64>,
    /// Height above the expected surface at which the tool moves across, m.
    pub lift_m: f64,
}

/// State for one run. A new one is the reset.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Hops {
    round: Option<Round>,
    begun: u32,
}

/// A round of hops.
#[derive(Clone, Copy, Debug)]
struct Round {
    /// Where contact was lost, m, base axes, and the displacement of the path's reference there, m.
    place: Vector3<f64>,
    aside: Vector2<f64>,
    distance_m: f64,
    /// Corner to which the tool goes; [`CORNERS`] for the way back.
    corner: u32,
    /// How often contact was lost there.
    slips: u8,
}

impl Hops {
    /// Begins a round with this distance (m) if contact was lost at this place often enough while
    /// the tool moved along, and if there were not too many rounds there before.
    pub fn offer(
        &mut self,
        distance_m: f64,
        (lost, rounds): (u32, u32),
        place: &Vector3<f64>,
        aside: &Vector2<f64>,
    ) -> bool {
        let begins = distance_m > 0.0
            && self.round.is_none()
            && lost >= AFTER_LOSSES
            && rounds < ROUNDS_MAX
            && self.begun < ROUNDS_IN_ALL;
        if begins {
            self.begun += 1;
            self.round = Some(Round {
                place: *place,
                aside: *aside,
                distance_m,
                corner: 0,
                slips: 0,
            });
        }
        begins
    }

    /// Whether the tool is on its way to a corner, or back, or touches one.
    pub fn is_under_way(&self) -> bool {
        self.round.is_some()
    }

    /// Share of a speed towards the surface: less where the tool slipped off.
    pub fn speed_share(&self) -> f64 {
        self.round
            .map_or(1.0, |round| SLOWER_FACTOR.powi(i32::from(round.slips)))
    }

    /// Whether the tool is on its way to a corner, or touches one.
    pub fn is_on_the_way_out(&self) -> bool {
        self.round.is_some_and(|round| round.corner < CORNERS)
    }

    /// Records that the tool slipped off where it touched. Returns whether it goes on to the next
    /// corner, or back; on the way back, the round ends.
    pub fn slips(&mut self) -> bool {
        let Some(round) = &mut self.round else {
            return false;
        };
        round.slips += 1;
        round.slips > SLIPS_MAX && self.next()
    }

    /// Goes on from a touch to the next corner, or back. Returns false after the way back.
    pub fn next(&mut self) -> bool {
        match &mut self.round {
            Some(round) if round.corner < CORNERS => {
                round.corner += 1;
                round.slips = 0;
                true
            }
            _ => {
                self.round = None;
                false
            }
        }
    }

    /// Goes back: there was no surface at a corner. Returns false on the way back itself.
    pub fn turn_back(&mut self) -> bool {
        match &mut self.round {
            Some(round) if round.corner < CORNERS => {
                round.corner = CORNERS;
                round.slips = 0;
                true
            }
            _ => {
                self.round = None;
                false
            }
        }
    }

    /// Where the tool lands next.
    pub fn landing(&self) -> Option<Landing> {
        self.round.map(|round| Landing {
            place: round.place,
            aside: round.aside,
            offset: if round.corner < CORNERS {
                let angle = std::f64::consts::TAU * f64::from(round.corner) / f64::from(CORNERS);
                Rotation2::new(angle) * Vector2::new(round.distance_m, 0.0)
            } else {
                Vector2::zeros()
            },
            lift_m: LIFT_SHARE * round.distance_m,
        })
    }

    /// Distance of the search for the surface from the height of a hop down, m.
    pub fn seek_distance_m(&self) -> Option<f64> {
        self.round
            .map(|round| (LIFT_SHARE + BELOW_SHARE) * round.distance_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_round_touches_three_corners_and_ends_where_it_began() {
        let mut hops = Hops::default();
        let (place, aside) = (Vector3::x(), Vector2::zeros());
        assert!(!hops.offer(3e-3, (2, 0), &place, &aside));
        assert!(!hops.offer(0.0, (3, 0), &place, &aside));
        assert!(!hops.offer(3e-3, (3, 2), &place, &aside));
        assert!(hops.offer(3e-3, (3, 0), &place, &aside));
        let mut sum = Vector2::zeros();
        for _ in 0..CORNERS {
            let offset = hops.landing().unwrap().offset;
            assert!((offset.norm() - 3e-3).abs() < 1e-12);
            sum += offset;
            assert!(hops.next());
        }
        assert!(sum.norm() < 1e-12);
        assert_eq!(hops.landing().unwrap().offset, Vector2::zeros());
        assert!(!hops.next());
        assert!(!hops.is_under_way());
        assert!(hops.offer(3e-3, (3, 1), &place, &aside));
    }

    #[test]
    fn a_tool_that_slips_off_a_corner_tries_again_more_slowly_and_then_goes_on() {
        let mut hops = Hops::default();
        assert!(!hops.slips());
        hops.offer(3e-3, (3, 0), &Vector3::x(), &Vector2::zeros());
        let first = hops.landing();
        for _ in 0..SLIPS_MAX {
            let before = hops.speed_share();
            assert!(!hops.slips());
            assert!(hops.speed_share() < before);
        }
        assert_eq!(hops.landing(), first);
        assert!(hops.slips());
        assert_ne!(hops.landing(), first);
        assert_eq!(hops.speed_share(), 1.0);
    }

    #[test]
    fn a_task_has_a_bounded_number_of_rounds() {
        let mut hops = Hops::default();
        let mut begun = 0;
        for _ in 0..20 {
            begun += u32::from(hops.offer(3e-3, (3, 0), &Vector3::x(), &Vector2::zeros()));
            while hops.next() {}
        }
        assert_eq!(begun, ROUNDS_IN_ALL);
    }

    #[test]
    fn without_a_surface_at_a_corner_the_tool_goes_back_once() {
        let mut hops = Hops::default();
        hops.offer(3e-3, (3, 0), &Vector3::x(), &Vector2::zeros());
        assert!(hops.turn_back());
        assert_eq!(hops.landing().unwrap().offset, Vector2::zeros());
        assert!(!hops.turn_back());
        assert!(!hops.is_under_way());
    }
}
