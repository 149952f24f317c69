//! Compliance of tool, wrist and surface: measured at touchdown, at the first motion across the
//! tool's axis, and doubted when the force on a soft tip changes.

use nalgebra::{Vector2, Vector3};
use tangent_mechanics::Tip;

use super::state::{
    COMPLIANCE_M_PER_N, Compliance, ContactFilterState, GIVE, HEIGHT, SurfaceState,
};
use crate::motion::Motion;

/// Largest compliance across the tool's axis over the one that was measured: a tip that slid
/// meanwhile moved further than its tool gave.
const ACROSS_MOST: f64 = 1.2;
/// Uncertainty of a compliance that was measured at touchdown, as a share of it.
const GIVE_DOUBT: f64 = 0.4;
/// Uncertainty of the compliance across the tool's axis, as a share of that along it.
const GIVE_ACROSS_DOUBT: f64 = 1.5;
/// Compliance across the axis and its standard deviation, as shares of the measured one, which is
/// an upper bound: the tip may have slid meanwhile.
const GIVE_ACROSS: (f64, f64) = (0.6, 0.4);
/// Change of the pressing force, as a share of it, with which a soft tip's compliance changes, and
/// the standard deviation of that change, as a share of the compliance, for a first force.
const STIFFENS_FROM: f64 = 0.1;
const STIFFENS: f64 = 0.55;
/// Assumed share of soft tips among those of unknown shape, by which the variance is weighted.
const SOFT_SHARE: f64 = 0.2;
/// Change of the force across from which that compliance is measured: share of the load, and N.
const ACROSS_SHARE: f64 = 0.15;
const ACROSS_MIN_N: f64 = 0.3;
/// Standard deviation of a height that is not known, m.
const HEIGHT_SD_M: f64 = 1e-3;

impl ContactFilterState {
    /// Measures the compliance: distance moved into the surface since touchdown, per force gained.
    pub(super) fn learn_compliance(&mut self, motion: &Motion, pressing_n: f64) {
        let gained_n = pressing_n - self.touch.force_n;
        if gained_n < 0.3 * pressing_n {
            return;
        }
        let z: Vector3<f64> = motion.rotation.column(2).into();
        let measured = (motion.point_lagged - self.touch.point).dot(&z) / gained_n;
        self.compliance = Compliance {
            m_per_n: measured.clamp(COMPLIANCE_M_PER_N.0, COMPLIANCE_M_PER_N.1),
            is_measured: true,
            ..self.compliance
        };
    }

    /// Widens the compliance along the axis of a tip that is soft, or may be, with a change of the
    /// pressing force of at least [`STIFFENS_FROM`].
    pub(super) fn stiffen(&mut self, tip: &Tip, force_min_n: f64) {
        let soft_share = match tip {
            Tip::Soft { .. } => 1.0,
            Tip::Unknown => SOFT_SHARE,
            Tip::Flat { .. } | Tip::Ring { .. } | Tip::Round { .. } => return,
        };
        let force_n = self.force_n.max(force_min_n);
        let change = (self.force_n - self.compliance.at_force_n).abs() / force_n;
        if change > STIFFENS_FROM {
            self.compliance.at_force_n = self.force_n;
            let deviation = STIFFENS * self.surface.give_m_per_n.x;
            self.surface.covariance[(GIVE, GIVE)] +=
                soft_share * deviation * deviation * change.min(1.0);
        }
    }

    /// Begins to measure heights over the surface: the tool starts to slide.
    pub(super) fn begin_heights(&mut self, motion: &Motion) {
        let normal = motion.rotation.tr_mul(&self.normal_at_centre());
        let force = self.force_in_tool(motion);
        let compliance = self.compliance;
        self.surface.begin_heights_with(
            compliance.m_per_n,
            compliance.is_measured,
            &normal,
            &force,
        );
        if let Some(across) = compliance.across_m_per_n {
            self.surface.set_give_across(across);
        }
    }

