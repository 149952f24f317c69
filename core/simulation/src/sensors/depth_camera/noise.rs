//! Errors of a stereo camera, applied to the true inverse depth: noise and steps of the disparity,
//! holes, flying pixels, rounding to millimetres.

use rand::{Rng, RngExt};
use rand_distr::{Distribution, Poisson, StandardNormal};
use rand_pcg::Pcg64Mcg;
use tangent_estimation::depth_normal::Intrinsics;

use super::config::DepthNoiseConfig;
use super::correlated::CorrelatedError;

/// Turns rendered frames of one size into readings.
pub struct StereoNoise {
    config: DepthNoiseConfig,
    range_m: [f64; 2],
    width: usize,
    height: usize,
    /// White noise of three lines, for the share that neighbours have in common.
    white: Vec<f32>,
    mixed: Vec<f32>,
    correlated: Option<CorrelatedError>,
    /// Inverse depth of each pixel before noise, 1/m: between foreground and background for a
    /// flying pixel; 0 for a hole.
    said: Vec<f32>,
}

impl StereoNoise {
    /// `range_m` as in [`crate::sensors::depth_camera::DepthCameraConfig`].
    pub fn new(
        config: &DepthNoiseConfig,
        range_m: [f64; 2],
        [width, height]: [usize; 2],
        seed: u64,
    ) -> Self {
        Self {
            correlated: CorrelatedError::new(config, width, seed),
            config: *config,
            range_m,
            width,
            height,
            white: vec![0.0; width * height],
            mixed: vec![0.0; width],
            said: vec![0.0; width * height],
        }
    }

    /// Standard deviation of inverse depth, 1/m. It does not depend on the depth, as the standard
    /// deviation of depth grows with the square of the depth.
    pub fn inverse_sd(config: &DepthNoiseConfig) -> f64 {
        config.sd_at_half_metre_m / 0.25
    }

    /// Converts `truth` (inverse depth, 1/m, 0 for nothing) of the frame exposed at `time_s` to
    /// `depth_mm` (0 for no reading).
    pub fn apply(
        &mut self,
        time_s: f64,
        truth: &[f32],
        intrinsics: &Intrinsics,
        rng: &mut Pcg64Mcg,
        depth_mm: &mut [u16],
    ) {
        self.edges_and_grazing(truth, intrinsics, rng);
        if self.config.stereo_shadow {
            self.shadow(truth, intrinsics);
        }
        self.holes(rng);
        if let Some(correlated) = &mut self.correlated {
            correlated.expose(time_s);
        }
        self.read(intrinsics, rng, depth_mm);
    }

    /// Adds flying pixels where foreground meets background, and losses where the surface is seen
    /// edge-on.
    fn edges_and_grazing(&mut self, truth: &[f32], intrinsics: &Intrinsics, rng: &mut Pcg64Mcg) {
        let (width, height) = (self.width, self.height);
        let c = self.config;
        let (cos_from, cos_to) = (c.grazing_from_rad.cos(), c.grazing_to_rad.cos());
        // Slopes beyond this are past the angle at which all pixels are lost.
        let slope_end = c.grazing_to_rad.min(1.55).tan();
        for v in 0..height {
            for u in 0..width {
                let i = v * width + u;
                let w = truth[i];
                self.said[i] = w;
                if w == 0.0 {
                    continue;
                }
                let left = truth[if u > 0 { i - 1 } else { i }];
                let right = truth[if u + 1 < width { i + 1 } else { i }];
                let up = truth[if v > 0 { i - width } else { i }];
                let down = truth[if v + 1 < height { i + width } else { i }];
                // A jump: more than a surface at the end of the grazing range could rise within a
                // pixel.
                let jump = (slope_end * f64::from(w) / intrinsics.fx_px) as f32 + 0.02 * w;
                let furthest = [left, right, up, down]
                    .into_iter()
                    .filter(|n| *n > 0.0)
                    .fold(w, |best, n| {
                        if (n - w).abs() > (best - w).abs() {
                            n
                        } else {
                            best
                        }
                    });
                if (furthest - w).abs() > jump {
                    let fly = rng.random::<f64>() < c.flying_share;
                    let between = rng.random::<f32>() * 0.5;
                    if fly {
                        // Depth between foreground and background, at most half way.
                        self.said[i] = 1.0 / (1.0 / w + (1.0 / furthest - 1.0 / w) * between);
                    }
                    continue;
                }
                let (across, span_u) = slope(left, w, right);
                let (along, span_v) = slope(up, w, down);
                let w_a = f64::from(across) * intrinsics.fx_px / span_u;
                let w_b = f64::from(along) * intrinsics.fy_px / span_v;
                let [a, b] = intrinsics.ray(u as f64, v as f64);
                let gradient = w_a * w_a + w_b * w_b + (f64::from(w) - a * w_a - b * w_b).powi(2);
                let ray = a * a + b * b + 1.0;
                let cos2 = f64::from(w).powi(2) / (gradient * ray);
                if cos2 < cos_from * cos_from {
                    let share = (cos_from - cos2.sqrt()) / (cos_from - cos_to).max(1e-9);
                    if rng.random::<f64>() < share {
                        self.said[i] = 0.0;
                    }
                }
            }
        }
    }

