//! The tab that plots fields of topics while the robot runs.

use std::collections::BTreeMap;

use ratatui::Frame;
use ratatui::crossterm::event::{KeyCode, KeyEvent};
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Text};
use ratatui::widgets::{Axis, Chart, Dataset, GraphType};

use super::choose::{Chooser, Chosen};
use crate::topic_field::TopicField;
use downbeat_msgs::printable;
use downbeat_robot::inspect::{Client, ClientError, TopicValues};
use downbeat_robot::table::MOST_POINTS;

/// One for each curve.
const COLORS: [Color; 6] =
    [Color::Cyan, Color::Yellow, Color::Magenta, Color::Green, Color::Red, Color::Blue];

/// How much of the past is shown, in seconds.
const WINDOWS: [u32; 3] = [10, 30, 60];

/// The chosen fields, their values of the last minute, and how they are shown.
#[derive(Default)]
pub(super) struct Plot {
    curves: Vec<Curve>,
    selected: usize,
    window: usize,
    /// The right end of the time axis while the plot is held.
    held: Option<f64>,
    chooser: Option<Chooser>,
    problem: Option<String>,
    /// Messages that the robot dropped before they were read.
    missed: u64,
    /// What the robot was asked to watch.
    watched: BTreeMap<String, Vec<String>>,
}

struct Curve {
    of: TopicField,
    color: Color,
    /// Times in seconds, ascending, and values.
    points: Vec<(f64, f64)>,
    /// The points at the moment since which the plot is held.
    held: Vec<(f64, f64)>,
    problem: Option<String>,
}

/// A request by which the robot watches what is plotted.
#[derive(Debug, PartialEq, Eq)]
enum Change {
    Watch(String, Vec<String>),
    Unwatch(String),
}

impl Plot {
    /// Adds a field.
    ///
    /// # Errors
    /// Returns a message if there are too many.
    pub(super) fn add(&mut self, field: &TopicField) -> Result<(), String> {
        let topic = field.topic.trim_start_matches('/').to_owned();
        let of = TopicField { topic, field: field.field.clone() };
        if let Some(known) = self.curves.iter().position(|curve| curve.of == of) {
            self.selected = known;
            return Ok(());
        }
        let is_free = |color: &&Color| self.curves.iter().all(|curve| curve.color != **color);
        let Some(&color) = COLORS.iter().find(is_free) else {
            return Err(format!("at most {} fields can be plotted: remove one first", COLORS.len()));
        };
        self.selected = self.curves.len();
        self.curves.push(Curve { of, color, points: Vec::new(), held: Vec::new(), problem: None });
        Ok(())
    }

    pub(super) fn len(&self) -> usize {
        self.curves.len()
    }

    /// The problem of the last request, if there was one.
    pub(super) fn problem(&self) -> Option<&str> {
        self.problem.as_deref()
    }

    /// True if all keys belong to the input line.
    pub(super) fn is_choosing(&self) -> bool {
        self.chooser.is_some()
    }

    pub(super) fn choose(&mut self) {
        (self.chooser, self.problem) = (Some(Chooser::default()), None);
    }

    /// Takes a key of this tab; `topics` are those of the robot, `now` its time in seconds.
    pub(super) fn press(&mut self, key: KeyEvent, topics: &[&str], now: f64) {
        if let Some(chooser) = &mut self.chooser {
            match chooser.press(key, topics) {
                None => {}
                Some(Chosen::Nothing) => self.chooser = None,
                Some(Chosen::Field(field)) => {
                    self.chooser = None;
                    self.problem = self.add(&field).err();
                }
            }
            return;
        }
        match key.code {
            KeyCode::Char('a') => self.choose(),
            KeyCode::Char('d') | KeyCode::Delete if self.selected < self.curves.len() => {
                self.curves.remove(self.selected);
                self.selected = self.selected.min(self.curves.len().saturating_sub(1));
            }
            KeyCode::Char('w') => self.window = (self.window + 1) % WINDOWS.len(),
            KeyCode::Char('h' | ' ') => self.hold_or_continue(now),
            KeyCode::Down => self.selected = (self.selected + 1).min(self.curves.len().saturating_sub(1)),
            KeyCode::Up => self.selected = self.selected.saturating_sub(1),
            _ => {}
        }
    }

