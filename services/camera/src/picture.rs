//! Converts a `sensor_msgs/msg/Image` to grey values, or returns the reason for refusing it. Pure.

use tangent_estimation::depth_normal::{DepthEncodingError, DepthLayout};
use tangent_schemas::standard::Image;
use tangent_sensing::GreyImage;

/// A stamp that is older than the newest by more than this, ns, means that the driver has
/// restarted.
pub const RESTART_NS: i64 = 10_000_000_000;

/// Why an image is not used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PictureError {
    /// An encoding that this service does not read.
    #[error("encoding \"{0}\" is not supported; allowed: mono8, 8UC1, rgb8, bgr8")]
    Encoding(String),
    /// The image is not depth, or has less data than its header states.
    #[error(transparent)]
    Depth(#[from] DepthEncodingError),
    /// The image has another size than the calibration.
    #[error("{found:?} pixels, but camera.size_px (or the driver's calibration) is {stated:?}")]
    Size {
        /// Size of the image, pixels.
        found: [u32; 2],
        /// Size in the calibration, pixels.
        stated: [u32; 2],
    },
    /// The image has less data than its header states.
    #[error("{bytes} bytes with rows of {step}: {height} rows of at least {row} bytes are needed")]
    Data {
        /// Length of the data, bytes.
        bytes: usize,
        /// Bytes per row, as stated.
        step: u32,
        /// Rows.
        height: u32,
        /// Bytes that a row needs.
        row: u64,
    },
    /// The image is older than one that was used, or a duplicate.
    #[error(
        "its stamp is {behind_s:.3} s before that of an image already used: out of order or repeated"
    )]
    OutOfOrder {
        /// Difference from the newest stamp, s.
        behind_s: f64,
    },
    /// Neither the cell file nor the driver gives a calibration.
    #[error("no calibration: the cell file has none, and none was received on camera.info_topic")]
    Uncalibrated,
    /// The detector refused it.
    #[error("{0}")]
    Detector(String),
}

/// Checks that a depth image matches its header, as `depth_normal` reads it.
///
/// # Errors
/// [`PictureError`]: another size than `size_px`, an encoding that is not depth, or data that does
/// not fit the header.
pub fn check_depth(image: &Image, size_px: [u32; 2]) -> Result<(), PictureError> {
    check_size(image, size_px)?;
    DepthLayout::stated(
        [image.width, image.height],
        image.step,
        image.is_bigendian,
        &image.encoding,
    )?
    .check(image.data.len())?;
    Ok(())
}

fn check_size(image: &Image, size_px: [u32; 2]) -> Result<(), PictureError> {
    let found = [image.width, image.height];
    if found == size_px {
        return Ok(());
    }
    Err(PictureError::Size {
        found,
        stated: size_px,
    })
}

/// Number of bytes of a row that are pixels. The data must be as long as the header states; the
/// last row may lack its padding.
fn check_data(image: &Image, bytes_per_pixel: u64) -> Result<u64, PictureError> {
    let row = u64::from(image.width) * bytes_per_pixel;
    let before_last = u64::from(image.height.saturating_sub(1)) * u64::from(image.step);
    if u64::from(image.step) < row
        || row == 0
        || image.height == 0
        || (image.data.len() as u64) < before_last.saturating_add(row)
    {
        return Err(PictureError::Data {
            bytes: image.data.len(),
            step: image.step,
            height: image.height,
            row,
        });
    }
    Ok(row)
}