    /// Removes what the right imager cannot see because of a nearer object.
    fn shadow(&mut self, truth: &[f32], intrinsics: &Intrinsics) {
        let scale = (intrinsics.fx_px * self.config.baseline_m) as f32;
        for v in 0..self.height {
            let line = v * self.width..(v + 1) * self.width;
            let mut taken = f32::INFINITY;
            for (u, (w, said)) in truth[line.clone()]
                .iter()
                .zip(&mut self.said[line])
                .enumerate()
                .rev()
            {
                if *w == 0.0 {
                    continue;
                }
                let in_right = u as f32 - scale * w;
                // Any slope overlaps by less than a pixel; only a larger overlap hides a pixel.
                if in_right > taken + 0.5 {
                    *said = 0.0;
                }
                taken = taken.min(in_right);
            }
        }
    }

    fn holes(&mut self, rng: &mut Pcg64Mcg) {
        if self.config.holes_per_frame <= 0.0 {
            return;
        }
        let count = Poisson::new(self.config.holes_per_frame).map_or(0.0, |p| p.sample(rng));
        for _ in 0..count as usize {
            let middle = [
                rng.random::<f64>() * self.width as f64,
                rng.random::<f64>() * self.height as f64,
            ];
            let radius = rng.random::<f64>() * self.config.hole_radius_px;
            let reach = |middle: f64, size: usize| {
                let from = (middle - radius).ceil().max(0.0) as usize;
                let to = (middle + radius).floor().max(-1.0) + 1.0;
                from..(to as usize).min(size)
            };
            for v in reach(middle[1], self.height) {
                for u in reach(middle[0], self.width) {
                    let d = [u as f64 - middle[0], v as f64 - middle[1]];
                    if d[0] * d[0] + d[1] * d[1] <= radius * radius {
                        self.said[v * self.width + u] = 0.0;
                    }
                }
            }
        }
    }

    /// Applies noise, disparity steps, single losses and rounding to millimetres.
    fn read(&mut self, intrinsics: &Intrinsics, rng: &mut Pcg64Mcg, depth_mm: &mut [u16]) {
        let c = self.config;
        let sd = Self::inverse_sd(&c) as f32;
        if sd > 0.0 {
            for x in &mut self.white {
                *x = StandardNormal.sample(rng);
            }
        }
        let share = c.neighbour_share as f32;
        // Keeps the noise variance of one pixel independent of `share`.
        let keep = 1.0 / (1.0 + 2.0 * share * share);
        let step = (c.disparity_steps > 0)
            .then(|| (intrinsics.fx_px * c.baseline_m * f64::from(c.disparity_steps)) as f32);
        let lost_below = (c.lost_share * (1u64 << 32) as f64) as u64;
        let [near, far] = self.range_m.map(|m| m as f32);
        let (width, height) = (self.width, self.height);
        for v in 0..height {
            let here = &self.white[v * width..(v + 1) * width];
            let up = &self.white[v.saturating_sub(1) * width..][..width];
            let down = &self.white[(v + 1).min(height - 1) * width..][..width];
            for (m, ((x, a), b)) in self.mixed.iter_mut().zip(here.iter().zip(up).zip(down)) {
                *m = x + share * (a + b);
            }
            let correlated = self.correlated.as_mut().map(|error| error.line(v));
            for u in 0..width {
                let i = v * width + u;
                depth_mm[i] = 0;
                let w = self.said[i];
                if w == 0.0 {
                    continue;
                }
                if lost_below > 0 && u64::from(rng.next_u32()) < lost_below {
                    continue;
                }
                let left = self.mixed[u.saturating_sub(1)];
                let right = self.mixed[(u + 1).min(width - 1)];
                let mut said = w + sd * keep * (self.mixed[u] + share * (left + right));
                if let Some(error) = correlated {
                    said += error[u];
                }
                if let Some(step) = step {
                    said = (said * step).round() / step;
                }
                if said > 0.0 {
                    let depth = 1.0 / said;
                    if depth >= near && depth <= far {
                        depth_mm[i] = (depth * 1000.0).round() as u16;
                    }
                }
            }
        }
    }
}

/// Difference over the existing neighbours, and the number of pixels that it spans.
fn slope(before: f32, here: f32, after: f32) -> (f32, f64) {
    match (before > 0.0, after > 0.0) {
        (true, true) => (after - before, 2.0),
        (true, false) => (here - before, 1.0),
        (false, true) => (after - here, 1.0),
        (false, false) => (0.0, 1.0),
    }
}
