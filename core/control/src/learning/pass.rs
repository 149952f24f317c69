//! The record of one pass, in bins along the strokes, and its smoothing.

use nalgebra::Vector3;

use super::memory::Memory;
use crate::contact::alignment::tangential;

/// Standard deviation of the smoothing along the path, m: the zero-phase low-pass filter Q.
const SMOOTH_M: f64 = 0.0015;
/// Half width of the smoothing, in standard deviations.
const SMOOTH_WIDTH: f64 = 3.0;

/// Bound of the learnt difference between the commanded and the made slope.
pub(super) const CORRECTION_MAX: f64 = 0.1;

#[derive(Clone, Copy, Debug, Default)]
struct Bin {
    count: f64,
    distance: f64,
    position: Vector3<f64>,
    normal: Vector3<f64>,
    /// Sum of the distance along the normal to where the force would be the reference.
    lift_count: f64,
    lift: f64,
    /// Sum of the commanded displacements that take effect here.
    commanded: Vector3<f64>,
}

#[derive(Clone, Copy, Debug, Default)]
struct StrokeError {
    count: f64,
    square_n2: f64,
    weight: f64,
}

/// Smoothed surface at one place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    pub position: Vector3<f64>,
    pub tangent: Vector3<f64>,
    pub normal: Vector3<f64>,
    /// Slope that was commanded less the slope that the arm made, metres along the normal per metre
    /// along the path.
    pub correction: f64,
}

/// Record of one pass, with the bins of its memory.
#[derive(Clone, Debug)]
pub(super) struct Pass {
    strokes: Vec<(f64, Vec<Bin>)>,
    errors: Vec<StrokeError>,
}

impl Pass {
    pub fn new(memory: &Memory) -> Self {
        let bins = |n: usize| vec![Bin::default(); n];
        Self {
            strokes: (memory.strokes.iter())
                .map(|stroke| (stroke.bin_m(), bins(stroke.bins.len())))
                .collect(),
            errors: vec![StrokeError::default(); memory.strokes.len()],
        }
    }

    fn bin(&mut self, stroke: usize, distance_m: f64) -> Option<&mut Bin> {
        let (bin_m, bins) = self.strokes.get_mut(stroke)?;
        if !distance_m.is_finite() || distance_m < 0.0 {
            return None;
        }
        bins.get_mut((distance_m / *bin_m) as usize)
    }

    /// Adds the tool's position and the normal in use.
    pub fn place(
        &mut self,
        stroke: usize,
        distance_m: f64,
        position: &Vector3<f64>,
        normal: &Vector3<f64>,
    ) {
        if let Some(bin) = self.bin(stroke, distance_m) {
            bin.count += 1.0;
            bin.distance += distance_m;
            bin.position += position;
            bin.normal += normal;
        }
    }

    /// Adds a commanded displacement, base axes, m, at the place where it takes effect.
    pub fn command(&mut self, stroke: usize, distance_m: f64, way: &Vector3<f64>) {
        if let Some(bin) = self.bin(stroke, distance_m) {
            bin.commanded += way;
        }
    }

    /// Adds a force error, N, and its depth, m, at the place where it was felt; `weight` of the
    /// memory in use.
    pub fn felt(&mut self, stroke: usize, distance_m: f64, error_n: f64, lift_m: f64, weight: f64) {
        if let Some(bin) = self.bin(stroke, distance_m) {
            bin.lift_count += 1.0;
            bin.lift += lift_m;
        }
        if let Some(error) = self.errors.get_mut(stroke) {
            error.count += 1.0;
            error.square_n2 += error_n * error_n;
            error.weight += weight;
        }
    }

    /// Removes the record around a place, where contact was lost.
    pub fn forget(&mut self, stroke: usize, distance_m: f64, around_m: f64) {
        let Some((bin_m, bins)) = self.strokes.get_mut(stroke) else {
            return;
        };
        for (i, bin) in bins.iter_mut().enumerate() {
            if (((i as f64) + 0.5) * *bin_m - distance_m).abs() <= around_m {
                *bin = Bin::default();
            }
        }
    }

