//! The service's view of `depth_normal`'s thread: problems with its images, and whether it runs.

use std::sync::mpsc::{Receiver, TryRecvError};
use std::thread::JoinHandle;

use tangent_runtime::Age;
use tangent_schemas::Text;
use tangent_schemas::convert::{cut, cut_format};

use crate::EstimatorError;

/// Silence of the camera after which it is reported, s.
const CAMERA_PATIENCE_S: f64 = 0.5;

/// Why `depth_normal` publishes no valid estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DepthTrouble {
    /// Its thread has ended by itself.
    Failed,
    /// No image arrives.
    Blind,
    /// The images are refused, for this reason.
    Refused(Text),
}

impl DepthTrouble {
    /// Text for a person.
    pub fn words(self) -> Text {
        match self {
            Self::Failed => cut("depth_normal: its thread has failed"),
            Self::Blind => cut_format(format_args!(
                "depth_normal: no camera/depth for more than {CAMERA_PATIENCE_S} s: does the camera run?"
            )),
            Self::Refused(why) => cut_format(format_args!("depth_normal: {why}")),
        }
    }
}

/// Watches the thread for the service.
pub struct DepthWatch {
    news: Receiver<Option<Text>>,
    refused: Option<Text>,
    failed: bool,
    age: Age,
    thread: JoinHandle<()>,
}

impl DepthWatch {
    /// Watches a thread that holds the other end of `news` as long as it runs; `age` is the age of
    /// the newest image.
    pub fn new(news: Receiver<Option<Text>>, age: Age, thread: JoinHandle<()>) -> Self {
        Self {
            news,
            refused: None,
            failed: false,
            age,
            thread,
        }
    }

    /// The present problem, if any. Does not wait.
    pub fn trouble(&mut self) -> Option<DepthTrouble> {
        loop {
            match self.news.try_recv() {
                Ok(refused) => self.refused = refused,
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => {
                    if !self.failed {
                        self.failed = true;
                        tracing::error!("the thread of depth_normal failed; this is a defect");
                    }
                    return Some(DepthTrouble::Failed);
                }
            }
        }
        let age_s = self.age.seconds();
        match self.refused {
            // No image is expected yet, as the calibration is missing.
            Some(why) if !(0.0..f64::INFINITY).contains(&age_s) => Some(DepthTrouble::Refused(why)),
            _ if !(0.0..=CAMERA_PATIENCE_S).contains(&age_s) => Some(DepthTrouble::Blind),
            refused => refused.map(DepthTrouble::Refused),
        }
    }

    /// Waits until the thread has ended.
    ///
    /// # Errors
    /// The thread panicked.
    pub fn join(self) -> Result<(), EstimatorError> {
        self.thread.join().map_err(|_| EstimatorError::DepthFailed)
    }
}
