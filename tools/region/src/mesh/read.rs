//! Reads a mesh file: STL, PLY or OBJ.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::{Mesh, obj, ply, stl};
use crate::error::RegionError;

/// Largest file, bytes.
const BYTES_MAX: u64 = 512 << 20;

/// Reads a file, by the ending of its name: `.stl`, `.ply` or `.obj`. Numbers are in the units of
/// the file.
///
/// # Errors
/// The file, what is wrong with it, and what is allowed.
pub fn read(path: &Path) -> Result<Mesh, RegionError> {
    let refuse = |reason: String| RegionError::File {
        file: path.display().to_string(),
        reason,
    };
    let bytes = bytes(path).map_err(refuse)?;
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("");
    parse(&bytes, ending).map_err(refuse)
}

fn bytes(path: &Path) -> Result<Vec<u8>, String> {
    let file = File::open(path).map_err(|error| error.to_string())?;
    let mut bytes = Vec::new();
    file.take(BYTES_MAX + 1)
        .read_to_end(&mut bytes)
        .map_err(|error| error.to_string())?;
    if bytes.len() as u64 > BYTES_MAX {
        return Err(format!(
            "it is larger than {} MiB: simplify the mesh, or cut out the region",
            BYTES_MAX >> 20
        ));
    }
    Ok(bytes)
}

/// Reads a mesh from the bytes of a file with this ending.
pub(crate) fn parse(bytes: &[u8], ending: &str) -> Result<Mesh, String> {
    match ending.to_ascii_lowercase().as_str() {
        "stl" => stl::parse(bytes),
        "ply" => ply::parse(bytes),
        "obj" => obj::parse(bytes),
        _ => Err(format!(
            "the ending `{ending}` is not known: allowed are .stl, .ply and .obj"
        )),
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use proptest::prelude::*;

    use super::*;

    const STL: &str = "solid a
        facet normal 0 0 1 outer loop vertex 0 0 0 vertex 1 0 0 vertex 0 1 0 endloop endfacet
        endsolid a";
    const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n\
        property float z\nproperty uchar red\nelement face 1\nproperty list uchar int vertex_indices\n\
        end_header\n0 0 0 1\n1 0 0 2\n1 1 0 3\n0 1 0 4\n4 0 1 2 3\n";
    const OBJ: &str =
        "# a\nmtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1 4//1\n";

    fn stl() -> String {
        STL.replace("outer", "\nouter")
            .replace("loop vertex", "loop\nvertex")
            .replace(" vertex", "\nvertex")
            .replace(" endloop", "\nendloop")
            .replace(" endfacet", "\nendfacet")
    }

    fn binary_stl(triangles: &[[[f32; 3]; 3]], count: u32) -> Vec<u8> {
        let mut bytes = vec![0; 80];
        bytes.extend(count.to_le_bytes());
        for triangle in triangles {
            bytes.extend([0; 12]);
            bytes.extend(triangle.iter().flatten().flat_map(|x| x.to_le_bytes()));
            bytes.extend([0; 2]);
        }
        bytes
    }

    fn binary_ply(little: bool) -> Vec<u8> {
        let order = if little { "little" } else { "big" };
        let mut bytes = format!(
            "ply\nformat binary_{order}_endian 1.0\nelement vertex 3\nproperty double x\nproperty double y\n\
             property double z\nelement face 1\nproperty list uchar uint vertex_index\nend_header\n"
        )
        .into_bytes();
        let f64s = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0_f64];
        bytes.extend(f64s.iter().flat_map(|x| {
            if little {
                x.to_le_bytes()
            } else {
                x.to_be_bytes()
            }
        }));
        bytes.push(3);
        for i in 0..3_u32 {
            bytes.extend(if little {
                i.to_le_bytes()
            } else {
                i.to_be_bytes()
            });
        }
        bytes
    }

    #[test]
    fn every_format_gives_its_triangles() {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        for (bytes, ending, vertices, triangles) in [
            (stl().into_bytes(), "stl", 3, 1),
            (binary_stl(&[corners; 1], 1), "STL", 3, 1),
            (PLY.as_bytes().to_vec(), "ply", 4, 2),
            (binary_ply(true), "ply", 3, 1),
            (binary_ply(false), "ply", 3, 1),
            (OBJ.as_bytes().to_vec(), "obj", 4, 2),
        ] {
            let mesh = parse(&bytes, ending).unwrap();
            assert_eq!(
                (mesh.vertices.len(), mesh.triangles.len()),
                (vertices, triangles),
                "{ending}"
            );
            for index in 0..triangles {
                assert_eq!(mesh.normal(index), Vector3::z(), "{ending}");
            }
        }
    }

    #[test]
    fn a_file_that_lies_is_refused_with_what_is_wrong() {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let bad = [[0.0, f32::NAN, 0.0], corners[1], corners[2]];
        let point = [corners[0]; 3];
        for (bytes, ending, word) in [
            (binary_stl(&[corners], u32::MAX), "stl", "4294967295"),
            (binary_stl(&[corners], 2), "stl", "2 triangles"),
            (binary_stl(&[bad], 1), "stl", "finite"),
            (binary_stl(&[point; 4], 4), "stl", "area"),
            (Vec::new(), "stl", "triangle"),
            (b"solid\n".to_vec(), "stl", "triangle"),
            (
                PLY.replace("vertex 4", "vertex 4000000000").into_bytes(),
                "ply",
                "4000000000",
            ),
            (
                PLY.replace("4 0 1 2 3", "4 0 1 2 9").into_bytes(),
                "ply",
                "vertices",
            ),
            (
                PLY.replace("4 0 1 2 3", "2 0 1").into_bytes(),
                "ply",
                "3 or more",
            ),
            (PLY.replace("1 1 0 3", "1 nan 0 3").into_bytes(), "ply", ""),
            (b"plx\n".to_vec(), "ply", ""),
            (OBJ.replace("f 1//1", "f 9//1").into_bytes(), "obj", ""),
            (OBJ.replace("v 1 1 0", "v 1 x 0").into_bytes(), "obj", ""),
            (b"".to_vec(), "obj", "0 different points"),
            (STL.as_bytes().to_vec(), "step", ".stl, .ply and .obj"),
        ] {
            let error = parse(&bytes, ending).unwrap_err();
            assert!(error.contains(word), "{ending}: {word}: {error}");
            assert!(!error.is_empty());
        }
    }

    proptest! {
        /// No input makes a reader panic or take more memory than the file's size allows.
        #[test]
        fn any_bytes_are_read_or_refused(cut in 0usize..200, at in 0usize..200, byte: u8, which in 0usize..6) {
            let (mut bytes, ending) = match which {
                0 => (stl().into_bytes(), "stl"),
                1 => (binary_stl(&[[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]; 2], 2), "stl"),
                2 => (PLY.as_bytes().to_vec(), "ply"),
                3 => (binary_ply(true), "ply"),
                4 => (binary_ply(false), "ply"),
                _ => (OBJ.as_bytes().to_vec(), "obj"),
            };
            let len = bytes.len();
            bytes[at % len] = byte;
            bytes.truncate(len - cut % len);
            if let Ok(mesh) = parse(&bytes, ending) {
                prop_assert!(mesh.vertices.iter().all(|v| v.amax().is_finite()));
            }
        }
    }
}