    /// RMS force error in a stroke, N; 0 without samples.
    pub fn error_rms_n(&self, stroke: usize) -> f64 {
        let error = self.errors[stroke];
        (error.square_n2 / error.count.max(1.0)).sqrt()
    }

    /// Mean weight of the memory in a stroke.
    pub fn weight(&self, stroke: usize) -> f64 {
        let error = self.errors[stroke];
        error.weight / error.count.max(1.0)
    }

    /// The surface at `place_m` along `stroke`: a local linear regression with Gaussian weights,
    /// which has no phase lag and no bias at the ends. `None` with too little data around it.
    pub fn smoothed(&self, stroke: usize, place_m: f64) -> Option<Point> {
        let (bin_m, bins) = self.strokes.get(stroke)?;
        let smooth_m = SMOOTH_M.max(*bin_m);
        let reach = (SMOOTH_WIDTH * smooth_m / bin_m).ceil() as usize;
        let centre = (place_m / bin_m) as usize;
        // The bin itself, or its neighbour at a gap of one, must have been felt.
        let is_felt = |i: usize| bins.get(i).is_some_and(|bin| bin.lift_count > 0.0);
        if !(is_felt(centre) || (is_felt(centre.wrapping_sub(1)) && is_felt(centre + 1))) {
            return None;
        }
        let from = centre.saturating_sub(reach);
        let (mut sum, mut sum_x, mut sum_xx) = (0.0, 0.0, 0.0);
        let (mut sum_y, mut sum_xy) = (Vector3::zeros(), Vector3::zeros());
        let (mut sum_p, mut sum_xp) = (Vector3::zeros(), Vector3::zeros());
        let (mut normal, mut commanded) = (Vector3::zeros(), Vector3::zeros());
        for bin in bins.iter().take(centre + reach + 1).skip(from) {
            if bin.count == 0.0 || bin.lift_count == 0.0 {
                continue;
            }
            let mean_normal = bin.normal.try_normalize(1e-3)?;
            let x = bin.distance / bin.count - place_m;
            let p = bin.position / bin.count;
            let y = p + mean_normal * (bin.lift / bin.lift_count);
            let weight = (-0.5 * (x / smooth_m).powi(2)).exp();
            sum += weight;
            sum_x += weight * x;
            sum_xx += weight * x * x;
            sum_y += y * weight;
            sum_xy += y * (weight * x);
            sum_p += p * weight;
            sum_xp += p * (weight * x);
            normal += mean_normal * weight;
            commanded += bin.commanded * weight;
        }
        let determinant = sum * sum_xx - sum_x * sum_x;
        if sum <= 0.0 || determinant < 0.1 * (sum * smooth_m).powi(2) * 0.1 {
            return None;
        }
        let slope = (sum_xy * sum - sum_y * sum_x) / determinant;
        let position = (sum_y * sum_xx - sum_xy * sum_x) / determinant;
        let (tangent, normal) = (slope.try_normalize(0.3)?, normal.try_normalize(1e-3)?);
        let made = ((sum_xp * sum - sum_p * sum_x) / determinant).try_normalize(0.3)?;
        let slope_of = |v: &Vector3<f64>| v.dot(&normal) / tangential(v, &normal).norm();
        // Little of a command falls on a place where the tool hardly moves.
        let correction = (commanded.try_normalize(0.1 * bin_m))
            .map_or(0.0, |commanded| slope_of(&commanded) - slope_of(&made));
        let point = Point {
            position,
            tangent,
            normal,
            correction: correction.clamp(-CORRECTION_MAX, CORRECTION_MAX),
        };
        let finite = |v: &Vector3<f64>| v.iter().all(|x| x.is_finite());
        let is_finite = finite(&position) && finite(&tangent) && finite(&normal);
        (is_finite && point.correction.is_finite()).then_some(point)
    }
}
