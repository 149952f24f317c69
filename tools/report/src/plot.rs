//! Line plots as SVG, drawn by plotters.

use plotters::prelude::*;

use crate::error::ReportError;

/// Points of one curve: x and y, in the plot's units.
pub type Curve = Vec<(f64, f64)>;

/// One curve of a plot.
pub struct Series<'a> {
    /// Name in the legend.
    pub name: &'a str,
    /// Points, in the plot's units; a NaN breaks the line.
    pub points: &'a [(f64, f64)],
    /// Colour.
    pub colour: RGBColor,
}

/// Axes and decoration of a plot.
pub struct Axes<'a> {
    /// Title above the plot.
    pub title: &'a str,
    /// Label of the x axis.
    pub x: &'a str,
    /// Label of the y axis.
    pub y: &'a str,
    /// Whether both axes have the same scale.
    pub equal: bool,
    /// A horizontal reference line, and its name.
    pub reference: Option<(f64, &'a str)>,
    /// Shaded spans of x.
    pub bands: &'a [Band],
}

/// A shaded span of x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Band {
    /// Begin of the span, in units of x.
    pub from: f64,
    /// End of the span, in units of x.
    pub to: f64,
    /// Colour.
    pub colour: RGBColor,
}

/// First colour, for measured values.
pub const BLUE: RGBColor = RGBColor(31, 98, 168);
/// Second colour, for reference values.
pub const ORANGE: RGBColor = RGBColor(214, 112, 28);
/// Third colour.
pub const GREEN: RGBColor = RGBColor(48, 138, 74);
/// Fourth colour.
pub const PURPLE: RGBColor = RGBColor(126, 78, 160);

/// Colours for one curve per joint or estimator.
pub const PALETTE: [RGBColor; 8] = [
    BLUE,
    ORANGE,
    GREEN,
    PURPLE,
    RGBColor(176, 42, 48),
    RGBColor(0, 135, 145),
    RGBColor(120, 110, 40),
    RGBColor(110, 110, 110),
];

const WIDTH: u32 = 900;
/// Largest number of points of a curve. Longer curves are thinned to keep the page small.
const POINTS_MAX: usize = 2500;

/// Draws the curves into one SVG element.
///
/// # Errors
/// Plotters cannot draw the plot.
pub fn draw(axes: &Axes<'_>, series: &[Series<'_>]) -> Result<String, ReportError> {
    let height = if axes.equal { 620 } else { 300 };
    let mut svg = String::new();
    let failed = |e: &dyn std::fmt::Display| ReportError::Plot {
        title: axes.title.to_owned(),
        reason: e.to_string(),
    };
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area();
        area.fill(&WHITE).map_err(|e| failed(&e))?;
        let (mut x, mut y) = (extent(series, |p| p.0), extent(series, |p| p.1));
        if let Some((level, _)) = axes.reference {
            y = (y.0.min(level), y.1.max(level));
        }
        y = padded(y);
        if axes.equal {
            x = padded(x);
            // Approximate ratio of width to height of the drawing area, without margins and labels.
            const ASPECT: f64 = 1.45;
            let (wx, wy) = (x.1 - x.0, y.1 - y.0);
            if wx < wy * ASPECT {
                x = widened(x, wy * ASPECT);
            } else {
                y = widened(y, wx / ASPECT);
            }
        }
        let mut chart = ChartBuilder::on(&area)
            .caption(axes.title, ("sans-serif", 18))
            .margin(12)
            .x_label_area_size(38)
            .y_label_area_size(64)
            .build_cartesian_2d(x.0..x.1, y.0..y.1)
            .map_err(|e| failed(&e))?;
        chart
            .draw_series(axes.bands.iter().map(|band| {
                Rectangle::new(
                    [(band.from.max(x.0), y.0), (band.to.min(x.1), y.1)],
                    band.colour.filled(),
                )
            }))
            .map_err(|e| failed(&e))?;
        chart
            .configure_mesh()
            .x_desc(axes.x)
            .y_desc(axes.y)
            .disable_x_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(RGBColor(226, 226, 226))
            .draw()
            .map_err(|e| failed(&e))?;
        if let Some((level, name)) = axes.reference {
            chart
                .draw_series(LineSeries::new(
                    [(x.0, level), (x.1, level)],
                    ORANGE.mix(0.9),
                ))
                .map_err(|e| failed(&e))?
                .label(name)
                .legend(|(x, y)| PathElement::new([(x, y), (x + 18, y)], ORANGE));
        }
        for one in series {
            let colour = one.colour;
            let mut labelled = false;
            for run in runs(one.points) {
                let drawn = chart
                    .draw_series(LineSeries::new(run.iter().copied(), colour.stroke_width(1)))
                    .map_err(|e| failed(&e))?;
                if !labelled {
                    labelled = true;
                    drawn
                        .label(one.name)
                        .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour));
                }
            }
        }
        if series.len() + usize::from(axes.reference.is_some()) > 1 {
            chart
                .configure_series_labels()
                .position(SeriesLabelPosition::UpperRight)
                .background_style(WHITE.mix(0.85))
                .border_style(RGBColor(200, 200, 200))
                .label_font(("sans-serif", 13))
                .draw()
                .map_err(|e| failed(&e))?;
        }
        area.present().map_err(|e| failed(&e))?;
    }
    Ok(svg)
}

