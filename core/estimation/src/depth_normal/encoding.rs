//! Converts payloads of `sensor_msgs/Image` to metres. Called where frames are received, before the
//! first step.

use thiserror::Error;

/// Number format of a payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DepthEncoding {
    /// Unsigned 16-bit integers, mm; 0 for no reading.
    Millimetres16,
    /// 32-bit floating point, m; NaN or 0 for no reading.
    Metres32,
}

/// Why a payload cannot be read as a depth image.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum DepthEncodingError {
    /// The encoding is neither of the two depth encodings (REP 118).
    #[error("a depth image must be encoded as 16UC1 (mm) or 32FC1 (m), not \"{0}\"")]
    Encoding(String),
    /// Rows overlap.
    #[error("step = {step} bytes is too short for a row of {width} pixels of {bytes} bytes each")]
    Step {
        /// Bytes from row to row.
        step: usize,
        /// Pixels along a row.
        width: usize,
        /// Bytes per pixel.
        bytes: usize,
    },
    /// There are fewer bytes than the size requires.
    #[error("{got} bytes of data, but {height} rows of {step} bytes need at least {needed}")]
    Short {
        /// Number of bytes found.
        got: usize,
        /// Number of rows.
        height: usize,
        /// Bytes from row to row.
        step: usize,
        /// Number of bytes needed.
        needed: usize,
    },
    /// There are no pixels, or more than can be counted.
    #[error("an image of {width} x {height} pixels cannot be read")]
    Size {
        /// Pixels along a row.
        width: usize,
        /// Number of rows.
        height: usize,
    },
}

/// The header of a payload, as in `sensor_msgs/Image`.
///
/// ```
/// use tangent_estimation::depth_normal::DepthLayout;
///
/// // Two pixels in millimetres, low byte first.
/// let layout = DepthLayout::stated([2, 1], 4, 0, "16UC1")?;
/// let mut depth_m = Vec::new();
/// layout.read(&[0xf4, 0x01, 0x00, 0x00], &mut depth_m)?;
/// assert_eq!(depth_m, [0.5, 0.0]);
/// // One byte is missing.
/// assert!(layout.check(3).is_err());
/// # Ok::<(), tangent_estimation::depth_normal::DepthEncodingError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DepthLayout {
    /// Pixels along a row.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Bytes from row to row.
    pub step: usize,
    /// `is_bigendian`.
    pub big_endian: bool,
    /// Encoding of a pixel.
    pub encoding: DepthEncoding,
}

impl DepthEncoding {
    /// Encoding by its name in `sensor_msgs/Image`: `16UC1` (also `mono16`, as some drivers name
    /// it) or `32FC1`.
    ///
    /// # Errors
    /// [`DepthEncodingError::Encoding`] for anything that is not depth.
    pub fn from_name(name: &str) -> Result<Self, DepthEncodingError> {
        match name {
            "16UC1" | "mono16" => Ok(Self::Millimetres16),
            "32FC1" => Ok(Self::Metres32),
            other => Err(DepthEncodingError::Encoding(other.to_owned())),
        }
    }

    /// Number of bytes per pixel.
    pub fn bytes(self) -> usize {
        match self {
            Self::Millimetres16 => 2,
            Self::Metres32 => 4,
        }
    }
}

impl DepthLayout {
    /// Layout from the fields of a `sensor_msgs/Image`: width and height, `step`, `is_bigendian`
    /// and `encoding`.
    ///
    /// # Errors
    /// [`DepthEncodingError::Encoding`] for anything that is not depth.
    pub fn stated(
        size_px: [u32; 2],
        step: u32,
        is_bigendian: u8,
        encoding: &str,
    ) -> Result<Self, DepthEncodingError> {
        let [width, height] = size_px.map(|count| count as usize);
        Ok(Self {
            width,
            height,
            step: step as usize,
            big_endian: is_bigendian != 0,
            encoding: DepthEncoding::from_name(encoding)?,
        })
    }

    /// Checks that `bytes` of data hold an image of this layout; the padding of the last row may be
    /// missing. Returns the number of bytes per row that are pixels.
    ///
    /// # Errors
    /// The size does not fit; the error states how.
    pub fn check(&self, bytes: usize) -> Result<usize, DepthEncodingError> {
        let Self {
            width,
            height,
            step,
            ..
        } = *self;
        let pixel = self.encoding.bytes();
        let size = DepthEncodingError::Size { width, height };
        let row = width.checked_mul(pixel).ok_or_else(|| size.clone())?;
        if width.checked_mul(height).is_none_or(|pixels| pixels == 0) {
            return Err(size);
        }
        if step < row {
            return Err(DepthEncodingError::Step {
                step,
                width,
                bytes: pixel,
            });
        }
        let needed = (height - 1)
            .checked_mul(step)
            .and_then(|n| n.checked_add(row))
            .ok_or(size)?;
        if bytes < needed {
            return Err(DepthEncodingError::Short {
                got: bytes,
                height,
                step,
                needed,
            });
        }
        Ok(row)
    }

