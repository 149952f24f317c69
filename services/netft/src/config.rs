//! Configuration of the service.

use std::time::Duration;

use tangent_mechanics::{Pose, Sensor, Tool};
use tangent_runtime::config::SensorMode;
use tangent_runtime::{CellConfig, StateFolder};
use tangent_sensing::{ConditioningConfig, Payload, TareConfig};

/// Rate of `wrench/tool` if the cell file states none, Hz: newer than 1 ms for any reader, with 7
/// kHz of input.
pub const TOOL_RATE_DEFAULT_HZ: f64 = 1000.0;
/// Requested socket buffer, bytes: room for well over a second of records at 7 kHz.
pub const SOCKET_BUFFER_BYTES: usize = 8 << 20;

/// Settings of one box, the parts that its sensor carries, and the conditioning of its wrench.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Host name or IP address of the box.
    pub address: String,
    /// UDP port of RDT.
    pub rdt_port: u16,
    /// TCP port of the box's web server.
    pub http_port: u16,
    /// Requested rate of records, Hz, 1 to 7000.
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
        Self {
            address: sensor.address.clone(),
            rdt_port: sensor.rdt_port + sensor.port_offset,
            http_port: sensor.http_port + sensor.port_offset,
            rate_hz: sensor.rate_hz,
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
                mass_kg: cell.tool.mass_kg,
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
                    ..TareConfig::default()
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
