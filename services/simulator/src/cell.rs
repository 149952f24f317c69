//! The UR cell: a controller and a Net F/T box around one plant.

use tangent_simulated_netft::{NetbBox, NetbError};
use tangent_simulated_ur::{Listeners, Place, SimulatedUr, StartError};
use tangent_simulation::{AdmittancePlant, PlantError};

use crate::config::Config;

/// Why a cell cannot start.
#[derive(Debug, thiserror::Error)]
pub enum CellError {
    /// The plant's configuration is wrong.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The controller cannot start.
    #[error(transparent)]
    Controller(#[from] StartError),
    /// The sensor box cannot start.
    #[error(transparent)]
    SensorBox(#[from] NetbError),
    /// The periods of plant and controller differ.
    #[error(
        "the plant steps {plant_s} s, but this controller's period is {controller_s} s; set plant.arm.period_s or controller.flavour"
    )]
    Period {
        /// Period of the plant as configured, s.
        plant_s: f64,
        /// Period of the controller's flavour, s.
        controller_s: f64,
    },
}

/// A running cell. Dropping it stops it.
pub struct SimulatedCell {
    robot: SimulatedUr,
    sensor_box: NetbBox,
}

impl SimulatedCell {
    /// Builds the plant and starts all threads and servers.
    ///
    /// # Errors
    /// A part of the configuration is wrong, or a port is taken; the error says which.
    pub fn start(config: &Config) -> Result<Self, CellError> {
        Self::start_with(config, Listeners::default())
    }

    /// Builds the plant and starts all threads and servers. `listeners` get the state of every
    /// cycle; the sensor's records go to the box.
    ///
    /// # Errors
    /// As [`SimulatedCell::start`].
    pub fn start_with(config: &Config, listeners: Listeners) -> Result<Self, CellError> {
        let plant = AdmittancePlant::new(&config.plant, config.seed)?;
        Self::start_around(plant, config, listeners)
    }

    /// As [`SimulatedCell::start_with`], around `plant`.
    pub(crate) fn start_around(
        plant: AdmittancePlant,
        config: &Config,
        listeners: Listeners,
    ) -> Result<Self, CellError> {
        let (plant_s, controller_s) = (plant.period_s(), config.controller.flavour.period_s());
        if (plant_s - controller_s).abs() > 1e-9 {
            return Err(CellError::Period {
                plant_s,
                controller_s,
            });
        }
        let sensor_box = NetbBox::for_sensor(
            config.address,
            config.ports,
            &config.plant.sensor,
            config.realtime_priority,
        )?;
        let robot = SimulatedUr::start(
            Place {
                address: config.address,
                ports: config.ports,
                realtime_priority: config.realtime_priority,
            },
            &config.controller,
            &config.plant.robot,
            Box::new(plant),
            Listeners {
                records: Some(sensor_box.listener()),
                ..listeners
            },
        )?;
        Ok(Self { robot, sensor_box })
    }

    /// The controller: its endpoints, its state, and faults on request.
    pub fn robot(&self) -> &SimulatedUr {
        &self.robot
    }

    /// The force/torque sensor box.
    pub fn sensor_box(&self) -> &NetbBox {
        &self.sensor_box
    }
}
