//! The steps to measure, and their inputs, which come from a whole simulated wipe.

use std::error::Error;
use std::hint::black_box;

use nalgebra::{UnitQuaternion, Vector3, Vector6};
use tangent_control::{ControlInput, Controller, Program};
use tangent_estimation::ContactSample;
use tangent_estimation::depth_normal::{
    DepthImage, DepthSample, ToolTarget, metres_from_millimetres,
};
use tangent_mechanics::{Base, Pose, Tool, Wrench};
use tangent_sensing::{
    Payload, Reading, SensorCondition, WrenchConditioner, WrenchConditionerState,
};
use tangent_simulation::depth_camera::{DepthCamera, DepthCameraConfig, DepthFrame};
use tangent_simulation::{
    AdmittancePlant, AdmittanceScenario, ObjectScenario, PoseConfig, ShapeConfig, Surface,
    VisuoTactileScenario,
};

const PIPE: &str = include_str!("../../../scenarios/pipe_realistic.toml");
const OBJECT: &str = include_str!("../../../scenarios/lippiello/lippiello_realistic.toml");
const WAVE: &str = include_str!("../../../scenarios/karacan/karacan_wave.toml");

/// Sizes of the depth images, columns and rows, in pixels.
pub const DEPTH_SIZES_PX: [[usize; 2]; 2] = [[640, 480], [848, 480]];

/// Result of building something from a built-in scenario; an error is a defect.
pub type Made<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// The shipped pipe scenario.
///
/// # Errors
/// The scenario cannot be read.
pub fn pipe() -> Made<AdmittanceScenario> {
    Ok(AdmittanceScenario::parse(
        "pipe_realistic",
        PIPE,
        &[],
        &tangent_simulation::no_files,
    )?)
}

/// The shipped object scenario.
///
/// # Errors
/// The scenario cannot be read.
pub fn object() -> Made<ObjectScenario> {
    Ok(ObjectScenario::parse("lippiello_realistic", OBJECT, &[])?)
}

/// The shipped wave scenario, wiped with camera and touch.
///
/// # Errors
/// The scenario cannot be read.
pub fn wave() -> Made<VisuoTactileScenario> {
    Ok(VisuoTactileScenario::parse("karacan_wave", WAVE, &[])?)
}

/// Inputs of the controller and the estimators during the wipe, cycle by cycle.
#[derive(Default)]
pub struct Inputs {
    /// Inputs of the control law.
    pub control: Vec<ControlInput>,
    /// Inputs of the estimators.
    pub contact: Vec<ContactSample>,
}

impl Inputs {
    /// Runs the scenario and keeps these inputs.
    ///
    /// # Errors
    /// The scenario does not run.
    pub fn of(scenario: &AdmittanceScenario) -> Made<Self> {
        let mut inputs = Self::default();
        let mut commanded = None;
        tangent_simulation::evaluate_admittance_with(scenario, |cycle| {
            let i = cycle.input;
            inputs.control.push(*i);
            inputs.contact.push(ContactSample {
                time_s: i.time_s,
                dt_s: i.dt_s,
                base_from_tool: i.base_from_tool,
                twist: i.twist,
                twist_commanded: commanded.unwrap_or(cycle.output.twist_commanded),
                wrench: i.wrench,
                wrench_delay_s: i.wrench_delay_s,
                wrench_validity: i.wrench_validity,
                wrench_bias_age_s: i.bias_age_s,
                base: i.base,
            });
            commanded = Some(cycle.output.twist_commanded);
        })?;
        Ok(inputs)
    }
}

/// The plant of a scenario.
///
/// # Errors
/// The plant cannot be built.
pub fn plant(scenario: &AdmittanceScenario) -> Made<AdmittancePlant> {
    Ok(AdmittancePlant::new(&scenario.plant, scenario.seed)?)
}

/// The law of a scenario, with its task started.
///
/// # Errors
/// The law or the task is refused.
pub fn law(scenario: &AdmittanceScenario) -> Made<Controller> {
    let plant = plant(scenario)?;
    let config = scenario.controller_config()?;
    let mut task = scenario.task.clone();
    task.controller = None;
    let (model, tool) = (*plant.model(), plant.flange_from_tool());
    let mut law = Controller::new(model, tool, scenario.limits, config)?;
    law.start(Program::new(&task, &config)?, 1)?;
    Ok(law)
}

