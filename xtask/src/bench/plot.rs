//! Curves as a picture (SVG): both axes logarithmic, a legend beside them.

use std::error::Error;

use anyhow::{Result, anyhow};
use plotters::backend::SVGBackend;
use plotters::chart::{ChartBuilder, ChartContext};
use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::coord::ranged1d::Ranged;
use plotters::drawing::{DrawingArea, IntoDrawingArea};
use plotters::element::{Circle, EmptyElement, PathElement, Polygon, Text};
use plotters::series::{DashedLineSeries, LineSeries};
use plotters::style::{BLACK, Color, IntoTextStyle, RGBAColor, RGBColor, ShapeStyle, TRANSPARENT, WHITE};

use super::axis::{LogAxis, plain};

const HEIGHT: u32 = 460;
const CHART_WIDTH: u32 = 700;
const FONT: &str = "sans-serif";
/// Mean width of a letter of the legend, pixels.
const LETTER_WIDTH: f64 = 7.4;
const LEGEND_SIZE: i32 = 14;
/// Distinct for eyes that tell few colours apart too (Okabe & Ito 2008), and on light and dark paper.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(128, 128, 128),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
];
const DIAMOND: [(i32, i32); 4] = [(-6, 0), (0, -6), (6, 0), (0, 6)];
const HIDDEN: ShapeStyle = ShapeStyle { color: RGBAColor(0, 0, 0, 0.0), filled: false, stroke_width: 0 };

/// What is drawn.
#[derive(Debug, Clone)]
pub struct Figure {
    /// Above the picture.
    pub title: String,
    /// To the right.
    pub x: Axis,
    /// Upwards.
    pub y: Axis,
    /// In the order of the legend.
    pub lines: Vec<Line>,
    /// Below this `y` nothing is known, and why, in lines of a few words.
    pub floor: Option<(f64, &'static [&'static str])>,
}

/// One axis.
#[derive(Debug, Clone)]
pub struct Axis {
    /// Quantity and unit.
    pub title: String,
    /// Whether values are fractions that are shown as per cent.
    pub is_percent: bool,
}

/// One line of a figure.
#[derive(Debug, Clone)]
pub struct Line {
    /// In the legend.
    pub title: String,
    /// What is not positive is left out.
    pub points: Vec<(f64, f64)>,
}

/// On what a picture is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Paper {
    /// White.
    White,
    /// Any, light or dark: text and axes have the colour of the text around the picture.
    Around,
}

/// The picture as text.
///
/// # Errors
/// When there is nothing to draw.
pub fn svg(figure: &Figure, paper: Paper) -> Result<String> {
    let mut text = String::new();
    draw(&mut text, figure, paper).map_err(|problem| anyhow!("{}: {problem}", figure.title))?;
    Ok(match paper {
        Paper::White => text,
        Paper::Around => text.replace("\"#000000\"", "\"currentColor\""),
    })
}

fn draw(text: &mut String, figure: &Figure, paper: Paper) -> Result<(), Box<dyn Error>> {
    let points = || figure.lines.iter().flat_map(drawn);
    let x = LogAxis::around(points().map(|p| p.0), 12).ok_or("nothing to draw")?;
    let floor = figure.floor.map(|(y, _)| y);
    let y = LogAxis::around(points().map(|p| p.1).chain(floor), 12).ok_or("nothing to draw")?;
    let area = SVGBackend::with_string(text, (CHART_WIDTH + legend_width(figure), HEIGHT)).into_drawing_area();
    if paper == Paper::White {
        area.fill(&WHITE)?;
    }
    let area = area.titled(&figure.title, (FONT, 18).into_text_style(&area))?;
    let (left, right) = area.split_horizontally(CHART_WIDTH);
    let mut chart = ChartBuilder::on(&left)
        .margin(12)
        .x_label_area_size(48)
        .y_label_area_size(76)
        .build_cartesian_2d(x.clone(), y)?;
    draw_axes(&mut chart, figure)?;
    if let Some(floor) = floor {
        let range = x.range();
        let ends = [(range.start, floor), (range.end, floor)];
        chart.draw_series(DashedLineSeries::new(ends, 4, 4, floor_style()))?;
    }
    for (i, line) in figure.lines.iter().enumerate() {
        chart.draw_series(LineSeries::new(drawn(line), colour(i).stroke_width(2)))?;
        let style = colour(i).filled();
        match is_first_of_colour(i) {
            true => chart.draw_series(drawn(line).map(|at| EmptyElement::at(at) + Circle::new((0, 0), 4, style)))?,
            false => chart.draw_series(drawn(line).map(|at| EmptyElement::at(at) + Polygon::new(DIAMOND, style)))?,
        };
    }
    draw_legend(&right, figure)?;
    area.present()?;
    Ok(())
}

type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<LogAxis, LogAxis>>;

