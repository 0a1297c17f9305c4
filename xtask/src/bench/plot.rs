//! Curves as a picture (SVG).

use std::error::Error;
use std::ops::Range;
use std::path::Path;

use anyhow::{Result, anyhow};
use plotters::backend::SVGBackend;
use plotters::chart::ChartBuilder;
use plotters::coord::Shift;
use plotters::coord::combinators::IntoLogRange;
use plotters::drawing::{DrawingArea, IntoDrawingArea};
use plotters::element::{Circle, PathElement, Text};
use plotters::series::{DashedLineSeries, LineSeries};
use plotters::style::{BLACK, Color, IntoTextStyle, RGBAColor, RGBColor, ShapeStyle, TRANSPARENT, WHITE};

use super::curves::{Clock, SceneCurves};

const SIZE: (u32, u32) = (860, 560);
const LEGEND_WIDTH: u32 = 150;
const HIDDEN: ShapeStyle = ShapeStyle { color: RGBAColor(0, 0, 0, 0.0), filled: false, stroke_width: 0 };
const FONT: &str = "sans-serif";
/// Distinct for eyes that tell few colours apart too: Okabe & Ito 2008.
const COLOURS: [RGBColor; 5] =
    [RGBColor(0, 114, 178), RGBColor(213, 94, 0), RGBColor(0, 158, 115), RGBColor(90, 90, 90), RGBColor(204, 121, 167)];

/// Draws time against mean error, both logarithmic, with the error of the reference as a line that nothing is known below.
///
/// # Errors
/// When there is nothing to draw, or the file cannot be written.
pub fn write(path: &Path, scene: &SceneCurves, clock: Clock) -> Result<()> {
    let mut text = String::new();
    draw(&mut text, scene, clock).map_err(|problem| anyhow!("{}: {problem}", scene.title))?;
    Ok(std::fs::write(path, text)?)
}

fn draw(text: &mut String, scene: &SceneCurves, clock: Clock) -> Result<(), Box<dyn Error>> {
    let points = || scene.curves.iter().flat_map(|c| &c.points);
    let times = range(points().map(|p| clock.of(p))).ok_or("no times")?;
    let errors = range(points().map(|p| p.mean).chain([scene.reference.mean])).ok_or("no errors")?;
    let area = SVGBackend::with_string(text, SIZE).into_drawing_area();
    area.fill(&WHITE)?;
    let area = area.titled(
        &format!("{}: error against time, {} points", scene.title, scene.n_points),
        (FONT, 20).into_text_style(&area),
    )?;
    let (left, right) = area.split_horizontally(SIZE.0 - LEGEND_WIDTH);
    let mut chart = ChartBuilder::on(&left)
        .margin(12)
        .x_label_area_size(48)
        .y_label_area_size(76)
        .build_cartesian_2d(times.clone().log_scale(), errors.log_scale())?;
    chart
        .configure_mesh()
        .y_labels(20)
        .x_desc(match clock {
            Clock::Wall => "time of the whole process, s",
            Clock::Processor => "processor time of the whole process, all threads, s",
        })
        .y_desc("mean relative error of total irradiance")
        .x_label_formatter(&|x| plain(*x))
        .y_label_formatter(&|y| format!("{} %", plain(100.0 * y)))
        .label_style((FONT, 14))
        .axis_desc_style((FONT, 15))
        .bold_line_style(BLACK.mix(0.18))
        .light_line_style(TRANSPARENT)
        .draw()?;
    let se = scene.reference.mean;
    chart.draw_series(DashedLineSeries::new([(times.start, se), (times.end, se)], 4, 4, reference_style()))?;
    for (curve, colour) in scene.curves.iter().zip(COLOURS.iter().cycle()) {
        let points = || curve.points.iter().map(|p| (clock.of(p), p.mean));
        chart.draw_series(LineSeries::new(points(), colour.stroke_width(2)))?;
        chart.draw_series(points().map(|at| Circle::new(at, 4, colour.filled())))?;
    }
    draw_legend(&right, scene)?;
    area.present()?;
    Ok(())
}

/// Beside the chart, so that it hides nothing.
fn draw_legend(area: &DrawingArea<SVGBackend<'_>, Shift>, scene: &SceneCurves) -> Result<(), Box<dyn Error>> {
    let curves = scene.curves.iter().zip(COLOURS.iter().cycle());
    let lines = curves.map(|(curve, colour)| (curve.title.as_str(), colour.stroke_width(3)));
    for (i, (title, style)) in
        lines.chain([("standard error", reference_style()), ("of the reference", HIDDEN)]).enumerate()
    {
        let y = 40 + 24 * i as i32;
        area.draw(&PathElement::new([(0, y), (24, y)], style))?;
        area.draw(&Text::new(title.to_owned(), (32, y - 7), (FONT, 14)))?;
    }
    Ok(())
}

fn reference_style() -> ShapeStyle {
    ShapeStyle { color: BLACK.mix(0.6), filled: false, stroke_width: 1 }
}

/// A little more than the values take, on a logarithmic axis.
fn range(values: impl Iterator<Item = f64>) -> Option<Range<f64>> {
    let [least, most] = values
        .filter(|v| v.is_finite() && *v > 0.0)
        .fold([f64::INFINITY, 0.0], |[least, most]: [f64; 2], v| [least.min(v), most.max(v)]);
    (most > 0.0).then_some(0.7 * least..1.5 * most)
}

/// As few digits as tell `0.05`, `0.5`, `5` and `500` apart.
fn plain(value: f64) -> String {
    let digits = (-value.log10().floor()).clamp(0.0, 6.0) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::super::curves::tests::scene;
    use super::*;

    #[test]
    fn the_picture_names_its_axes_methods_and_points() {
        let mut svg = String::new();
        draw(&mut svg, &scene(), Clock::Wall).unwrap();
        for text in [
            "time of the whole process, s",
            "mean relative error",
            "links",
            "path tracer",
            "standard error",
            "2000 points",
        ] {
            assert!(svg.contains(text), "{text}");
        }
        assert_eq!(svg.matches("<circle").count(), 4);
        assert!(svg.contains("Cornell &amp; co"));
    }

    #[test]
    fn without_a_point_there_is_no_picture() {
        let mut empty = scene();
        empty.curves.clear();
        assert!(draw(&mut String::new(), &empty, Clock::Wall).is_err());
    }

    #[test]
    fn labels_are_short() {
        assert_eq!([0.05, 0.5, 5.0, 500.0, 0.30000000000000004].map(plain), ["0.05", "0.5", "5", "500", "0.3"]);
        assert_eq!(range([2.0, 8.0, 0.0, f64::NAN].into_iter()), Some(0.7 * 2.0..12.0));
    }
}