/// Wrench conditioning with the tool of a scenario, one sensor record per step.
pub struct Conditioning {
    conditioner: WrenchConditioner,
    state: WrenchConditionerState,
    pose: Pose<Base, Tool>,
    rate_hz: f64,
    records: f64,
}

impl Conditioning {
    /// Builds the conditioning at the rate of the scenario's sensor.
    ///
    /// # Errors
    /// The settings are refused.
    pub fn new(scenario: &AdmittanceScenario) -> Made<Self> {
        let tool = &scenario.plant.tool;
        let payload = Payload {
            mass_kg: tool.payload.mass_kg,
            com_in_sensor_m: tool.payload.com_in_sensor_m,
            inertia_kg_m2: tool.payload.inertia_kg_m2,
        };
        let plant = plant(scenario)?;
        let sensor_from_tool = plant.flange_from_sensor().inverse() * plant.flange_from_tool();
        let rate_hz = scenario.plant.sensor.rate_hz;
        Ok(Self {
            conditioner: WrenchConditioner::new(
                &scenario.sensing,
                &payload,
                sensor_from_tool,
                rate_hz,
            )?,
            state: WrenchConditionerState::default(),
            pose: plant.model().base_from_flange(&plant.arm().q) * plant.flange_from_tool(),
            rate_hz,
            records: 0.0,
        })
    }

    /// Conditions the next record.
    pub fn step(&mut self) {
        let time_s = self.records / self.rate_hz;
        self.records += 1.0;
        let reading = Reading {
            time_s,
            wrench: Wrench::from_vector(&Vector6::repeat((time_s * 7.0).sin())),
            condition: SensorCondition::Good,
            missed: 0,
            base_from_tool: Some((self.pose, 0.001)),
            motion: None,
        };
        black_box(self.conditioner.update(&mut self.state, &reading));
    }
}

/// A depth image of a waved sheet, taken from a distance of 0.5 m.
pub struct DepthInput {
    frame: DepthFrame,
    depth_m: Vec<f32>,
    size_px: [usize; 2],
}

impl DepthInput {
    /// Renders an image with this number of columns and rows.
    ///
    /// # Errors
    /// The camera or the surface is refused.
    pub fn new(size_px: [usize; 2]) -> Made<Self> {
        let shape = ShapeConfig::Sheet {
            amplitude_m: [0.0, 0.02],
            wavelength_m: [1.0, 0.38],
        };
        let surface = Surface::new(&shape, &PoseConfig::default())?;
        let config = DepthCameraConfig {
            image_px: size_px,
            ..DepthCameraConfig::default()
        };
        let mut camera = DepthCamera::new(&config, &Pose::identity(), 1)?;
        let down = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.1, 0.0);
        let over = Pose::new(Vector3::new(0.0, 0.0, 0.5), down);
        let frame = camera.picture(0.0, 0, &over, &surface);
        let mut depth_m = Vec::new();
        metres_from_millimetres(&frame.depth_mm, &mut depth_m);
        Ok(Self {
            frame,
            depth_m,
            size_px,
        })
    }

    /// The depths in metres.
    ///
    /// # Errors
    /// The image is not complete.
    pub fn image(&self) -> Made<DepthImage<'_>> {
        let image = DepthImage::new(self.frame.width, self.frame.height, &self.depth_m);
        image.ok_or_else(|| "an incomplete depth image".into())
    }

    /// The image with the tool in its middle.
    ///
    /// # Errors
    /// The image is not complete.
    pub fn sample(&self) -> Made<DepthSample<'_>> {
        Ok(DepthSample {
            time_s: 0.0,
            image: self.image()?,
            intrinsics: self.frame.intrinsics,
            target: ToolTarget::Pixel(self.size_px.map(|n| 0.5 * n as f64)),
            left_out: None,
            travel: Some(Vector3::x()),
        })
    }

    /// One normal for each pixel, all zero.
    pub fn normals(&self) -> Vec<[f32; 3]> {
        vec![[0.0; 3]; self.depth_m.len()]
    }
}
