//! The four corners of a target in a grey image, with sub-pixel positions and the right labels.
//!
//! The target is a light plate with a mark of two dark and two light cells at each corner of a
//! square, and a dark dot halfway between the square's middle and corner 0. The marks' saddle
//! points are found by the ChESS detector of `chess-corners`. Called wherever images are received:
//! the simulated camera, a camera service.

use chess_corners::{ChessRefiner, CornerDescriptor, Detector, DetectorConfig};
use nalgebra::Vector2;

/// Corners of the target.
const CORNERS: usize = 4;
/// A corner is looked for so far from where it was in the frame before, pixels.
const TRACK_PX: f64 = 15.0;
/// The dot must be darker than this share of what lies at its place at the other corners.
const DOT_SHARE: f64 = 0.7;
/// Half a side of the patch that is looked at for the dot, pixels.
const DOT_PX: i64 = 2;
/// Candidates looked at for a first labelling, strongest first.
const CANDIDATES_MAX: usize = 8;
/// Share of the strongest response below which nothing is a mark.
const RESPONSE_SHARE: f32 = 0.25;

/// An 8-bit grey image, row by row from the top. Pixel (0, 0)'s middle is at (0, 0).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GreyImage {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` values.
    pub pixels: Vec<u8>,
}

impl GreyImage {
    /// All of one value.
    pub fn filled(width: u32, height: u32, value: u8) -> Self {
        Self {
            width,
            height,
            pixels: vec![value; width as usize * height as usize],
        }
    }

    /// Mean over a small patch; none where it is not all inside.
    fn patch(&self, at: &Vector2<f64>) -> Option<f64> {
        let (x, y) = (at.x.round() as i64, at.y.round() as i64);
        let (width, height) = (i64::from(self.width), i64::from(self.height));
        if x < DOT_PX || y < DOT_PX || x + DOT_PX >= width || y + DOT_PX >= height {
            return None;
        }
        let mut sum = 0.0_f64;
        for row in y - DOT_PX..=y + DOT_PX {
            for column in x - DOT_PX..=x + DOT_PX {
                sum += f64::from(self.pixels[(row * width + column) as usize]);
            }
        }
        Some(sum / ((2 * DOT_PX + 1) * (2 * DOT_PX + 1)) as f64)
    }
}

/// The detector does not take its settings, or an image's size is not that of its pixels.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("corners of the target: {0}")]
pub struct TargetDetectorError(String);

/// Finds the target from image to image. A new one knows nothing of earlier images.
pub struct TargetDetector {
    detector: Detector,
    last: [Option<Vector2<f64>>; CORNERS],
}

impl TargetDetector {
    /// With the detector's single-scale preset and its saddle-point refinement.
    ///
    /// # Errors
    /// When the detector does not take its own preset.
    pub fn new() -> Result<Self, TargetDetectorError> {
        let config = DetectorConfig::chess()
            .without_orientation()
            .with_chess(|c| c.refiner = ChessRefiner::saddle_point());
        Ok(Self {
            detector: Detector::new(config).map_err(|e| TargetDetectorError(e.to_string()))?,
            last: [None; CORNERS],
        })
    }

    /// The corners, in the order of the target's own; none for one that was not found. Pixels.
    ///
    /// # Errors
    /// An image whose size is not that of its pixels.
    pub fn detect(
        &mut self,
        image: &GreyImage,
    ) -> Result<[Option<Vector2<f64>>; CORNERS], TargetDetectorError> {
        let mut found = self
            .detector
            .detect_u8(&image.pixels, image.width, image.height)
            .map_err(|e| TargetDetectorError(e.to_string()))?;
        found.sort_by(|a, b| b.response.total_cmp(&a.response));
        let floor = found.first().map_or(0.0, |c| c.response * RESPONSE_SHARE);
        found.retain(|c| c.response >= floor);
        let points: Vec<Vector2<f64>> = found.iter().map(position).collect();
        let tracked = self.tracked(&points);
        self.last = if tracked.iter().flatten().count() >= 2 {
            tracked
        } else {
            labelled(image, &points).map_or([None; CORNERS], |corners| corners.map(Some))
        };
        Ok(self.last)
    }

    /// Corners near where they were, and those that come back into view where the other three say.
    fn tracked(&self, points: &[Vector2<f64>]) -> [Option<Vector2<f64>>; CORNERS] {
        let nearest = |at: Vector2<f64>| {
            points
                .iter()
                .map(|p| ((p - at).norm(), *p))
                .filter(|(distance, _)| *distance <= TRACK_PX)
                .min_by(|a, b| a.0.total_cmp(&b.0))
                .map(|(_, p)| p)
        };
        let mut corners = self.last.map(|last| last.and_then(nearest));
        for i in 0..CORNERS {
            let others = [1, 2, 3].map(|k| corners[(i + k) % CORNERS]);
            if let (None, [Some(next), Some(across), Some(before)]) = (corners[i], others) {
                corners[i] = nearest(next + before - across);
            }
        }
        corners
    }
}

fn position(corner: &CornerDescriptor) -> Vector2<f64> {
    Vector2::new(f64::from(corner.x), f64::from(corner.y))
}

/// The strongest four that make a square seen from its front, beginning with the one that the dot
/// belongs to.
fn labelled(image: &GreyImage, points: &[Vector2<f64>]) -> Option<[Vector2<f64>; CORNERS]> {
    let count = points.len().min(CANDIDATES_MAX);
    for a in 0..count {
        for b in a + 1..count {
            for c in b + 1..count {
                for d in c + 1..count {
                    let four = [points[a], points[b], points[c], points[d]];
                    if let Some(corners) = ordered(image, four) {
                        return Some(corners);
                    }
                }
            }
        }
    }
    None
}

