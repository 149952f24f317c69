//! The camera's driver: turns exposures into images, which arrive one frame after the exposure.

use std::sync::mpsc::Receiver;
use std::time::Duration;

use tangent_runtime::Publisher;
use tangent_runtime::clock::now_ns;
use tangent_schemas::standard::{Header, Image};
use tangent_sensing::GreyImage;
use tangent_simulation::{Exposure, Imager};

/// One exposure with its stamp, ns since the Unix epoch.
#[derive(Clone, Copy, Debug)]
pub struct Shot {
    /// Exposure of the camera.
    pub exposure: Exposure,
    /// Time of the exposure, ns since the Unix epoch.
    pub stamp_ns: i64,
}

/// Renders and publishes until the camera is dropped.
pub fn draw_images(mut imager: Imager, shots: &Receiver<Shot>, images: &Publisher<Image>) {
    let delay_ns = (imager.delay_s() * 1e9) as i64;
    while let Ok(shot) = shots.recv() {
        let picture = imager.draw(&shot.exposure);
        let early_ns = shot.stamp_ns + delay_ns - now_ns();
        if early_ns > 0 {
            std::thread::sleep(Duration::from_nanos(early_ns.unsigned_abs()));
        }
        images.publish(&message(picture, shot.stamp_ns));
    }
}

fn message(picture: GreyImage, stamp_ns: i64) -> Image {
    Image {
        header: Header::new(stamp_ns, "camera"),
        height: picture.height,
        width: picture.width,
        encoding: "mono8".to_owned(),
        is_bigendian: 0,
        step: picture.width,
        data: picture.pixels,
    }
}
