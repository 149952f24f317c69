//! The force/torque sensor's records of one arm period. The sensor has its own clock.

use nalgebra::Vector6;

use super::fault::FaultySensor;
use super::force_torque::Sensor;
use super::force_torque::SensorConfig;
use super::sample::SensorSample;
use crate::hardware_errors::WrenchDistortion;

/// Sensor with its clock and the records of the current period.
#[derive(Clone, Debug)]
pub(crate) struct SensorRecords {
    sensor: Sensor,
    fault: Option<FaultySensor>,
    distortion: Option<WrenchDistortion>,
    rate_hz: f64,
    records: Vec<SensorSample>,
    taken: u64,
    /// True wrench on the sensor at the end of the last sub-step.
    wrench: Vector6<f64>,
}

impl SensorRecords {
    /// `wrench` (N, Nm, sensor axes) is the initial wrench on the sensor.
    pub fn new(config: &SensorConfig, period_s: f64, seed: u64, wrench: Vector6<f64>) -> Self {
        Self {
            sensor: Sensor::new(config, seed),
            fault: config
                .fault
                .map(|fault| FaultySensor::new(fault, config.rate_hz)),
            distortion: None,
            rate_hz: config.rate_hz,
            records: Vec::with_capacity((period_s * config.rate_hz).ceil() as usize + 1),
            taken: 0,
            wrench,
        }
    }

    /// Distorts the load before the gauges measure it.
    pub fn distort_with(&mut self, distortion: Option<WrenchDistortion>) {
        self.distortion = distortion;
    }

    /// Sets the speed of the flange, m/s.
    pub fn set_speed(&mut self, speed: f64) {
        if let Some(distortion) = &mut self.distortion {
            distortion.set_speed(speed);
        }
    }

    /// Starts a period.
    pub fn clear(&mut self) {
        self.records.clear();
    }

    /// One sub-step of `dt` (s), at the end of which `wrench` acts on the sensor. Between sub-steps
    /// the wrench is interpolated linearly.
    pub fn advance(&mut self, time_before: f64, dt: f64, wrench: Vector6<f64>) {
        let time_after = time_before + dt;
        loop {
            let time = (self.taken + 1) as f64 / self.rate_hz;
            if time > time_after + 1e-9 {
                break;
            }
            let share = ((time - time_before) / dt).clamp(0.0, 1.0);
            let mut between = self.wrench + (wrench - self.wrench) * share;
            if let Some(distortion) = &mut self.distortion {
                between = distortion.distort(time, &between);
            }
            if self.records.len() < self.records.capacity() {
                self.records.push(match &mut self.fault {
                    Some(faulty) => {
                        let load = faulty.load(time, &between);
                        faulty.distort(self.sensor.read(time, &load))
                    }
                    None => self.sensor.read(time, &between),
                });
            }
            self.taken += 1;
        }
        self.wrench = wrench;
    }

    /// Sets the wrench without interpolation, as after a teleport.
    pub fn set_wrench(&mut self, wrench: Vector6<f64>) {
        self.wrench = wrench;
    }

    /// Records of the current period, oldest first.
    pub fn records(&self) -> &[SensorSample] {
        &self.records
    }

    /// Current true wrench, N and Nm, sensor axes.
    pub fn wrench(&self) -> Vector6<f64> {
        self.wrench
    }

    /// Current zero of the sensor, N and Nm.
    pub fn bias(&self, time_s: f64) -> Vector6<f64> {
        self.sensor.bias(time_s)
    }
}
