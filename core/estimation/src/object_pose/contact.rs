//! When the tool touches, and which way the force points: eq. (18).

use nalgebra::Vector3;

use super::{ContactNoiseConfig, ObjectSample};

/// What the force tells in one cycle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Touch {
    /// n_h of eq. (18), base axes.
    pub direction: Vector3<f64>,
    /// N
    pub force_n: f64,
}

/// Whether the tool touches, with a hysteresis.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TouchDetector {
    touching: bool,
}

impl TouchDetector {
    /// `normal` is the best guess of where the surface faces, base axes: a force across it is no pressing.
    pub fn step(
        &mut self,
        config: &ContactNoiseConfig,
        sample: &ObjectSample,
        normal: &Vector3<f64>,
    ) -> Option<Touch> {
        let force = sample.base_from_tool.rotate(&sample.wrench.force);
        let usable = sample.wrench_validity.is_valid() && force.iter().all(|x| x.is_finite());
        let threshold = if self.touching {
            config.force_off_n
        } else {
            config.force_on_n
        };
        self.touching = usable && force.dot(normal) >= threshold;
        self.touching.then(|| {
            let force_n = force.norm();
            Touch {
                direction: force / force_n,
                force_n,
            }
        })
    }

    pub fn touching(&self) -> bool {
        self.touching
    }
}