    /// Fills `depth_m` (m; 0 for no reading) with `width * height` pixels; allocates only if it has
    /// to grow.
    ///
    /// # Errors
    /// The size does not fit; the error states how. `depth_m` is empty then.
    pub fn read(&self, data: &[u8], depth_m: &mut Vec<f32>) -> Result<(), DepthEncodingError> {
        depth_m.clear();
        let row = self.check(data.len())?;
        let (height, step) = (self.height, self.step);
        depth_m.reserve(self.width * height);
        for v in 0..height {
            let line = &data[v * step..v * step + row];
            match (self.encoding, self.big_endian) {
                (DepthEncoding::Millimetres16, false) => {
                    extend(depth_m, line, |b| millimetres(u16::from_le_bytes(b)));
                }
                (DepthEncoding::Millimetres16, true) => {
                    extend(depth_m, line, |b| millimetres(u16::from_be_bytes(b)));
                }
                (DepthEncoding::Metres32, false) => {
                    extend(depth_m, line, |b| reading(f32::from_le_bytes(b)));
                }
                (DepthEncoding::Metres32, true) => {
                    extend(depth_m, line, |b| reading(f32::from_be_bytes(b)));
                }
            }
        }
        Ok(())
    }
}

/// Converts millimetres in native byte order, as in a simulated frame; 0 stays 0.
pub fn metres_from_millimetres(depth_mm: &[u16], depth_m: &mut Vec<f32>) {
    depth_m.clear();
    depth_m.extend(depth_mm.iter().map(|mm| millimetres(*mm)));
}

fn extend<const N: usize>(depth_m: &mut Vec<f32>, line: &[u8], take: impl Fn([u8; N]) -> f32) {
    let (pixels, _) = line.as_chunks::<N>();
    depth_m.extend(pixels.iter().map(|b| take(*b)));
}

fn millimetres(mm: u16) -> f32 {
    f32::from(mm) * 1e-3
}

fn reading(m: f32) -> f32 {
    if m.is_finite() && m > 0.0 { m } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_encodings_in_both_byte_orders_with_padding() {
        let mm: [u16; 6] = [0, 1, 500, 1234, 40_000, u16::MAX];
        for big_endian in [false, true] {
            let layout = DepthLayout {
                width: 3,
                height: 2,
                step: 8,
                big_endian,
                encoding: DepthEncoding::Millimetres16,
            };
            let mut data = Vec::new();
            for row in mm.chunks(3) {
                for x in row {
                    data.extend(if big_endian {
                        x.to_be_bytes()
                    } else {
                        x.to_le_bytes()
                    });
                }
                data.extend([0xff; 2]);
            }
            let mut out = vec![9.0; 100];
            layout.read(&data, &mut out).unwrap();
            assert_eq!(out, mm.map(|x| f32::from(x) * 1e-3));
            // The data are complete without the last row's padding, but not with a byte less.
            layout.read(&data[..14], &mut out).unwrap();
            let error = layout.read(&data[..13], &mut out).unwrap_err();
            assert_eq!(
                error.to_string(),
                "13 bytes of data, but 2 rows of 8 bytes need at least 14"
            );
            assert!(out.is_empty());
        }
        let m = [f32::NAN, 0.5, f32::INFINITY, -1.0, 0.25, 3.5];
        for big_endian in [false, true] {
            let layout = DepthLayout {
                width: 2,
                height: 3,
                step: 8,
                big_endian,
                encoding: DepthEncoding::Metres32,
            };
            let order = |x: &f32| {
                if big_endian {
                    x.to_be_bytes()
                } else {
                    x.to_le_bytes()
                }
            };
            let data: Vec<u8> = m.iter().flat_map(order).collect();
            let mut out = Vec::new();
            layout.read(&data, &mut out).unwrap();
            assert_eq!(out, [0.0, 0.5, 0.0, 0.0, 0.25, 3.5]);
        }
    }

    #[test]
    fn what_is_no_depth_image_is_refused_by_name() {
        let error = DepthEncoding::from_name("rgb8").unwrap_err();
        assert_eq!(
            error.to_string(),
            "a depth image must be encoded as 16UC1 (mm) or 32FC1 (m), not \"rgb8\""
        );
        let layout = DepthLayout {
            width: 4,
            height: 1,
            step: 7,
            big_endian: false,
            encoding: DepthEncoding::from_name("16UC1").unwrap(),
        };
        let mut out = Vec::new();
        let error = layout.read(&[0; 64], &mut out).unwrap_err();
        assert_eq!(
            error.to_string(),
            "step = 7 bytes is too short for a row of 4 pixels of 2 bytes each"
        );
        for (width, height) in [(0, 1), (1, 0), (usize::MAX, 2)] {
            let empty = DepthLayout {
                width,
                height,
                step: usize::MAX,
                ..layout
            };
            assert!(empty.read(&[0; 64], &mut out).is_err());
        }
        let huge = DepthLayout {
            width: 1,
            height: usize::MAX,
            step: 8,
            ..layout
        };
        assert!(huge.read(&[0; 64], &mut out).is_err());
    }
}
