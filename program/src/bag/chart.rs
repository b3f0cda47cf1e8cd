//! Curves over time, drawn as SVG or PNG.

use std::ops::Range;
use std::path::Path;

use anyhow::{anyhow, bail};
use plotters::coord::Shift;
use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::register_font;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::unfinished::write_file;

/// The font family: in SVG the viewer's own, in PNG the font below.
const FONT: &str = "sans-serif";

/// A chart of curves.
pub(crate) struct Chart {
    pub(crate) title: String,
    /// Width and height in pixels.
    pub(crate) size: (u32, u32),
    pub(crate) curves: Vec<Curve>,
}

/// A curve of times in seconds and values.
pub(crate) struct Curve {
    pub(crate) name: String,
    pub(crate) points: Vec<(f64, f64)>,
}

impl Chart {
    /// Draws it into an SVG or PNG file, depending on the extension.
    pub(crate) fn write(&self, path: &Path) -> anyhow::Result<()> {
        register_font(FONT, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT)
            .map_err(|_| anyhow!("the font of this build is broken"))?;
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("svg") => self.write_svg(path),
            Some("png") => self.write_png(path),
            _ => bail!("{}: a plot is written as .svg or .png", path.display()),
        }
    }

    fn write_svg(&self, path: &Path) -> anyhow::Result<()> {
        let mut text = String::new();
        self.draw(&SVGBackend::with_string(&mut text, self.size).into_drawing_area())?;
        write_file(path, text)
    }

    fn write_png(&self, path: &Path) -> anyhow::Result<()> {
        const BYTES_PER_PIXEL: usize = 3;
        let (width, height) = self.size;
        let mut pixels = vec![0; width as usize * height as usize * BYTES_PER_PIXEL];
        self.draw(&BitMapBackend::with_buffer(&mut pixels, self.size).into_drawing_area())?;
        let mut picture = Vec::new();
        let mut encoder = png::Encoder::new(&mut picture, width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.write_header()?.write_image_data(&pixels)?;
        write_file(path, picture)
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> anyhow::Result<()>
    where
        B::ErrorType: 'static,
    {
        let all = || self.curves.iter().flat_map(|curve| &curve.points).filter(|(_, y)| is_drawn(*y));
        let times = range(all().map(|(x, _)| *x), 0.0);
        let values = range(all().map(|(_, y)| *y), 0.05);
        area.fill(&WHITE)?;
        let (area, legend) = area.split_horizontally(self.size.0 - self.legend_width(area)?);
        let mut chart = ChartBuilder::on(&area)
            .caption(&self.title, (FONT, 20))
            .margin(12)
            .x_label_area_size(40)
            .y_label_area_size(80)
            .build_cartesian_2d(times.clone(), values)?;
        chart.configure_mesh().x_desc("seconds since the start of the bag").draw()?;
        for (curve, stroke) in self.curves.iter().zip(Stroke::all()) {
            for part in drawn_parts(&curve.points, &times, area.dim_in_pixel().0) {
                // A line of one point would not be visible.
                match (&part[..], stroke.dash) {
                    ([point], _) => {
                        chart.draw_series([Circle::new(*point, 2, stroke.style().filled())])?;
                    }
                    (_, None) => {
                        chart.draw_series(LineSeries::new(part, stroke.style()))?;
                    }
                    (_, Some((dash, gap))) => {
                        chart.draw_series(DashedLineSeries::new(part, dash, gap, stroke.style()))?;
                    }
                }
            }
        }
        self.draw_legend(&legend)?;
        area.present()?;
        Ok(())
    }

    /// Draws the legend beside the data, in as many columns as needed.
    fn draw_legend<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> anyhow::Result<()>
    where
        B::ErrorType: 'static,
    {
        let rows = self.legend_rows();
        let width = area.dim_in_pixel().0 / self.curves.len().div_ceil(rows).max(1) as u32;
        for (index, (curve, stroke)) in self.curves.iter().zip(Stroke::all()).enumerate() {
            let (column, row) = (index / rows, index % rows);
            let (x, y) = (column as i32 * width as i32, LEGEND_TOP + row as i32 * LEGEND_LINE);
            let sample = vec![(x, y), (x + LEGEND_SAMPLE, y)];
            match stroke.dash {
                None => area.draw(&PathElement::new(sample, stroke.style()))?,
                Some((dash, gap)) => area.draw(&DashedPathElement::new(sample, dash, gap, stroke.style()))?,
            }
            let room = width.saturating_sub(LEGEND_SAMPLE as u32 + 2 * LEGEND_GAP as u32);
            let text = fitting(&curve.name, room, |text| text_width(area, text))?;
            let anchor = Pos::new(HPos::Left, VPos::Center);
            let style = (FONT, LEGEND_FONT).into_text_style(area).pos(anchor);
            area.draw(&Text::new(text, (x + LEGEND_SAMPLE + LEGEND_GAP, y), style))?;
        }
        Ok(())
    }

    fn legend_rows(&self) -> usize {
        let room = i64::from(self.size.1) - i64::from(LEGEND_TOP);
        usize::try_from(room / i64::from(LEGEND_LINE)).unwrap_or(0).max(1)
    }

    /// The width of the legend, at most half of the image.
    fn legend_width<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> anyhow::Result<u32>
    where
        B::ErrorType: 'static,
    {
        let mut widest = 0;
        for curve in &self.curves {
            widest = widest.max(text_width(area, &curve.name)?);
        }
        let columns = self.curves.len().div_ceil(self.legend_rows()).max(1) as u32;
        let column = widest + LEGEND_SAMPLE as u32 + 2 * LEGEND_GAP as u32;
        Ok((columns * column).min(self.size.0 / 2))
    }
}

/// Layout of the legend in pixels: space above, line height, length of the line sample, and space beside it.
const LEGEND_TOP: i32 = 24;
const LEGEND_LINE: i32 = 18;
const LEGEND_SAMPLE: i32 = 30;
const LEGEND_GAP: i32 = 8;
const LEGEND_FONT: i32 = 14;

fn text_width<B: DrawingBackend>(area: &DrawingArea<B, Shift>, text: &str) -> anyhow::Result<u32>
where
    B::ErrorType: 'static,
{
    let style = (FONT, LEGEND_FONT).into_text_style(area);
    Ok(area.estimate_text_size(text, &style)?.0)
}

/// The text, or its two ends if it is wider than `room`: they describe a field better than its middle.
fn fitting(text: &str, room: u32, width: impl Fn(&str) -> anyhow::Result<u32>) -> anyhow::Result<String> {
    let characters: Vec<_> = text.chars().collect();
    let mut kept = characters.len();
    let mut fitting = text.to_owned();
    while kept > 2 && width(&fitting)? > room {
        kept -= 1;
        let (front, back) = (kept / 2, kept - kept / 2);
        let ends = [&characters[..front], &['…'], &characters[characters.len() - back..]];
        fitting = ends.concat().into_iter().collect();
    }
    Ok(fitting)
}

/// The style of a curve.
#[derive(Clone, Copy)]
struct Stroke {
    color: RGBColor,
    /// Length of a dash and of the gap after it, in pixels.
    dash: Option<(u32, u32)>,
}

impl Stroke {
    /// Distinguishable styles: the colour-blind-safe palette of Okabe and Ito without yellow, which is pale
    /// on white; solid, then dashed.
    fn all() -> impl Iterator<Item = Self> {
        const COLORS: [RGBColor; 7] = [
            RGBColor(0, 114, 178),
            RGBColor(213, 94, 0),
            RGBColor(0, 158, 115),
            RGBColor(204, 121, 167),
            RGBColor(0, 0, 0),
            RGBColor(230, 159, 0),
            RGBColor(86, 180, 233),
        ];
        const DASHES: [Option<(u32, u32)>; 6] =
            [None, Some((8, 4)), Some((2, 4)), Some((16, 4)), Some((4, 8)), Some((12, 12))];
        let dashes = DASHES.into_iter().cycle();
        dashes.flat_map(|dash| COLORS.into_iter().map(move |color| Self { color, dash }))
    }

    fn style(self) -> ShapeStyle {
        self.color.stroke_width(2)
    }
}

/// NaN, and numbers that represent missing values, are gaps.
fn is_drawn(value: f64) -> bool {
    value.abs() < 1e300
}

/// From the smallest to the largest value, extended by a fraction of the range on both ends.
fn range(values: impl Iterator<Item = f64>, margin: f64) -> Range<f64> {
    let (low, high) =
        values.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return 0.0..1.0;
    }
    let width = high - low;
    if width > 0.0 { low - margin * width..high + margin * width } else { low - 0.5..low + 0.5 }
}

