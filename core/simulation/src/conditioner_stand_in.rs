//! Stand-in for the wrench conditioner of `core/sensing`, until that one is there.

use nalgebra::{UnitQuaternion, Vector3, Vector6};
use tangent_mechanics::{Base, Pose, Sensor, Tool, Wrench};
use tangent_sensing::Validity;

pub struct WrenchConditioner {
    mass: f64,
    com: Vector3<f64>,
    sensor_from_tool: Pose<Sensor, Tool>,
    cutoff_hz: f64,
    tare_s: f64,
    bias: Vector6<f64>,
    bias_at: Option<f64>,
    taring: Option<(Vector6<f64>, usize, f64)>,
    stages: [Vector6<f64>; 2],
    primed: bool,
}

pub struct ConditionedWrench {
    pub wrench: Wrench<Tool>,
    pub validity: Validity,
    pub delay_s: f64,
    pub bias_age_s: Option<f64>,
}

impl WrenchConditioner {
    pub fn new(
        mass: f64,
        com: [f64; 3],
        sensor_from_tool: Pose<Sensor, Tool>,
        cutoff_hz: f64,
        tare_s: f64,
    ) -> Self {
        Self {
            mass,
            com: Vector3::from(com),
            sensor_from_tool,
            cutoff_hz,
            tare_s,
            bias: Vector6::zeros(),
            bias_at: None,
            taring: None,
            stages: [Vector6::zeros(); 2],
            primed: false,
        }
    }

    pub fn tare(&mut self, now: f64) {
        if self.taring.is_none() {
            self.taring = Some((Vector6::zeros(), 0, now));
        }
    }

    pub fn update(
        &mut self,
        raw: &Vector6<f64>,
        saturated: bool,
        base_from_sensor: &UnitQuaternion<f64>,
        now: f64,
        dt: f64,
    ) -> ConditionedWrench {
        let _: Option<Base> = None;
        let g = base_from_sensor.inverse_transform_vector(&Vector3::new(0.0, 0.0, -9.80665))
            * self.mass;
        let t = self.com.cross(&g);
        let unloaded = raw - Vector6::new(g.x, g.y, g.z, t.x, t.y, t.z);
        if let Some((sum, n, since)) = &mut self.taring {
            *sum += unloaded;
            *n += 1;
            if now - *since >= self.tare_s {
                self.bias = *sum / *n as f64;
                self.bias_at = Some(now);
                self.taring = None;
            }
        }
        let value = unloaded - self.bias;
        let keep = (-std::f64::consts::TAU * self.cutoff_hz * dt).exp();
        if !self.primed {
            self.stages = [value; 2];
            self.primed = true;
        }
        self.stages[0] = self.stages[0] * keep + value * (1.0 - keep);
        self.stages[1] = self.stages[1] * keep + self.stages[0] * (1.0 - keep);
        let sensor: Wrench<Sensor> = Wrench::from_vector(&self.stages[1]);
        ConditionedWrench {
            wrench: self.sensor_from_tool.inverse().transform_wrench(&sensor),
            validity: if saturated {
                Validity::Saturated
            } else {
                Validity::Valid
            },
            delay_s: 2.0 / (std::f64::consts::TAU * self.cutoff_hz),
            bias_age_s: self.bias_at.map(|t| now - t),
        }
    }
}
