//! The figures that `tangent reproduce lippiello` prints: four variants over the same seeds of the
//! calibration error, and how each figure is taken from their runs.

use crate::evaluation::Evaluation;
use crate::metrics::object::{CalibrationError, ObjectFigures};
use crate::reproduction::{self, Goal, Metric, Over, Row};

/// Section of the paper that has the figures.
const TABLE: &str = "Section V (plane of 10 kN/m, camera calibration wrong by seed)";

/// Scenario that is reproduced.
pub const SCENARIO: &str = "lippiello_plane";

/// The four variants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Variant {
    /// The paper's law and filter with the camera alone: the paper's first simulation.
    PaperVision,
    /// The paper's law and filter with all measurements: the paper's second simulation.
    PaperAll,
    /// Our law and filter with the camera alone.
    OursVision,
    /// Our law and filter with all measurements.
    OursAll,
}

impl Variant {
    /// All variants.
    pub const ALL: [Self; 4] = [
        Self::PaperVision,
        Self::PaperAll,
        Self::OursVision,
        Self::OursAll,
    ];

    /// Name as text.
    pub fn name(self) -> &'static str {
        match self {
            Self::PaperVision => "paper's law and filter, vision only",
            Self::PaperAll => "paper's law and filter, vision + force + joints",
            Self::OursVision => "default law and object_pose, vision only",
            Self::OursAll => "default law and object_pose, vision + force + joints",
        }
    }

    /// Overrides of the scenario.
    pub fn overrides(self) -> Vec<String> {
        let (law, filter, measurements) = match self {
            Self::PaperVision => ("paper", "object_pose_paper", "vision"),
            Self::PaperAll => ("paper", "object_pose_paper", "all"),
            Self::OursVision => ("default", "object_pose", "vision"),
            Self::OursAll => ("default", "object_pose", "all"),
        };
        vec![
            format!("controller=\"{law}\""),
            format!("task.estimators=[\"{filter}\"]"),
            format!("estimation.measurements=\"{measurements}\""),
        ]
    }
}

/// Pressing force of the paper's task, N.
const REFERENCE_N: f64 = 20.0;
/// Largest share of the peak that may remain.
const PEAK_SHARE: f64 = 0.75;

/// The runs of one variant, one per seed.
pub struct Runs {
    /// Variant of the runs.
    pub variant: Variant,
    /// Result of each run, in order of the seeds.
    pub runs: Vec<Evaluation>,
}

type Pick = fn(&ObjectFigures) -> Option<f64>;

/// All figures of section 4 from the runs of all four variants, in the order of [`Variant::ALL`].
pub fn figures(runs: &[Runs]) -> Vec<Row> {
    let mut table = Vec::new();
    let of = |variant: Variant| {
        runs.iter()
            .find(|r| r.variant == variant)
            .map_or(&[][..], |r| &r.runs)
    };
    for variant in Variant::ALL {
        let ours = variant == Variant::OursAll;
        let goal = |value: f64| ours.then_some(value);
        let mut add = |metric, unit, goal, pick: Pick| {
            let values = picked(of(variant), pick);
            table.push(figure(variant.name(), metric, unit, values, goal));
        };
        add(
            "position error along the normal, 1 s after contact",
            "mm",
            goal(0.3),
            |f| Some(f.along_normal_settled_m? * 1e3),
        );
        add(
            "orientation error about the plane's axes, 1 s after contact",
            "deg",
            goal(0.2),
            |f| f.about_surface_settled_deg,
        );
        add(
            "position error in the plane, 1 s after contact",
            "mm",
            None,
            |f| Some(f.across_normal_settled_m? * 1e3),
        );
        add(
            "normal force during the circle, RMSE",
            "N",
            goal(0.2),
            |f| f.sliding_force_rmse_n,
        );
        add(
            "other forces after the transient, largest",
            "N",
            goal(0.3),
            |f| f.lateral_force_max_n,
        );
        add(
            "moments after the transient, largest",
            "Nm",
            goal(0.1),
            |f| f.moment_max_nm,
        );
        add("peak force at contact", "N", goal(30.0), |f| {
            f.peak_at_contact_n
        });
        add(
            "circle: position in the plane against the estimated object, RMSE",
            "mm",
            goal(1.0),
            |f| Some(f.path_on_estimate_rmse_m? * 1e3),
        );
        add(
            "circle: position in the plane against the true object, RMSE",
            "mm",
            None,
            |f| Some(f.path_on_object_rmse_m? * 1e3),
        );
    }
    for (all, vision, goal) in [
        (Variant::PaperAll, Variant::PaperVision, false),
        (Variant::OursAll, Variant::OursVision, true),
        (Variant::OursAll, Variant::PaperVision, true),
    ] {
        let row = format!("{}, over {}", all.name(), vision.name());
        let mut add = |metric, limit: f64, pick: Pick| {
            // Ratio of the medians, as the error of a single seed may be close to zero.
            let share = median(&picked(of(all), pick))
                .zip(median(&picked(of(vision), pick)))
                .map(|(a, b)| a / b);
            let values = share.map(|s| vec![s]);
            table.push(figure(
                &row,
                metric,
                "",
                values,
                (goal && limit.is_finite()).then_some(limit),
            ));
        };
        add("position error along the normal, share left", 0.1, |f| {
            f.along_normal_settled_m
        });
        add(
            "orientation error about the plane's axes, share left",
            0.1,
            |f| f.about_surface_settled_deg,
        );
        // No peak can be below the reference force. If the goal's share of the peak with the camera
        // alone is below it, there is no goal.
        let vision_peak = median(&picked(of(vision), |f| f.peak_at_contact_n));
        let within_reach = vision_peak.is_none_or(|n| PEAK_SHARE * n >= REFERENCE_N);
        let share = if within_reach {
            PEAK_SHARE
        } else {
            f64::INFINITY
        };
        add("peak force at contact, share", share, |f| {
            f.peak_at_contact_n
        });
    }
    calibration(of(Variant::OursAll), &mut table);
    table
}

