//! The route of a lift above the surface, and the state of the lift.

use nalgebra::{UnitVector3, Vector3};

use crate::task::profile::Profile;

/// A way above the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Route {
    pub from: Vector3<f64>,
    pub to: Vector3<f64>,
    pub from_normal: Vector3<f64>,
    pub to_normal: Vector3<f64>,
    /// Height of the middle of the route above the straight line, m.
    pub bulge_m: f64,
    /// Where the next stroke begins on the surface, m.
    pub lands: Vector3<f64>,
    pub profile: Profile,
    pub time_s: f64,
}

impl Route {
    /// Place and normal at a time of the route.
    pub fn at(&self, time_s: f64) -> (Vector3<f64>, Vector3<f64>) {
        let (share, _) = self.profile.at(time_s);
        let (a, b) = (self.from_normal, self.to_normal);
        let normal = UnitVector3::new_normalize(a)
            .try_slerp(&UnitVector3::new_normalize(b), share, 1e-9)
            .map_or(a, |n| n.into_inner());
        let bulge = 4.0 * share * (1.0 - share) * self.bulge_m;
        (self.from.lerp(&self.to, share) + normal * bulge, normal)
    }
}

/// State of a lift. A new one is the reset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lifting {
    pub stage: Stage,
    /// Where the present way off begins, m.
    pub from: Vector3<f64>,
    pub climbs: u32,
    /// Time on the path's clock at which the tool lands, s, if it passes over something in the way;
    /// `None`: it lands at the next stroke.
    pub past_s: Option<f64>,
    /// Force along the surface at the start of a way over something, N: it lets go.
    pub held_n: f64,
    /// Whether the surface was felt near the landing.
    pub knows_landing: bool,
}

impl Lifting {
    /// Whether the tool is on its route above the surface.
    pub fn is_over(&self) -> bool {
        matches!(self.stage, Stage::Over(_))
    }

    pub fn idle() -> Self {
        Self {
            stage: Stage::Off,
            from: Vector3::zeros(),
            climbs: 0,
            past_s: None,
            held_n: 0.0,
            knows_landing: false,
        }
    }
}

/// Where a lift is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Stage {
    /// Off the surface, along the normal.
    Off,
    /// Above the surface, waiting for its route.
    Above,
    /// On its route.
    Over(Route),
}
