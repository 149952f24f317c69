//! `unified_force_impedance` in the service: tasks name estimators of the normal, and the camera's
//! normal is read too.

use arrayvec::ArrayVec;
use tangent_control::{
    Clearance, ControlError, EstimatorNames, UnifiedForceImpedance, UnifiedForceImpedanceConfig,
};
use tangent_runtime::{Bus, BusError};
use tangent_schemas::tangent::NormalEstimate;
use tangent_schemas::topics::{self, Topic};

use super::torque::ServedLaw;
use crate::config::torque::TorqueCell;
use crate::error::TaskRefusal;
use crate::inputs::{EstimateReader, Readers, VisionReader};

impl ServedLaw for UnifiedForceImpedanceConfig {
    type Law<const N: usize> = UnifiedForceImpedance<N>;

    type Estimate = NormalEstimate;

    fn law<const N: usize>(
        cell: &TorqueCell<Self, N>,
        clearance: Clearance,
    ) -> Result<Self::Law<N>, ControlError> {
        UnifiedForceImpedance::idle(
            cell.arm,
            cell.flange_from_tool,
            cell.limits,
            &cell.parameters(None)?,
            cell.setup,
            clearance,
        )
    }

    fn topic(estimator: &str) -> Topic<Self::Estimate> {
        topics::estimate_normal(estimator)
    }

    fn readers(bus: &Bus, estimators: &EstimatorNames) -> Result<Readers, BusError> {
        let mut normals = ArrayVec::new();
        for name in estimators {
            normals.push(EstimateReader::new(*name, bus.latest(&Self::topic(name))?));
        }
        Ok(Readers {
            normals,
            vision: Some(VisionReader::new(bus)?),
            ..Readers::default()
        })
    }

    fn silent(estimators: Vec<String>) -> TaskRefusal {
        TaskRefusal::NoNormal(estimators)
    }
}
