//! The task of a region: the plane, the strokes, the expected surface, and the start pose.

use nalgebra::Vector2;
use tangent_control::fill::area_m2;
use tangent_control::{ExpectedSurface, Pattern, Task};

use crate::error::RegionError;
use crate::fill::{Fill, Filled, fill, length_m};
use crate::height_map::HeightMap;
use crate::mesh::{Mesh, bounds};
use crate::options::{AROUND_M, RegionOptions, cell_m};
use crate::patch::{Selection, area_vector, select, unit};
use crate::plane::TaskPlane;
use crate::scan;
use crate::start_pose;
use crate::surface::expected;
use crate::text::{TaskStroke, text};
use crate::touch::touch;

/// Distance of the tool's middle from every edge: this share of its radius with a dose, so that the
/// edge gets enough.
const DOSE_MARGIN_SHARE: f64 = 0.4;
/// Smallest and largest force and speed of a stroke, as a task allows them, N and m/s.
const EDGE_FORCE_N: (f64, f64) = (0.5, 100.0);
const EDGE_SPEED_M_PER_S: (f64, f64) = (0.001, 0.25);
/// Smallest and largest spacing, m.
const SPACING_M: (f64, f64) = (0.0005, 0.5);

/// A task file, and what it holds.
#[derive(Clone, Debug)]
pub struct Draft {
    /// Text of the file.
    pub text: String,
    /// The task as read back from it.
    pub task: Task,
    /// Plane of the path, with its origin where the tool touches down.
    pub plane: TaskPlane,
    /// Edges of the region over the plane: the outline and holes, m.
    pub rings_m: Vec<Vec<[f64; 2]>>,
    /// Number of strokes.
    pub strokes: usize,
    /// Number of strokes along edges, which may have a force and a speed of their own.
    pub edge_strokes: usize,
    /// Number of times that the tool lifts off.
    pub lifts: usize,
    /// Length of all strokes over the plane, m.
    pub length_m: f64,
    /// Area along the surface, cm².
    pub area_cm2: f64,
    /// Greatest angle between the region and the plane, degrees.
    pub steepest_deg: f64,
    /// Joint positions of the start pose, rad; empty without one.
    pub start_joints_rad: Vec<f64>,
    /// What the person should know.
    pub notes: Vec<String>,
}

/// Makes the task of a region of a mesh in base axes, or of a scan: a mesh without triangles.
///
/// # Errors
/// The region, an option or the task that would be made is not usable.
pub fn draft(mesh: &Mesh, options: &RegionOptions<'_>) -> Result<Draft, RegionError> {
    check(options)?;
    let spacing_m = options.spacing_m.unwrap_or(options.radius_m);
    let (mut map, mut notes) = if mesh.triangles.is_empty() {
        scan::map(mesh, options, spacing_m)?
    } else {
        of_mesh(mesh, options, spacing_m)?
    };
    let plane = map.plane;
    let flat = |ring: &Vec<[f64; 3]>| -> Vec<[f64; 2]> {
        let place = |p: &[f64; 3]| plane.place(&(*p).into()).xy().into();
        ring.iter().map(place).collect()
    };
    let outline = options.outline_m.as_ref().map(flat);
    let holes: Vec<_> = options.holes_m.iter().map(flat).collect();
    map.cut(outline.as_deref(), &holes);
    if !map.inside.iter().any(|inside| *inside) {
        return Err(RegionError::Nothing(
            "the outline leaves nothing: its places are in the base, m".to_owned(),
        ));
    }
    if mesh.degenerate > 0 {
        notes.push(format!(
            "{} triangles without an area were left out",
            mesh.degenerate
        ));
    }
    let margin_share = options.dose_n_s_per_cm2.map_or(1.0, |_| DOSE_MARGIN_SHARE);
    let how = Fill {
        pattern: options.pattern,
        spacing_m,
        margin_m: options.margin_m.unwrap_or(margin_share * options.radius_m),
        edge_pass: options.edge_pass,
    };
    let filled = fill(&map, &how)?;
    // In an order that begins at the corner of the region with the least x and y.
    let first = filled.ordered(map.low)[0].points[0];
    let at = touch(&map, first, options.touch_m)?;
    finish(&map, &how, &filled, at, options, notes)
}

fn of_mesh(
    mesh: &Mesh,
    options: &RegionOptions<'_>,
    spacing_m: f64,
) -> Result<(HeightMap, Vec<String>), RegionError> {
    let mut patch = select(mesh, &options.selection)?;
    let normal = match options.approach {
        Some(approach) => -unit(&approach, "--approach")?,
        None => area_vector(mesh, &patch)
            .try_normalize(1e-12)
            .ok_or_else(|| {
                RegionError::Nothing(
                    "the selected surface is closed, so it faces no direction: state --approach, \
                     or select one side with --seed or --facing"
                        .to_owned(),
                )
            })?,
    };
    let origin = mesh.corners(patch[0])[0];
    let along = unit(&options.rows_along, "--rows-along")?;
    let plane = TaskPlane::new(origin, &normal, &along);
    if options.selection == Selection::All {
        // What faces away is the other side of the part.
        patch.retain(|i| mesh.normal(*i).dot(&normal) > 0.0);
    }
    if let Some(outline) = &options.outline_m {
        patch = near_outline(mesh, patch, &plane, outline);
    }
    if patch.is_empty() {
        return Err(RegionError::Nothing(
            "no triangle faces the approach there: check --approach, --outline and --frame"
                .to_owned(),
        ));
    }
    let corners = patch.iter().flat_map(|i| mesh.corners(*i));
    let (low, high) = bounds(corners.map(|v| plane.place(&v).xy()));
    let cell_m = cell_m(high - low, spacing_m, 0.0)?;
    let map = HeightMap::of_mesh(mesh, &patch, &plane, cell_m, AROUND_M)?;
    Ok((map, Vec::new()))
}

