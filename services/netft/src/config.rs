//! Configuration of the service.

use std::time::Duration;

use tangent_mechanics::{Pose, Sensor, Tool};
use tangent_runtime::config::{SensorDriver, SensorMode, UrReading};
use tangent_runtime::{CellConfig, StateFolder};
use tangent_schemas::topics::ARM_WRENCH;
use tangent_sensing::{ConditioningConfig, Payload, TareConfig};

/// Rate of `wrench/tool` if the cell file states none, Hz: newer than 1 ms for any reader, with 7
/// kHz of input.
pub const TOOL_RATE_DEFAULT_HZ: f64 = 1000.0;
/// Requested socket buffer, bytes: room for well over a second of records at 7 kHz.
pub const SOCKET_BUFFER_BYTES: usize = 8 << 20;

/// Origin of the samples.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Driver {
    /// A Net F/T box, over RDT.
    Netft,
    /// A topic of the bus.
    Bus(BusSource),
}

/// Wrench that another service or program publishes on the bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BusSource {
    /// Key of the topic, relative to the cell.
    pub key: String,
    /// `frame_id` that every message must have; `None`: any.
    pub frame: Option<String>,
    /// Whether the sign has to be reversed.
    pub inverted: bool,
    /// Identity of the sensor, to which a stored zero belongs.
    pub owner: String,
    /// What to check if the topic is silent.
    pub remedy: &'static str,
}

/// Settings of one sensor, the parts that it carries, and the conditioning of its wrench.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Origin of the samples.
    pub driver: Driver,
    /// Host name or IP address of the box.
    pub address: String,
    /// UDP port of RDT.
    pub rdt_port: u16,
    /// TCP port of the box's web server.
    pub http_port: u16,
    /// Rate of records to which a box is set while the service runs, Hz, 1 to 7000; `None`: the box
    /// keeps its own setting.
    pub rate_asked_hz: Option<f64>,
    /// Rate of records that is expected until the sensor states its own, Hz.
    pub rate_hz: f64,
    /// Records per datagram, 1 to 40; `None`: one each, sent at once.
    pub buffer_records: Option<u8>,
    /// Largest rate of `wrench/tool`, Hz.
    pub tool_rate_hz: f64,
    /// Rate of `wrench/raw`, Hz; `None`: every record.
    pub raw_rate_hz: Option<f64>,
    /// Silence after which it is reported, and the stream requested again.
    pub patience: Duration,
    /// Loads beyond this range count as saturated even if the box does not report it: N, then Nm;
    /// x, y, z.
    pub range: [f64; 6],
    /// Pose of the tool in the sensor frame.
    pub sensor_from_tool: Pose<Sensor, Tool>,
    /// Mass and centre of mass of the parts that the sensor carries.
    pub payload: Payload,
    /// Filter, tare and gravity.
    pub conditioning: ConditioningConfig,
    /// SCHED_FIFO priority of the receiving thread; `None`: normal scheduling.
    pub realtime_priority: Option<u8>,
    /// Requested socket buffer, bytes.
    pub socket_buffer_bytes: usize,
    /// Folder in which the last good zero and the controller's last state are kept across restarts;
    /// `None`: not kept.
    pub state: Option<StateFolder>,
}

