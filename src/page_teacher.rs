//! Teaching by hand from the operator's page: its steps, as keys of a lesson.

use tangent_mechanics::{Flange, ModelData, Pose, Tool};
use tangent_runtime::{Bus, CellConfig};
use tangent_teach::{DraftOptions, Key, Places, Session, Shape, draft};
use tangent_ui::{TaskWish, TaughtMark, TaughtShape, TaughtTask, TeachState, TeachStep, Teacher};

use crate::teach::{bridge, shown_on, travels};

/// The one lesson that pages may give at a time.
pub struct PageTeacher {
    session: Session,
    model: ModelData,
    flange_from_tool: Pose<Flange, Tool>,
    shown_on: String,
    travels: bool,
}

impl PageTeacher {
    /// For the arm of this cell.
    pub fn new(bus: &Bus, cell: &CellConfig, model: ModelData) -> Self {
        Self {
            session: Session::new(bus, bridge(cell)),
            model,
            flange_from_tool: cell.tool.flange_from_tool(),
            shown_on: shown_on(cell),
            travels: travels(cell),
        }
    }
}

impl Teacher for PageTeacher {
    fn step(&self, who: &str, step: TeachStep) -> Result<String, String> {
        let session = &self.session;
        let done = match step {
            TeachStep::Begin => session.begin(who, true),
            TeachStep::BeginHeld => session.begin(who, false),
            TeachStep::Keep => session.keep(who).map(|()| String::new()),
            TeachStep::Hold => session.hold(who),
            TeachStep::Point => session.press(who, Key::Point),
            TeachStep::Stroke => session.press(who, Key::Stroke),
            TeachStep::Home => session.press(who, Key::Home),
            TeachStep::Undo => session.press(who, Key::Undo),
            TeachStep::Discard => session.press(who, Key::Quit),
        };
        done.map_err(|error| error.to_string())
    }

    fn draft(&self, who: &str, wish: &TaskWish) -> Result<TaughtTask, String> {
        let options = DraftOptions {
            name: &wish.name,
            shown_on: &self.shown_on,
            shape: match wish.shape {
                TaughtShape::Open => Shape::Open,
                TaughtShape::Outline => Shape::Polygon,
                TaughtShape::Region => Shape::Region {
                    spacing_m: wish.spacing_m,
                },
            },
            force_n: wish.force_n,
            speed_m_per_s: wish.speed_m_per_s,
            clearance_m: wish.clearance_m,
            tolerance_m: wish.tolerance_m,
            travels: self.travels,
            model: &self.model,
            flange_from_tool: &self.flange_from_tool,
        };
        let drafted = self.session.read(who, |lesson| draft(lesson, &options));
        let drafted = drafted.and_then(|drafted| drafted);
        let drafted = drafted.map_err(|error| error.to_string())?;
        Ok(TaughtTask {
            text: drafted.text,
            places: drafted.places,
            length_m: drafted.length_m,
            notes: drafted.notes,
        })
    }

    fn state(&self) -> Option<TeachState> {
        self.session.state().map(|state| TeachState {
            who: state.who,
            free: state.is_free,
            held_because: state.held_because,
            points: state.points,
            strokes: state.strokes,
            stroking: state.is_stroking,
            home: state.has_home,
            revision: state.changes,
        })
    }

    fn marks(&self) -> Vec<TaughtMark> {
        let marks = self.session.places().into_iter();
        let marks = marks.map(|places| match places {
            Places::Point(place) => ("point", vec![place]),
            Places::Stroke(places) => ("stroke", places),
            Places::Home(place) => ("home", vec![place]),
        });
        marks
            .map(|(kind, places)| TaughtMark {
                kind,
                places_m: places.into_iter().map(Into::into).collect(),
            })
            .collect()
    }
}
