//! Motion of the tool along the surface, and of its tip, which follows it late.

use nalgebra::Vector3;

/// Time constant of the rate at which the direction of sliding turns, s.
const RATE_TIME_S: f64 = 0.05;
/// Share of the angle between the tip's direction and the tool's by which the former may be wrong,
/// beside the error of the compliance, which is a state.
const BEND_DOUBT: f64 = 0.3;
/// Length of the tip's direction from which the tip slides, and no longer sticks.
const FOLLOWED: f64 = 0.7;
/// Cosine of the turn of the sliding direction beyond which presliding starts again. Friction
/// follows a gentler turn without it.
const TURN_COS_MIN: f64 = 0.5;

/// Motion along the surface.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Slide {
    /// Unit direction of sliding in the tangent plane, world axes; zero before the tool has slid.
    pub direction: Vector3<f64>,
    /// Distance slid since the last stop or turn, m.
    pub distance_m: f64,
    /// Direction in which the tip slides, world axes: follows its motion over the presliding
    /// distance, and is shorter than one until it has.
    pub tip_direction: Vector3<f64>,
    /// Derivative of the tip's direction by the compliance across the tool's axis, N/m.
    pub tip_by_give: Vector3<f64>,
    /// Force at the last sample, world axes, N.
    pub force_n: Option<Vector3<f64>>,
    /// Way since a height was measured, of a tool too slow to slide, world axes, m.
    pub crept_m: Vector3<f64>,
    /// Innovation of the height at the last sample, m.
    pub height_innovation_m: f64,
    /// Position (m) and force (N) at the last rest, world axes; `None` once the tip slides.
    pub rest: Option<(Vector3<f64>, Vector3<f64>)>,
    /// Turn rate of the sliding direction.
    pub turn_rate_rad_per_s: f64,
    /// Speed of the centre of pressure in the tangent plane.
    pub speed_m_per_s: f64,
}

impl Slide {
    /// Continues sliding with a tangential velocity at the present speed.
    pub fn go_on(&mut self, tangential: &Vector3<f64>, dt_s: f64) {
        let direction = tangential / self.speed_m_per_s;
        self.crept_m = Vector3::zeros();
        if self.distance_m > 0.0 {
            let turn = direction.cross(&self.direction).norm();
            self.turn_rate_rad_per_s +=
                (turn - self.turn_rate_rad_per_s * dt_s) / (RATE_TIME_S + dt_s);
        } else {
            self.turn_rate_rad_per_s = 0.0;
        }
        if direction.dot(&self.direction) < TURN_COS_MIN {
            self.distance_m = 0.0;
        }
        self.direction = direction;
        self.distance_m += self.speed_m_per_s * dt_s;
    }

    /// The tip's direction after its origin moved by `step` (tangent plane, m) under `force` (world
    /// axes, N). A tool that gives sideways bends before its tip follows; the change of the force
    /// shows by how much. `length_m` is the presliding distance.
    pub fn follow_tip(
        &mut self,
        step: &Vector3<f64>,
        force: &Vector3<f64>,
        give_across_m_per_n: f64,
        normal: &Vector3<f64>,
        length_m: f64,
    ) {
        let change = force - self.force_n.replace(*force).unwrap_or(*force);
        let bent = change - normal * normal.dot(&change);
        let moved = step + bent * give_across_m_per_n;
        let way = moved.norm();
        let way_by_give = if way > 0.0 {
            moved.dot(&bent) / way
        } else {
            0.0
        };
        self.tip_by_give +=
            (bent - self.tip_direction * way_by_give - self.tip_by_give * way) / (length_m + way);
        self.tip_direction += (moved - self.tip_direction * way) / (length_m + way);
        if self.tip_direction.norm() > FOLLOWED {
            self.rest = None;
        }
    }

    /// Uncertainty of the direction in which friction acts, rad.
    pub fn tip_direction_sd_rad(&self) -> f64 {
        let known = self.tip_direction.norm();
        let behind = 1.0 - self.tip_direction.dot(&self.direction) / known.max(1e-9);
        (1.0 - known).max(0.0) + BEND_DOUBT * (2.0 * behind.max(0.0)).sqrt()
    }
}
