//! Plays the images of a recording as a driver would publish them: at their original rate,
//! repeatedly, stamped with the time at which they are published. Only one image is in memory at a
//! time.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use tangent_recorder::RecordingStream;
use tangent_runtime::clock::now_ns;
use tangent_runtime::{Publisher, Stop};
use tangent_schemas::standard::{Image, Time};
use tangent_schemas::{Message, cdr};

use crate::CameraError;
use crate::picture::RESTART_NS;

/// Longest pause between two images; a longer gap in the recording is shortened to it.
const PAUSE_MAX: Duration = Duration::from_secs(1);
/// Pause between the end of the recording and its next start.
const BETWEEN: Duration = Duration::from_millis(100);

/// The images of one topic of a file.
pub struct Player {
    file: PathBuf,
    /// With its leading slash.
    topic: String,
}

impl Player {
    /// Finds the first image on `topic`; `None`: on any topic.
    ///
    /// # Errors
    /// The file is not a recording, or has no such image.
    pub fn open(file: &Path, topic: Option<&str>) -> Result<Self, CameraError> {
        let wanted = topic.map(|t| format!("/{}", t.trim_start_matches('/')));
        for message in RecordingStream::open(file)? {
            let message = message?;
            if message.type_name == Image::NAME
                && wanted.as_ref().is_none_or(|t| *t == message.topic)
            {
                decode(file, &message.topic, &message.bytes)?;
                return Ok(Self {
                    file: file.to_owned(),
                    topic: message.topic,
                });
            }
        }
        Err(CameraError::Recording {
            file: file.display().to_string(),
            reason: match wanted {
                Some(topic) => format!("there is no sensor_msgs/msg/Image on {topic}"),
                None => "there is no sensor_msgs/msg/Image in it".to_owned(),
            },
        })
    }

    /// Its images in the file's order.
    ///
    /// # Errors
    /// The file cannot be opened. An item is an error if the file is damaged there, or an image
    /// does not decode.
    pub fn images(
        &self,
    ) -> Result<impl Iterator<Item = Result<Image, CameraError>> + '_, CameraError> {
        Ok(RecordingStream::open(&self.file)?.filter_map(|message| {
            message.map_err(CameraError::from).map_or_else(
                |error| Some(Err(error)),
                |m| {
                    (m.topic == self.topic && m.type_name == Image::NAME)
                        .then(|| decode(&self.file, &self.topic, &m.bytes))
                },
            )
        }))
    }

    /// Plays until `stop`. An image that is slightly older than the previous one, or does not
    /// decode, is left out.
    pub fn play(&self, publisher: &Publisher<Image>, stop: &Stop) {
        while !stop.is_stopped() {
            match self.images() {
                Ok(images) => play_once(images, publisher, stop),
                Err(error) => tracing::warn!("{error}"),
            }
            if stop.wait(BETWEEN) {
                return;
            }
        }
    }
}

fn decode(file: &Path, topic: &str, bytes: &[u8]) -> Result<Image, CameraError> {
    cdr::decode(bytes).map_err(|e| CameraError::Recording {
        file: file.display().to_string(),
        reason: format!("an image on {topic} does not decode: {e}"),
    })
}

fn play_once(
    images: impl Iterator<Item = Result<Image, CameraError>>,
    publisher: &Publisher<Image>,
    stop: &Stop,
) {
    let began = Instant::now();
    let mut due = Duration::ZERO;
    let mut before: Option<i64> = None;
    for image in images {
        let mut image = match image {
            Ok(image) => image,
            Err(error) => {
                tracing::warn!("{error}");
                continue;
            }
        };
        let at_ns = image.header.stamp.to_ns();
        let gap = at_ns - before.unwrap_or(at_ns);
        if (1 - RESTART_NS..0).contains(&gap) {
            continue;
        }
        before = Some(at_ns);
        due += Duration::from_nanos(gap.max(0).unsigned_abs()).min(PAUSE_MAX);
        if stop.wait(due.saturating_sub(began.elapsed())) {
            return;
        }
        image.header.stamp = Time::from_ns(now_ns());
        publisher.publish(&image);
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
                publisher: [0; 16],
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
        for (i, mark) in [(0_u64, 10_u8), (1, 11), (2, 12), (1, 98)] {
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

    /// What depth cameras record, compressed as `ros2 bag record` does it.
    #[test]
    fn depth_of_both_encodings_plays_from_a_compressed_recording() {
        let folder = tempfile::tempdir().unwrap();
        for (encoding, pixel) in [("16UC1", 2_u32), ("32FC1", 4)] {
            let file = folder.path().join(format!("{encoding}.mcap"));
            let mut writer = mcap::WriteOptions::new()
                .compression(Some(mcap::Compression::Zstd))
                .create(std::io::BufWriter::new(
                    std::fs::File::create(&file).unwrap(),
                ))
                .unwrap();
            let schema = writer
                .add_schema(Image::NAME, "ros2msg", Image::definition().as_bytes())
                .unwrap();
            let channel = writer
                .add_channel(
                    schema,
                    "/camera/depth/image_rect_raw",
                    "cdr",
                    &Default::default(),
                )
                .unwrap();
            let sent: Vec<Image> = (0..3_u32)
                .map(|i| Image {
                    height: 480,
                    width: 848,
                    encoding: encoding.to_owned(),
                    step: 848 * pixel,
                    data: vec![i as u8 + 1; (848 * 480 * pixel) as usize],
                    ..image(1_700_000_000_000_000_000 + i64::from(i) * 1_000_000, 0)
                })
                .collect();
            for (sequence, image) in (0..).zip(&sent) {
                let mut bytes = Vec::new();
                cdr::encode(image, &mut bytes).unwrap();
                let time = image.header.stamp.to_ns() as u64;
                let header = mcap::records::MessageHeader {
                    channel_id: channel,
                    sequence,
                    log_time: time,
                    publish_time: time,
                };
                writer.write_to_known_channel(&header, &bytes).unwrap();
            }
            writer.finish().unwrap();
            drop(writer);
            // Three images of one value each: it is compressed.
            assert!(std::fs::metadata(&file).unwrap().len() < 100_000);

            let player = Player::open(&file, None).unwrap();
            let found: Vec<Image> = player.images().unwrap().map(Result::unwrap).collect();
            assert_eq!(found, sent);
            for image in &found {
                crate::check_depth(image, [848, 480]).unwrap();
            }
        }
    }
}