    fn hold_or_continue(&mut self, now: f64) {
        self.held = match self.held {
            Some(_) => None,
            None => {
                self.curves.iter_mut().for_each(|curve| curve.held.clone_from(&curve.points));
                Some(self.end(now))
            }
        };
    }

    /// Asks the robot to watch what is plotted, and takes the new values.
    ///
    /// # Errors
    /// Returns an error if the robot has ended. What it refuses is shown instead.
    pub(super) fn exchange(&mut self, client: &mut Client) -> Result<(), ClientError> {
        while let Some(change) = self.change() {
            let answer = match &change {
                Change::Watch(topic, fields) => client.watch(topic, fields),
                Change::Unwatch(topic) => client.unwatch(topic),
            };
            match answer {
                Ok(()) => self.accept(change),
                Err(ClientError::Refused { refusal, .. }) => self.refuse(change, refusal),
                Err(error) => return Err(error),
            }
        }
        if let Some(chooser) = self.chooser.as_mut().filter(|chooser| chooser.lacks_numbers())
            && let Some(topic) = chooser.topic()
        {
            match client.numbers(topic) {
                Ok(numbers) => chooser.set_numbers(numbers),
                Err(ClientError::Refused { refusal, .. }) => chooser.refuse(refusal),
                Err(error) => return Err(error),
            }
        }
        if !self.watched.is_empty() {
            client.values()?.into_iter().for_each(|values| self.take(values));
        }
        Ok(())
    }

    /// True if the robot has to be asked before the next values are due.
    pub(super) fn is_waiting(&self) -> bool {
        self.change().is_some()
    }

    /// The next request, until the robot watches what is plotted, and the topic of which a field is being
    /// chosen.
    fn change(&self) -> Option<Change> {
        let mut wanted: BTreeMap<&str, Vec<String>> = BTreeMap::new();
        for TopicField { topic, field } in self.curves.iter().map(|curve| &curve.of) {
            wanted.entry(topic).or_default().push(field.clone());
        }
        if let Some(topic) = self.chooser.as_ref().and_then(Chooser::topic) {
            wanted.entry(topic).or_default();
        }
        let gone = self.watched.keys().find(|topic| !wanted.contains_key(topic.as_str()));
        if let Some(topic) = gone {
            return Some(Change::Unwatch(topic.clone()));
        }
        let mut wanted = wanted.into_iter();
        let (topic, fields) = wanted.find(|(topic, fields)| self.watched.get(*topic) != Some(fields))?;
        Some(Change::Watch(topic.to_owned(), fields))
    }

    fn accept(&mut self, change: Change) {
        match change {
            Change::Watch(topic, fields) => drop(self.watched.insert(topic, fields)),
            Change::Unwatch(topic) => drop(self.watched.remove(&topic)),
        }
    }

    /// Removes what the robot does not watch.
    fn refuse(&mut self, change: Change, refusal: String) {
        let Change::Watch(topic, _) = change else { return self.accept(change) };
        let watched = self.watched.get(&topic);
        self.curves.retain(|curve| {
            curve.of.topic != topic || watched.is_some_and(|fields| fields.contains(&curve.of.field))
        });
        self.selected = self.selected.min(self.curves.len().saturating_sub(1));
        match self.chooser.as_mut().filter(|chooser| chooser.topic() == Some(&topic)) {
            Some(chooser) => chooser.refuse(refusal),
            None => self.problem = Some(refusal),
        }
    }

