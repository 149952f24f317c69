//! Depth images in a driver's format: header, payload, and the normals computed from them.

use nalgebra::Vector3;
use tangent_camera::{check_depth, grey};
use tangent_estimation::depth_normal::{
    DepthImage, DepthLayout, DepthNormal, DepthNormalConfig, DepthNormalState, DepthSample,
    Intrinsics, ToolTarget,
};
use tangent_schemas::standard::Image;

/// Length of the header, bytes: width, height, step, and a byte for encoding and byte order.
const HEADER_BYTES: usize = 5;

/// Reads a small image with any payload. A normal that is marked valid is a finite unit vector.
pub fn depth_image(data: &[u8]) {
    let Some((header, payload)) = data.split_at_checked(HEADER_BYTES) else {
        return;
    };
    let encoding = ["16UC1", "32FC1", "mono8", "rgb8"][usize::from(header[4] & 3)];
    let image = Image {
        width: u32::from(header[0]),
        height: u32::from(header[1]),
        step: u32::from(u16::from_le_bytes([header[2], header[3]])),
        is_bigendian: header[4] >> 2 & 1,
        encoding: encoding.into(),
        data: payload.to_vec(),
        ..Image::default()
    };
    let size_px = [image.width, image.height];
    let _ = grey(&image, size_px);
    let checked = check_depth(&image, size_px);
    let stated = DepthLayout::stated(size_px, image.step, image.is_bigendian, encoding);
    let Ok(layout) = stated else {
        assert!(checked.is_err());
        return;
    };
    let mut depth_m = Vec::new();
    let read = layout.read(&image.data, &mut depth_m);
    assert_eq!(read.is_ok(), checked.is_ok());
    let Some(frame) = DepthImage::new(layout.width, layout.height, &depth_m) else {
        return;
    };
    let estimator = DepthNormal::new(&DepthNormalConfig::default())
        .expect("the default settings are in their ranges");
    let centre = [f64::from(image.width) / 2.0, f64::from(image.height) / 2.0];
    let sample = DepthSample {
        time_s: 0.0,
        image: frame,
        intrinsics: Intrinsics {
            fx_px: 60.0,
            fy_px: 60.0,
            cx_px: centre[0],
            cy_px: centre[1],
        },
        target: ToolTarget::Pixel(centre),
        left_out: None,
        travel: Some(Vector3::x()),
    };
    let seen = estimator.update(&mut DepthNormalState::default(), &sample);
    if seen.validity.is_valid() {
        let norm = seen.normal.norm();
        assert!((norm - 1.0).abs() < 1e-6, "a normal of length {norm}");
        assert!(seen.covariance.iter().all(|x| x.is_finite()));
    }
}
