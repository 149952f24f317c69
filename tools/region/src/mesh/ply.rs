//! PLY, ASCII and binary: triangles or other polygons, or points alone.

use std::io::Cursor;

use nalgebra::Vector3;
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{Property, PropertyAccess, PropertyAccessResult};

use super::{COUNT_MAX, Mesh};

/// Most corners of a polygon.
const CORNERS_MAX: usize = 64;

#[derive(Default)]
struct Vertex(Vector3<f64>);

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, value: Property) -> PropertyAccessResult {
        let axis = match name {
            "x" => 0,
            "y" => 1,
            "z" => 2,
            _ => return PropertyAccessResult::Ignored,
        };
        self.0[axis] = match value {
            Property::Float(v) => f64::from(v),
            Property::Double(v) => v,
            Property::Char(v) => f64::from(v),
            Property::UChar(v) => f64::from(v),
            Property::Short(v) => f64::from(v),
            Property::UShort(v) => f64::from(v),
            Property::Int(v) => f64::from(v),
            Property::UInt(v) => f64::from(v),
            _ => return PropertyAccessResult::UnsupportedType,
        };
        PropertyAccessResult::Set
    }
}

#[derive(Default)]
struct Face(Vec<u32>);

impl PropertyAccess for Face {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, value: Property) -> PropertyAccessResult {
        if !matches!(name, "vertex_indices" | "vertex_index") {
            return PropertyAccessResult::Ignored;
        }
        // A negative index becomes one that no vertex has.
        self.0 = match value {
            Property::ListUChar(v) => v.into_iter().map(u32::from).collect(),
            Property::ListUShort(v) => v.into_iter().map(u32::from).collect(),
            Property::ListUInt(v) => v,
            Property::ListChar(v) => v.into_iter().map(|i| i as u32).collect(),
            Property::ListShort(v) => v.into_iter().map(|i| i as u32).collect(),
            Property::ListInt(v) => v.into_iter().map(|i| i as u32).collect(),
            _ => return PropertyAccessResult::UnsupportedType,
        };
        PropertyAccessResult::Set
    }
}

/// An element that is not used.
struct Other;

impl PropertyAccess for Other {
    fn new() -> Self {
        Self
    }

    fn set_property(&mut self, _: &str, _: Property) -> PropertyAccessResult {
        PropertyAccessResult::Ignored
    }
}

/// Reads the bytes of a file.
pub(super) fn parse(bytes: &[u8]) -> Result<Mesh, String> {
    let mut reader = Reader::new(Cursor::new(bytes));
    let vertices = Parser::<Vertex>::new();
    let header = vertices
        .read_header(&mut reader)
        .map_err(|error| format!("its header is no PLY header: {error}"))?;
    let (mut points, mut triangles) = (Vec::new(), Vec::new());
    for (name, element) in &header.elements {
        if element.count > COUNT_MAX || element.count > bytes.len() {
            return Err(format!(
                "it states {} of `{name}` in {} bytes: allowed are {COUNT_MAX} at most, of 1 byte or more each",
                element.count,
                bytes.len()
            ));
        }
        if element.properties.is_empty() {
            return Err(format!("its element `{name}` has no property"));
        }
        let words = |error: ply_rs_bw::parser::ParseError| format!("`{name}`: {error}");
        match name.as_str() {
            "vertex" => {
                let found = vertices.read_payload_for_element(&mut reader, element, &header);
                points = found.map_err(words)?.into_iter().map(|v| v.0).collect();
            }
            "face" => {
                let found =
                    Parser::<Face>::new().read_payload_for_element(&mut reader, element, &header);
                triangles = fans(&found.map_err(words)?)?;
            }
            _ => {
                Parser::<Other>::new()
                    .read_payload_for_element(&mut reader, element, &header)
                    .map_err(words)?;
            }
        }
    }
    if points.is_empty() {
        return Err("it has no element `vertex` with x, y and z".to_owned());
    }
    Mesh::new(points, triangles)
}

/// Polygons as triangles.
fn fans(faces: &[Face]) -> Result<Vec<[u32; 3]>, String> {
    let mut triangles = Vec::new();
    for (index, Face(corners)) in faces.iter().enumerate() {
        if !(3..=CORNERS_MAX).contains(&corners.len()) {
            return Err(format!(
                "face {index} has {} corners: allowed are 3 or more, and {CORNERS_MAX} at most",
                corners.len()
            ));
        }
        triangles.extend((corners[1..].windows(2)).map(|ends| [corners[0], ends[0], ends[1]]));
        if triangles.len() > COUNT_MAX {
            return Err(format!(
                "it has more than {COUNT_MAX} triangles: simplify the mesh"
            ));
        }
    }
    Ok(triangles)
}