    fn take(&mut self, values: TopicValues) {
        self.missed += values.missed;
        for field in values.fields {
            let is_it = |curve: &Curve| curve.of.topic == values.topic && curve.of.field == field.field;
            let Some(index) = self.curves.iter().position(is_it) else { continue };
            for point in field.series.times.into_iter().zip(field.series.values) {
                let is_back = self.curves[index].points.last().is_some_and(|(time, _)| *time > point.0);
                if is_back {
                    // The time of the robot was set back: what is known is no longer past.
                    self.curves.iter_mut().for_each(|curve| curve.points.clear());
                }
                self.curves[index].points.push(point);
            }
            let curve = &mut self.curves[index];
            curve.problem = field.problem;
            let start = curve.points.last().map_or(0.0, |(time, _)| time - f64::from(WINDOWS[2]));
            let old = curve.points.partition_point(|(time, _)| *time < start);
            curve.points.drain(..old.max(curve.points.len().saturating_sub(MOST_POINTS)));
        }
    }

    /// The right end of the time axis.
    fn end(&self, now: f64) -> f64 {
        let last = |curve: &Curve| curve.points.last().map(|(time, _)| *time);
        self.held.unwrap_or_else(|| self.curves.iter().filter_map(last).fold(now, f64::max))
    }

    pub(super) fn keys(&self) -> String {
        if self.is_choosing() {
            return "esc cancel  enter select  tab complete  ↑↓ choose".to_owned();
        }
        let hold = if self.held.is_some() { "h continue" } else { "h hold" };
        format!("a add  d remove  ↑↓ select  w last {} s  {hold}", WINDOWS[self.window])
    }

    pub(super) fn draw(&self, frame: &mut Frame<'_>, area: Rect, topics: &[&str], now: f64) {
        let chooser = self.chooser.as_ref().map(|chooser| {
            // Two thirds stay for the curves.
            chooser.lines(topics, usize::from(area.height / 3).max(2))
        });
        let notes: Vec<_> = self.problem.iter().map(|problem| printable(problem).into_owned()).collect();
        let legend = self.legend();
        let [chart, list, note, input] = Layout::vertical([
            Constraint::Min(0),
            Constraint::Length(legend.len() as u16),
            Constraint::Length(notes.len() as u16),
            Constraint::Length(chooser.as_ref().map_or(0, Vec::len) as u16),
        ])
        .areas(area);
        if self.curves.is_empty() {
            frame.render_widget(Text::raw("no field is plotted: press a and select one"), chart);
        } else {
            self.draw_chart(frame, chart, now);
        }
        frame.render_widget(Text::from_iter(legend), list);
        frame.render_widget(Text::from_iter(notes).style(Style::new().fg(Color::Red)), note);
        frame.render_widget(Text::from_iter(chooser.into_iter().flatten()), input);
    }

    fn draw_chart(&self, frame: &mut Frame<'_>, area: Rect, now: f64) {
        let (window, end) = (f64::from(WINDOWS[self.window]), self.end(now));
        let shown: Vec<Vec<(f64, f64)>> = self.curves.iter().map(|curve| self.shown(curve, end)).collect();
        let [low, high] = range(shown.iter().flatten().map(|(_, value)| *value));
        let datasets = self.curves.iter().zip(&shown).map(|(curve, points)| {
            Dataset::default()
                .marker(Marker::Braille)
                .graph_type(GraphType::Line)
                .style(Style::new().fg(curve.color))
                .data(points)
        });
        let values = [low, f64::midpoint(low, high), high].map(|value| short(value, high - low));
        let times = [format!("-{window} s"), format!("-{} s", window / 2.0), "0 s".to_owned()];
        let chart = Chart::new(datasets.collect())
            .x_axis(Axis::default().bounds([-window, 0.0]).labels(times))
            .y_axis(Axis::default().bounds([low, high]).labels(values));
        frame.render_widget(chart, area);
    }

    /// The points of a curve in the window, with times relative to its end.
    fn shown(&self, curve: &Curve, end: f64) -> Vec<(f64, f64)> {
        let points = if self.held.is_some() { &curve.held } else { &curve.points };
        let start = end - f64::from(WINDOWS[self.window]);
        let first = points.partition_point(|(time, _)| *time < start);
        points[first..].iter().map(|(time, value)| (time - end, *value)).collect()
    }