fn calibration(runs: &[Evaluation], table: &mut Vec<Row>) {
    let row = "default law and object_pose, after one circle";
    let stated = |f: &ObjectFigures| f.calibration_stated;
    let last = |f: &ObjectFigures| f.calibration_final;
    let mut add = |metric, pick: fn(&CalibrationError) -> f64, goal: Option<f64>| {
        let values = |which: &dyn Fn(&ObjectFigures) -> Option<CalibrationError>| {
            runs.iter()
                .map(|r| which(r.object_pose.as_ref()?).map(|c| pick(&c)))
                .collect::<Option<Vec<f64>>>()
        };
        let share = median(&values(&last))
            .zip(median(&values(&stated)))
            .map(|(after, before)| after / before);
        table.push(figure(row, metric, "", share.map(|s| vec![s]), goal));
    };
    add(
        "camera's position along the normal, error left as a share",
        |c| c.along_normal_m,
        Some(0.2),
    );
    add(
        "camera's orientation about the plane's axes, error left as a share",
        |c| c.about_surface_deg,
        Some(0.2),
    );
    add(
        "camera's position in the plane, error left as a share",
        |c| c.across_normal_m,
        None,
    );
    add(
        "focal length, error left as a share",
        |c| c.focal_share,
        None,
    );
    let nees = picked(runs, |f| f.nees_per_dof);
    table.push(figure(
        row,
        "NEES per degree of freedom, pose and camera",
        "",
        nees.clone(),
        Some(2.0),
    ));
    let inverse = nees.map(|v| v.iter().map(|x| 1.0 / x).collect());
    table.push(figure(
        row,
        "inverse of NEES per degree of freedom: not underconfident",
        "",
        inverse,
        Some(2.0),
    ));
    let cost: Option<Vec<f64>> = runs
        .iter()
        .map(|r| r.real_time_factor.map(|f| 1.0 / f))
        .collect();
    table.push(figure(
        row,
        "time that a simulated second takes",
        "s",
        cost,
        Some(0.02),
    ));
}

fn picked(runs: &[Evaluation], pick: Pick) -> Option<Vec<f64>> {
    reproduction::picked(runs, |run| pick(run.object_pose.as_ref()?))
}

fn median(values: &Option<Vec<f64>>) -> Option<f64> {
    reproduction::median(values.as_deref()?)
}

/// A figure that the paper plots but does not print.
fn figure(
    row: &str,
    name: &'static str,
    unit: &'static str,
    values: Option<Vec<f64>>,
    goal: Option<f64>,
) -> Row {
    let metric = Metric {
        name,
        unit,
        published: None,
        goal: Goal::at_most(goal),
        over: Over::Median,
    };
    Row::new(TABLE, row, metric, values.as_deref())
}