/// Splits the points into thinned runs of finite points.
fn runs(points: &[(f64, f64)]) -> Vec<Vec<(f64, f64)>> {
    let stride = points.len().div_ceil(POINTS_MAX).max(1);
    points
        .split(|p| !p.0.is_finite() || !p.1.is_finite())
        .filter(|run| !run.is_empty())
        .map(|run| run.iter().step_by(stride).copied().collect())
        .collect()
}

fn extent(series: &[Series<'_>], pick: impl Fn(&(f64, f64)) -> f64) -> (f64, f64) {
    let values = series
        .iter()
        .flat_map(|s| s.points.iter().map(&pick))
        .filter(|v| v.is_finite());
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
        (l.min(v), h.max(v))
    });
    if low < high {
        (low, high)
    } else if low.is_finite() {
        (low - 0.5, low + 0.5)
    } else {
        (0.0, 1.0)
    }
}

fn padded((low, high): (f64, f64)) -> (f64, f64) {
    let pad = 0.05 * (high - low);
    (low - pad, high + pad)
}

fn widened((low, high): (f64, f64), width: f64) -> (f64, f64) {
    let middle = 0.5 * (low + high);
    (middle - 0.5 * width, middle + 0.5 * width)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axes(reference: Option<(f64, &'static str)>) -> Axes<'static> {
        Axes {
            title: "force",
            x: "s",
            y: "N",
            equal: false,
            reference,
            bands: &[],
        }
    }

    #[test]
    fn an_empty_plot_is_still_a_plot() {
        let svg = draw(&axes(None), &[]).unwrap();
        assert!(svg.starts_with("<svg") && svg.contains("force"));
    }

    #[test]
    fn a_nan_breaks_the_line_and_nothing_else() {
        let points = [(0.0, 1.0), (1.0, f64::NAN), (2.0, 3.0), (3.0, 4.0)];
        assert_eq!(
            runs(&points),
            vec![vec![(0.0, 1.0)], vec![(2.0, 3.0), (3.0, 4.0)]]
        );
        let one = Series {
            name: "f",
            points: &points,
            colour: BLUE,
        };
        assert!(draw(&axes(Some((3.0, "reference"))), &[one]).is_ok());
    }

    #[test]
    fn a_long_recording_is_thinned() {
        let points: Vec<_> = (0..100_000).map(|i| (f64::from(i), 0.0)).collect();
        assert!(runs(&points)[0].len() <= POINTS_MAX);
    }
}