    /// A line for each curve with its latest value, or the reason why there is none.
    fn legend(&self) -> Vec<Line<'static>> {
        let line = |(index, curve): (usize, &Curve)| {
            let mark = if index == self.selected { '>' } else { ' ' };
            let name = curve.of.to_string();
            let points = if self.held.is_some() { &curve.held } else { &curve.points };
            let state = match (&curve.problem, points.last()) {
                (Some(problem), _) => problem.clone(),
                (None, Some((_, value))) => short(*value, value.abs() / 10.0),
                (None, None) => "no message yet".to_owned(),
            };
            let text = printable(&format!("{mark} {name}  {state}")).into_owned();
            Line::styled(text, Style::new().fg(curve.color))
        };
        let mut lines: Vec<_> = self.curves.iter().enumerate().map(line).collect();
        if self.missed > 0 {
            lines.push(Line::raw(format!("{} messages missed: too many to read", self.missed)));
        }
        lines
    }
}

/// The limits of the value axis. Their difference is a finite number, so values beyond 1e300 may be outside.
fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let values = values.map(|value| value.clamp(-1e300, 1e300));
    let [low, high] = values
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)]);
    if low > high {
        return [0.0, 1.0];
    }
    let margin = match high - low {
        // Beside a large constant, 0.5 alone would vanish.
        0.0 => low.abs().mul_add(0.1, 0.5),
        spread => spread * 0.05,
    };
    [low - margin, high + margin]
}

/// A number with as many digits as tell numbers apart that are a part of `range` away from each other.
fn short(value: f64, range: f64) -> String {
    if value.abs() >= 1e7 || (value != 0.0 && range < 1e-7) {
        return format!("{value:.3e}");
    }
    #[allow(clippy::disallowed_methods)] // for eyes only
    let digits = if range > 0.0 { (2.0 - range.log10().floor()).clamp(0.0, 8.0) as usize } else { 0 };
    let text = format!("{value:.digits$}");
    // Rounded to nothing.
    if text.trim_start_matches(['-', '0', '.']).is_empty() { text.replace('-', "") } else { text }
}

#[cfg(test)]
pub(super) mod tests {
    #![allow(clippy::unwrap_used)]

    use ratatui::Terminal;
    use ratatui::backend::TestBackend;
    use ratatui::crossterm::event::KeyModifiers;

    use super::*;
    use downbeat_robot::inspect::FieldValues;
    use downbeat_robot::table::{NumberField, Series};

    const TOPICS: [&str; 3] = ["joint_states", "imu/data", "image"];

    pub(in super::super) fn press(plot: &mut Plot, code: KeyCode) {
        plot.press(KeyEvent::new(code, KeyModifiers::NONE), &TOPICS, 0.0);
    }

    fn write(plot: &mut Plot, text: &str) {
        text.chars().for_each(|char| press(plot, KeyCode::Char(char)));
    }

    fn plot(fields: &[&str]) -> Plot {
        let mut plot = Plot::default();
        fields.iter().for_each(|field| plot.add(&field.parse().unwrap()).unwrap());
        settle(&mut plot);
        plot
    }

    /// Answers all requests as a robot does that has everything.
    fn settle(plot: &mut Plot) -> Vec<Change> {
        let mut changes = Vec::new();
        while let Some(change) = plot.change() {
            changes.push(plot.change().unwrap());
            plot.accept(change);
        }
        changes
    }

    fn values(topic: &str, field: &str, points: &[(f64, f64)]) -> TopicValues {
        let (times, values) = points.iter().copied().unzip();
        let series = Series { times, values };
        let field = FieldValues { field: field.to_owned(), series, problem: None };
        TopicValues { topic: topic.to_owned(), missed: 0, fields: vec![field] }
    }