/// The parts of a curve between gaps, with at most two points for each pixel of the width: the smallest and
/// the largest value.
fn drawn_parts(points: &[(f64, f64)], times: &Range<f64>, width: u32) -> Vec<Vec<(f64, f64)>> {
    let pixel = (times.end - times.start) / f64::from(width);
    let parts = points.split(|(_, y)| !is_drawn(*y)).filter(|part| !part.is_empty());
    parts
        .map(|part| {
            let of_a_pixel =
                part.chunk_by(|(one, _), (other, _)| (one / pixel).floor() == (other / pixel).floor());
            of_a_pixel.flat_map(extremes).collect()
        })
        .collect()
}

/// The smallest and the largest value, sorted by time; one point if they are the same.
fn extremes(points: &[(f64, f64)]) -> impl Iterator<Item = (f64, f64)> + use<> {
    let by_value = |(_, one): &&(f64, f64), (_, other): &&(f64, f64)| one.total_cmp(other);
    let mut ends: Vec<_> = [points.iter().min_by(by_value), points.iter().max_by(by_value)]
        .into_iter()
        .flatten()
        .copied()
        .collect();
    ends.sort_by(|(one, _), (other, _)| one.total_cmp(other));
    ends.dedup();
    ends.into_iter()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_curve_of_many_points_keeps_its_peaks_and_its_gaps() {
        let mut points: Vec<_> = (0..10_000).map(|n| (f64::from(n) / 1000.0, 0.0)).collect();
        points[1234].1 = 5.0;
        points[5000].1 = f64::MAX;
        points[7000].1 = -3.0;
        let parts = drawn_parts(&points, &(0.0..10.0), 100);
        assert_eq!(parts.len(), 2);
        assert!(parts.iter().map(Vec::len).sum::<usize>() <= 204, "{parts:?}");
        assert!(parts[0].contains(&(1.234, 5.0)) && parts[1].contains(&(7.0, -3.0)));
        assert!(parts.iter().flatten().is_sorted_by_key(|(time, _)| *time));
    }

    #[test]
    fn a_legend_shortens_texts_in_the_middle() {
        let width = |text: &str| Ok(text.chars().count() as u32);
        assert_eq!(fitting("position[head_tilt]", 19, width).unwrap(), "position[head_tilt]");
        assert_eq!(fitting("position[head_tilt]", 11, width).unwrap(), "posit…tilt]");
        assert_eq!(fitting("abc", 0, width).unwrap().chars().count(), 3);
    }

    #[test]
    fn no_two_of_forty_curves_look_the_same() {
        let strokes: Vec<_> = Stroke::all().take(40).map(|stroke| (stroke.color, stroke.dash)).collect();
        let distinct = strokes.iter().enumerate().all(|(n, stroke)| !strokes[..n].contains(stroke));
        assert!(distinct);
    }

    #[test]
    fn a_constant_has_room_above_and_below() {
        assert_eq!(range([2.0, 2.0].into_iter(), 0.05), 1.5..2.5);
        assert_eq!(range([0.0, 10.0].into_iter(), 0.1), -1.0..11.0);
        assert_eq!(range([].into_iter(), 0.1), 0.0..1.0);
    }
}
