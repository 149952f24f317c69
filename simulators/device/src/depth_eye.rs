//! The depth camera on a simulated arm's flange, with images as from its driver: rendered in a
//! thread of its own, and published with a camera's delay.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use tangent_mechanics::{Base, Flange, Pose, Tool};
use tangent_runtime::Publisher;
use tangent_runtime::clock::now_ns;
use tangent_runtime::realtime::setup_thread;
use tangent_schemas::standard::{Header, Image};
use tangent_simulation::depth_camera::{
    DepthCamera, DepthCameraConfig, DepthCameraError, DepthFrame,
};
use tangent_simulation::{Surface, True};

/// Number of exposures that may wait to be rendered; further ones are left out.
const WAITING: usize = 2;
/// SCHED_FIFO priority of the rendering thread: below all time-critical threads.
const PRIORITY: u8 = 20;

/// One exposure: time, and pose of the flange.
#[derive(Clone, Copy, Debug)]
struct Look {
    /// Simulated time, s.
    time_s: f64,
    /// Time of the exposure on the wall clock, ns since the Unix epoch.
    stamp_ns: i64,
    /// True pose of the flange.
    base_from_flange: Pose<Base, Flange>,
}

/// Why the camera cannot start.
#[derive(Debug, thiserror::Error)]
pub enum ShutterError {
    /// A setting of the camera is out of its range.
    #[error("plant.{0}")]
    Camera(#[from] DepthCameraError),
    /// The system cannot start another thread.
    #[error("the simulated depth camera cannot start: {0}")]
    Thread(#[from] std::io::Error),
}

/// Exposes the camera at its rate, in the thread of the arm. The camera ends when it is dropped.
pub struct Shutter {
    looks: SyncSender<Look>,
    rate_hz: f64,
    taken: u64,
}

impl Shutter {
    /// Starts a camera that sees `surface`, and the tool at its true pose if the configuration has
    /// one. It renders in a thread of its own. `hurried`: the thread gets a real-time priority.
    ///
    /// # Errors
    /// A setting of the camera is out of its range, or a thread could not be started.
    pub fn start(
        config: &DepthCameraConfig,
        flange_from_tool: &True<Pose<Flange, Tool>>,
        seed: u64,
        surface: &Surface,
        images: Publisher<Image>,
        hurried: bool,
    ) -> Result<Self, ShutterError> {
        let eye = DepthEye {
            camera: DepthCamera::new(config, flange_from_tool.to_compare(), seed)?,
            surface: surface.clone(),
            images,
        };
        let (sender, looks) = sync_channel(WAITING);
        std::thread::Builder::new()
            .name("simulator-depth".into())
            .spawn(move || {
                if hurried {
                    setup_thread("simulated depth camera", PRIORITY);
                }
                eye.draw(&looks);
            })?;
        Ok(Self {
            looks: sender,
            rate_hz: config.rate_hz,
            taken: 0,
        })
    }

    /// Exposes the camera if an exposure is due at the simulated time `time_s`, with the flange
    /// truly at `base_from_flange`.
    pub fn look(&mut self, time_s: f64, base_from_flange: &True<Pose<Base, Flange>>) {
        if self.rate_hz <= 0.0 || time_s + 1e-9 < self.taken as f64 / self.rate_hz {
            return;
        }
        self.taken = (time_s * self.rate_hz + 1e-6).floor() as u64 + 1;
        // If the renderer is behind, the exposure is left out, as with a real camera.
        let _ = self.looks.try_send(Look {
            time_s,
            stamp_ns: now_ns(),
            base_from_flange: *base_from_flange.to_compare(),
        });
    }
}

/// The camera, the surface that it sees, and the publisher of its images.
struct DepthEye {
    camera: DepthCamera,
    surface: Surface,
    images: Publisher<Image>,
}

impl DepthEye {
    fn draw(mut self, looks: &Receiver<Look>) {
        while let Ok(look) = looks.recv() {
            self.camera
                .expose(look.time_s, &look.base_from_flange, &self.surface);
            while let Some(frame) = self.camera.take(f64::INFINITY) {
                let delay_ns = ((frame.arrives_s - frame.time_s) * 1e9) as i64;
                let early_ns = look.stamp_ns + delay_ns - now_ns();
                if early_ns > 0 {
                    std::thread::sleep(Duration::from_nanos(early_ns.unsigned_abs()));
                }
                self.images.publish(&message(&frame, look.stamp_ns));
            }
        }
    }
}

fn message(frame: &DepthFrame, stamp_ns: i64) -> Image {
    Image {
        header: Header::new(stamp_ns, "camera"),
        height: frame.height as u32,
        width: frame.width as u32,
        encoding: "16UC1".to_owned(),
        is_bigendian: 0,
        step: 2 * frame.width as u32,
        data: frame
            .depth_mm
            .iter()
            .flat_map(|depth| depth.to_le_bytes())
            .collect(),
    }
}
