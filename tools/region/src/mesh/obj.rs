//! Wavefront OBJ: places and faces; materials, normals and textures are not read.

use std::io::Cursor;

use nalgebra::Vector3;
use tobj::{LoadError, LoadOptions};

use super::{COUNT_MAX, Mesh};

/// Reads the bytes of a file.
pub(super) fn parse(bytes: &[u8]) -> Result<Mesh, String> {
    let options = LoadOptions {
        triangulate: true,
        ..LoadOptions::default()
    };
    // No other file is opened.
    let no_material = |_: &std::path::Path| Err(LoadError::OpenFileFailed);
    let (models, _) = tobj::load_obj_buf(&mut Cursor::new(bytes), &options, no_material)
        .map_err(|error| format!("it is no OBJ file: {error}"))?;
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for model in models {
        let first = vertices.len() as u32;
        let mesh = model.mesh;
        vertices.extend((mesh.positions.chunks_exact(3)).map(|p| Vector3::new(p[0], p[1], p[2])));
        triangles.extend(
            (mesh.indices.chunks_exact(3))
                .map(|t| [t[0], t[1], t[2]].map(|index| first.saturating_add(index))),
        );
        if triangles.len() > COUNT_MAX || vertices.len() > 3 * COUNT_MAX {
            return Err(format!(
                "it has more than {COUNT_MAX} triangles: simplify the mesh"
            ));
        }
    }
    Mesh::new(vertices, triangles)
}
