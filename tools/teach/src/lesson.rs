//! What a person shows: points and strokes, taken by keys. Pure: keys and poses go in, words for
//! the person come out.

use nalgebra::Vector3;
use tangent_mechanics::{Base, Pose, Tool};

/// Distance between two samples of a stroke, m.
const SAMPLE_M: f64 = 0.001;
/// Number of samples of one stroke: 20 m of path.
const SAMPLES_MAX: usize = 20_000;

/// The arm at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// Joint positions, rad.
    pub joints_rad: Vec<f64>,
    /// Pose of the tool.
    pub base_from_tool: Pose<Base, Tool>,
}

impl Shown {
    fn away_m(&self, other: &Self) -> f64 {
        (self.base_from_tool.translation() - other.base_from_tool.translation()).norm()
    }
}

/// What a key means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Key {
    /// Take the place where the tool is.
    Point,
    /// Begin or end a stroke.
    Stroke,
    /// Take this pose as home.
    Home,
    /// Forget what was taken last.
    Undo,
    /// Write the task.
    Done,
    /// End without a file.
    Quit,
}

impl Key {
    /// The key of one line of input: a letter, or nothing for a point. `None` for any other text.
    pub fn of_line(line: &str) -> Option<Self> {
        Some(match line.trim() {
            "" => Self::Point,
            "s" => Self::Stroke,
            "h" => Self::Home,
            "u" => Self::Undo,
            "d" => Self::Done,
            "q" => Self::Quit,
            _ => return None,
        })
    }

    /// The key of one character in a terminal.
    pub fn of_char(character: char) -> Option<Self> {
        match character {
            '\n' | '\r' => Some(Self::Point),
            other if other.is_whitespace() => None,
            other => Self::of_line(&other.to_string()),
        }
    }
}

/// A part of what was shown.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Mark {
    Point(Shown),
    Stroke(Vec<Shown>),
}

/// What a key has done.
#[derive(Clone, Debug, PartialEq)]
pub enum Pressed {
    /// Something was taken or forgotten: in words.
    Taken(String),
    /// Nothing was done: why.
    Refused(&'static str),
    /// The task is to be written.
    Done,
    /// Nothing is to be written.
    Quit,
}

/// Everything that was shown so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lesson {
    pub(crate) marks: Vec<Mark>,
    pub(crate) home: Option<Shown>,
    stroke: Option<Vec<Shown>>,
    changes: u64,
}

/// Tool's places of a part of what was shown, base axes, m.
#[derive(Clone, Debug, PartialEq)]
pub enum Places {
    /// A point.
    Point(Vector3<f64>),
    /// A stroke, also one that is being taken.
    Stroke(Vec<Vector3<f64>>),
    /// Home.
    Home(Vector3<f64>),
}

impl Lesson {
    /// Number of points and finished strokes.
    pub fn counts(&self) -> (usize, usize) {
        let points = self.marks.iter().filter(|m| matches!(m, Mark::Point(_)));
        let points = points.count();
        (points, self.marks.len() - points)
    }

    /// Whether a stroke is being sampled.
    pub fn is_stroking(&self) -> bool {
        self.stroke.is_some()
    }

    /// Whether a home was taken.
    pub fn has_home(&self) -> bool {
        self.home.is_some()
    }

    /// Whether nothing was taken.
    pub fn is_empty(&self) -> bool {
        self.marks.is_empty() && self.home.is_none() && self.stroke.is_none()
    }

    /// Counts the changes of what was shown.
    pub fn changes(&self) -> u64 {
        self.changes
    }

    /// Where the tool was, for a picture: of each stroke at most `stroke_max` places, at least two.
    pub fn places(&self, stroke_max: usize) -> Vec<Places> {
        let place = |shown: &Shown| shown.base_from_tool.translation();
        let stroke = |samples: &[Shown]| {
            let step = samples.len().div_ceil(stroke_max.max(2) - 1).max(1);
            let mut places: Vec<_> = samples.iter().step_by(step).map(place).collect();
            places.extend(samples.last().map(place));
            Places::Stroke(places)
        };
        let marks = self.marks.iter().map(|mark| match mark {
            Mark::Point(shown) => Places::Point(place(shown)),
            Mark::Stroke(samples) => stroke(samples),
        });
        let open = self.stroke.as_deref().map(stroke);
        let home = self.home.as_ref().map(|home| Places::Home(place(home)));
        marks.chain(open).chain(home).collect()
    }

    /// Takes the arm where it moves; matters during a stroke only.
    pub fn sample(&mut self, now: &Shown) {
        let Some(stroke) = &mut self.stroke else {
            return;
        };
        let moved = stroke
            .last()
            .is_none_or(|last| last.away_m(now) >= SAMPLE_M);
        if moved && stroke.len() < SAMPLES_MAX {
            stroke.push(now.clone());
            self.changes += 1;
        }
    }

