//! Curves as a picture (SVG).

use std::ops::Range;
use std::path::Path;

use anyhow::{Result, anyhow};
use plotters::backend::SVGBackend;
use plotters::chart::{ChartBuilder, SeriesLabelPosition};
use plotters::coord::combinators::IntoLogRange;
use plotters::drawing::IntoDrawingArea;
use plotters::element::{Circle, PathElement};
use plotters::series::LineSeries;
use plotters::style::{BLACK, Color, RGBColor, ShapeStyle, WHITE};

use super::curves::SceneCurves;

const SIZE: (u32, u32) = (860, 560);
const FONT: &str = "sans-serif";
/// Distinct for eyes that tell few colours apart too: Okabe & Ito 2008.
const COLOURS: [RGBColor; 5] =
    [RGBColor(0, 114, 178), RGBColor(213, 94, 0), RGBColor(0, 158, 115), RGBColor(90, 90, 90), RGBColor(204, 121, 167)];

/// Draws time against mean error, both logarithmic, with the error of the reference as a line that nothing is known below.
///
/// # Errors
/// When there is nothing to draw, or the file cannot be written.
pub fn write(path: &Path, scene: &SceneCurves) -> Result<()> {
    let mut text = String::new();
    draw(&mut text, scene).map_err(|problem| anyhow!("{}: {problem}", scene.title))?;
    Ok(std::fs::write(path, text)?)
}

fn draw(text: &mut String, scene: &SceneCurves) -> Result<(), Box<dyn std::error::Error>> {
    let points = || scene.curves.iter().flat_map(|c| &c.points);
    let times = range(points().map(|p| p.seconds)).ok_or("no times")?;
    let errors = range(points().map(|p| p.mean).chain([scene.reference.mean])).ok_or("no errors")?;
    let area = SVGBackend::with_string(text, SIZE).into_drawing_area();
    area.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&area)
        .caption(format!("{}: error against time, {} points", scene.title, scene.n_points), (FONT, 20))
        .margin(16)
        .x_label_area_size(48)
        .y_label_area_size(72)
        .build_cartesian_2d(times.clone().log_scale(), errors.log_scale())?;
    chart
        .configure_mesh()
        .x_desc("time of the whole process, s")
        .y_desc("mean relative error of total irradiance")
        .x_label_formatter(&|x| plain(*x))
        .y_label_formatter(&|y| format!("{} %", plain(100.0 * y)))
        .label_style((FONT, 15))
        .axis_desc_style((FONT, 16))
        .bold_line_style(BLACK.mix(0.25))
        .light_line_style(BLACK.mix(0.07))
        .draw()?;
    let floor = ShapeStyle { color: BLACK.mix(0.6), filled: false, stroke_width: 1 };
    let se = scene.reference.mean;
    chart
        .draw_series(plotters::series::DashedLineSeries::new([(times.start, se), (times.end, se)], 4, 4, floor))?
        .label("standard error of the reference")
        .legend(move |(x, y)| PathElement::new([(x, y), (x + 24, y)], floor));
    for (curve, colour) in scene.curves.iter().zip(COLOURS.iter().cycle()) {
        let line = colour.stroke_width(2);
        let points = || curve.points.iter().map(|p| (p.seconds, p.mean));
        chart
            .draw_series(LineSeries::new(points(), line))?
            .label(curve.title.clone())
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 24, y)], line.stroke_width(3)));
        chart.draw_series(points().map(|at| Circle::new(at, 4, colour.filled())))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .margin(10)
        .legend_area_size(32)
        .background_style(WHITE.mix(0.9))
        .border_style(BLACK.mix(0.4))
        .label_font((FONT, 15))
        .draw()?;
    area.present()?;
    Ok(())
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
        draw(&mut svg, &scene()).unwrap();
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
        assert!(draw(&mut String::new(), &empty).is_err());
    }

    #[test]
    fn labels_are_short() {
        assert_eq!([0.05, 0.5, 5.0, 500.0, 0.30000000000000004].map(plain), ["0.05", "0.5", "5", "500", "0.3"]);
        assert_eq!(range([2.0, 8.0, 0.0, f64::NAN].into_iter()), Some(0.7 * 2.0..12.0));
    }
}
