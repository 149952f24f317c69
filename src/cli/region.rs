//! `tangent region`.

use std::path::PathBuf;

use clap::Args;

/// Options of `tangent region`. Places and directions are in the base of the robot, m.
#[derive(Debug, Args)]
pub struct Region {
    /// Mesh (.stl, .ply, .obj), points of a scan (.ply without faces), or a recording (.mcap) with
    /// depth images.
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Name of the task; by default that of the file.
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// File to write; by default NAME.toml.
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Replace the file if it exists.
    #[arg(long)]
    pub force: bool,
    /// Metres per unit of the mesh: 0.001 for millimetres.
    #[arg(long, value_name = "M", default_value_t = 1.0)]
    pub scale: f64,
    /// Pose of the mesh in the base: x, y, z in m, then roll, pitch and yaw in rad about fixed
    /// axes, or a quaternion x, y, z, w.
    #[arg(
        long,
        value_name = "X,Y,Z,R,P,Y",
        value_delimiter = ',',
        allow_hyphen_values = true,
        conflicts_with = "matches"
    )]
    pub frame: Vec<f64>,
    /// A place in the mesh (after --scale, m) and in the base, as shown with the tool; three or
    /// more times, in place of --frame.
    #[arg(long = "match", value_name = "X,Y,Z=X,Y,Z", value_parser = matched, allow_hyphen_values = true)]
    pub matches: Vec<([f64; 3], [f64; 3])>,
    /// Select from the triangle nearest to this place on, over edges of up to --angle-deg.
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true, group = "selection")]
    pub seed: Option<[f64; 3]>,
    /// Select triangles whose normal is within --angle-deg of this direction, out of the material.
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true, group = "selection")]
    pub facing: Option<[f64; 3]>,
    /// Largest angle of --seed between neighbouring triangles, or of --facing, degrees.
    #[arg(long, value_name = "DEG", default_value_t = 20.0, value_parser = angle)]
    pub angle_deg: f64,
    /// Keep what is inside this outline, projected along the approach.
    #[arg(long, value_name = "X,Y,Z:X,Y,Z:...", value_parser = ring, allow_hyphen_values = true)]
    pub outline: Option<Ring>,
    /// Leave out what is inside this outline; may be repeated.
    #[arg(long, value_name = "X,Y,Z:X,Y,Z:...", value_parser = ring, allow_hyphen_values = true)]
    pub hole: Vec<Ring>,
    /// Direction of the approach, into the material; by default against the mean normal of the
    /// region.
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true)]
    pub approach: Option<[f64; 3]>,
    /// Direction of rows, projected into the plane perpendicular to the approach.
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true, default_value = "1,0,0")]
    pub rows_along: [f64; 3],
    /// Pattern of the strokes.
    #[arg(long, value_enum, default_value_t = RegionPattern::Raster)]
    pub pattern: RegionPattern,
    /// One more stroke along every edge before the rows of a raster.
    #[arg(long)]
    pub edge_pass: bool,
    /// Pressing force of the strokes along the edges, N: 0.5 to 100; with --edge-pass, or with
    /// --pattern contour for its outermost rings. By default that of all strokes.
    #[arg(long, value_name = "N")]
    pub edge_force_n: Option<f64>,
    /// Speed of the strokes along the edges, m/s: 0.001 to 0.25. By default that of all strokes.
    #[arg(long, value_name = "M_PER_S")]
    pub edge_speed: Option<f64>,
    /// Radius of the tip's contact, m; by default that of a flat, ring or soft tip in the cell
    /// file.
    #[arg(long, value_name = "M")]
    pub radius_m: Option<f64>,
    /// Largest distance between strokes, along the surface, m; by default the radius.
    #[arg(long, value_name = "M")]
    pub spacing_m: Option<f64>,
    /// Distance of the strokes from every edge, along the surface, m; by default the radius, or 0.4
    /// of it with --dose.
    #[arg(long, value_name = "M")]
    pub margin_m: Option<f64>,
    /// Where the tool touches down; by default beside the first stroke if there is a surface, else
    /// at its start.
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true)]
    pub touch: Option<[f64; 3]>,
    /// Pressing force, N.
    #[arg(long, value_name = "N", default_value_t = 5.0)]
    pub force_n: f64,
    /// Speed along the surface, m/s.
    #[arg(long, value_name = "M_PER_S", default_value_t = 0.02)]
    pub speed: f64,
    /// Least and most dose of pressure, N*s/cm²: the task gets `[coverage]`, and closes what is
    /// missing.
    #[arg(long, value_name = "LEAST,MOST", value_parser = pair)]
    pub dose: Option<[f64; 2]>,
    /// Height of the start pose above the place where the tool touches down, m: 0.005 to 0.3.
    #[arg(long, value_name = "M", default_value_t = 0.03)]
    pub clearance_m: f64,
    /// Write no start pose: the task starts where the arm stands.
    #[arg(long)]
    pub no_start: bool,
}

/// Places of an outline, m.
#[derive(Clone, Debug, PartialEq)]
pub struct Ring(pub Vec<[f64; 3]>);

/// Patterns of the strokes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum RegionPattern {
    /// Parallel rows.
    Raster,
    /// Rings along all edges.
    Contour,
    /// Rings that pass into each other.
    Spiral,
}

fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let found: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    found
        .ok()
        .filter(|found: &Vec<f64>| found.iter().all(|x| x.is_finite()))
        .and_then(|found| found.try_into().ok())
        .ok_or_else(|| format!("allowed are {N} finite numbers, separated by commas"))
}

fn triple(text: &str) -> Result<[f64; 3], String> {
    numbers(text)
}

fn pair(text: &str) -> Result<[f64; 2], String> {
    numbers(text)
}

fn ring(text: &str) -> Result<Ring, String> {
    let places: Result<Vec<_>, _> = text.split(':').map(triple).collect();
    let places =
        places.map_err(|error| format!("{error} for each place, and `:` between places"))?;
    if places.len() < 3 {
        return Err("an outline has three places or more".to_owned());
    }
    Ok(Ring(places))
}

fn matched(text: &str) -> Result<([f64; 3], [f64; 3]), String> {
    let (mesh, base) = text.split_once('=').ok_or_else(|| {
        "a place in the mesh and one in the base have `=` between them".to_owned()
    })?;
    Ok((triple(mesh)?, triple(base)?))
}

fn angle(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.0..=90.0).contains(&value) => Ok(value),
        _ => Err("allowed is 0 to 90".to_owned()),
    }
}
