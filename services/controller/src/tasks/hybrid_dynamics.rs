//! `hybrid_dynamics` in the service: tasks name estimators of an object's pose.

use arrayvec::ArrayVec;
use tangent_control::{
    Clearance, ControlError, EstimatorNames, HybridDynamics, HybridDynamicsConfig,
};
use tangent_runtime::{Bus, BusError};
use tangent_schemas::tangent::ObjectEstimate;
use tangent_schemas::topics::{self, Topic};

use super::torque::ServedLaw;
use crate::config::torque::TorqueCell;
use crate::error::TaskRefusal;
use crate::inputs::{ObjectReader, Readers};

impl ServedLaw for HybridDynamicsConfig {
    type Law<const N: usize> = HybridDynamics<N>;

    type Estimate = ObjectEstimate;

    fn law<const N: usize>(
        cell: &TorqueCell<Self, N>,
        clearance: Clearance,
    ) -> Result<Self::Law<N>, ControlError> {
        HybridDynamics::idle(
            cell.arm,
            cell.flange_from_tool,
            cell.limits,
            &cell.parameters(None)?,
            Box::new(cell.setup),
            clearance,
        )
    }

    fn topic(estimator: &str) -> Topic<Self::Estimate> {
        topics::estimate_object(estimator)
    }

    fn readers(bus: &Bus, estimators: &EstimatorNames) -> Result<Readers, BusError> {
        let mut objects = ArrayVec::new();
        for name in estimators {
            objects.push(ObjectReader::new(*name, bus.latest(&Self::topic(name))?));
        }
        Ok(Readers {
            objects,
            ..Readers::default()
        })
    }

    fn silent(estimators: Vec<String>) -> TaskRefusal {
        TaskRefusal::NoObject(estimators)
    }
}
