//! From a `sensor_msgs/msg/Image` to grey values, or why not. Pure.

use tangent_schemas::standard::Image;
use tangent_sensing::GreyImage;

/// A stamp that is older than the newest by more than this is a driver that began anew, ns.
pub const RESTART_NS: i64 = 10_000_000_000;

/// Why an image is not used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PictureError {
    /// Colours or depths that this service does not read.
    #[error("encoding \"{0}\" is not read; allowed: mono8, 8UC1, rgb8, bgr8")]
    Encoding(String),
    /// Not depth.
    #[error("encoding \"{0}\" is no depth; allowed: 16UC1 (mm) and 32FC1 (m)")]
    DepthEncoding(String),
    /// Another camera or another mode than the calibration is for.
    #[error("{found:?} pixels, but camera.size_px is {stated:?}")]
    Size {
        /// Of the image.
        found: [u32; 2],
        /// As configured.
        stated: [u32; 2],
    },
    /// Fewer or more bytes than the header says.
    #[error("{bytes} bytes with rows of {step}: {height} rows of at least {row} bytes are needed")]
    Data {
        /// Bytes that came.
        bytes: usize,
        /// Bytes per row, as stated.
        step: u32,
        /// Rows.
        height: u32,
        /// Bytes that a row needs.
        row: u64,
    },
    /// Older than one that was used, or the same again.
    #[error("taken {behind_s:.3} s before one that was used: out of order or repeated")]
    OutOfOrder {
        /// How much older.
        behind_s: f64,
    },
    /// The detector refused it.
    #[error("{0}")]
    Detector(String),
}

/// Whether a depth image is what its header says.
///
/// # Errors
/// [`PictureError`]: another size than `size_px`, an encoding that is not depth, or data that does not fit the header.
pub fn check_depth(image: &Image, size_px: [u32; 2]) -> Result<(), PictureError> {
    check_size(image, size_px)?;
    let bytes = match image.encoding.as_str() {
        "16UC1" => 2,
        "32FC1" => 4,
        other => {
            return Err(PictureError::DepthEncoding(
                other.chars().take(32).collect(),
            ));
        }
    };
    check_data(image, bytes)?;
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

/// Bytes of a row that are pixels, where the data is as long as the header says.
fn check_data(image: &Image, bytes_per_pixel: u64) -> Result<u64, PictureError> {
    let row = u64::from(image.width) * bytes_per_pixel;
    let needed = (image.step as usize).checked_mul(image.height as usize);
    if u64::from(image.step) < row || needed != Some(image.data.len()) {
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
/// [`PictureError`]: another size than `size_px`, an unknown encoding, or data that does not fit the header.
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
        .chunks_exact(image.step as usize)
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
    fn what_does_not_fit_is_refused_with_the_reason() {
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
        assert_eq!(check_depth(&image("16UC1", 6, vec![0; 12]), [3, 2]), Ok(()));
        assert_eq!(
            check_depth(&image("32FC1", 12, vec![0; 24]), [3, 2]),
            Ok(())
        );
        for (bad, word) in [
            (image("mono8", 3, vec![0; 6]), "no depth"),
            (image("16UC1", 5, vec![0; 10]), "at least 6"),
            (image("32FC1", 12, vec![0; 23]), "23 bytes"),
        ] {
            let error = check_depth(&bad, [3, 2]).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
        let error = grey(&image("mono8", 3, vec![0; 6]), [640, 480]).unwrap_err();
        assert!(error.to_string().contains("640"), "{error}");
    }
}
