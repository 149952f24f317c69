//! What the service is told at its start.

use std::time::Duration;

use tangent_mechanics::{Pose, Sensor, Tool};
use tangent_runtime::config::SensorMode;
use tangent_runtime::{CellConfig, StateFolder};
use tangent_sensing::{ConditioningConfig, Payload, TareConfig};

/// `wrench/tool` per second where the cell file leaves it open: fresher than 1 ms for any reader,
/// at 7 kHz in.
pub const TOOL_RATE_DEFAULT_HZ: f64 = 1000.0;
/// Socket buffer asked for: room for well over a second of records at 7 kHz.
pub const SOCKET_BUFFER_BYTES: usize = 8 << 20;

/// One box, what hangs on its sensor, and how its wrench is conditioned.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Host name or IP address of the box.
    pub address: String,
    /// UDP port of RDT.
    pub rdt_port: u16,
    /// TCP port of its web server.
    pub http_port: u16,
    /// Records per second asked for, 1 to 7000.
    pub rate_hz: f64,
    /// Records per datagram, 1 to 40; none: one each, at once.
    pub buffer_records: Option<u8>,
    /// `wrench/tool` per second at most.
    pub tool_rate_hz: f64,
    /// `wrench/raw` per second; `None`: every record.
    pub raw_rate_hz: Option<f64>,
    /// Silence for this long is reported, and the stream asked for again.
    pub patience: Duration,
    /// Loads beyond count as saturated even when the box does not say so: N, then Nm; x, y, z.
    pub range: [f64; 6],
    /// Where the tool sits, seen from the sensor.
    pub sensor_from_tool: Pose<Sensor, Tool>,
    /// What the sensor carries.
    pub payload: Payload,
    /// Filter, tare and gravity.
    pub conditioning: ConditioningConfig,
    /// SCHED_FIFO priority of the receiving thread; none: normal scheduling.
    pub realtime_priority: Option<u8>,
    /// Socket buffer asked for, bytes.
    pub socket_buffer_bytes: usize,
    /// Where the last good zero and the controller's last word are kept over restarts; none:
    /// nowhere.
    pub state: Option<StateFolder>,
}

impl Config {
    /// From the cell file.
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