    /// Measures the compliance across the tool's axis: a tip that still sticks moves by nothing
    /// else, and one that slides moves further. The least motion per force counts.
    pub(super) fn learn_compliance_across(&mut self, motion: &Motion, load_n: f64) {
        let Some((point, force)) = self.slide.rest else {
            return;
        };
        let normal = self.surface.frame.normal;
        let across = |v: Vector3<f64>| (v - normal * normal.dot(&v)).norm();
        let gained_n = across(self.force(motion) - force);
        if gained_n < (ACROSS_SHARE * load_n).max(ACROSS_MIN_N) {
            return;
        }
        let measured = across(motion.point_lagged - point) / gained_n;
        let measured = measured.clamp(COMPLIANCE_M_PER_N.0, COMPLIANCE_M_PER_N.1);
        if self
            .compliance
            .across_m_per_n
            .is_some_and(|old| measured > 0.95 * old)
        {
            return;
        }
        self.compliance.across_m_per_n = Some(measured);
        self.surface.set_give_across(measured);
    }
}

impl SurfaceState {
    /// Begins to measure heights with the compliance found at touchdown: the tool stands on the
    /// surface under the force `force` (tool axes, N) and the normal `normal` (tool axes).
    fn begin_heights_with(
        &mut self,
        compliance_m_per_n: f64,
        is_measured: bool,
        normal: &Vector3<f64>,
        force: &Vector3<f64>,
    ) {
        self.give_m_per_n = Vector2::repeat(compliance_m_per_n);
        self.height_m = -self.give_m_per_n.dot(&given(normal, force));
        let doubt = if is_measured { GIVE_DOUBT } else { 1.0 };
        self.restart(HEIGHT, HEIGHT_SD_M.powi(2));
        self.restart(GIVE, (doubt * compliance_m_per_n).powi(2));
        self.restart(GIVE + 1, (GIVE_ACROSS_DOUBT * compliance_m_per_n).powi(2));
    }

    /// Sets the compliance across the tool's axis by a measurement, which includes the tip's own.
    fn set_give_across(&mut self, measured_m_per_n: f64) {
        let (share, sd) = GIVE_ACROSS;
        self.give_m_per_n.y = share * measured_m_per_n;
        self.give_across_most_m_per_n = (ACROSS_MOST * measured_m_per_n).min(COMPLIANCE_M_PER_N.1);
        self.restart(GIVE + 1, (sd * measured_m_per_n).powi(2));
    }
}

/// What the compliances along and across the tool's axis are multiplied by to give the motion of
/// the contact along the `normal` under `force`; both in tool axes.
pub(super) fn given(normal: &Vector3<f64>, force: &Vector3<f64>) -> Vector2<f64> {
    let along = normal.z * force.z;
    Vector2::new(along, normal.dot(force) - along)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::EstimatorConfig;

    const SOFT: Tip = Tip::Soft { radius_m: 0.01 };

    /// Standard deviation of the compliance along the tool's axis, as a share of it, after these
    /// pressing forces, N.
    fn doubt(tip: &Tip, forces_n: impl IntoIterator<Item = f64>) -> f64 {
        let mut state = ContactFilterState::new(&EstimatorConfig::default());
        for force_n in forces_n {
            state.force_n = force_n;
            state.stiffen(tip, 0.3);
        }
        state.surface.covariance[(GIVE, GIVE)].sqrt() / state.surface.give_m_per_n.x
    }

    #[test]
    fn a_growing_force_widens_a_soft_compliance_and_a_trembling_one_does_not() {
        let touched = doubt(&SOFT, [4.0]);
        let grown = doubt(&SOFT, (0..500).map(|i| 4.0 + 16.0 * f64::from(i) / 499.0));
        assert!((STIFFENS..2.0 * STIFFENS).contains(&grown), "{grown}");
        assert!(grown > 1.3 * touched, "{touched} {grown}");
        let trembled = doubt(&SOFT, (0..500).map(|i| if i % 2 == 0 { 4.0 } else { 4.3 }));
        assert_eq!(trembled, touched);
    }

    #[test]
    fn a_tip_of_unknown_shape_may_be_soft_and_a_hard_one_is_not() {
        let grown = |tip: &Tip| doubt(tip, [4.0, 20.0]);
        let hard = [
            Tip::Flat { radius_m: 0.01 },
            Tip::Ring { radius_m: 0.01 },
            Tip::Round { radius_m: 0.01 },
        ];
        for tip in hard {
            assert_eq!(grown(&tip), doubt(&tip, []), "{tip:?}");
        }
        let (hard, unknown, soft) = (grown(&hard[0]), grown(&Tip::Unknown), grown(&SOFT));
        let added = |doubt: f64| doubt.powi(2) - hard.powi(2);
        assert!((added(unknown) / added(soft) - SOFT_SHARE).abs() < 1e-9);
    }
}
