//! The text of a task file.

use nalgebra::Vector3;
use tangent_control::{ExpectedSurface, Pattern};

use crate::fill::Fill;
use crate::options::RegionOptions;
use crate::plane::TaskPlane;

/// The approach continues this far below the expected surface, m.
const BELOW_M: f64 = 0.03;

/// A stroke as the task has it.
pub(crate) struct TaskStroke {
    /// Places over the plane, from where the tool touches down, m.
    pub points_m: Vec<[f64; 2]>,
    /// Whether it runs along an edge of the region.
    pub at_edge: bool,
}

pub(crate) fn text(
    options: &RegionOptions<'_>,
    fill: &Fill,
    plane: &TaskPlane,
    strokes: &[TaskStroke],
    surface: &ExpectedSurface,
    rings_m: &[Vec<[f64; 2]>],
    start_joints_rad: &[f64],
) -> String {
    let pattern = match fill.pattern {
        Pattern::Raster => "rows",
        Pattern::Spiral => "a spiral",
        Pattern::Contour => "rings",
    };
    let origin: Vec<String> = plane.origin.iter().map(|x| rounded(*x, 4)).collect();
    let mut text = format!(
        "# Made of {}: {pattern} {} m apart along the surface, {} m from its edges.\n\
         # The tool is expected to touch down at ({}) m in the base.\n\
         name = {}\n\
         force.reference_n = {:?}\n\n\
         [approach]\n\
         direction = {}\n\
         distance_max_m = {}\n\n\
         [plane]\n\
         x_axis = {}\n",
        options.source.replace(['\n', '\r'], " "),
        rounded(fill.spacing_m, 5),
        rounded(fill.margin_m, 5),
        origin.join(", "),
        toml::Value::from(options.name),
        options.force_n,
        vector(&-plane.normal),
        rounded(options.clearance_m + BELOW_M, 4),
        vector(&plane.x),
    );
    if !start_joints_rad.is_empty() {
        let joints: Vec<String> = start_joints_rad.iter().map(|q| rounded(*q, 5)).collect();
        text += &format!(
            "\n# {:.0} mm above that place.\n[start]\njoints_rad = [{}]\n",
            options.clearance_m * 1e3,
            joints.join(", ")
        );
    }
    if let Some([least, most]) = options.dose_n_s_per_cm2 {
        text += &format!(
            "\n[coverage]\nradius_m = {:?}\ndose_n_s_per_cm2 = [{least:?}, {most:?}]\nmargin_m = {}\n\
             outline_m = {}\n",
            options.radius_m,
            rounded(fill.margin_m, 5),
            points(&rings_m[0]),
        );
        let holes: Vec<String> = rings_m[1..].iter().map(|ring| points(ring)).collect();
        if !holes.is_empty() {
            text += &format!("holes_m = [{}]\n", holes.join(", "));
        }
    }
    text += &format!(
        "\n# Places over the plane through the place where the tool touches down, m.\n\
         [path]\nkind = \"strokes\"\nspeed_m_per_s = {:?}\n",
        options.speed_m_per_s
    );
    let edge = [
        ("force_n", options.edge_force_n),
        ("speed_m_per_s", options.edge_speed_m_per_s),
    ];
    for stroke in strokes {
        let of_its_own: String = (edge.iter())
            .filter(|_| stroke.at_edge)
            .filter_map(|(key, value)| Some(format!("{key} = {:?}\n", (*value)?)))
            .collect();
        text += &format!(
            "\n[[path.strokes]]\npoints_m = {}\n{of_its_own}",
            points(&stroke.points_m)
        );
    }
    let heights: Vec<String> = (surface.heights_m.chunks(surface.columns))
        .map(|row| {
            let row: Vec<String> = row.iter().map(|h| rounded(*h, 5)).collect();
            format!("    {},\n", row.join(", "))
        })
        .collect();
    text += &format!(
        "\n# Expected heights over the plane: a guess, which touch corrects.\n\
         [path.surface]\ncorner_m = {:?}\ncell_m = {:?}\ncolumns = {}\nheights_m = [\n{}]\n",
        surface.corner_m,
        surface.cell_m,
        surface.columns,
        heights.concat()
    );
    text
}

fn points(points: &[[f64; 2]]) -> String {
    let each: Vec<String> = (points.iter())
        .map(|[x, y]| format!("[{}, {}]", rounded(*x, 5), rounded(*y, 5)))
        .collect();
    format!("[{}]", each.join(", "))
}

fn vector(v: &Vector3<f64>) -> String {
    let each: Vec<String> = v.iter().map(|x| rounded(*x, 6)).collect();
    format!("[{}]", each.join(", "))
}

/// A number without a negative zero.
fn rounded(value: f64, digits: i32) -> String {
    let unit = 10f64.powi(digits);
    format!("{:?}", (value * unit).round() / unit + 0.0)
}
