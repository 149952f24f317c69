//! Friction of one pad point.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Friction per pad point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FrictionConfig {
    /// `none`, `coulomb` or `lugre`.
    pub model: FrictionModel,
    /// Sliding friction coefficient.
    pub coulomb_coefficient: f64,
    /// Static friction coefficient.
    pub static_coefficient: f64,
    /// Stribeck speed, m/s.
    pub stribeck_m_per_s: f64,
    /// Viscous part, per unit of normal force, s/m.
    pub viscous_s_per_m: f64,
    /// LuGre bristle stiffness per unit of normal force, 1/m.
    pub bristle_stiffness_per_m: f64,
    /// LuGre bristle damping per unit of normal force, s/m.
    pub bristle_damping_s_per_m: f64,
}

impl Default for FrictionConfig {
    fn default() -> Self {
        Self {
            model: FrictionModel::Lugre,
            coulomb_coefficient: 0.25,
            static_coefficient: 0.3,
            stribeck_m_per_s: 0.003,
            viscous_s_per_m: 0.0,
            bristle_stiffness_per_m: 3_000.0,
            bristle_damping_s_per_m: 2.0,
        }
    }
}

/// Friction law.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FrictionModel {
    /// Frictionless.
    None,
    /// Coulomb friction with the Stribeck effect, as a steep line through zero speed.
    Coulomb,
    /// Bristle model: sticks, and creeps before it slips (Canudas de Wit et al. 1995).
    #[default]
    Lugre,
}

/// LuGre (Canudas de Wit, Olsson, Åström, Lischinsky 1995) scaled by the normal force, or Coulomb
/// with Stribeck:
///
/// ```text
/// z' = v - |v| s0 / g(v) z        g(v) = mu_c + (mu_s - mu_c) exp(-(v / v_s)²)
/// F  = -N (s0 z + s1(v) z' + s2 v)       s1(v) = s1 exp(-(v / v_s)²), which keeps it passive
/// ```
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_simulation::contact::{Friction, FrictionConfig};
///
/// // 20 mm/s under a load of 10 N, with the default coefficient of 0.25.
/// let friction = Friction::new(&FrictionConfig::default());
/// let velocity = Vector3::new(0.02, 0.0, 0.0);
/// let mut bristle = Vector3::zeros();
/// let mut last = Vector3::zeros();
/// for _ in 0..200 {
///     last = friction.step(&mut bristle, &Vector3::z(), &velocity, 10.0, 0.001).force;
/// }
/// assert!((last - Vector3::new(-2.5, 0.0, 0.0)).norm() < 0.01);
/// ```
#[derive(Clone, Debug)]
pub struct Friction {
    config: FrictionConfig,
}

/// Friction of one point, with its derivative for an implicit step.
#[derive(Clone, Copy, Debug)]
pub struct FrictionForce {
    /// Force in the tangent plane, N.
    pub force: Vector3<f64>,
    /// Upper bound of -dF/dv, Ns/m.
    pub damping: f64,
}

impl Friction {
    /// Friction with the coefficients of the scenario.
    pub fn new(config: &FrictionConfig) -> Self {
        Self {
            config: config.clone(),
        }
    }

    /// Steady sliding coefficient at a speed (m/s), without the viscous part.
    pub fn coefficient(&self, speed: f64) -> f64 {
        self.level(self.stribeck(speed))
    }

    /// `exp(-(v / v_s)²)`: 1 at rest, 0 when sliding.
    fn stribeck(&self, speed: f64) -> f64 {
        let ratio = speed / self.config.stribeck_m_per_s;
        // Beyond six times the Stribeck speed, as in most of a wipe, the term is below the last
        // digit.
        if ratio > 6.1 {
            0.0
        } else {
            (-ratio * ratio).exp()
        }
    }

    fn level(&self, stribeck: f64) -> f64 {
        let c = &self.config;
        c.coulomb_coefficient + (c.static_coefficient - c.coulomb_coefficient) * stribeck
    }

