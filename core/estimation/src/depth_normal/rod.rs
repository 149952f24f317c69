//! Mask of the tool in the image: a rod between two points, seen from the camera. Camera and tool
//! are both fixed to the flange, so it is drawn only once.

use nalgebra::Vector3;

use super::image::Intrinsics;

/// Marks in `left_out` (one entry per pixel of `size_px`) the pixels whose ray passes within
/// `radius_m` of the rod from `ends[0]` to `ends[1]`, camera axes, m. Existing marks remain.
/// Returns false and draws nothing if the sizes do not match.
pub fn leave_out_rod(
    intrinsics: &Intrinsics,
    size_px: [usize; 2],
    ends: [&Vector3<f64>; 2],
    radius_m: f64,
    left_out: &mut [u8],
) -> bool {
    let [width, height] = size_px;
    if width * height != left_out.len() || !intrinsics.is_sound() {
        return false;
    }
    for (i, out) in left_out.iter_mut().enumerate() {
        let [a, b] = intrinsics.ray((i % width) as f64, (i / width) as f64);
        if distance(&Vector3::new(a, b, 1.0), ends) <= radius_m {
            *out = 1;
        }
    }
    true
}

/// Distance between a half line from the origin and a segment, m.
fn distance(ray: &Vector3<f64>, ends: [&Vector3<f64>; 2]) -> f64 {
    let direction = ray.normalize();
    let rod = ends[1] - ends[0];
    // In the plane perpendicular to the ray, the line is a point and the rod a segment.
    let across = |v: &Vector3<f64>| v - direction * direction.dot(v);
    let (start, run) = (across(ends[0]), across(&rod));
    let length = run.norm_squared();
    let share = if length > 0.0 {
        (-start.dot(&run) / length).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let near = ends[0] + rod * share;
    if direction.dot(&near) > 0.0 {
        across(&near).norm()
    } else {
        near.norm()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_picture_of_a_rod_is_where_it_projects_to() {
        let intrinsics = Intrinsics {
            fx_px: 100.0,
            fy_px: 100.0,
            cx_px: 50.0,
            cy_px: 40.0,
        };
        let (from, to) = (Vector3::new(0.0, 0.0, 0.5), Vector3::new(0.1, 0.0, 0.5));
        let mut mask = vec![0; 101 * 81];
        assert!(leave_out_rod(
            &intrinsics,
            [101, 81],
            [&from, &to],
            0.01,
            &mut mask
        ));
        // The rod from (50, 40) to (70, 40), two pixels to either side.
        for (u, v, inside) in [
            (50, 40, 1),
            (70, 40, 1),
            (60, 42, 1),
            (60, 43, 0),
            (73, 40, 0),
            (47, 40, 0),
        ] {
            assert_eq!(mask[v * 101 + u], inside, "{u} {v}");
        }
        assert!(!leave_out_rod(
            &intrinsics,
            [100, 81],
            [&from, &to],
            0.01,
            &mut mask
        ));
    }

    #[test]
    fn a_rod_behind_the_camera_is_not_in_its_picture() {
        let intrinsics = Intrinsics {
            fx_px: 100.0,
            fy_px: 100.0,
            cx_px: 50.0,
            cy_px: 40.0,
        };
        let (from, to) = (Vector3::new(0.0, 0.0, -0.5), Vector3::new(0.1, 0.0, -0.5));
        let mut mask = vec![0; 101 * 81];
        leave_out_rod(&intrinsics, [101, 81], [&from, &to], 0.01, &mut mask);
        assert!(mask.iter().all(|m| *m == 0));
    }
}
