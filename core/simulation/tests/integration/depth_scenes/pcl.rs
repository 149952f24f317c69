//! Normals of the Point Cloud Library for the same frames, from a small program that is built when
//! needed.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use tangent_estimation::depth_normal::PixelNormal;
use tangent_simulation::depth_camera::DepthFrame;

/// Result of the library for one frame.
pub struct PclFrame {
    pub fastest_ms: f64,
    pub median_ms: f64,
    /// Points (m) and normals, camera axes.
    pub points: Vec<([f32; 3], PixelNormal)>,
}

/// The compiled program.
pub struct Pcl {
    program: PathBuf,
    folder: PathBuf,
}

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

impl Pcl {
    /// Compiles the program against PCL 1.13.
    ///
    /// # Errors
    /// What is missing.
    pub fn build() -> Result<Self, String> {
        let source = repository().join("tests/pcl/voxel_normals.cpp");
        // Headers of the whole development package, or only those that .ci/pcl-headers unpacks.
        let headers = [
            repository().join(".pcl/usr/include/pcl-1.13"),
            PathBuf::from("/usr/include/pcl-1.13"),
        ]
        .into_iter()
        .find(|path| path.join("pcl/features/normal_3d.h").exists())
        .ok_or("there are no headers of PCL 1.13 (.ci/pcl-headers unpacks them)")?;
        let folder = std::env::temp_dir().join(format!("pcl-{}", std::process::id()));
        fs::create_dir_all(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        let program = folder.join("voxel_normals");
        let libraries = [
            "features", "filters", "search", "kdtree", "octree", "common",
        ];
        let output = Command::new("g++")
            .args(["-O2", "-std=c++17", "-w", "-isystem"])
            .arg(headers)
            .args(["-isystem", "/usr/include/eigen3"])
            .arg(source)
            .arg("-o")
            .arg(&program)
            .args(libraries.map(|l| format!("-l:libpcl_{l}.so.1.13")))
            .output()
            .map_err(|e| format!("g++ does not run: {e}"))?;
        if output.status.success() {
            Ok(Self { program, folder })
        } else {
            let said = String::from_utf8_lossy(&output.stderr);
            Err(format!("g++: {}", said.lines().next().unwrap_or_default()))
        }
    }

    /// Computes the normals of every frame with a voxel size of `leaf_m` (0 for none) and this
    /// number of neighbours.
    ///
    /// # Errors
    /// The program failed, which is a defect.
    pub fn run(
        &self,
        frames: &[DepthFrame],
        leaf_m: f64,
        neighbours: u32,
        repeats: u32,
    ) -> Result<Vec<PclFrame>, String> {
        let (input, result) = (self.folder.join("frames"), self.folder.join("result"));
        fs::write(&input, file_of(frames)).map_err(|e| e.to_string())?;
        let output = Command::new(&self.program)
            .args([&input, &result])
            .args([
                leaf_m.to_string(),
                neighbours.to_string(),
                repeats.to_string(),
            ])
            .output()
            .map_err(|e| e.to_string())?;
        if !output.status.success() {
            return Err(String::from_utf8_lossy(&output.stderr).into_owned());
        }
        let bytes = fs::read(&result).map_err(|e| e.to_string())?;
        let mut words = bytes.as_chunks::<4>().0.iter();
        let mut times = Vec::new();
        for line in String::from_utf8_lossy(&output.stdout).lines() {
            let mut numbers = line.split(' ').filter_map(|n| n.parse().ok());
            let pair = numbers.next().zip(numbers.next());
            times.push(pair.ok_or_else(|| format!("not two times: {line}"))?);
        }
        let mut found = Vec::new();
        for (fastest_ms, median_ms) in times {
            let count = words.next().map_or(0, |w| u32::from_le_bytes(*w));
            let mut next = || {
                words
                    .next()
                    .map(|w| f32::from_le_bytes(*w))
                    .ok_or("too few points")
            };
            let mut points = Vec::new();
            for _ in 0..count {
                let [x, y, z, a, b, c] = [next()?, next()?, next()?, next()?, next()?, next()?];
                points.push(([x, y, z], [a, b, c]));
            }
            found.push(PclFrame {
                fastest_ms,
                median_ms,
                points,
            });
        }
        Ok(found)
    }
}

impl Drop for Pcl {
    fn drop(&mut self) {
        // A folder that cannot be removed remains in the target folder.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Input file of the program; its header describes its contents.
fn file_of(frames: &[DepthFrame]) -> Vec<u8> {
    let mut bytes = b"tgdepth1".to_vec();
    let first = &frames[0];
    for n in [frames.len(), first.width, first.height] {
        bytes.extend((n as u32).to_le_bytes());
    }
    let i = first.intrinsics;
    for x in [i.fx_px, i.fy_px, i.cx_px, i.cy_px] {
        bytes.extend((x as f32).to_le_bytes());
    }
    for frame in frames {
        bytes.extend(frame.depth_mm.iter().flat_map(|mm| mm.to_le_bytes()));
    }
    bytes
}

/// True normals at the pixels of the points, in the points' order.
pub fn truth_at_points(
    frame: &DepthFrame,
    truth: &[PixelNormal],
    points: &[([f32; 3], PixelNormal)],
) -> Vec<PixelNormal> {
    let at = |p: &[f32; 3]| {
        let [u, v] = frame.intrinsics.project(&p.map(f64::from).into())?;
        let (u, v) = (u.round(), v.round());
        let inside = u >= 0.0 && v >= 0.0 && u < frame.width as f64 && v < frame.height as f64;
        inside.then(|| truth[v as usize * frame.width + u as usize])
    };
    points
        .iter()
        .map(|(p, _)| at(p).unwrap_or([0.0; 3]))
        .collect()
}
