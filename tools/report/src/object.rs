//! An object-pose run from its recording: the estimates beside the truth, and the paper's four
//! figures.

use nalgebra::Vector3;
use tangent_mechanics::{Base, Flange, Object, Pose, Sensor, Tool};
use tangent_schemas::standard::{Point, PoseStamped};
use tangent_simulation::ObjectScenario;
use tangent_simulation::metrics::object::{ObjectFigures, ObjectSampleTruth, pose_error};

use crate::plot::Curve;
use crate::run::Run;
use crate::task_run::{Cycle, TaskRun, nearest, newest, within};

/// The cycles of a simulated object-pose task; `None` if there was no object, or no truth was
/// recorded.
pub fn samples(run: &Run, task: &TaskRun<'_>) -> Option<(Vec<ObjectSampleTruth>, f64)> {
    if run.objects.is_empty() || run.object_truth.is_empty() {
        return None;
    }
    let scenario =
        ObjectScenario::parse("scenario.toml", run.attachments.get("scenario.toml")?, &[]).ok()?;
    let tool = &scenario.plant.tool;
    let flange_from_sensor: Pose<Flange, Sensor> =
        Pose::from_isometry(tool.flange_from_sensor.isometry());
    let flange_from_tool: Pose<Flange, Tool> =
        Pose::from_isometry(tool.flange_from_tool.isometry());
    let tool_from_sensor = flange_from_tool.inverse() * flange_from_sensor;
    let cycles = task
        .cycles
        .iter()
        .filter_map(|cycle| sample(run, task.window_ns, cycle, &tool_from_sensor));
    Some((cycles.collect(), scenario.task.force.reference_n))
}

/// The figures of an object-pose task.
pub fn figures(run: &Run, task: &TaskRun<'_>) -> Option<ObjectFigures> {
    let (samples, reference_n) = samples(run, task)?;
    Some(ObjectFigures::of(&samples, reference_n))
}

fn sample(
    run: &Run,
    window_ns: (i64, i64),
    cycle: &Cycle<'_>,
    tool_from_sensor: &Pose<Tool, Sensor>,
) -> Option<ObjectSampleTruth> {
    let truth = cycle.truth?;
    let stamp_ns = cycle.arm.header.stamp.to_ns();
    let object = pose(nearest(&run.object_truth, &mut 0, |t| &t.header, stamp_ns)?)?;
    let base_from_tool: Pose<Base, Tool> = (&truth.tool_pose).try_into().ok()?;
    let estimates = run.objects.get(cycle.control.estimator.as_str());
    let estimates = estimates.map(|all| within(all, |e| &e.header, window_ns));
    let newest = newest(
        estimates.unwrap_or_default(),
        &mut 0,
        |e| e.cycle,
        cycle.control.cycle,
    );
    let estimated: Option<Pose<Base, Object>> = newest
        .filter(|e| e.validity == 0)
        .and_then(|e| (&e.pose).try_into().ok());
    let force = Vector3::from(&truth.wrench.force);
    let sensor = base_from_tool * *tool_from_sensor;
    let lever = base_from_tool.translation() - sensor.translation();
    let moment = Vector3::from(&truth.wrench.torque) + lever.cross(&force);
    Some(ObjectSampleTruth {
        time_s: cycle.time_s,
        phase: cycle.sample.phase,
        object,
        estimated,
        tip: base_from_tool.translation(),
        reference_in_object: estimated.map(|e| {
            e.inverse()
                .transform_point(&vector(&cycle.control.path_reference))
        }),
        force_n: force.dot(&Vector3::from(&truth.normal)),
        sensor: (sensor.unrotate(&force), sensor.unrotate(&moment)),
        in_contact: truth.in_contact,
    })
}

fn vector(point: &Point) -> Vector3<f64> {
    point.into()
}

fn pose(stamped: &PoseStamped) -> Option<Pose<Base, Object>> {
    (&stamped.pose).try_into().ok()
}

/// Selects three components at one time; `None` if there is no estimate.
type Pick = fn(&ObjectSampleTruth) -> Option<[f64; 3]>;

/// One figure of the paper: file stem, title, unit, and the plotted quantity.
pub type Drawn = (&'static str, &'static str, &'static str, Pick);

/// The figures that the paper shows of each run.
pub const FIGURES: [Drawn; 4] = [
    ("position", "Position error in object axes", "m", |s| {
        Some(pose_error(&s.object, s.estimated.as_ref()?).0.into())
    }),
    (
        "orientation",
        "Orientation error in object axes",
        "deg",
        |s| {
            let turn = pose_error(&s.object, s.estimated.as_ref()?).1;
            Some(turn.map(f64::to_degrees).into())
        },
    ),
    ("force", "Force at the wrist", "N", |s| {
        Some(s.sensor.0.into())
    }),
    ("moment", "Moment at the wrist", "Nm", |s| {
        Some(s.sensor.1.into())
    }),
];

/// The three components of one figure over time.
pub fn curves(samples: &[ObjectSampleTruth], pick: Pick) -> [(&'static str, Curve); 3] {
    [("x", 0), ("y", 1), ("z", 2)].map(|(name, i)| {
        let value = |s: &ObjectSampleTruth| pick(s).map_or(f64::NAN, |v| v[i]);
        (name, samples.iter().map(|s| (s.time_s, value(s))).collect())
    })
}

/// Formats the figures as lines for a terminal.
pub fn words(figures: &ObjectFigures) -> Vec<String> {
    let mut lines = Vec::new();
    if let (Some(along), Some(across), Some(about)) = (
        figures.along_normal_settled_m,
        figures.across_normal_settled_m,
        figures.about_surface_settled_deg,
    ) {
        lines.push(format!(
            "object           1 s after contact {:.2} mm off along the normal, {:.2} mm across, {about:.2} deg about the surface",
            1e3 * along,
            1e3 * across
        ));
    }
    if let (Some(force), Some(peak)) = (figures.sliding_force_rmse_n, figures.peak_at_contact_n) {
        lines.push(format!(
            "force, sliding   error {force:.3} N RMS; peak at contact {peak:.1} N"
        ));
    }
    lines
}

/// Draws all four figures with `draw(title, unit, series)`.
///
/// # Errors
/// The error of `draw`.
pub fn draw_all<E>(
    samples: &[ObjectSampleTruth],
    mut draw: impl FnMut(&Drawn, &[(&'static str, Curve)]) -> Result<(), E>,
) -> Result<(), E> {
    for figure in &FIGURES {
        draw(figure, &curves(samples, figure.3))?;
    }
    Ok(())
}
