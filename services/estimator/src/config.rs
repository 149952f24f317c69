//! Configuration of the estimator service.

use nalgebra::Vector2;
use serde::Deserialize;
use tangent_estimation::depth_normal::{
    DEPTH_NORMAL, DepthNormalConfig, Intrinsics, leave_out_rod,
};
use tangent_estimation::object_pose::{CameraModel, OBJECT_ESTIMATORS};
use tangent_estimation::{EstimatorConfig, ObjectPoseConfig, estimator_names};
use tangent_mechanics::{Camera, Flange, ModelData, Pose, Tip, Tool};
use tangent_runtime::CellConfig;
use tangent_runtime::config::{Calibration, CameraKind, WrenchSource};
use tangent_sensing::BaseConfig;
use toml::{Table, Value};

use crate::EstimatorError;

/// Key under `[estimators.settings]` for settings common to all estimators.
pub const ALL: &str = "all";

/// One estimator and its settings.
#[derive(Clone, Debug, PartialEq)]
pub struct EstimatorChoice {
    /// Name, one of [`estimator_names`]; also part of its topic, `estimate/NAME/normal`.
    pub name: String,
    /// Its settings.
    pub settings: EstimatorConfig,
}

/// One estimator of an object's pose and its settings.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectChoice {
    /// Name, one of [`OBJECT_ESTIMATORS`]; also part of its topics, `estimate/NAME/object` and
    /// `estimate/NAME/normal`.
    pub name: String,
    /// Its settings.
    pub settings: ObjectPoseConfig,
}

/// Cylinder around the tool's axis that is left out of every depth image, since it shows the tool.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToolInView {
    /// Radius, with a margin for mixed pixels at the tool's edge, m.
    pub radius_m: f64,
    /// Length from the tool's origin backwards, m.
    pub length_m: f64,
}

impl ToolInView {
    /// One entry per pixel of an image of `size_px`, not zero where the tool is seen; all zero
    /// without a tool.
    pub fn left_out(
        tool: Option<&Self>,
        camera_from_tool: &Pose<Camera, Tool>,
        intrinsics: &Intrinsics,
        size_px: [u32; 2],
    ) -> Vec<u8> {
        let size_px = size_px.map(|count| count as usize);
        let mut left_out = vec![0; size_px[0].saturating_mul(size_px[1])];
        if let Some(rod) = tool {
            let tip = camera_from_tool.translation();
            let end = tip - camera_from_tool.z_axis() * rod.length_m;
            leave_out_rod(
                intrinsics,
                size_px,
                [&tip, &end],
                rod.radius_m,
                &mut left_out,
            );
        }
        left_out
    }
}

/// Settings of `depth_normal` in a service.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DepthSettings {
    /// The tool in the view, which is left out.
    pub tool: Option<ToolInView>,
    /// Settings of the fits.
    pub fit: DepthNormalConfig,
}

impl DepthSettings {
    /// `[estimators.settings.depth_normal]` of a cell file, whether or not the estimator runs.
    ///
    /// # Errors
    /// A key or value is wrong; the error names it.
    pub fn from_cell(cell: &CellConfig) -> Result<Self, EstimatorError> {
        let own = cell.estimators.settings.get(DEPTH_NORMAL);
        parsed(DEPTH_NORMAL, own.cloned().unwrap_or_default())
    }
}

/// Configuration of `depth_normal` before the calibration is known.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthPlan {
    /// Its settings.
    pub settings: DepthSettings,
    /// Calibration of the camera; `None`: taken from `camera/info`.
    pub calibration: Option<Calibration>,
    /// Pose of the camera on the flange.
    pub flange_from_camera: Pose<Flange, Camera>,
}

impl DepthPlan {
    /// Completes the plan with a calibration.
    pub fn with(&self, calibration: &Calibration) -> DepthChoice {
        DepthChoice {
            settings: self.settings.clone(),
            intrinsics: Intrinsics::new(calibration.focal_px, calibration.principal_px),
            size_px: calibration.size_px,
            flange_from_camera: self.flange_from_camera,
        }
    }
}

/// `depth_normal` with its camera.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthChoice {
    /// Its settings.
    pub settings: DepthSettings,
    /// Intrinsics of the camera.
    pub intrinsics: Intrinsics,
    /// Width and height of its images, pixels.
    pub size_px: [u32; 2],
    /// Pose of the camera on the flange.
    pub flange_from_camera: Pose<Flange, Camera>,
}