fn ordered(
    image: &GreyImage,
    mut four: [Vector2<f64>; CORNERS],
) -> Option<[Vector2<f64>; CORNERS]> {
    let middle = four.iter().sum::<Vector2<f64>>() / CORNERS as f64;
    // The image's y points down: counter-clockwise as seen is by falling angle.
    let angle = |p: &Vector2<f64>| (p.y - middle.y).atan2(p.x - middle.x);
    four.sort_by(|a, b| angle(b).total_cmp(&angle(a)));
    let centre = crossing(&four)?;
    let mut darkness = [0.0; CORNERS];
    for (value, corner) in darkness.iter_mut().zip(&four) {
        *value = image.patch(&((centre + corner) * 0.5))?;
    }
    let dot = (0..CORNERS).min_by(|&i, &j| darkness[i].total_cmp(&darkness[j]))?;
    let others = (0..CORNERS).filter(|&i| i != dot).map(|i| darkness[i]);
    let lightest = others.reduce(f64::min)?;
    if darkness[dot] > DOT_SHARE * lightest {
        return None;
    }
    four.rotate_left(dot);
    Some(four)
}

/// Where the diagonals cross, which is the square's middle under any perspective; none unless the
/// four are convex.
fn crossing(four: &[Vector2<f64>; CORNERS]) -> Option<Vector2<f64>> {
    let (u, v) = (four[2] - four[0], four[3] - four[1]);
    let cross = u.perp(&v);
    let from = four[1] - four[0];
    let (s, t) = (from.perp(&v) / cross, from.perp(&u) / cross);
    let inside = |x: f64| (0.1..0.9).contains(&x);
    (inside(s) && inside(t)).then(|| four[0] + u * s)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A target seen flat: 100 px to a side, turned by `angle`, cells of 15 px, blurred over 2.4 px
    /// as by a lens.
    fn drawn(middle: Vector2<f64>, angle: f64) -> (GreyImage, [Vector2<f64>; CORNERS]) {
        let (sin, cos) = angle.sin_cos();
        // x to the right, y up in the target; y down in the image.
        let turn = |x: f64, y: f64| Vector2::new(cos * x - sin * y, -(sin * x + cos * y));
        let corners =
            [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[x, y]| [50.0 * x, 50.0 * y]);
        let dark = |p: Vector2<f64>| {
            let d = p - middle;
            let (x, y) = (cos * d.x - sin * d.y, -(sin * d.x + cos * d.y));
            let cell = corners.iter().any(|[cx, cy]| {
                let (u, v) = (x - cx, y - cy);
                u.abs() < 15.0 && v.abs() < 15.0 && u * v > 0.0
            });
            let (u, v) = (x + 25.0, y + 25.0);
            cell || u * u + v * v < 64.0
        };
        let mut image = GreyImage::filled(320, 240, 220);
        for row in 0..240 {
            for column in 0..320 {
                let mut sum = 0.0_f64;
                for i in 0..6 {
                    for j in 0..6 {
                        let at = |k: u32, n: u32| f64::from(n) + (f64::from(k) - 2.5) * 0.4;
                        let p = Vector2::new(at(i, column), at(j, row));
                        sum += if dark(p) { 30.0 } else { 220.0 };
                    }
                }
                image.pixels[(row * 320 + column) as usize] = (sum / 36.0).round() as u8;
            }
        }
        (image, corners.map(|[x, y]| middle + turn(x, y)))
    }

    #[test]
    fn corners_are_found_with_their_labels_however_the_target_lies() {
        for k in 0..8 {
            let angle = 0.3 + 0.8 * f64::from(k);
            let middle = Vector2::new(158.3 + 0.37 * f64::from(k), 121.6);
            let (image, truth) = drawn(middle, angle);
            let found = TargetDetector::new().unwrap().detect(&image).unwrap();
            for (found, truth) in found.iter().zip(&truth) {
                let found = found.unwrap();
                assert!((found - truth).norm() < 0.2, "{k}: {found} {truth}");
            }
        }
    }

    #[test]
    fn a_corner_that_leaves_the_image_comes_back_under_its_own_label() {
        let mut detector = TargetDetector::new().unwrap();
        let mut seen = [0; CORNERS];
        for step in 0..60_i32 {
            // Out to the left and back.
            let x = 70.0 + 1.5 * f64::from((step - 30).abs());
            let (image, truth) = drawn(Vector2::new(x - 25.0, 120.4), 0.2);
            let found = detector.detect(&image).unwrap();
            for i in 0..CORNERS {
                if let Some(found) = found[i] {
                    assert!((found - truth[i]).norm() < 0.3, "step {step} corner {i}");
                    seen[i] += 1;
                }
            }
        }
        assert!(seen.iter().all(|&n| n >= 10), "{seen:?}");
        assert!(seen.iter().any(|&n| n < 58), "{seen:?}");
    }

    #[test]
    fn an_empty_or_wrong_image_has_no_corners() {
        let mut detector = TargetDetector::new().unwrap();
        let blank = GreyImage::filled(64, 48, 128);
        assert_eq!(detector.detect(&blank).unwrap(), [None; CORNERS]);
        let mut wrong = blank;
        wrong.width = 65;
        assert!(detector.detect(&wrong).is_err());
    }
}
