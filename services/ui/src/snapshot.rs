//! What a page shows of the present: one compact JSON object, the same for every page.

use std::time::Duration;

use nalgebra::{Isometry3, Vector3};
use serde::Serialize;
use tangent_control::Phase;
use tangent_mechanics::{Base, Chain, Pose, Tool, World};
use tangent_schemas::tangent::{ArmState, ControlState, Health, NormalEstimate};

use crate::lights::{Light, Seen};
use crate::teacher::TeachState;

/// Force since the last snapshot, N: a peak between two snapshots is shown too.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Force {
    /// Wanted force; null without a task.
    pub reference: Option<f64>,
    /// Newest, least and most pressing force; null without a usable wrench.
    pub now: Option<f64>,
    /// Least force.
    pub least: Option<f64>,
    /// Most force.
    pub most: Option<f64>,
}

impl Force {
    /// Takes one more state in.
    pub fn take(&mut self, control: &ControlState) {
        let finite = |x: f64| x.is_finite().then(|| round(x, 1e3));
        self.reference = finite(control.force_reference_n);
        self.now = finite(control.force_n);
        if let Some(now) = self.now {
            self.least = Some(self.least.map_or(now, |least| least.min(now)));
            self.most = Some(self.most.map_or(now, |most| most.max(now)));
        }
    }

    /// Begins a new snapshot: the newest force stays.
    pub fn next(&mut self) {
        (self.least, self.most) = (self.now, self.now);
    }
}

/// One estimator.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Estimator {
    name: String,
    in_use: bool,
    /// Age of the newest estimate, ms; null if none has come in.
    age_ms: Option<f64>,
    valid: bool,
    /// Why it is not valid.
    reason: String,
    /// Angle between its normal and the one in use, degrees.
    angle_deg: Option<f64>,
    /// Angle to the true normal that its covariance states, degrees, root mean square.
    sd_deg: Option<f64>,
}

impl Estimator {
    /// `control` is the state of the controller that uses one of them.
    pub fn of(
        name: &str,
        newest: Option<(&NormalEstimate, Duration)>,
        control: Option<&ControlState>,
    ) -> Self {
        let in_use = control.is_some_and(|control| control.estimator.as_str() == name);
        let mut shown = Self {
            name: name.to_owned(),
            in_use,
            age_ms: None,
            valid: false,
            reason: String::new(),
            angle_deg: None,
            sd_deg: None,
        };
        let Some((estimate, age)) = newest else {
            return shown;
        };
        shown.age_ms = Some((age.as_secs_f64() * 1e3).round());
        shown.valid = estimate.validity == 0;
        shown.reason = estimate.reason.to_string();
        if !shown.valid {
            return shown;
        }
        let degrees = |rad: f64| rad.is_finite().then(|| round(rad.to_degrees(), 1e2));
        let trace = estimate.covariance[0] + estimate.covariance[4] + estimate.covariance[8];
        shown.sd_deg = degrees(trace.sqrt());
        let own = Vector3::from(&estimate.normal).try_normalize(1e-6);
        let used = control.and_then(|c| Vector3::from(&c.normal).try_normalize(1e-6));
        if let (Some(own), Some(used)) = (own, used) {
            shown.angle_deg = degrees(own.angle(&used));
        }
        shown
    }
}

/// The arm in space, world axes, m.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Space {
    /// Origins of base, links, flange and tool.
    joints: Vec<[f64; 3]>,
    /// Direction out of the tool.
    tool_z: [f64; 3],
    /// Normal in use; null before the first.
    normal: Option<[f64; 3]>,
    /// Force of the environment on the tool, N.
    force: Option<[f64; 3]>,
    /// Where the path wants the tool, while it slides.
    reference: Option<[f64; 3]>,
}