/// Configuration of the service.
#[derive(Clone, Debug)]
pub struct Config {
    /// Estimators, each on its own topic.
    pub estimators: Vec<EstimatorChoice>,
    /// Estimators of an object's pose.
    pub objects: Vec<ObjectChoice>,
    /// Normals from depth images.
    pub depth: Option<DepthPlan>,
    /// The camera as the cell file states it.
    pub camera: Option<CameraModel>,
    /// The arm's model, for converting commanded joint velocities to a twist.
    pub model: ModelData,
    /// Pose of the tool on the flange.
    pub flange_from_tool: Pose<Flange, Tool>,
    /// The wrench that the estimators use.
    pub wrench_source: WrenchSource,
    /// Age at which a wrench is no longer used, s.
    pub wrench_patience_s: f64,
    /// Checks on the pose of a moving base.
    pub base: BaseConfig,
    /// SCHED_FIFO priority of the estimating thread; `None` for normal scheduling.
    pub realtime_priority: Option<u8>,
}

impl Config {
    /// Configuration from the cell file: `[estimators]` and `[tool]`.
    ///
    /// # Errors
    /// An estimator, key or value is wrong; the error names it.
    pub fn from_cell(cell: &CellConfig, model: ModelData) -> Result<Self, EstimatorError> {
        let settings = &cell.estimators.settings;
        let names = [&estimator_names()[..], &OBJECT_ESTIMATORS, &[DEPTH_NORMAL]].concat();
        if let Some(name) = settings
            .keys()
            .find(|k| k.as_str() != ALL && !names.contains(&k.as_str()))
        {
            return Err(EstimatorError::Settings {
                name: name.clone(),
                reason: format!(
                    "there is no such estimator; there are: {}, and \"{ALL}\" for what those of normals share",
                    names.join(", ")
                ),
            });
        }
        let (mut estimators, mut objects, mut depth) = (Vec::new(), Vec::new(), None);
        for name in &cell.estimators.run {
            let own = settings.get(name);
            if OBJECT_ESTIMATORS.contains(&name.as_str()) {
                objects.push(ObjectChoice {
                    name: name.clone(),
                    settings: parsed(name, own.cloned().unwrap_or_default())?,
                });
                continue;
            }
            if name == DEPTH_NORMAL {
                depth = Some(depth_plan(cell, own.cloned().unwrap_or_default())?);
                continue;
            }
            let mut table = Table::new();
            for own in [settings.get(ALL), own].into_iter().flatten() {
                overlay(&mut table, own);
            }
            state_tip(&mut table, &cell.tool.tip.tip());
            estimators.push(EstimatorChoice {
                name: name.clone(),
                settings: parsed(name, table)?,
            });
        }
        Ok(Self {
            estimators,
            objects,
            depth,
            camera: cell.camera.as_ref().and_then(|camera| {
                let calibration = camera.calibration()?;
                let [fx, fy] = calibration.focal_px;
                Some(CameraModel {
                    flange_from_camera: camera.flange_from_camera(),
                    // The filter has one focal length, and estimates its error.
                    focal_px: 0.5 * (fx + fy),
                    principal_px: Vector2::from(calibration.principal_px),
                    pixel_m: camera.pixel_m,
                })
            }),
            model,
            flange_from_tool: cell.tool.flange_from_tool(),
            wrench_source: cell.estimators.wrench,
            wrench_patience_s: 0.05,
            base: cell.base,
            realtime_priority: cell
                .realtime
                .enabled
                .then_some(cell.realtime.estimator_priority),
        })
    }
}

fn depth_plan(cell: &CellConfig, table: Table) -> Result<DepthPlan, EstimatorError> {
    let camera = cell
        .camera
        .as_ref()
        .filter(|camera| camera.kind == CameraKind::Depth)
        .ok_or(EstimatorError::NoDepthCamera)?;
    Ok(DepthPlan {
        settings: parsed(DEPTH_NORMAL, table)?,
        calibration: camera.calibration(),
        flange_from_camera: camera.flange_from_camera(),
    })
}

fn parsed<T: serde::de::DeserializeOwned>(name: &str, table: Table) -> Result<T, EstimatorError> {
    T::deserialize(Value::Table(table)).map_err(|e| EstimatorError::Settings {
        name: name.to_owned(),
        reason: e.to_string(),
    })
}

/// Writes the cell's tip into settings that do not state one. A stated tip stays whole: its shape
/// must not get the radius of another.
fn state_tip(settings: &mut Table, tip: &Tip) {
    let contact = settings
        .entry("contact")
        .or_insert_with(|| Table::new().into());
    if let (Some(contact), Ok(tip)) = (contact.as_table_mut(), Value::try_from(tip)) {
        contact.entry("tip").or_insert(tip);
    }
}