fn draw_axes(chart: &mut Chart<'_, '_>, figure: &Figure) -> Result<(), Box<dyn Error>> {
    let label = |axis: &Axis, v: f64| if axis.is_percent { format!("{} %", plain(100.0 * v)) } else { plain(v) };
    chart
        .configure_mesh()
        .x_desc(&figure.x.title)
        .y_desc(&figure.y.title)
        .x_label_formatter(&|x| label(&figure.x, *x))
        .y_label_formatter(&|y| label(&figure.y, *y))
        .label_style((FONT, 14))
        .axis_desc_style((FONT, 15))
        .bold_line_style(BLACK.mix(0.18))
        .light_line_style(TRANSPARENT)
        .draw()?;
    Ok(())
}

/// Beside the chart, so that it hides nothing.
fn draw_legend(area: &DrawingArea<SVGBackend<'_>, Shift>, figure: &Figure) -> Result<(), Box<dyn Error>> {
    let row = |i: usize| 40 + 24 * i as i32;
    let write = |title: &str, y: i32| area.draw(&Text::new(title.to_owned(), (32, y - 7), (FONT, LEGEND_SIZE)));
    for (i, line) in figure.lines.iter().enumerate() {
        area.draw(&PathElement::new([(0, row(i)), (24, row(i))], colour(i).stroke_width(3)))?;
        let (at, style) = (EmptyElement::at((12, row(i))), colour(i).filled());
        match is_first_of_colour(i) {
            true => area.draw(&(at + Circle::new((0, 0), 4, style)))?,
            false => area.draw(&(at + Polygon::new(DIAMOND, style)))?,
        }
        write(&line.title, row(i))?;
    }
    for (i, words) in figure.floor.iter().flat_map(|(_, words)| words.iter()).enumerate() {
        let y = row(figure.lines.len() + i);
        area.draw(&PathElement::new([(0, y), (24, y)], if i == 0 { floor_style() } else { HIDDEN }))?;
        write(words, y)?;
    }
    Ok(())
}

fn legend_width(figure: &Figure) -> u32 {
    let floor = figure.floor.iter().flat_map(|(_, words)| words.iter().map(|w| w.chars().count()));
    let longest = figure.lines.iter().map(|line| line.title.chars().count()).chain(floor).max().unwrap_or(0);
    40 + (LETTER_WIDTH * longest as f64).ceil() as u32
}

fn drawn(line: &Line) -> impl Iterator<Item = (f64, f64)> {
    line.points.iter().copied().filter(|(x, y)| [x, y].iter().all(|v| v.is_finite() && **v > 0.0))
}

fn colour(i: usize) -> RGBColor {
    COLOURS[i % COLOURS.len()]
}

/// Circles for the first lines, diamonds when the colours come again.
fn is_first_of_colour(i: usize) -> bool {
    i < COLOURS.len()
}

fn floor_style() -> ShapeStyle {
    ShapeStyle { color: BLACK.mix(0.6), filled: false, stroke_width: 1 }
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// Two lines of two points.
    pub fn figure() -> Figure {
        let line = |title: &str, points: &[(f64, f64)]| Line { title: title.into(), points: points.into() };
        Figure {
            title: "Cornell & co".into(),
            x: Axis { title: "time, s".into(), is_percent: false },
            y: Axis { title: "mean error".into(), is_percent: true },
            lines: vec![
                line("links", &[(0.5, 0.02), (8.0, 0.004)]),
                line("path tracer", &[(1.0, 0.08), (30.0, 0.01), (60.0, 0.0)]),
            ],
            floor: Some((0.002, &["standard error", "of the reference"])),
        }
    }

    #[test]
    fn the_picture_names_its_axes_and_lines_and_leaves_out_what_has_no_place() {
        let svg = svg(&figure(), Paper::White).unwrap();
        for text in ["time, s", "mean error", "links", "path tracer", "standard error", "0.5 %", "Cornell &amp; co"] {
            assert!(svg.contains(text), "{text}");
        }
        // A mark for each of four points, and for each line of the legend.
        assert_eq!(svg.matches("<circle").count(), 4 + 2);
        assert!(!svg.contains("NaN") && !svg.contains("currentColor"));
    }

    #[test]
    fn on_any_paper_nothing_is_black_or_filled_white() {
        let svg = svg(&figure(), Paper::Around).unwrap();
        assert!(svg.contains("currentColor") && !svg.contains("#000000") && !svg.contains("#FFFFFF"));
    }

    #[test]
    fn without_a_point_there_is_no_picture() {
        let mut empty = figure();
        empty.lines.clear();
        assert!(svg(&empty, Paper::White).is_err());
    }

    #[test]
    fn the_legend_has_room_for_its_longest_line() {
        let mut wide = figure();
        wide.lines[0].title = "a very long title of a line, with details".into();
        assert!(legend_width(&wide) > legend_width(&figure()) + 100);
    }

    #[test]
    fn lines_beyond_the_colours_have_other_marks() {
        let mut many = figure();
        many.lines = vec![many.lines[0].clone(); COLOURS.len() + 1];
        let svg = svg(&many, Paper::White).unwrap();
        assert_eq!(svg.matches("<circle").count(), 3 * COLOURS.len());
        assert_eq!(svg.matches("<polygon").count(), 3);
    }
}