impl Space {
    /// `None` if the arm's pose is not usable.
    pub fn of(
        chain: &Chain,
        world_from_base: &Pose<World, Base>,
        arm: &ArmState,
        control: Option<&ControlState>,
    ) -> Option<Self> {
        let base_from_tool = Pose::<Base, Tool>::try_from(&arm.tool_pose).ok()?;
        let point = |p: &Vector3<f64>| numbers(&world_from_base.transform_point(p), 1e4);
        let direction = |v: &Vector3<f64>| numbers(&world_from_base.rotate(v), 1e4);
        let mut frame = Isometry3::identity();
        let mut joints = vec![point(&Vector3::zeros())?];
        for (i, &q) in arm.q.iter().take(chain.links().len()).enumerate() {
            frame *= chain.parent_from_link(i, q);
            joints.push(point(&frame.translation.vector)?);
        }
        frame *= chain.last_from_flange();
        joints.push(point(&frame.translation.vector)?);
        joints.push(point(&base_from_tool.translation())?);
        let slides = |c: &&ControlState| c.phase == Phase::Slide as u8;
        Some(Self {
            joints,
            tool_z: direction(&base_from_tool.rotate(&Vector3::z()))?,
            normal: control
                .and_then(|c| Vector3::from(&c.normal).try_normalize(1e-6))
                .and_then(|n| direction(&n)),
            force: control
                .map(|c| base_from_tool.rotate(&Vector3::from(&c.wrench.force)))
                .and_then(|f| direction(&f)),
            reference: control
                .filter(slides)
                .and_then(|c| point(&Vector3::from(&c.path_reference))),
        })
    }
}

/// The task.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Task {
    name: String,
    activation: u64,
    phase: String,
    paused: bool,
    active: bool,
    /// Progress along the path, 0 to 1.
    progress: f64,
    fault: String,
    path_error_mm: Option<f64>,
    tilt_deg: Option<f64>,
    contact_lost: u32,
}

impl Task {
    /// The task of the controller's state.
    pub fn of(control: &ControlState) -> Self {
        let phase = Phase::from_code(control.phase);
        let finite = |x: f64| x.is_finite().then(|| round(x, 1e2));
        Self {
            name: control.task.to_string(),
            activation: control.activation,
            phase: phase.map_or("unknown", Phase::name).to_owned(),
            paused: control.paused,
            active: phase.is_some_and(Phase::is_active),
            progress: finite(control.path_progress).unwrap_or(0.0).clamp(0.0, 1.0),
            fault: control.fault.to_string(),
            path_error_mm: finite(control.path_error_m * 1e3),
            tilt_deg: finite(control.alignment_error_rad.to_degrees()),
            contact_lost: control.contact_lost_count,
        }
    }
}

/// The last command of a page, and what became of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LastCommand {
    /// Counts commands.
    pub number: u64,
    /// Who gave it.
    pub who: String,
    /// What it was.
    pub action: &'static str,
    /// Whether the cell carried it out, and its answer.
    pub done: bool,
    /// The answer.
    pub message: String,
}

/// What every page shows.
#[derive(Clone, Debug, Serialize)]
pub struct Snapshot {
    /// Counts snapshots.
    pub number: u64,
    /// Time since the service started, s.
    pub time_s: f64,
    /// The task; null without a controller.
    pub task: Option<Task>,
    /// The force.
    pub force: Force,
    /// The arm; null without its state.
    pub space: Option<Space>,
    /// The estimators.
    pub estimators: Vec<Estimator>,
    /// State of each part, one light each.
    pub lights: Vec<Light>,
    /// Epoch and revision of the dose map: it is read separately.
    pub dose: [u64; 2],
    /// Number of pages that are open, and of those that may command.
    pub pages: [usize; 2],
    /// What is being taught, if anything.
    pub teach: Option<TeachState>,
    /// The last command of a page.
    pub last_command: Option<LastCommand>,
}

/// The lights of the parts of a cell.
pub fn lights(
    arm: Option<(&ArmState, Duration)>,
    control: Option<(&ControlState, Duration)>,
    healths: &[(&Health, Duration)],
) -> Vec<Light> {
    Seen {
        arm,
        control,
        healths,
    }
    .lights()
}

fn numbers(v: &Vector3<f64>, scale: f64) -> Option<[f64; 3]> {
    let finite = v.iter().all(|x| x.is_finite());
    finite.then(|| [v.x, v.y, v.z].map(|x| round(x, scale)))
}