/// The image as 8-bit grey values.
///
/// # Errors
/// [`PictureError`]: another size than `size_px`, an unknown encoding, or data that does not fit
/// the header.
pub fn grey(image: &Image, size_px: [u32; 2]) -> Result<GreyImage, PictureError> {
    check_size(image, size_px)?;
    let (channels, weights): (u64, [u32; 3]) = match image.encoding.as_str() {
        "mono8" | "8UC1" => (1, [1, 0, 0]),
        // ITU-R BT.601.
        "rgb8" => (3, [299, 587, 114]),
        "bgr8" => (3, [114, 587, 299]),
        other => return Err(PictureError::Encoding(other.chars().take(32).collect())),
    };
    let row = check_data(image, channels)?;
    let rows = image
        .data
        .chunks(image.step as usize)
        .take(image.height as usize)
        .map(|line| &line[..row as usize]);
    let pixels = if channels == 1 {
        rows.flatten().copied().collect()
    } else {
        rows.flat_map(|line| line.chunks_exact(3))
            .map(|c| {
                let sum: u32 = (0..3).map(|i| weights[i] * u32::from(c[i])).sum();
                // At most 255.
                (sum / 1000) as u8
            })
            .collect()
    };
    Ok(GreyImage {
        width: image.width,
        height: image.height,
        pixels,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(encoding: &str, step: u32, data: Vec<u8>) -> Image {
        Image {
            height: 2,
            width: 3,
            encoding: encoding.to_owned(),
            step,
            data,
            ..Image::default()
        }
    }

    #[test]
    fn rows_may_be_padded() {
        let found = grey(&image("mono8", 4, vec![1, 2, 3, 99, 4, 5, 6, 99]), [3, 2]).unwrap();
        assert_eq!(found.pixels, [1, 2, 3, 4, 5, 6]);
        let short = grey(&image("mono8", 4, vec![1, 2, 3, 99, 4, 5, 6]), [3, 2]).unwrap();
        assert_eq!(short.pixels, found.pixels);
    }

    #[test]
    fn depth_is_taken_and_refused_as_the_estimator_does() {
        for (encoding, step, bytes) in [
            ("16UC1", 6, 12),
            ("mono16", 6, 12),
            ("32FC1", 12, 24),
            // Padded, and the last row without its padding.
            ("16UC1", 8, 16),
            ("16UC1", 8, 14),
        ] {
            for is_bigendian in [0, 1] {
                let sent = Image {
                    is_bigendian,
                    ..image(encoding, step, vec![0; bytes])
                };
                assert_eq!(check_depth(&sent, [3, 2]), Ok(()), "{encoding} {bytes}");
            }
        }
        for (bad, word) in [
            (image("mono8", 3, vec![0; 6]), "not \"mono8\""),
            (image("16UC1", 5, vec![0; 10]), "step = 5"),
            (image("16UC1", 8, vec![0; 13]), "at least 14"),
            (image("32FC1", 12, vec![0; 23]), "23 bytes"),
        ] {
            let error = check_depth(&bad, [3, 2]).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
    }

    #[test]
    fn colours_become_grey() {
        let mut data = vec![0; 18];
        data[..6].copy_from_slice(&[255, 0, 0, 255, 255, 255]);
        let rgb = grey(&image("rgb8", 9, data.clone()), [3, 2]).unwrap();
        let bgr = grey(&image("bgr8", 9, data), [3, 2]).unwrap();
        assert_eq!(rgb.pixels[..3], [76, 255, 0]);
        assert_eq!(bgr.pixels[..3], [29, 255, 0]);
    }

    #[test]
    fn images_that_do_not_fit_are_refused_with_the_reason() {
        for (bad, word) in [
            (image("mono16", 6, vec![0; 12]), "mono16"),
            (image("mono8", 3, vec![0; 5]), "5 bytes"),
            (image("mono8", 2, vec![0; 4]), "rows of at least 3"),
            (image("mono8", 0, vec![]), "0 bytes"),
            (image("rgb8", 3, vec![0; 6]), "at least 9"),
            (image("mono8", u32::MAX, vec![0; 6]), "6 bytes"),
        ] {
            let error = grey(&bad, [3, 2]).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
        let error = grey(&image("mono8", 3, vec![0; 6]), [640, 480]).unwrap_err();
        assert!(error.to_string().contains("640"), "{error}");
    }
}
