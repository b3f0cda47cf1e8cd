//! Curves over time, drawn as SVG or PNG.

use std::fs::File;
use std::io::BufWriter;
use std::ops::Range;
use std::path::Path;

use anyhow::{Context, anyhow, bail};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::register_font;

/// The family of what is written: in SVG the viewer's own, in PNG the font below.
const FONT: &str = "sans-serif";

/// What is drawn.
pub(crate) struct Chart {
    pub(crate) title: String,
    /// Width and height in pixels.
    pub(crate) size: (u32, u32),
    pub(crate) curves: Vec<Curve>,
}

/// A curve: seconds, and values.
pub(crate) struct Curve {
    pub(crate) name: String,
    pub(crate) points: Vec<(f64, f64)>,
}

impl Chart {
    /// Draws it into a file, by whose ending it becomes SVG or PNG.
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
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
    }

    fn write_png(&self, path: &Path) -> anyhow::Result<()> {
        const BYTES_PER_PIXEL: usize = 3;
        let (width, height) = self.size;
        let mut pixels = vec![0; width as usize * height as usize * BYTES_PER_PIXEL];
        self.draw(&BitMapBackend::with_buffer(&mut pixels, self.size).into_drawing_area())?;
        let file = File::create(path).with_context(|| format!("cannot write {}", path.display()))?;
        let mut encoder = png::Encoder::new(BufWriter::new(file), width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.write_header()?.write_image_data(&pixels)?;
        Ok(())
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> anyhow::Result<()>
    where
        B::ErrorType: 'static,
    {
        let all = || self.curves.iter().flat_map(|curve| &curve.points).filter(|(_, y)| is_drawn(*y));
        let times = range(all().map(|(x, _)| *x), 0.0);
        let values = range(all().map(|(_, y)| *y), 0.05);
        area.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(area)
            .caption(&self.title, (FONT, 20))
            .margin(12)
            .x_label_area_size(40)
            .y_label_area_size(80)
            .build_cartesian_2d(times.clone(), values)?;
        chart.configure_mesh().x_desc("seconds since the beginning of the bag").draw()?;
        for (index, curve) in self.curves.iter().enumerate() {
            let color = Palette99::pick(index).to_rgba();
            chart
                .draw_series(LineSeries::new([], color))?
                .label(&curve.name)
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 20, y)], color));
            for part in drawn_parts(&curve.points, &times, self.size.0) {
                // A line of one point would not be seen.
                match part[..] {
                    [point] => chart.draw_series([Circle::new(point, 2, color.filled())])?,
                    _ => chart.draw_series(LineSeries::new(part, color))?,
                };
            }
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK)
            .draw()?;
        area.present()?;
        Ok(())
    }
}

/// Numbers that are none, and those that stand for none, are gaps.
fn is_drawn(value: f64) -> bool {
    value.abs() < 1e300
}

/// From the least to the greatest, and by so much of their distance further at both ends.
fn range(values: impl Iterator<Item = f64>, margin: f64) -> Range<f64> {
    let (low, high) =
        values.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return 0.0..1.0;
    }
    let width = high - low;
    if width > 0.0 { low - margin * width..high + margin * width } else { low - 0.5..low + 0.5 }
}

/// The parts of a curve between values that are no numbers, with at most two points for each pixel of the width: the
/// least and the greatest value there.
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

/// The least and the greatest value, in the order of their times; one point if there is one.
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
    fn a_constant_has_room_above_and_below() {
        assert_eq!(range([2.0, 2.0].into_iter(), 0.05), 1.5..2.5);
        assert_eq!(range([0.0, 10.0].into_iter(), 0.1), -1.0..11.0);
        assert_eq!(range([].into_iter(), 0.1), 0.0..1.0);
    }
}
