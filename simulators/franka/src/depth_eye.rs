//! The depth camera on the simulated arm's flange, with images as from its driver: rendered in a
//! thread of its own, and published with a camera's delay.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use tangent_mechanics::{Base, Flange, Pose, Tool};
use tangent_runtime::Publisher;
use tangent_runtime::clock::now_ns;
use tangent_runtime::realtime::setup_thread;
use tangent_schemas::standard::{Header, Image};
use tangent_simulation::Surface;
use tangent_simulation::depth_camera::{
    DepthCamera, DepthCameraConfig, DepthCameraError, DepthFrame,
};

/// Number of exposures that may wait to be rendered; further ones are left out.
const WAITING: usize = 2;
/// SCHED_FIFO priority of the rendering thread: below all time-critical threads.
const PRIORITY: u8 = 20;

/// One exposure: time, and pose of the flange.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// Simulated time, s.
    pub time_s: f64,
    /// Time of the exposure on the wall clock, ns since the Unix epoch.
    pub stamp_ns: i64,
    /// Pose of the flange, as measured by the arm.
    pub base_from_flange: Pose<Base, Flange>,
}

/// The camera, the surface that it sees, and the publisher of its images.
pub struct DepthEye {
    camera: DepthCamera,
    surface: Surface,
    images: Publisher<Image>,
}

impl DepthEye {
    /// Creates a camera that sees `surface`, and the tool if the configuration has one.
    ///
    /// # Errors
    /// A setting of the camera is out of its range.
    pub fn new(
        config: &DepthCameraConfig,
        flange_from_tool: &Pose<Flange, Tool>,
        seed: u64,
        surface: Surface,
        images: Publisher<Image>,
    ) -> Result<Self, DepthCameraError> {
        Ok(Self {
            camera: DepthCamera::new(config, flange_from_tool, seed)?,
            surface,
            images,
        })
    }

    /// Renders in a thread of its own until the returned sender is dropped. `hurried`: the thread
    /// gets a real-time priority.
    ///
    /// # Errors
    /// A thread could not be started.
    pub fn start(self, hurried: bool) -> std::io::Result<SyncSender<Look>> {
        let (sender, looks) = sync_channel(WAITING);
        std::thread::Builder::new()
            .name("simulator-depth".into())
            .spawn(move || {
                if hurried {
                    setup_thread("simulated depth camera", PRIORITY);
                }
                self.draw(&looks);
            })?;
        Ok(sender)
    }

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
