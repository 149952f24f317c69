//! The points of a depth image, in axes of the camera.

use nalgebra::Vector3;
use tangent_estimation::depth_normal::{DepthEncodingError, DepthLayout, Intrinsics};
use tangent_schemas::standard::Image;

/// Nearest and furthest reading that is used, m.
const RANGE_M: (f64, f64) = (0.02, 3.0);
/// Readings that differ by more than this share from that beside them are at the rim of something
/// nearer: their depth is mixed.
const RIM_SHARE: f64 = 0.03;

/// At most about `count_max` points, evenly over the image, m. Pixels that are not zero in
/// `left_out` are left out. `number` of the image: those of one camera that stands differ in the
/// pixels that are taken, so that together they have all of them.
pub(crate) fn points_of(
    image: &Image,
    intrinsics: &Intrinsics,
    left_out: &[u8],
    count_max: usize,
    number: usize,
) -> Result<Vec<Vector3<f64>>, DepthEncodingError> {
    let (width, height) = (image.width as usize, image.height as usize);
    let mut depth_m = Vec::new();
    DepthLayout::stated(
        [image.width, image.height],
        image.step,
        image.is_bigendian,
        &image.encoding,
    )?
    .read(&image.data, &mut depth_m)?;
    let mut step = 1;
    while (width / step) * (height / step) > count_max {
        step += 1;
    }
    let [first_u, first_v] = first_pixel(step, number);
    let mut points = Vec::new();
    for v in (first_v..height).step_by(step) {
        for u in (first_u..width).step_by(step) {
            let z = f64::from(depth_m[v * width + u]);
            let beside = [
                (u + 1 < width).then(|| (u + 1, v)),
                (v + 1 < height).then(|| (u, v + 1)),
            ];
            let at_rim = beside.into_iter().flatten().any(|(u, v)| {
                let other = f64::from(depth_m[v * width + u]);
                let step = (other - z).abs();
                step.is_nan() || step > RIM_SHARE * z
            });
            let is_tool = left_out.get(v * width + u).is_some_and(|out| *out != 0);
            if (RANGE_M.0..RANGE_M.1).contains(&z) && !at_rim && !is_tool {
                let [x, y] = intrinsics.ray(u as f64, v as f64);
                points.push(Vector3::new(x * z, y * z, z));
            }
        }
    }
    Ok(points)
}

/// First column and row of every `step`-th pixel of an image: `step * step` images in sequence have
/// each pixel once, and few of them are spread over the gaps.
fn first_pixel(step: usize, number: usize) -> [usize; 2] {
    let (column, turn) = (number % step, number / step);
    // Each next column begins about 0.38 of the step further down, the golden section.
    [column, (turn + column * (3 * step / 8).max(1)) % step]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_of_a_camera_that_stands_have_all_pixels_together() {
        for step in [1, 2, 5, 6, 8] {
            let all: std::collections::HashSet<_> = (0..step * step)
                .map(|number| first_pixel(step, number))
                .collect();
            assert_eq!(all.len(), step * step);
        }
    }

    #[test]
    fn a_tilted_plane_is_seen_where_it_is() {
        let intrinsics = Intrinsics {
            fx_px: 100.0,
            fy_px: 100.0,
            cx_px: 32.0,
            cy_px: 24.0,
        };
        let (width, height) = (64_usize, 48_usize);
        // The plane z = 0.3 + 0.2 x.
        let depth = |k: usize| {
            let [x, _] = intrinsics.ray((k % width) as f64, (k / width) as f64);
            (0.3 / (1.0 - 0.2 * x)) as f32
        };
        let mut image = Image {
            header: Default::default(),
            height: height as u32,
            width: width as u32,
            encoding: "32FC1".into(),
            is_bigendian: 0,
            step: 4 * width as u32,
            data: (0..width * height)
                .flat_map(|k| depth(k).to_le_bytes())
                .collect(),
        };
        let points = points_of(&image, &intrinsics, &[], 10_000, 0).unwrap();
        assert_eq!(points.len(), width * height);
        for p in &points {
            assert!((p.z - 0.3 - 0.2 * p.x).abs() < 1e-6);
        }
        assert!(points_of(&image, &intrinsics, &[], 100, 0).unwrap().len() <= 100);
        // No reading, and the pixels beside it.
        image.data[..4].copy_from_slice(&f32::NAN.to_le_bytes());
        assert_eq!(
            points_of(&image, &intrinsics, &[], 10_000, 0)
                .unwrap()
                .len(),
            width * height - 1
        );
        image.step = 7;
        assert!(points_of(&image, &intrinsics, &[], 100, 0).is_err());
    }
}
