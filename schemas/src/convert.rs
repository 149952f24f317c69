//! Conversion between messages and the types that services compute with: poses, twists, wrenches,
//! joints, stamps, short texts.

use std::fmt::{self, Write as _};

use arrayvec::ArrayString;
use nalgebra::{Quaternion, SVector, UnitQuaternion, Vector3};
use tangent_mechanics::{Pose, Twist, Wrench};

use crate::standard::{self, Header, Time};
use crate::{FrameId, JointArray};

/// A message whose numbers are not valid for their type.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ConvertError {
    /// The quaternion of a pose is not of unit length.
    #[error("quaternion of length {0} is not a rotation: its length must be 1 to within 0.001")]
    NotARotation(f64),
    /// A coordinate is NaN or infinite.
    #[error("position ({0}, {1}, {2}) m is not finite")]
    NotFinite(f64, f64, f64),
    /// The number of joint values is not that of the arm.
    #[error("{found} joint values where the arm has {expected} joints")]
    Joints {
        /// Joints of the arm.
        expected: usize,
        /// Values in the message.
        found: usize,
    },
}

impl From<&Vector3<f64>> for standard::Vector3 {
    fn from(v: &Vector3<f64>) -> Self {
        Self {
            x: v.x,
            y: v.y,
            z: v.z,
        }
    }
}

impl From<&standard::Vector3> for Vector3<f64> {
    fn from(v: &standard::Vector3) -> Self {
        Self::new(v.x, v.y, v.z)
    }
}

impl From<&Vector3<f64>> for standard::Point {
    fn from(v: &Vector3<f64>) -> Self {
        Self {
            x: v.x,
            y: v.y,
            z: v.z,
        }
    }
}

impl From<&standard::Point> for Vector3<f64> {
    fn from(v: &standard::Point) -> Self {
        Self::new(v.x, v.y, v.z)
    }
}

impl From<&UnitQuaternion<f64>> for standard::Quaternion {
    /// Uses the quaternion with `w` ≥ 0 of the two that describe the rotation.
    fn from(rotation: &UnitQuaternion<f64>) -> Self {
        let sign = if rotation.w < 0.0 { -1.0 } else { 1.0 };
        Self {
            x: sign * rotation.i,
            y: sign * rotation.j,
            z: sign * rotation.k,
            w: sign * rotation.w,
        }
    }
}

impl<A, B> From<&Pose<A, B>> for standard::Pose {
    fn from(a_from_b: &Pose<A, B>) -> Self {
        Self {
            position: (&a_from_b.translation()).into(),
            orientation: (&a_from_b.rotation()).into(),
        }
    }
}

impl<A, B> From<&Pose<A, B>> for standard::Transform {
    fn from(a_from_b: &Pose<A, B>) -> Self {
        Self {
            translation: (&a_from_b.translation()).into(),
            rotation: (&a_from_b.rotation()).into(),
        }
    }
}

impl<A, B> TryFrom<&standard::Pose> for Pose<A, B> {
    type Error = ConvertError;

    fn try_from(pose: &standard::Pose) -> Result<Self, ConvertError> {
        let (p, o) = (&pose.position, &pose.orientation);
        if ![p.x, p.y, p.z].iter().all(|x| x.is_finite()) {
            return Err(ConvertError::NotFinite(p.x, p.y, p.z));
        }
        let quaternion = Quaternion::new(o.w, o.x, o.y, o.z);
        let length = quaternion.norm();
        if length.is_nan() || (length - 1.0).abs() > 1e-3 {
            return Err(ConvertError::NotARotation(length));
        }
        Ok(Self::new(
            p.into(),
            UnitQuaternion::new_normalize(quaternion),
        ))
    }
}

impl<F> From<&Twist<F>> for standard::Twist {
    fn from(twist: &Twist<F>) -> Self {
        Self {
            linear: (&twist.linear).into(),
            angular: (&twist.angular).into(),
        }
    }
}

impl<F> From<&standard::Twist> for Twist<F> {
    fn from(twist: &standard::Twist) -> Self {
        Self::new((&twist.linear).into(), (&twist.angular).into())
    }
}

impl<F> From<&Wrench<F>> for standard::Wrench {
    fn from(wrench: &Wrench<F>) -> Self {
        Self {
            force: (&wrench.force).into(),
            torque: (&wrench.torque).into(),
        }
    }
}

impl<F> From<&standard::Wrench> for Wrench<F> {
    fn from(wrench: &standard::Wrench) -> Self {
        Self::new((&wrench.force).into(), (&wrench.torque).into())
    }
}

impl Time {
    /// Time from nanoseconds since the Unix epoch. The message's 32 bits cover the years 1901 to
    /// 2038; outside, the time is clamped.
    pub fn from_ns(ns: i64) -> Self {
        let seconds = ns.div_euclid(1_000_000_000);
        match i32::try_from(seconds) {
            Ok(sec) => Self {
                sec,
                nanosec: ns.rem_euclid(1_000_000_000) as u32,
            },
            Err(_) => Self {
                sec: if seconds < 0 { i32::MIN } else { i32::MAX },
                nanosec: 0,
            },
        }
    }

    /// Nanoseconds since the Unix epoch.
    pub fn to_ns(&self) -> i64 {
        i64::from(self.sec) * 1_000_000_000 + i64::from(self.nanosec)
    }
}

