//! Detection of a target's four labelled corners in a grey image, with sub-pixel accuracy.
//!
//! The target is a light plate with a mark of two dark and two light cells at each corner of a
//! square, and a dark dot halfway between the square's centre and corner 0. The ChESS detector of
//! `chess-corners` finds the saddle points of the marks. Called by the camera service and the
//! simulated camera for each image.

use chess_corners::{ChessRefiner, CornerDescriptor, Detector, DetectorConfig};
use nalgebra::Vector2;

/// Number of corners of the target.
const CORNERS: usize = 4;
/// Search radius of a corner around its position in the previous image, pixels.
const TRACK_PX: f64 = 15.0;
/// Largest brightness of the dot, as a share of that of the corresponding places at the other
/// corners.
const DOT_SHARE: f64 = 0.7;
/// Half the side of the patch in which the dot's brightness is measured, pixels.
const DOT_PX: i64 = 2;
/// Number of candidates for the first labelling, strongest first.
const CANDIDATES_MAX: usize = 8;
/// Smallest response of a mark, as a share of the strongest response.
const RESPONSE_SHARE: f32 = 0.25;

/// An 8-bit grey image, row by row from the top. The centre of the first pixel is at (0, 0).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GreyImage {
    /// Number of pixels per row.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// Brightness of each pixel: `width * height` values.
    pub pixels: Vec<u8>,
}

impl GreyImage {
    /// Image of one brightness.
    pub fn filled(width: u32, height: u32, value: u8) -> Self {
        Self {
            width,
            height,
            pixels: vec![value; width as usize * height as usize],
        }
    }

    /// Mean brightness of a small patch; `None` if it is not entirely inside the image.
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

/// The detector rejects its settings, or the size of an image does not match its pixels.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("corners of the target: {0}")]
pub struct TargetDetectorError(String);

/// Finds the target in successive images and tracks its corners. A new one is the reset.
///
/// ```
/// use tangent_sensing::{GreyImage, TargetDetector};
/// let mut detector = TargetDetector::new()?;
/// let empty = GreyImage::filled(320, 240, 128);
/// assert_eq!(detector.detect(&empty)?, [None; 4]);
/// # Ok::<(), tangent_sensing::TargetDetectorError>(())
/// ```
pub struct TargetDetector {
    detector: Detector,
    last: [Option<Vector2<f64>>; CORNERS],
}

impl TargetDetector {
    /// Detector with the single-scale preset and saddle-point refinement of `chess-corners`.
    ///
    /// # Errors
    /// `chess-corners` rejects its preset.
    pub fn new() -> Result<Self, TargetDetectorError> {
        let config = DetectorConfig::chess()
            .without_orientation()
            .with_chess(|c| c.refiner = ChessRefiner::saddle_point());
        Ok(Self {
            detector: Detector::new(config).map_err(|e| TargetDetectorError(e.to_string()))?,
            last: [None; CORNERS],
        })
    }

    /// Positions of the corners in pixels, in the target's order; `None` for one that was not
    /// found.
    ///
    /// # Errors
    /// The size of the image does not match its pixels.
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

    /// Corners near their previous positions, and those that return into view at the place that the
    /// other three imply.
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

/// The strongest four points that form a square seen from its front, beginning with the corner of
/// the dot.
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
    // The image's y axis points down, so falling angles are counter-clockwise in view.
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

/// Intersection of the diagonals, which is the square's centre in any perspective; `None` unless
/// the four points are convex.
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