impl Config {
    /// Configuration from the cell file.
    pub fn from_cell(cell: &CellConfig) -> Self {
        let sensor = &cell.sensor;
        let ([fx, fy, fz], [tx, ty, tz]) = (sensor.force_range_n, sensor.torque_range_nm);
        // The robot has subtracted the payload that is set on its pendant.
        let compensated = sensor.ur_reading() == Some(UrReading::ActualTcpForce);
        Self {
            driver: driver(cell),
            address: sensor.address.clone(),
            rdt_port: sensor.rdt_port + sensor.port_offset,
            http_port: sensor.http_port + sensor.port_offset,
            rate_asked_hz: sensor.rate_stated_hz(),
            rate_hz: sensor.rate_max_hz(),
            buffer_records: match sensor.mode {
                SensorMode::Realtime => None,
                SensorMode::Buffered => Some(sensor.buffer_records),
            },
            raw_rate_hz: (sensor.raw_rate_hz > 0.0).then_some(sensor.raw_rate_hz),
            tool_rate_hz: if sensor.tool_rate_hz > 0.0 {
                sensor.tool_rate_hz
            } else {
                TOOL_RATE_DEFAULT_HZ
            },
            patience: Duration::from_secs_f64(sensor.patience_s),
            range: [fx, fy, fz, tx, ty, tz],
            sensor_from_tool: sensor.flange_from_sensor().inverse() * cell.tool.flange_from_tool(),
            payload: Payload {
                mass_kg: if compensated { 0.0 } else { cell.tool.mass_kg },
                com_in_sensor_m: cell.tool.com_in_sensor_m,
                inertia_kg_m2: [0.0; 3],
            },
            conditioning: ConditioningConfig {
                filter_cutoff_hz: sensor.filter_cutoff_hz,
                gravity_in_base_m_per_s2: cell.robot.gravity_in_base_m_per_s2,
                tare: TareConfig {
                    jump_max_n: sensor.zero_jump_max_n,
                    jump_max_nm: sensor.zero_jump_max_nm,
                    drift_n_per_min: sensor.zero_drift_n_per_min,
                    drift_nm_per_min: sensor.zero_drift_nm_per_min,
                    rated: Some([fx, fy, fz, tx, ty, tz]),
                    rated_share_max: sensor.zero_share_max,
                    ..tare_limits(sensor.driver)
                },
                ..ConditioningConfig::default()
            },
            realtime_priority: cell
                .realtime
                .enabled
                .then_some(cell.realtime.sensor_priority),
            socket_buffer_bytes: SOCKET_BUFFER_BYTES,
            state: StateFolder::of_cell(cell),
        }
    }
}

fn driver(cell: &CellConfig) -> Driver {
    let sensor = &cell.sensor;
    match (sensor.driver, &sensor.topic) {
        (SensorDriver::Ur, _) => {
            let reading = sensor.ur_reading().unwrap_or_default();
            Driver::Bus(BusSource {
                key: ARM_WRENCH.key().to_owned(),
                frame: None,
                inverted: false,
                owner: format!("{} of {}", reading.field(), cell.robot.address),
                remedy: "is the service `rtde` running with the same cell file, and connected to the robot?",
            })
        }
        (SensorDriver::Topic, Some(topic)) => Driver::Bus(BusSource {
            key: topic.key.clone(),
            frame: (!topic.frame.is_empty()).then(|| topic.frame.clone()),
            inverted: topic.inverted,
            owner: topic.key.clone(),
            remedy: "is the program that publishes it running, in this cell's namespace?",
        }),
        _ => Driver::Netft,
    }
}

/// Noise that a tare accepts. The sensor of an e-Series arm has several times the noise of the
/// others.
fn tare_limits(driver: SensorDriver) -> TareConfig {
    match driver {
        SensorDriver::Ur => TareConfig {
            force_std_max_n: 1.0,
            torque_std_max_nm: 0.1,
            force_change_max_n: 0.4,
            torque_change_max_nm: 0.04,
            ..TareConfig::default()
        },
        _ => TareConfig::default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(driver: &str) -> CellConfig {
        let title = "the test's cell";
        CellConfig::default_cell()
            .changed(title, |table| {
                let mut sensor: toml::Table = driver.parse().expect("TOML");
                let own = table["sensor"].as_table().expect("a table");
                for key in ["force_range_n", "torque_range_nm"] {
                    sensor.insert(key.to_owned(), own[key].clone());
                }
                table.insert("sensor".to_owned(), sensor.into());
            })
            .expect("a cell file")
    }

    #[test]
    fn a_compensated_reading_carries_no_payload() {
        let raw = Config::from_cell(&cell("driver = \"ur\"\nrate_hz = 500.0"));
        assert!(raw.payload.mass_kg > 0.0);
        let text = "driver = \"ur\"\nrate_hz = 500.0\nur = { reading = \"actual_TCP_force\" }";
        let compensated = Config::from_cell(&cell(text));
        assert_eq!(compensated.payload.mass_kg, 0.0);
        // A zero of one reading is not that of the other.
        let owner = |config: &Config| match &config.driver {
            Driver::Bus(source) => source.owner.clone(),
            Driver::Netft => String::new(),
        };
        assert_ne!(owner(&raw), owner(&compensated));
        assert!(raw.conditioning.tare.force_std_max_n > TareConfig::default().force_std_max_n);
    }

    #[test]
    fn without_a_driver_it_is_the_box() {
        let config = Config::from_cell(&CellConfig::default_cell());
        assert_eq!(config.driver, Driver::Netft);
        assert_eq!(
            config.conditioning.tare.force_std_max_n,
            TareConfig::default().force_std_max_n
        );
    }
}
