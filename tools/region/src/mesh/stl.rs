//! STL, binary and ASCII.

use std::io::Cursor;

use nalgebra::Vector3;

use super::{COUNT_MAX, Mesh};

/// Bytes before the triangles of a binary file, and of each triangle.
const HEADER_BYTES: usize = 84;
const TRIANGLE_BYTES: usize = 50;

/// Reads the bytes of a file.
pub(super) fn parse(bytes: &[u8]) -> Result<Mesh, String> {
    let mut cursor = Cursor::new(bytes);
    let reader = stl_io::create_stl_reader(&mut cursor)
        .map_err(|error| format!("no triangle is found, it is no STL file: {error}"))?;
    // An ASCII file states no count.
    if let (count, Some(_)) = reader.size_hint() {
        let room = bytes.len().saturating_sub(HEADER_BYTES) / TRIANGLE_BYTES;
        if count > room {
            return Err(format!(
                "it states {count} triangles and has room for {room}: it is cut off or no STL file"
            ));
        }
    }
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for triangle in reader {
        let triangle =
            triangle.map_err(|error| format!("after {} triangles: {error}", triangles.len()))?;
        if triangles.len() >= COUNT_MAX {
            return Err(format!(
                "it has more than {COUNT_MAX} triangles: simplify the mesh"
            ));
        }
        let first = vertices.len() as u32;
        vertices.extend((triangle.vertices.iter()).map(|v| Vector3::from(v.0).map(f64::from)));
        triangles.push([first, first + 1, first + 2]);
    }
    if triangles.is_empty() {
        return Err("it has no triangle".to_owned());
    }
    Mesh::new(vertices, triangles)
}