    /// Handles a key, with the arm at `now`.
    pub fn press(&mut self, key: Key, now: &Shown) -> Pressed {
        self.changes += 1;
        match key {
            Key::Point if self.is_stroking() => {
                Pressed::Refused("a stroke is being taken: `s` ends it")
            }
            Key::Point => {
                self.marks.push(Mark::Point(now.clone()));
                Pressed::Taken(format!("point {}", self.counts().0))
            }
            Key::Stroke => self.stroke(now),
            Key::Home => {
                self.home = Some(now.clone());
                Pressed::Taken("home is here".to_owned())
            }
            Key::Undo if self.stroke.take().is_some() => {
                Pressed::Taken("the stroke is dropped".to_owned())
            }
            Key::Undo => match self.marks.pop() {
                None => Pressed::Refused("nothing was taken yet"),
                Some(_) => {
                    let (points, strokes) = self.counts();
                    Pressed::Taken(format!(
                        "forgotten; {points} points and {strokes} strokes are left"
                    ))
                }
            },
            Key::Done if self.is_stroking() => {
                Pressed::Refused("a stroke is being taken: `s` ends it, `u` drops it")
            }
            Key::Done => Pressed::Done,
            Key::Quit => Pressed::Quit,
        }
    }

    fn stroke(&mut self, now: &Shown) -> Pressed {
        let Some(mut stroke) = self.stroke.take() else {
            self.stroke = Some(vec![now.clone()]);
            return Pressed::Taken("a stroke begins: move the arm, `s` ends it".to_owned());
        };
        if stroke.last() != Some(now) {
            stroke.push(now.clone());
        }
        let length_m: f64 = stroke.windows(2).map(|pair| pair[0].away_m(&pair[1])).sum();
        if length_m < 2.0 * SAMPLE_M {
            return Pressed::Refused("the arm has not moved: no stroke");
        }
        self.marks.push(Mark::Stroke(stroke));
        Pressed::Taken(format!(
            "stroke {}: {:.0} mm",
            self.counts().1,
            length_m * 1e3
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    fn at(x: f64) -> Shown {
        Shown {
            joints_rad: vec![x; 6],
            base_from_tool: Pose::new(Vector3::new(x, 0.0, 0.0), UnitQuaternion::identity()),
        }
    }

    #[test]
    fn keys_are_letters_or_an_empty_line() {
        assert_eq!(Key::of_line(""), Some(Key::Point));
        assert_eq!(Key::of_line(" s\r"), Some(Key::Stroke));
        assert_eq!(Key::of_line("done"), None);
        assert_eq!(Key::of_char('\n'), Some(Key::Point));
        assert_eq!(Key::of_char(' '), None);
        assert_eq!(Key::of_char('u'), Some(Key::Undo));
    }

    #[test]
    fn points_and_strokes_are_taken_and_forgotten() {
        let mut lesson = Lesson::default();
        assert!(matches!(
            lesson.press(Key::Undo, &at(0.0)),
            Pressed::Refused(_)
        ));
        lesson.press(Key::Point, &at(0.0));
        lesson.press(Key::Stroke, &at(0.1));
        assert!(matches!(
            lesson.press(Key::Point, &at(0.1)),
            Pressed::Refused(_)
        ));
        assert!(matches!(
            lesson.press(Key::Done, &at(0.1)),
            Pressed::Refused(_)
        ));
        for i in 0..100 {
            lesson.sample(&at(0.1 + 1e-4 * f64::from(i)));
        }
        let words = lesson.press(Key::Stroke, &at(0.11));
        assert_eq!(words, Pressed::Taken("stroke 1: 10 mm".to_owned()));
        let Mark::Stroke(stroke) = &lesson.marks[1] else {
            panic!("{lesson:?}");
        };
        // One sample per millimetre, not one per packet.
        assert!((10..=12).contains(&stroke.len()), "{}", stroke.len());
        assert_eq!(lesson.counts(), (1, 1));
        let [Places::Point(point), Places::Stroke(line)] = &lesson.places(4)[..] else {
            panic!("{:?}", lesson.places(4));
        };
        assert_eq!((point.x, line[0].x), (0.0, 0.1));
        assert!((2..=4).contains(&line.len()) && line.last().unwrap().x == 0.11);
        let changes = lesson.changes();
        lesson.press(Key::Undo, &at(0.0));
        assert!(lesson.changes() > changes);
        assert_eq!(lesson.counts(), (1, 0));
        assert_eq!(lesson.press(Key::Done, &at(0.0)), Pressed::Done);
    }

    #[test]
    fn an_arm_that_did_not_move_makes_no_stroke() {
        let mut lesson = Lesson::default();
        lesson.press(Key::Stroke, &at(0.1));
        assert!(matches!(
            lesson.press(Key::Stroke, &at(0.1)),
            Pressed::Refused(_)
        ));
        assert_eq!(lesson.counts(), (0, 0));
        lesson.press(Key::Stroke, &at(0.1));
        lesson.press(Key::Undo, &at(0.1));
        assert!(!lesson.is_stroking());
    }
}