fn overlay(base: &mut Table, own: &Table) {
    for (key, value) in own {
        match (base.get_mut(key), value) {
            (Some(Value::Table(inner)), Value::Table(outer)) => overlay(inner, outer),
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tangent_runtime::config::{TipConfig, TipKind};

    fn cell(estimators: &str) -> CellConfig {
        let mut cell = CellConfig::default_cell();
        let table: Table = toml::from_str(estimators).unwrap();
        cell.estimators = Value::Table(table).try_into().unwrap();
        cell
    }

    fn config(estimators: &str) -> Result<Config, EstimatorError> {
        Config::from_cell(&cell(estimators), ModelData::builtin("ur5").unwrap())
    }

    #[test]
    fn a_depth_cameras_size_and_pixels_are_those_of_the_file_or_left_to_the_driver() {
        let mut cell = cell("run = [\"depth_normal\"]");
        let plan = |cell: &CellConfig| {
            Config::from_cell(cell, ModelData::builtin("ur5").unwrap())
                .unwrap()
                .depth
                .unwrap()
        };
        let camera = |given: &str| {
            let pose = "flange_from_camera = { translation_m = [0.07, 0.0, -0.03] }";
            toml::from_str(&format!("kind = \"depth\"\n{given}\n{pose}")).ok()
        };
        // A D435i at its native 848 x 480.
        cell.camera = camera(
            "size_px = [848, 480]\nfocal_px = [423.6, 424.1]\nprincipal_px = [421.7, 239.2]",
        );
        let found = plan(&cell);
        let choice = found.with(&found.calibration.unwrap());
        assert_eq!(choice.size_px, [848, 480]);
        let seen = choice.intrinsics;
        assert_eq!(
            [seen.fx_px, seen.fy_px, seen.cx_px, seen.cy_px],
            [423.6, 424.1, 421.7, 239.2]
        );
        cell.camera = camera("info_topic = \"camera/depth/camera_info\"");
        assert_eq!(plan(&cell).calibration, None);
    }

    #[test]
    fn an_estimators_own_settings_stand_above_the_shared_ones() {
        let config = config(
            "run = ['reactive', 'blend']\n[settings.all.contact]\nmemory_distance_m = 0.02\nforce_on_n = 0.8\n\
             [settings.blend.contact]\nmemory_distance_m = 0.03",
        )
        .unwrap();
        let distances: Vec<f64> = config
            .estimators
            .iter()
            .map(|e| e.settings.contact.memory_distance_m)
            .collect();
        assert_eq!(distances, [0.02, 0.03]);
        assert_eq!(config.estimators[1].settings.contact.force_on_n, 0.8);
    }

    #[test]
    fn the_cells_tip_is_told_to_every_estimator_that_has_none_of_its_own() {
        let mut cell = cell(
            "run = ['reactive', 'quadratic', 'object_pose']\n\
             [settings.all.contact]\nforce_on_n = 0.8\n\
             [settings.quadratic.contact]\ntip = { shape = 'unknown' }",
        );
        let tips = |cell: &CellConfig| -> Vec<Tip> {
            let config = Config::from_cell(cell, ModelData::builtin("ur5").unwrap()).unwrap();
            let estimators = config.estimators.iter();
            estimators.map(|e| e.settings.contact.tip).collect()
        };
        cell.tool.tip = TipConfig::default();
        assert_eq!(tips(&cell), [Tip::Unknown, Tip::Unknown]);
        cell.tool.tip = TipConfig {
            kind: TipKind::Round,
            radius_m: Some(0.006),
        };
        assert_eq!(tips(&cell), [Tip::Round { radius_m: 0.006 }, Tip::Unknown]);
        let all: Table = "[contact]\ntip = { shape = 'flat', radius_m = 0.01 }"
            .parse()
            .unwrap();
        cell.estimators.settings.insert(ALL.to_owned(), all);
        assert_eq!(tips(&cell)[0], Tip::Flat { radius_m: 0.01 });
    }

    #[test]
    fn unknown_settings_are_named() {
        let text = config("run = ['blend']\n[settings.blend.contact]\npad_radius = 0.02")
            .err()
            .unwrap()
            .to_string();
        assert!(
            text.contains("blend") && text.contains("pad_radius"),
            "{text}"
        );
        let text = config("run = ['blend']\n[settings.blnd]")
            .err()
            .unwrap()
            .to_string();
        assert!(
            text.contains("blnd") && text.contains("gaussian_process"),
            "{text}"
        );
    }

    #[test]
    fn an_objects_pose_has_settings_and_a_camera_of_its_own() {
        let text = "run = ['blend', 'object_pose']\n[settings.all.contact]\nforce_on_n = 0.8\n\
                    [settings.object_pose]\ncorner_sd_px = 0.7";
        let found = config(text).unwrap();
        assert_eq!(found.estimators.len(), 1);
        assert_eq!(found.objects[0].settings.corner_sd_px, 0.7);
        assert!(found.camera.is_none());
        let wrong = config("run = ['object_pose']\n[settings.object_pose]\ncorner_px = 1");
        let text = wrong.err().unwrap().to_string();
        assert!(
            text.contains("object_pose") && text.contains("corner_px"),
            "{text}"
        );
    }

    #[test]
    fn the_built_in_cell_is_accepted() {
        let cell = CellConfig::default_cell();
        let config = Config::from_cell(&cell, ModelData::builtin("ur5").unwrap()).unwrap();
        assert!(!config.estimators.is_empty());
    }
}