    /// One step of `dt` (s): `bristle` (m) is the point's state, `velocity` (m/s) its sliding
    /// velocity in the tangent plane of `normal`, `load` its normal force (N).
    pub fn step(
        &self,
        bristle: &mut Vector3<f64>,
        normal: &Vector3<f64>,
        velocity: &Vector3<f64>,
        load: f64,
        dt: f64,
    ) -> FrictionForce {
        let c = &self.config;
        let speed = velocity.norm();
        let stribeck = self.stribeck(speed);
        let slide = self.level(stribeck);
        match c.model {
            FrictionModel::None => {
                return FrictionForce {
                    force: Vector3::zeros(),
                    damping: 0.0,
                };
            }
            FrictionModel::Coulomb => {
                // The line through zero speed is steep enough to reach the friction cone at a tenth
                // of the Stribeck speed.
                let steepest = c.static_coefficient / (0.1 * c.stribeck_m_per_s);
                let slope = steepest.min(slide / speed.max(1e-12));
                return FrictionForce {
                    force: velocity * (-load * (slope + c.viscous_s_per_m)),
                    damping: load * (slope + c.viscous_s_per_m),
                };
            }
            FrictionModel::Lugre => {}
        }
        // The bristle turns with the surface, and is integrated exactly over a step of constant
        // velocity.
        *bristle -= normal * normal.dot(bristle);
        let before = *bristle;
        if speed > 1e-12 {
            let steady = velocity * (slide / (c.bristle_stiffness_per_m * speed));
            let rate = c.bristle_stiffness_per_m * speed / slide;
            *bristle = steady + (before - steady) * (-rate * dt).exp();
        }
        let bristle_rate = (*bristle - before) / dt;
        let damping = c.bristle_damping_s_per_m * stribeck;
        let mut friction = -(*bristle * c.bristle_stiffness_per_m + bristle_rate * damping);
        // Bristle damping must not move a transient out of the friction cone.
        let size = friction.norm();
        let limit = c.static_coefficient.max(c.coulomb_coefficient);
        if size > limit {
            friction *= limit / size;
        }
        let slope = (c.bristle_stiffness_per_m * dt + damping).min(slide / speed.max(1e-12));
        FrictionForce {
            force: (friction - velocity * c.viscous_s_per_m) * load,
            damping: load * (slope + c.viscous_s_per_m),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn steady_sliding_reaches_the_stribeck_curve() {
        let friction = Friction::new(&FrictionConfig::default());
        for speed in [0.0005, 0.002, 0.02] {
            let mut bristle = Vector3::zeros();
            let velocity = Vector3::new(speed, 0.0, 0.0);
            let mut force = Vector3::zeros();
            for _ in 0..20_000 {
                force = friction
                    .step(&mut bristle, &Vector3::z(), &velocity, 3.0, 1e-3)
                    .force;
            }
            assert!((force.x + 3.0 * friction.coefficient(speed)).abs() < 1e-9);
        }
    }

    #[test]
    fn a_resting_point_holds_its_presliding_force() {
        let config = FrictionConfig::default();
        let friction = Friction::new(&config);
        let mut bristle = Vector3::new(2e-5, 0.0, 0.0);
        let force = friction
            .step(&mut bristle, &Vector3::z(), &Vector3::zeros(), 2.0, 1e-3)
            .force;
        assert!((force.x + 2.0 * config.bristle_stiffness_per_m * 2e-5).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn it_stays_in_the_cone_and_in_the_tangent_plane(
            moves in prop::collection::vec((-0.05f64..0.05, -0.05f64..0.05, 0.0f64..20.0), 1..200)) {
            let config = FrictionConfig::default();
            let friction = Friction::new(&config);
            let mut bristle = Vector3::zeros();
            for (x, y, load) in moves {
                let velocity = Vector3::new(x, y, 0.0);
                let f = friction.step(&mut bristle, &Vector3::z(), &velocity, load, 1e-3).force;
                prop_assert!(f.norm() <= config.static_coefficient * load + 1e-12);
                prop_assert!(f.z == 0.0);
            }
        }
    }
}
