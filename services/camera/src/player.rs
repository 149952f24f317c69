//! Plays the images of a recording as a driver would give them: at their own pace, over and over, stamped with the time at which they
//! are shown.

use std::path::Path;
use std::time::{Duration, Instant};

use tangent_recorder::Recording;
use tangent_runtime::clock::now_ns;
use tangent_runtime::{Publisher, Stop};
use tangent_schemas::standard::{Image, Time};
use tangent_schemas::{Message, cdr};

use crate::CameraError;

/// Longest pause between two images; a gap in the recording is not waited out.
const PAUSE_MAX: Duration = Duration::from_secs(1);
/// Between the end and the next beginning.
const BETWEEN: Duration = Duration::from_millis(100);

/// Images of one topic, with the time of each, ns.
pub struct Player {
    images: Vec<(i64, Image)>,
}

impl Player {
    /// Reads the images on `topic` (any topic of images where it is none).
    ///
    /// # Errors
    /// A file that is no recording, or has no image there.
    pub fn open(file: &Path, topic: Option<&str>) -> Result<Self, CameraError> {
        let recording = Recording::open(file)?;
        let wanted = topic.map(|t| format!("/{}", t.trim_start_matches('/')));
        let mut first: Option<String> = None;
        let mut images = Vec::new();
        for message in recording.messages() {
            if message.type_name != Image::NAME {
                continue;
            }
            let chosen = wanted
                .as_ref()
                .unwrap_or_else(|| first.get_or_insert_with(|| message.topic.clone()));
            if message.topic != *chosen {
                continue;
            }
            let image: Image = cdr::decode(&message.bytes).map_err(|e| CameraError::Recording {
                file: file.display().to_string(),
                reason: format!("an image on {} does not decode: {e}", message.topic),
            })?;
            images.push((image.header.stamp.to_ns(), image));
        }
        if images.is_empty() {
            return Err(CameraError::Recording {
                file: file.display().to_string(),
                reason: match wanted {
                    Some(topic) => format!("there is no sensor_msgs/msg/Image on {topic}"),
                    None => "there is no sensor_msgs/msg/Image in it".to_owned(),
                },
            });
        }
        images.sort_by_key(|(at, _)| *at);
        Ok(Self { images })
    }

    /// Plays until `stop`.
    pub fn play(&self, publisher: &Publisher<Image>, stop: &Stop) {
        while !stop.is_stopped() {
            let began = Instant::now();
            let mut due = Duration::ZERO;
            let mut before: Option<i64> = None;
            for (at_ns, image) in &self.images {
                let gap = before.map_or(0, |last| (at_ns - last).max(0));
                due += Duration::from_nanos(gap.unsigned_abs()).min(PAUSE_MAX);
                before = Some(*at_ns);
                if stop.wait(due.saturating_sub(began.elapsed())) {
                    return;
                }
                let mut shown = image.clone();
                shown.header.stamp = Time::from_ns(now_ns());
                publisher.publish(&shown);
            }
            if stop.wait(BETWEEN) {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tangent_recorder::{Record, RecordingWriter};
    use tangent_runtime::Bus;
    use tangent_schemas::standard::{CompressedImage, Header};
    use tangent_schemas::topics::{Delivery, Topic};

    fn image(stamp_ns: i64, mark: u8) -> Image {
        Image {
            header: Header::new(stamp_ns, "camera"),
            height: 1,
            width: 2,
            encoding: "mono8".to_owned(),
            step: 2,
            data: vec![mark, 2],
            ..Image::default()
        }
    }

    fn put<M: Message>(writer: &mut RecordingWriter, topic: &str, at: u64, message: &M) {
        let mut bytes = Vec::new();
        cdr::encode(message, &mut bytes).unwrap();
        writer
            .write(&Record {
                topic,
                type_name: M::NAME,
                definition: Some(&M::definition()),
                sequence: at as u32,
                log_time_ns: at,
                publish_time_ns: at,
                bytes: &bytes,
            })
            .unwrap();
    }

    #[test]
    fn a_recordings_images_come_in_order_at_their_pace_with_new_stamps() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("images.mcap");
        let mut writer = RecordingWriter::create(&file).unwrap();
        for (i, mark) in [(2_u64, 12_u8), (0, 10), (1, 11)] {
            let at = 1_000_000 * i;
            put(&mut writer, "/camera/depth", at, &image(at as i64, mark));
            put(&mut writer, "/other", at, &image(at as i64, 99));
        }
        put(&mut writer, "/picture", 9, &CompressedImage::default());
        writer.finish().unwrap();

        let player = Player::open(&file, Some("camera/depth")).unwrap();
        let bus = Bus::in_process("player");
        let topic: Topic<Image> = Topic::new("driver/image", Delivery::Bulk);
        let heard = bus.subscribe(&topic, 8).unwrap();
        let publisher = bus.publisher(&topic).unwrap();
        let stop = Stop::new();
        let before = now_ns();
        std::thread::scope(|scope| {
            let (player, stop_player) = (&player, &stop);
            scope.spawn(move || player.play(&publisher, stop_player));
            for mark in [10, 11, 12, 10] {
                let shown = heard.recv_timeout(Duration::from_secs(20)).unwrap().message;
                assert_eq!(shown.data[0], mark);
                assert!(shown.header.stamp.to_ns() >= before);
            }
            stop.trigger();
        });

        let error = Player::open(&file, Some("/nothing")).err().unwrap();
        assert!(error.to_string().contains("/nothing"), "{error}");
        let error = Player::open(&folder.path().join("none.mcap"), None)
            .err()
            .unwrap();
        assert!(error.to_string().contains("none.mcap"), "{error}");
    }
}
