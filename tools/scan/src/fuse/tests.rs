use crate::testing::{HEIGHT, WIDTH, fuse, image, image_of, info, intrinsics, state};

use super::*;

/// An arm that stands at x = 0.1 m, with a state every 10 ms up to this time.
fn standing(until_ms: i64) -> Fuse {
    let mut fuse = fuse();
    fuse.info(&info());
    for at_ms in (0..=until_ms).step_by(10) {
        fuse.state(&state(at_ms, 0.1));
    }
    fuse
}

#[test]
fn an_image_is_placed_at_its_stamp_once_the_arm_has_said_where_it_was() {
    let mut fuse = fuse();
    fuse.info(&info());
    // At its stamp the camera is at x = 0.1; when the image arrives, it has moved on.
    for at_ms in 0..=60 {
        fuse.state(&state(at_ms, 0.1 + 1e-4 * (at_ms - 20) as f64));
    }
    fuse.image(image(20));
    assert_eq!((fuse.images(), fuse.tally().placed), (1, 1));
    // No state after this one has arrived yet.
    fuse.image(image(65));
    assert_eq!((fuse.images(), fuse.tally().placed), (1, 1));
    fuse.state(&state(70, 0.105));
    assert_eq!(fuse.images(), 2);
    assert!(fuse.area_cm2() > 500.0, "{}", fuse.area_cm2());

    let scan = fuse.finish().unwrap();
    assert!(scan.points.iter().all(|p| p.z.abs() < 1e-6));
    let first = &scan.points[..(WIDTH * HEIGHT) as usize];
    let mean_x = first.iter().map(|p| p.x).sum::<f64>() / first.len() as f64;
    assert!((mean_x - 0.1).abs() < 1e-6, "{mean_x}");
}

#[test]
fn reordered_and_repeated_images_are_left_out() {
    let mut fuse = standing(200);
    for at_ms in [100, 100, 60, 140] {
        fuse.image(image(at_ms));
    }
    assert_eq!((fuse.tally().placed, fuse.tally().out_of_order), (2, 2));
    assert!(fuse.tally().left_out()[0].contains("2 older than an image before"));
}

#[test]
fn a_driver_that_restarts_with_an_older_clock_is_used_again() {
    let mut fuse = fuse();
    fuse.info(&info());
    fuse.image(image(3_600_000));
    fuse.state(&state(0, 0.1));
    fuse.state(&state(10, 0.1));
    fuse.image(image(5));
    assert_eq!(fuse.tally().out_of_order, 0);
}

#[test]
fn stamps_that_do_not_match_those_of_the_arm_are_named_with_their_distance() {
    let mut fuse = standing(3000);
    fuse.image(image(500));
    fuse.image(image(6400));
    assert_eq!((fuse.tally().late, fuse.tally().ahead), (1, 1));
    let said = fuse.tally().left_out().join("; ");
    for words in ["2.5 s before", "3.4 s after", "clocks"] {
        assert!(said.contains(words), "{words}: {said}");
    }
    assert!(fuse.finish().is_none());
}

#[test]
fn an_image_in_a_gap_of_the_arms_states_is_left_out() {
    let mut fuse = standing(100);
    fuse.image(image(150));
    fuse.state(&state(400, 0.1));
    assert_eq!((fuse.tally().placed, fuse.tally().unplaced), (0, 1));
    // The states go on.
    fuse.state(&state(410, 0.1));
    fuse.image(image(405));
    assert_eq!(fuse.tally().placed, 1);
}

#[test]
fn an_image_taken_in_a_fast_motion_is_left_out() {
    let mut fuse = fuse();
    fuse.info(&info());
    for at_ms in 0..=200 {
        // 0.1 m/s, then 0.2 m/s.
        let x_m = if at_ms < 100 {
            1e-4 * at_ms as f64
        } else {
            0.01 + 2e-4 * (at_ms - 100) as f64
        };
        fuse.state(&state(at_ms, x_m));
    }
    fuse.image(image(80));
    fuse.image(image(150));
    assert_eq!((fuse.tally().placed, fuse.tally().fast), (1, 1));
    assert!(fuse.tally().left_out()[0].contains("move the arm more slowly"));
}

#[test]
fn pixels_without_a_reading_are_left_out_and_an_image_without_any_is_blank() {
    let mut fuse = standing(200);
    fuse.image(image_of(50, |_| f64::NAN));
    fuse.image(image_of(60, |_| f64::INFINITY));
    fuse.image(image_of(70, |_| 0.0));
    assert_eq!((fuse.tally().placed, fuse.tally().blank), (0, 3));
    fuse.image(image_of(80, |k| [f64::NAN, 0.3][k % 8 / 4]));
    let scan = fuse.finish().unwrap();
    assert!(scan.points.iter().flatten().all(|x| x.is_finite()));
    assert!(!scan.points.is_empty());
}

#[test]
fn images_of_another_size_or_encoding_are_refused_with_the_reason() {
    let mut fuse = standing(200);
    fuse.image(Image {
        width: WIDTH / 2,
        ..image(50)
    });
    let said = fuse.tally().left_out().join("; ");
    assert!(
        said.contains("[32, 48] pixels") && said.contains("[64, 48]"),
        "{said}"
    );
    fuse.image(Image {
        encoding: "rgb8".into(),
        ..image(60)
    });
    fuse.image(Image {
        data: vec![0; 7],
        ..image(70)
    });
    assert_eq!((fuse.tally().placed, fuse.tally().refused), (0, 3));
}

#[test]
fn what_is_missing_is_named_and_waiting_images_are_bounded() {
    let mut fuse = fuse();
    assert_eq!(fuse.lacks(), Some("camera/depth"));
    for k in 0..100 {
        fuse.image(image(k));
    }
    assert_eq!(fuse.waiting.len(), WAITING_MAX);
    assert_eq!(fuse.lacks(), Some("camera/info"));
    fuse.info(&CameraInfo::default());
    assert_eq!(fuse.lacks(), Some("camera/info"));
    fuse.info(&info());
    assert_eq!(fuse.lacks(), Some("arm/state"));
    for at_ms in (0..=100).step_by(10) {
        fuse.state(&state(at_ms, 0.1));
    }
    assert_eq!(fuse.lacks(), None);
    assert_eq!(fuse.tally().placed, WAITING_MAX);
    assert_eq!(fuse.tally().unplaced, 100 - WAITING_MAX);
}

/// The arm stands still: what hides the surface in one image hides it in all.
#[test]
fn the_tool_in_the_view_is_left_out() {
    let mut cell = crate::testing::cell();
    cell.estimators.settings.insert(
        "depth_normal".to_owned(),
        "tool = { radius_m = 0.02, length_m = 0.2 }"
            .parse()
            .unwrap(),
    );
    let mut mounting = Mounting::from_cell(&cell).unwrap();
    // The tool is in the middle of the image.
    mounting.tool_from_camera = Pose::new(
        Vector3::new(0.0, 0.0, -0.25),
        nalgebra::UnitQuaternion::identity(),
    );
    let left_out = mounting.left_out(&intrinsics(), [WIDTH, HEIGHT]);
    let middle = (HEIGHT / 2 * WIDTH + WIDTH / 2) as usize;
    assert_eq!((left_out[middle], left_out[0]), (1, 0));
    let all = points_of(&image(0), &intrinsics(), &[], 10_000, 0).unwrap();
    let seen = points_of(&image(0), &intrinsics(), &left_out, 10_000, 0).unwrap();
    assert!(seen.len() < all.len());
    assert!(seen.iter().all(|p| p.xy().norm() > 0.01));
}