/// Triangles whose box meets that of the outline.
fn near_outline(
    mesh: &Mesh,
    patch: Vec<usize>,
    plane: &TaskPlane,
    outline: &[[f64; 3]],
) -> Vec<usize> {
    let around = bounds(outline.iter().map(|p| plane.place(&(*p).into()).xy()));
    (patch.into_iter())
        .filter(|index| {
            let own = bounds(mesh.corners(*index).iter().map(|v| plane.place(v).xy()));
            own.0.x <= around.1.x
                && own.0.y <= around.1.y
                && own.1.x >= around.0.x
                && own.1.y >= around.0.y
        })
        .collect()
}

fn check(options: &RegionOptions<'_>) -> Result<(), RegionError> {
    let range = |option, value: f64, (least, most): (f64, f64)| {
        if (least..=most).contains(&value) {
            Ok(())
        } else {
            Err(RegionError::option(
                option,
                value,
                format!("{least} to {most}"),
            ))
        }
    };
    range("--radius-m", options.radius_m, (0.001, 0.1))?;
    if let Some(spacing_m) = options.spacing_m {
        range("--spacing-m", spacing_m, SPACING_M)?;
    }
    if let Some(margin_m) = options.margin_m {
        range("--margin-m", margin_m, (0.0, 0.5))?;
    }
    let has_edges = match options.pattern {
        Pattern::Raster => options.edge_pass,
        Pattern::Contour => true,
        Pattern::Spiral => false,
    };
    for (option, value, allowed) in [
        ("--edge-force-n", options.edge_force_n, EDGE_FORCE_N),
        (
            "--edge-speed",
            options.edge_speed_m_per_s,
            EDGE_SPEED_M_PER_S,
        ),
    ] {
        let Some(value) = value else { continue };
        if !has_edges {
            return Err(RegionError::option(
                option,
                value,
                "only where strokes run along the edges: with --edge-pass of a raster, or with --pattern contour",
            ));
        }
        range(option, value, allowed)?;
    }
    range("--clearance-m", options.clearance_m, (0.005, 0.3))?;
    for ring in options.outline_m.iter().chain(&options.holes_m) {
        if ring.len() < 3 || !ring.iter().flatten().all(|x| x.abs() < 100.0) {
            return Err(RegionError::option(
                "--outline or --hole",
                format!("{} places", ring.len()),
                "three places or more, finite, in m",
            ));
        }
    }
    Ok(())
}

fn finish(
    map: &HeightMap,
    how: &Fill,
    filled: &Filled,
    at: Vector2<f64>,
    options: &RegionOptions<'_>,
    mut notes: Vec<String>,
) -> Result<Draft, RegionError> {
    let height_m = map.height_m(&at).unwrap_or_default();
    let plane = map.plane.moved_to(&at, height_m);
    let shifted =
        |ring: &[Vector2<f64>]| -> Vec<[f64; 2]> { ring.iter().map(|p| (p - at).into()).collect() };
    let surface: ExpectedSurface = expected(map, filled, &at, height_m);
    let rings_m: Vec<_> = filled.edge.rings.iter().map(|ring| shifted(ring)).collect();
    let normal = map.normal(&at, 2.0 * map.cell_m);
    let start_joints_rad = match options.arm {
        Some((model, tool)) => {
            let outwards = normal.unwrap_or_else(nalgebra::Vector3::z);
            let outwards = plane.direction_in_base(&outwards);
            start_pose::above(model, tool, &plane, &outwards, options.clearance_m)?
        }
        None => Vec::new(),
    };
    let outlines = (filled.edge.rings.iter()).filter(|ring| area_m2(ring) > 0.0);
    if outlines.count() > 1 {
        notes.push(
            "the region has several parts: coverage is judged within the largest one".to_owned(),
        );
    }
    // The strokes nearest to the tool first.
    let strokes: Vec<_> = (filled.ordered(at).iter())
        .map(|stroke| TaskStroke {
            points_m: shifted(&stroke.points),
            at_edge: stroke.at_edge,
        })
        .collect();
    let text = text(
        options,
        how,
        &plane,
        &strokes,
        &surface,
        &rings_m,
        &start_joints_rad,
    );
    let task: Task = text.parse()?;
    let program =
        tangent_control::Program::new(&task, &tangent_control::ControllerConfig::default())?;
    if options.arm.is_none() {
        let [x, y, z] = plane.origin.into();
        notes.push(format!(
            "without a start pose: before each start, bring the tool above ({x:.4}, {y:.4}, {z:.4}) m in the base"
        ));
    }
    Ok(Draft {
        strokes: strokes.len(),
        edge_strokes: strokes.iter().filter(|stroke| stroke.at_edge).count(),
        lifts: program.path.lifts(),
        length_m: filled.strokes.iter().map(|s| length_m(&s.points)).sum(),
        area_cm2: map.area_m2() * 1e4,
        steepest_deg: steepest_deg(map),
        text,
        task,
        plane,
        rings_m,
        start_joints_rad,
        notes,
    })
}

fn steepest_deg(map: &HeightMap) -> f64 {
    (0..map.inside.len())
        .filter(|node| map.inside[*node])
        .filter_map(|node| map.normal(&map.place(node), 2.0 * map.cell_m))
        .map(|n| n.z.clamp(-1.0, 1.0).acos().to_degrees())
        .fold(0.0, f64::max)
}
