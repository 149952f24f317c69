//! The kinds of surface of the suite: one row of its table each.

/// Kind of surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum SurfaceKind {
    /// Cylinder of 60 to 300 mm radius.
    Pipe,
    /// Cone, on its side.
    Cone,
    /// Sphere of 60 to 300 mm radius.
    Sphere,
    /// Plane.
    Plane,
    /// Ellipsoid with semi-axes of 80 to 300 mm.
    Ellipsoid,
    /// Torus, on its convex outside.
    TorusOutside,
    /// Torus, on the saddle of its inside.
    TorusInside,
    /// Sheet waved in both directions, with radii down to 30 mm.
    WavedSheet,
    /// Smooth random heights on a grid.
    HeightField,
    /// A step across the path.
    Step,
    /// A gap across the path that the tip cannot fall through.
    Gap,
    /// A plate that ends beside the path or across it.
    Edge,
    /// A narrow groove across the path.
    Seam,
}

impl SurfaceKind {
    /// All kinds, in the order of the table.
    pub const ALL: [Self; 13] = [
        Self::Pipe,
        Self::Cone,
        Self::Sphere,
        Self::Plane,
        Self::Ellipsoid,
        Self::TorusOutside,
        Self::TorusInside,
        Self::WavedSheet,
        Self::HeightField,
        Self::Step,
        Self::Gap,
        Self::Edge,
        Self::Seam,
    ];

    /// Name in tables and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pipe => "pipe",
            Self::Cone => "cone",
            Self::Sphere => "sphere",
            Self::Plane => "plane",
            Self::Ellipsoid => "ellipsoid",
            Self::TorusOutside => "torus_outside",
            Self::TorusInside => "torus_inside",
            Self::WavedSheet => "waved_sheet",
            Self::HeightField => "height_field",
            Self::Step => "step",
            Self::Gap => "gap",
            Self::Edge => "edge",
            Self::Seam => "seam",
        }
    }

    /// Kind with a name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}