impl Header {
    /// Header with a stamp in ns since the Unix epoch and the name of a frame (cut off at 32
    /// bytes).
    pub fn new(stamp_ns: i64, frame: &str) -> Self {
        Self {
            stamp: Time::from_ns(stamp_ns),
            frame_id: cut(frame),
        }
    }

    /// Header for a frame that is given as a type: `Header::in_frame::<Base>(stamp_ns)`, stamp in
    /// ns since the Unix epoch.
    pub fn in_frame<F: tangent_mechanics::Frame>(stamp_ns: i64) -> Self {
        let mut frame_id = FrameId::new();
        // Frame names have about a dozen bytes; `new` cuts a longer one off.
        if frame_id.try_push_str(F::NAME).is_err() {
            return Self::new(stamp_ns, F::NAME);
        }
        Self {
            stamp: Time::from_ns(stamp_ns),
            frame_id,
        }
    }
}

/// Joint values as a message. Arms have at most seven joints; further values are left out.
pub fn joint_array<const N: usize>(joints: &SVector<f64, N>) -> JointArray {
    joints.iter().copied().take(7).collect()
}

/// Joint values from a message.
///
/// # Errors
/// [`ConvertError::Joints`] if the message has a different number of values.
pub fn joints<const N: usize>(array: &[f64]) -> Result<SVector<f64, N>, ConvertError> {
    if array.len() == N {
        Ok(SVector::from_column_slice(array))
    } else {
        Err(ConvertError::Joints {
            expected: N,
            found: array.len(),
        })
    }
}

/// Text of bounded length, cut off at a character boundary. No allocation.
pub fn cut<const N: usize>(text: &str) -> ArrayString<N> {
    let mut short = ArrayString::new();
    let mut end = text.len().min(N);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    short.push_str(&text[..end]);
    short
}

/// Formats into a text of bounded length, cut off where it is full. No allocation.
pub fn cut_format<const N: usize>(arguments: fmt::Arguments<'_>) -> ArrayString<N> {
    struct Cut<const N: usize>(ArrayString<N>);
    impl<const N: usize> fmt::Write for Cut<N> {
        fn write_str(&mut self, text: &str) -> fmt::Result {
            let mut end = text.len().min(self.0.remaining_capacity());
            while !text.is_char_boundary(end) {
                end -= 1;
            }
            self.0.push_str(&text[..end]);
            if end < text.len() {
                Err(fmt::Error)
            } else {
                Ok(())
            }
        }
    }
    let mut short = Cut(ArrayString::new());
    // The only possible error is that the text is full.
    let _ = short.write_fmt(arguments);
    short.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tangent_mechanics::{Base, Tool};

    proptest! {
        #[test]
        fn a_pose_there_and_back_is_itself(t in prop::array::uniform3(-2.0f64..2.0), r in prop::array::uniform3(-6.0f64..6.0)) {
            let pose: Pose<Base, Tool> = Pose::new(t.into(), UnitQuaternion::new(r.into()));
            let message = standard::Pose::from(&pose);
            prop_assert!(message.orientation.w >= 0.0);
            let back: Pose<Base, Tool> = (&message).try_into().unwrap();
            prop_assert!((back.matrix() - pose.matrix()).norm() < 1e-14);
        }

        #[test]
        fn a_stamp_there_and_back_is_itself(ns in i64::from(i32::MIN) * 1_000_000_000..=i64::from(i32::MAX) * 1_000_000_000) {
            prop_assert_eq!(Time::from_ns(ns).to_ns(), ns);
        }

        #[test]
        fn cutting_keeps_whole_characters(text in "\\PC{0,60}") {
            let short = cut::<16>(&text);
            prop_assert!(text.starts_with(short.as_str()));
            prop_assert!(short.len() >= 13.min(text.len()));
            prop_assert_eq!(cut_format::<16>(format_args!("{text}")), short);
        }
    }

    #[test]
    fn what_is_no_rotation_is_refused() {
        let mut pose = standard::Pose::default();
        assert_eq!(
            Pose::<Base, Tool>::try_from(&pose),
            Err(ConvertError::NotARotation(0.0))
        );
        pose.orientation.w = 1.0;
        assert!(Pose::<Base, Tool>::try_from(&pose).is_ok());
        pose.position.y = f64::NAN;
        assert!(Pose::<Base, Tool>::try_from(&pose).is_err());
        pose.position.y = 0.0;
        pose.orientation.x = f64::NAN;
        assert!(Pose::<Base, Tool>::try_from(&pose).is_err());
    }

    #[test]
    fn stamps_beyond_32_bits_stay_at_the_limit() {
        assert_eq!(Time::from_ns(i64::MAX).sec, i32::MAX);
        assert_eq!(Time::from_ns(i64::MIN).sec, i32::MIN);
        assert_eq!(Time::from_ns(-1).to_ns(), -1);
    }

    #[test]
    fn joints_must_be_as_many_as_the_arm_has() {
        let six = SVector::<f64, 6>::from_fn(|i, _| i as f64);
        assert_eq!(joints::<6>(&joint_array(&six)), Ok(six));
        assert!(joints::<7>(&joint_array(&six)).is_err());
    }
}
