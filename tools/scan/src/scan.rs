//! The points of a scan, and its file.

use nalgebra::Vector3;

use crate::tally::Tally;

/// Points of a scan.
#[derive(Clone, Debug, PartialEq)]
pub struct Scan {
    /// Points in the base, m.
    pub points: Vec<Vector3<f64>>,
    /// Images that were used.
    pub images: usize,
    /// Area that was seen along the axis of the camera in its first image, cm².
    pub area_cm2: f64,
    /// What became of all images.
    pub tally: Tally,
    /// What was lost on the way; empty if nothing was.
    pub lost: Vec<String>,
}

impl Scan {
    /// A PLY file (binary, low byte first, single precision) with the points in the base, m.
    pub fn to_ply(&self, cell: &str) -> Vec<u8> {
        let cell = cell.replace(|c: char| c.is_control(), " ");
        let mut bytes = format!(
            "ply\nformat binary_little_endian 1.0\n\
             comment points of {} depth images of the cell {cell}, in the base of the robot, m\n\
             element vertex {}\n\
             property float x\nproperty float y\nproperty float z\nend_header\n",
            self.images,
            self.points.len()
        )
        .into_bytes();
        for point in &self.points {
            for x in point.iter() {
                bytes.extend((*x as f32).to_le_bytes());
            }
        }
        bytes
    }

    /// Corners of the box around the points, m.
    pub fn bounds_m(&self) -> ([f64; 3], [f64; 3]) {
        let start = (
            Vector3::repeat(f64::INFINITY),
            Vector3::repeat(f64::NEG_INFINITY),
        );
        let (low, high): (Vector3<f64>, Vector3<f64>) =
            (self.points.iter()).fold(start, |(low, high), p| (low.inf(p), high.sup(p)));
        (low.into(), high.into())
    }

    /// What a person should know about the scan, a sentence each.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = vec![format!(
            "{} points of {} out of {} depth images",
            self.points.len(),
            self.images,
            self.tally.received
        )];
        notes.extend((self.tally.left_out().iter()).map(|why| format!("images left out: {why}")));
        notes.extend(self.lost.iter().cloned());
        notes
    }
}