/// Rounded to a fraction `1/scale`: a page needs no more, and the text stays short.
pub fn round(x: f64, scale: f64) -> f64 {
    (x * scale).round() / scale
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;

    fn control() -> ControlState {
        ControlState {
            phase: Phase::Slide as u8,
            task: "wipe".try_into().unwrap(),
            estimator: "blend".try_into().unwrap(),
            force_reference_n: 3.0,
            force_n: 2.9,
            path_progress: 0.4,
            normal: (&Vector3::z()).into(),
            ..ControlState::default()
        }
    }

    #[test]
    fn the_force_between_two_snapshots_is_not_lost() {
        let mut force = Force::default();
        for n in [2.0, 9.0, 1.0, 3.0] {
            let state = ControlState {
                force_n: n,
                ..control()
            };
            force.take(&state);
        }
        let of = |f: &Force| (f.now.unwrap(), f.least.unwrap(), f.most.unwrap());
        assert_eq!(of(&force), (3.0, 1.0, 9.0));
        force.next();
        assert_eq!(of(&force), (3.0, 3.0, 3.0));
        force.take(&ControlState {
            force_n: f64::NAN,
            ..control()
        });
        assert_eq!(force.now, None);
    }

    #[test]
    fn what_is_not_a_number_is_null_and_never_invalid_json() {
        let bad = ControlState {
            force_n: f64::NAN,
            force_reference_n: f64::INFINITY,
            path_error_m: f64::NAN,
            path_progress: f64::NAN,
            alignment_error_rad: f64::NEG_INFINITY,
            ..control()
        };
        let mut force = Force::default();
        force.take(&bad);
        let estimate = NormalEstimate {
            normal: (&Vector3::new(f64::NAN, 0.0, 0.0)).into(),
            covariance: [f64::NAN; 9],
            ..NormalEstimate::default()
        };
        let newest = Some((&estimate, Duration::from_millis(3)));
        let snapshot = Snapshot {
            number: 1,
            time_s: 0.5,
            task: Some(Task::of(&bad)),
            force,
            space: None,
            estimators: vec![Estimator::of("blend", newest, Some(&bad))],
            lights: lights(None, Some((&bad, Duration::ZERO)), &[]),
            dose: [0, 0],
            pages: [1, 0],
            teach: None,
            last_command: None,
        };
        let text = serde_json::to_string(&snapshot).unwrap();
        let read: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(read["force"]["now"], Value::Null);
        assert_eq!(read["force"]["reference"], Value::Null);
        assert_eq!(read["task"]["progress"], 0.0);
        assert_eq!(read["task"]["tilt_deg"], Value::Null);
        assert_eq!(read["estimators"][0]["sd_deg"], Value::Null);
        assert!(!text.contains("NaN") && text.len() < 4000, "{text}");
    }

    #[test]
    fn an_estimator_is_shown_with_its_angle_to_the_normal_in_use() {
        let mut estimate = NormalEstimate {
            normal: (&Vector3::new(f64::sin(0.1), 0.0, f64::cos(0.1))).into(),
            ..NormalEstimate::default()
        };
        estimate.covariance[0] = 0.02_f64.powi(2);
        let newest = Some((&estimate, Duration::from_millis(12)));
        let shown = Estimator::of("reactive", newest, Some(&control()));
        assert!(!shown.in_use && shown.valid);
        assert_eq!(shown.angle_deg, Some(5.73));
        assert_eq!(shown.sd_deg, Some(1.15));
        assert_eq!(shown.age_ms, Some(12.0));
        assert!(Estimator::of("blend", newest, Some(&control())).in_use);
        assert_eq!(Estimator::of("blend", None, None).age_ms, None);
    }

    #[test]
    fn the_arm_ends_at_its_tool() {
        let cell = tangent_runtime::CellConfig::default_cell();
        let model = tangent_mechanics::ModelData::builtin(&cell.robot.model).unwrap();
        let chain = Chain::new(&model).unwrap();
        let q = [0.1, -1.2, 1.3, -1.5, -1.5, 0.2];
        let flange = chain.base_from_flange(&q);
        let tool = flange * cell.tool.flange_from_tool().isometry();
        let pose = Pose::<Base, Tool>::new(tool.translation.vector, tool.rotation);
        let arm = ArmState {
            q: q.into_iter().collect(),
            tool_pose: (&pose).into(),
            ..ArmState::default()
        };
        let space = Space::of(&chain, &Pose::identity(), &arm, Some(&control())).unwrap();
        assert_eq!(space.joints.len(), 9, "base, six links, flange, tool");
        let at = |i: usize| Vector3::from(space.joints[i]);
        assert!((at(7) - flange.translation.vector).norm() < 2e-4);
        let length = cell.tool.flange_from_tool().translation().norm();
        assert!(((at(8) - at(7)).norm() - length).abs() < 3e-4);
        let mut lost = arm;
        lost.q[2] = f64::NAN;
        assert_eq!(Space::of(&chain, &Pose::identity(), &lost, None), None);
    }
}