    fn screen(plot: &Plot, width: u16, height: u16, now: f64) -> Vec<String> {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| plot.draw(frame, frame.area(), &TOPICS, now)).unwrap();
        let buffer = terminal.backend().buffer();
        let line = |y| (0..width).map(|x| buffer[(x, y)].symbol()).collect::<String>().trim_end().to_owned();
        (0..height).map(line).collect()
    }

    /// The columns of the screen with braille dots.
    fn drawn(screen: &[String]) -> Vec<usize> {
        let is_dot = |char: &char| ('\u{2801}'..='\u{28ff}').contains(char);
        let columns = screen.iter().flat_map(|line| line.chars().enumerate());
        let mut columns: Vec<_> =
            columns.filter(|(_, char)| is_dot(char)).map(|(column, _)| column).collect();
        columns.sort_unstable();
        columns.dedup();
        columns
    }

    #[test]
    fn a_curve_is_drawn_over_the_window_with_its_range_and_its_latest_value() {
        let mut plot = plot(&["joint_states:position[3]"]);
        assert_eq!(screen(&plot, 60, 12, 100.0)[11], "> joint_states:position[3]  no message yet");
        let ramp: Vec<_> = (0..=50).map(|n| (95.0 + f64::from(n) * 0.1, f64::from(n) * 0.1)).collect();
        plot.take(values("joint_states", "position[3]", &ramp));
        let lines = screen(&plot, 60, 12, 99.0);
        assert!(lines[0].contains("5.25") && lines[8].contains("-0.25"), "{lines:#?}");
        assert!(lines[10].contains("-10 s") && lines[10].contains("-5 s"), "{lines:#?}");
        assert!(lines[11].starts_with("> joint_states:position[3]  5.000"), "{lines:#?}");
        // Five of ten seconds: the right half, as the newest value is at the right end.
        let columns = drawn(&lines);
        assert!(columns[0] >= 30 && columns[0] <= 36 && *columns.last().unwrap() == 59, "{lines:#?}");
        press(&mut plot, KeyCode::Char('w'));
        let wide = drawn(&screen(&plot, 60, 12, 99.0));
        assert!(wide[0] > 45, "five of thirty seconds: {wide:?}");
    }

    #[test]
    fn a_held_plot_stays_and_continues_with_what_has_come() {
        let mut plot = plot(&["a:x"]);
        plot.take(values("a", "x", &[(1.0, 1.0), (2.0, 2.0)]));
        press(&mut plot, KeyCode::Char('h'));
        let held = screen(&plot, 40, 10, 2.0);
        plot.take(values("a", "x", &[(3.0, 300.0)]));
        assert_eq!(screen(&plot, 40, 10, 3.0), held);
        assert!(plot.keys().contains("h continue"));
        press(&mut plot, KeyCode::Char('h'));
        assert!(screen(&plot, 40, 10, 3.0)[9].contains("300"));
    }

    #[test]
    fn curves_are_removed_and_their_colors_used_again() {
        let mut plot = plot(&["a:x", "a:y", "b:x"]);
        press(&mut plot, KeyCode::Up);
        press(&mut plot, KeyCode::Char('d'));
        let left: Vec<_> = plot.curves.iter().map(|curve| (curve.of.to_string(), curve.color)).collect();
        assert_eq!(left, [("a:x".to_owned(), COLORS[0]), ("b:x".to_owned(), COLORS[2])]);
        assert_eq!(settle(&mut plot), [Change::Watch("a".into(), vec!["x".into()])]);
        plot.add(&"/b:x".parse().unwrap()).unwrap();
        assert_eq!(plot.len(), 2, "it is plotted already");
        plot.add(&"c:x".parse().unwrap()).unwrap();
        assert_eq!(plot.curves[2].color, COLORS[1]);
        for field in ["d:x", "e:x", "f:x"] {
            plot.add(&field.parse().unwrap()).unwrap();
        }
        assert!(plot.add(&"g:x".parse().unwrap()).unwrap_err().contains("at most 6"));
        while plot.len() > 0 {
            press(&mut plot, KeyCode::Char('d'));
        }
        press(&mut plot, KeyCode::Char('d'));
        settle(&mut plot);
        assert!(plot.watched.is_empty(), "the robot reads nothing any more");
    }

    #[test]
    fn a_field_is_chosen_by_topic_and_then_among_the_numbers_of_a_message() {
        let mut plot = Plot::default();
        press(&mut plot, KeyCode::Char('a'));
        write(&mut plot, "im");
        let lines = screen(&plot, 60, 18, 0.0);
        assert!(lines.iter().any(|line| line == "> imu/data") && lines.iter().any(|line| line == "  image"));
        assert!(!lines.iter().any(|line| line.contains("joint_states")), "{lines:#?}");
        press(&mut plot, KeyCode::Enter);
        assert_eq!(settle(&mut plot), [Change::Watch("imu/data".into(), vec![])]);
        assert!(screen(&plot, 60, 18, 0.0).iter().any(|line| line.contains("waiting for a message")));
        let numbers = ["angular_velocity.x", "angular_velocity.y"];
        let numbers = numbers.map(|field| NumberField { field: field.to_owned(), element: None });
        plot.chooser.as_mut().unwrap().set_numbers(Some(numbers.to_vec()));
        press(&mut plot, KeyCode::Down);
        assert!(screen(&plot, 60, 18, 0.0).iter().any(|line| line == "> angular_velocity.y"));
        press(&mut plot, KeyCode::Enter);
        assert!(!plot.is_choosing());
        let expected = Change::Watch("imu/data".into(), vec!["angular_velocity.y".into()]);
        assert_eq!(settle(&mut plot), [expected]);
    }

    #[test]
    fn a_canceled_choice_watches_nothing() {
        let mut plot = Plot::default();
        press(&mut plot, KeyCode::Char('a'));
        write(&mut plot, "image:");
        assert_eq!(settle(&mut plot), [Change::Watch("image".into(), vec![])]);
        press(&mut plot, KeyCode::Esc);
        assert_eq!(settle(&mut plot), [Change::Unwatch("image".into())]);
    }

    #[test]
    fn a_refused_field_is_removed_and_the_reason_shown() {
        let mut plot = plot(&["a:x"]);
        plot.add(&"a:z".parse().unwrap()).unwrap();
        let change = plot.change().unwrap();
        plot.refuse(change, "a has no number at z: a/msg/A has no field `z`".into());
        assert_eq!((plot.len(), plot.change()), (1, None));
        let lines = screen(&plot, 60, 12, 0.0);
        assert!(lines[11].contains("a has no number at z") && lines[10].starts_with("> a:x"), "{lines:#?}");
    }

    #[test]
    fn only_the_last_minute_is_kept_and_a_time_that_was_set_back_starts_again() {
        let mut plot = plot(&["a:x"]);
        let times: Vec<_> = (0..200).map(|second| (f64::from(second), 1.0)).collect();
        plot.take(values("a", "x", &times));
        assert_eq!(plot.curves[0].points.first().unwrap().0, 139.0);
        plot.take(values("a", "x", &[(5.0, 2.0)]));
        assert_eq!(plot.curves[0].points, [(5.0, 2.0)]);
    }

    #[test]
    fn any_values_fit_on_the_axis_and_any_terminal_shows_what_fits() {
        for extremes in [[0.0, 0.0], [1e300, 1e300], [f64::MIN, f64::MAX], [-1e-300, 1e-300], [5e7, 5e7]] {
            let [low, high] = range(extremes.into_iter());
            assert!(low < high && (high - low).is_finite(), "{extremes:?}: {low} {high}");
            let mut plot = plot(&["a:x", "b:y"]);
            plot.take(values("a", "x", &[(1.0, extremes[0]), (2.0, extremes[1])]));
            press(&mut plot, KeyCode::Char('a'));
            for (width, height) in [(1, 1), (20, 3), (40, 5), (200, 60)] {
                assert_eq!(screen(&plot, width, height, 2.0).len(), usize::from(height));
            }
        }
    }

    #[test]
    fn numbers_are_short() {
        let texts = [(0.1234, 1.0), (-0.0001, 1.0), (1234.5, 100.0), (2e9, 1e8), (0.0, 0.0), (3e-9, 1e-9)];
        let texts = texts.map(|(value, range)| short(value, range));
        assert_eq!(texts, ["0.12", "0.00", "1234", "2.000e9", "0", "3.000e-9"]);
    }
}
