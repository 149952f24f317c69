//! Calibration of the camera: from the cell file, from its driver, and a check that the two agree.
//! Pure.

use tangent_runtime::config::Calibration;
use tangent_schemas::standard::{CameraInfo, Header};

/// Largest relative difference of focal length between cell file and driver; two calibrations of
/// one camera differ less.
const DIFFERS_SHARE: f64 = 0.02;

/// The cell file's calibration and the driver's.
#[derive(Clone, Debug, Default)]
pub struct Known {
    stated: Option<Calibration>,
    driver: Option<CameraInfo>,
}

impl Known {
    /// State before the driver has published anything.
    pub fn new(stated: Option<Calibration>) -> Self {
        Self {
            stated,
            driver: None,
        }
    }

    /// Takes the driver's calibration.
    pub fn receive(&mut self, info: &CameraInfo) {
        self.driver = Some(info.clone());
    }

    /// Calibration in use: the cell file's, else the driver's.
    pub fn calibration(&self) -> Option<Calibration> {
        self.stated
            .or_else(|| self.driver.as_ref().and_then(Calibration::of))
    }

    /// Describes a problem with the calibration, if there is one; `topic` is the driver's.
    pub fn trouble(&self, topic: &str) -> Option<String> {
        let info = self.driver.as_ref()?;
        let Some(said) = Calibration::of(info) else {
            return Some(format!(
                "{topic} has no calibration (its K is zero or not finite)"
            ));
        };
        if let Some(stated) = &self.stated
            && let Some(what) = stated.differs(&said, DIFFERS_SHARE)
        {
            return Some(format!("the cell file contradicts {topic}: camera.{what}"));
        }
        info.d.iter().any(|d| *d != 0.0).then(|| {
            format!(
                "{topic} states that the images are distorted, and they are not rectified here: set topic to the rectified images"
            )
        })
    }

    /// Message to publish. It has no distortion, since none is configured.
    pub fn info(&self, now_ns: i64) -> Option<CameraInfo> {
        let known = self.calibration()?;
        let header = Header::new(now_ns, "camera");
        let agreed = self.driver.as_ref().filter(|info| {
            Calibration::of(info).is_some_and(|said| known.differs(&said, DIFFERS_SHARE).is_none())
        });
        let ([width, height], [fx, fy], [cx, cy]) =
            (known.size_px, known.focal_px, known.principal_px);
        let k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0];
        Some(match agreed {
            Some(info) => CameraInfo {
                header,
                k,
                ..info.clone()
            },
            None => CameraInfo {
                header,
                height,
                width,
                k,
                r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
                p: [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
                ..CameraInfo::default()
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STATED: Calibration = Calibration {
        size_px: [848, 480],
        focal_px: [423.0, 424.0],
        principal_px: [421.0, 239.0],
    };

    fn driver(fx: f64, d: Vec<f64>) -> CameraInfo {
        CameraInfo {
            height: 480,
            width: 848,
            distortion_model: "plumb_bob".to_owned(),
            d,
            k: [fx, 0.0, 421.5, 0.0, 424.5, 239.5, 0.0, 0.0, 1.0],
            ..CameraInfo::default()
        }
    }

    #[test]
    fn the_file_alone_does_not_state_distortion() {
        let known = Known::new(Some(STATED));
        let info = known.info(5).unwrap();
        assert_eq!((info.width, info.height), (848, 480));
        assert_eq!(
            info.k,
            [423.0, 0.0, 421.0, 0.0, 424.0, 239.0, 0.0, 0.0, 1.0]
        );
        assert_eq!((info.d.len(), info.distortion_model.as_str()), (0, ""));
        assert_eq!(known.trouble("x"), None);
    }

    #[test]
    fn the_drivers_calibration_is_used_if_the_file_has_none() {
        let mut known = Known::new(None);
        assert_eq!(known.info(5), None);
        known.receive(&driver(423.5, vec![0.0; 5]));
        let info = known.info(5).unwrap();
        assert_eq!((info.k[0], info.d.len()), (423.5, 5));
        assert_eq!(info.header.frame_id.as_str(), "camera");
        assert_eq!(known.trouble("x"), None);
        known.receive(&driver(0.0, vec![]));
        assert_eq!(known.info(5), None);
        assert!(known.trouble("x").unwrap().contains("no calibration"));
    }

    #[test]
    fn a_contradiction_is_reported_and_the_file_takes_precedence() {
        let mut known = Known::new(Some(STATED));
        known.receive(&driver(385.0, vec![]));
        let words = known.trouble("camera/info_of_driver").unwrap();
        assert!(words.contains("camera.focal_px = [423.0, 424.0] against [385.0, 424.5]"));
        assert_eq!(known.info(5).unwrap().k[0], 423.0);
        let mut smaller = driver(423.0, vec![]);
        smaller.width = 640;
        known.receive(&smaller);
        assert!(known.trouble("x").unwrap().contains("size_px"));
        assert_eq!(known.info(5).unwrap().width, 848);
        known.receive(&driver(423.0, vec![0.1, 0.0]));
        assert!(known.trouble("x").unwrap().contains("distorted"));
        assert_eq!(known.info(5).unwrap().d, [0.1, 0.0]);
    }
}
