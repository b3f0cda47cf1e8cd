//! The interactive screen and its keys.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use downbeat_executor::Snapshot;
use downbeat_robot::ChainReport;
use downbeat_robot::inspect::Client;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::layout::{Alignment, Constraint, Layout, Rect};
use ratatui::style::Style;
use ratatui::text::{Line, Text};
use ratatui::widgets::{Cell, Paragraph, Row, Table, Tabs};
use ratatui::{DefaultTerminal, Frame};

use super::graph;
use super::grid::{Grid, Sort, summary};
use super::plot::Plot;
use crate::stop::Stop;
use crate::topic_field::TopicField;

const REFRESH: Duration = Duration::from_millis(500);

/// How often curves move while they are shown.
const PLOT_REFRESH: Duration = Duration::from_millis(100);

/// Shows the robot until a key ends it, first the plot if there are fields to plot.
pub(super) fn show(mut client: Client, snapshot: Snapshot, fields: &[TopicField]) -> anyhow::Result<()> {
    let mut app = App::new(client.robot().to_string(), snapshot);
    // A robot of an earlier version measures none.
    app.chains = client.latencies().unwrap_or_default();
    for field in fields {
        app.plot.add(field).map_err(anyhow::Error::msg)?;
        app.tab = Tab::Plot;
    }
    app.plot.exchange(&mut client)?;
    if let Some(problem) = app.plot.problem() {
        bail!("{}", downbeat_msgs::printable(problem));
    }
    if !std::io::stdout().is_terminal() {
        bail!("standard output is not a terminal; --once prints a snapshot, --json all numbers");
    }
    // Before the terminal is changed, which a signal would leave as it is.
    let stop = Stop::new()?;
    let mut terminal = ratatui::try_init().context("cannot use this terminal")?;
    let outcome = show_on(&mut terminal, client, app, &stop);
    ratatui::restore();
    // A terminal that was closed is no error.
    if stop.is_due() { Ok(()) } else { outcome }
}

fn show_on(
    terminal: &mut DefaultTerminal,
    mut client: Client,
    mut app: App,
    stop: &Stop,
) -> anyhow::Result<()> {
    let mut next_update = Instant::now() + REFRESH;
    let mut next_values = Instant::now();
    while !stop.is_due() {
        terminal.draw(|frame| app.draw(frame)).context("cannot draw on the terminal")?;
        let rest = next_update.min(next_values).saturating_duration_since(Instant::now());
        if event::poll(rest).context("cannot read from the terminal")? {
            let action = match event::read().context("cannot read from the terminal")? {
                Event::Key(key) if key.kind != KeyEventKind::Release => app.press(key),
                _ => None,
            };
            match action {
                Some(Action::Quit) => return Ok(()),
                Some(Action::Pause) => client.pause()?,
                Some(Action::Resume) => client.resume()?,
                Some(Action::Step) => client.step()?,
                None => {}
            }
            if action.is_some() || app.lacks_graph() {
                next_update = Instant::now();
            }
            if app.plot.is_waiting() {
                next_values = Instant::now();
            }
        }
        if next_values <= Instant::now() {
            app.plot.exchange(&mut client)?;
            next_values = Instant::now() + if app.tab == Tab::Plot { PLOT_REFRESH } else { REFRESH };
        }
        if next_update <= Instant::now() {
            if app.tab == Tab::Graph {
                app.graph = Some(graph::lines(&client.graph()?));
            }
            app.update(client.snapshot()?);
            app.chains = client.latencies().unwrap_or_default();
            next_update = Instant::now() + REFRESH;
        }
    }
    Ok(())
}

/// The tables, the graph and the plot, one of which is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Tab {
    #[default]
    Modules,
    Topics,
    Outlets,
    /// Left out if the robot measures no chains.
    Latencies,
    Graph,
    Plot,
}

/// An action triggered by a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Action {
    Quit,
    Pause,
    Resume,
    Step,
}

/// The state of the screen.
pub(crate) struct App {
    robot: String,
    earlier: Snapshot,
    later: Snapshot,
    /// The measured chains.
    chains: Vec<ChainReport>,
    tab: Tab,
    sort: Sort,
    /// The number of rows above the first visible one.
    scrolled: usize,
    /// The lines of the graph, once they were read.
    graph: Option<Vec<String>>,
    plot: Plot,
}

impl App {
    /// Shows average rates since the robot's start until there is a second snapshot.
    pub(crate) fn new(robot: String, snapshot: Snapshot) -> Self {
        let earlier = Snapshot::default();
        let (tab, sort) = (Tab::default(), Sort::default());
        let (chains, plot) = (Vec::new(), Plot::default());
        Self { robot, earlier, later: snapshot, chains, tab, sort, scrolled: 0, graph: None, plot }
    }

    pub(crate) fn update(&mut self, snapshot: Snapshot) {
        self.earlier = std::mem::replace(&mut self.later, snapshot);
    }

    fn lacks_graph(&self) -> bool {
        self.tab == Tab::Graph && self.graph.is_none()
    }

    pub(crate) fn press(&mut self, key: KeyEvent) -> Option<Action> {
        match key.code {
            KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => return Some(Action::Quit),
            _ if self.tab == Tab::Plot && self.plot.is_choosing() => self.press_in_plot(key),
            KeyCode::Char('q') | KeyCode::Esc => return Some(Action::Quit),
            KeyCode::Char('p') if self.later.is_paused => return Some(Action::Resume),
            KeyCode::Char('p') => return Some(Action::Pause),
            KeyCode::Char('n') if self.later.is_paused => return Some(Action::Step),
            KeyCode::Char('s') => self.sort = self.sort.next(),
            KeyCode::Char('g') => self.show(if self.tab == Tab::Graph { Tab::Modules } else { Tab::Graph }),
            KeyCode::Char('v') if self.tab == Tab::Plot => self.show(Tab::Modules),
            KeyCode::Char('v') => {
                self.show(Tab::Plot);
                if self.plot.len() == 0 {
                    self.plot.choose();
                }
            }
            KeyCode::Tab => self.turn(1),
            KeyCode::BackTab => self.turn(self.tabs().len() - 1),
            _ if self.tab == Tab::Plot => self.press_in_plot(key),
            KeyCode::Down => self.scrolled = (self.scrolled + 1).min(self.rows().saturating_sub(1)),
            KeyCode::Up => self.scrolled = self.scrolled.saturating_sub(1),
            _ => {}
        }
        None
    }

    fn press_in_plot(&mut self, key: KeyEvent) {
        let Self { plot, later, .. } = self;
        plot.press(key, &topics(later), seconds(later));
    }

    fn tabs(&self) -> Vec<Tab> {
        let all = [Tab::Modules, Tab::Topics, Tab::Outlets, Tab::Latencies, Tab::Graph, Tab::Plot];
        all.into_iter().filter(|tab| *tab != Tab::Latencies || !self.chains.is_empty()).collect()
    }

    /// The position of the shown tab.
    fn selected(&self) -> usize {
        self.tabs().iter().position(|tab| *tab == self.tab).unwrap_or(0)
    }

    /// Shows the tab that follows so many tabs behind the shown one.
    fn turn(&mut self, by: usize) {
        let tabs = self.tabs();
        self.show(tabs[(self.selected() + by) % tabs.len()]);
    }

    fn show(&mut self, tab: Tab) {
        (self.tab, self.scrolled) = (tab, 0);
    }

    pub(crate) fn draw(&self, frame: &mut Frame<'_>) {
        let lines = summary(&self.robot, &self.earlier, &self.later, usize::from(frame.area().width));
        let [head, tabs, table, keys] = Layout::vertical([
            Constraint::Length(lines.len() as u16),
            Constraint::Length(1),
            Constraint::Min(1),
            Constraint::Length(1),
        ])
        .areas(frame.area());
        frame.render_widget(Text::from_iter(lines.into_iter().map(Line::from)), head);
        let Snapshot { modules, topics, outlets, .. } = &self.later;
        let title = |tab: &Tab| match tab {
            Tab::Modules => format!("modules {}", modules.len()),
            Tab::Topics => format!("topics {}", topics.len()),
            Tab::Outlets => format!("outlets {}", outlets.len()),
            Tab::Latencies => format!("latencies {}", self.chains.len()),
            Tab::Graph => "graph".to_owned(),
            Tab::Plot => format!("plot {}", self.plot.len()),
        };
        let titles: Vec<_> = self.tabs().iter().map(title).collect();
        frame.render_widget(Tabs::new(titles).select(self.selected()), tabs);
        match self.grid() {
            Some(grid) => self.draw_table(grid, frame, table),
            None if self.tab == Tab::Plot => {
                self.plot.draw(frame, table, &self::topics(&self.later), seconds(&self.later));
            }
            None => self.draw_graph(frame, table),
        }
        frame.render_widget(Paragraph::new(self.keys()).style(Style::new().dim()), keys);
    }

    fn draw_graph(&self, frame: &mut Frame<'_>, area: Rect) {
        let lines = self.graph.iter().flatten().skip(self.scrolled);
        frame.render_widget(Text::from_iter(lines.map(|line| Line::from(line.as_str()))), area);
    }

    fn draw_table(&self, grid: Grid, frame: &mut Frame<'_>, area: Rect) {
        let grid = grid.fitting(usize::from(area.width));
        let alignment = |column| if grid.is_left(column) { Alignment::Left } else { Alignment::Right };
        let cell =
            |(column, text): (usize, String)| Cell::from(Text::from(text).alignment(alignment(column)));
        let headings = grid.headings.iter().map(ToString::to_string).enumerate().map(cell);
        let header = Row::new(headings.collect::<Vec<_>>()).style(Style::new().reversed());
        let widths = grid.widths().into_iter().map(|width| Constraint::Length(width as u16));
        let rows = grid
            .rows
            .iter()
            .skip(self.scrolled)
            .map(|row| Row::new(row.iter().cloned().enumerate().map(cell).collect::<Vec<_>>()));
        let table =
            Table::new(rows.collect::<Vec<_>>(), widths).header(header).column_spacing(Grid::SPACING as u16);
        frame.render_widget(table, area);
    }

    fn keys(&self) -> String {
        let pause = if self.later.is_paused { "p resume  n next cycle" } else { "p pause" };
        match self.tab {
            Tab::Plot if self.plot.is_choosing() => self.plot.keys(),
            Tab::Plot => format!("q quit  tab table  {}  {pause}", self.plot.keys()),
            _ => {
                let sort = self.sort.name();
                format!("q quit  tab table  g graph  v plot  s sort: {sort}  {pause}  ↑↓ scroll")
            }
        }
    }

    fn rows(&self) -> usize {
        match self.tab {
            Tab::Modules => self.later.modules.len(),
            Tab::Topics => self.later.topics.len(),
            Tab::Outlets => self.later.outlets.len(),
            Tab::Latencies => self.chains.len(),
            Tab::Graph => self.graph.as_ref().map_or(0, Vec::len),
            Tab::Plot => 0,
        }
    }

    /// The table; `None` for the graph and the plot.
    fn grid(&self) -> Option<Grid> {
        let table = match self.tab {
            Tab::Modules => Grid::of_modules,
            Tab::Topics => Grid::of_topics,
            Tab::Outlets => Grid::of_outlets,
            Tab::Latencies => return Some(Grid::of_latencies(&self.chains)),
            Tab::Graph | Tab::Plot => return None,
        };
        Some(table(&self.earlier, &self.later, self.sort))
    }
}

fn topics(snapshot: &Snapshot) -> Vec<&str> {
    snapshot.topics.iter().map(|topic| &*topic.name).collect()
}

/// The time of a robot in seconds.
fn seconds(snapshot: &Snapshot) -> f64 {
    snapshot.time.as_nanos() as f64 / 1e9
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    use super::super::grid::tests::snapshot;
    use super::*;

    fn app() -> App {
        let mut app = App::new("darwin_op (process 7)".into(), snapshot(10));
        app.update(snapshot(12));
        app
    }

    /// The screen as lines of text.
    fn screen(app: &App, width: u16, height: u16) -> Vec<String> {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| app.draw(frame)).unwrap();
        let buffer = terminal.backend().buffer();
        let line = |y| (0..width).map(|x| buffer[(x, y)].symbol()).collect::<String>().trim_end().to_owned();
        (0..height).map(line).collect()
    }

    fn press(app: &mut App, code: KeyCode) -> Option<Action> {
        app.press(KeyEvent::new(code, KeyModifiers::NONE))
    }

    #[test]
    fn small_terminals_are_drawn_on() {
        for (width, height) in [(0, 0), (1, 1), (0, 5), (20, 0), (20, 5), (5, 20), (300, 2)] {
            let mut app = app();
            for key in [
                KeyCode::Char('s'),
                KeyCode::Down,
                KeyCode::Tab,
                KeyCode::Tab,
                KeyCode::Char('g'),
                KeyCode::Char('v'),
            ] {
                screen(&app, width, height);
                press(&mut app, key);
            }
            screen(&app, width, height);
        }
        let small = screen(&app(), 20, 5);
        assert!(small[0].contains("darwin_op"), "{small:#?}");
    }

    #[test]
    fn the_screen_shows_the_cycles_the_modules_and_the_keys() {
        let screen = screen(&app(), 130, 10);
        let expected_tables = Grid::of_modules(&snapshot(10), &snapshot(12), Sort::Order);
        assert_eq!(screen[..3], summary("darwin_op (process 7)", &snapshot(10), &snapshot(12), 130));
        assert!(screen[3].contains("modules 3") && screen[3].contains("topics 2"), "{screen:#?}");
        assert_eq!(screen[4..8], expected_tables.lines().collect::<Vec<_>>());
        assert_eq!(screen[9], "q quit  tab table  g graph  v plot  s sort: order  p pause  ↑↓ scroll");
    }

    #[test]
    fn keys_change_the_table_the_sort_order_and_the_scroll_position() {
        let mut app = app();
        press(&mut app, KeyCode::Char('s'));
        assert!(screen(&app, 130, 10)[5].starts_with("vision"));
        press(&mut app, KeyCode::Down);
        assert!(screen(&app, 130, 10)[5].starts_with("motion"));
        press(&mut app, KeyCode::Tab);
        let topics = screen(&app, 130, 10);
        assert!(topics[4].starts_with("TOPIC") && topics[5].starts_with("image"), "{topics:#?}");
        for _ in 0..5 {
            press(&mut app, KeyCode::Down);
        }
        assert!(screen(&app, 130, 10)[5].starts_with("joint_states"));
    }

    #[test]
    fn measured_chains_have_a_table_of_their_own() {
        let mut app = app();
        for _ in 0..3 {
            let _ = press(&mut app, KeyCode::Tab);
        }
        assert_eq!(app.tab, Tab::Graph);
        app.chains = vec![ChainReport { name: "reaction".into(), ..ChainReport::default() }];
        press(&mut app, KeyCode::BackTab);
        assert_eq!(app.tab, Tab::Latencies);
        let screen = screen(&app, 130, 12).join("\n");
        assert!(screen.contains("latencies 1") && screen.contains("reaction"), "{screen}");
    }

    #[test]
    fn the_graph_is_shown_by_its_key_and_scrolls() {
        let mut app = app();
        press(&mut app, KeyCode::Char('g'));
        assert!(app.lacks_graph(), "it is read when it is needed");
        let lines = graph::lines(&graph::tests::graph());
        app.graph = Some(lines.clone());
        assert_eq!(screen(&app, 130, 12)[4..11], lines);
        press(&mut app, KeyCode::Down);
        assert_eq!(screen(&app, 130, 12)[4..10], lines[1..]);
        press(&mut app, KeyCode::Char('g'));
        assert_eq!(app.tab, Tab::Modules);
    }

    #[test]
    fn the_plot_is_shown_by_its_key_and_its_input_line_takes_all_keys() {
        let mut app = app();
        press(&mut app, KeyCode::Char('v'));
        let lines = screen(&app, 130, 20);
        assert!(lines.iter().any(|line| line == "> joint_states"), "{lines:#?}");
        for key in "qpg".chars() {
            assert_eq!(press(&mut app, KeyCode::Char(key)), None);
        }
        assert!(screen(&app, 130, 20).iter().any(|line| line.starts_with("field: qpg")), "{lines:#?}");
        assert_eq!(press(&mut app, KeyCode::Esc), None);
        app.plot.add(&"joint_states:position[3]".parse().unwrap()).unwrap();
        let lines = screen(&app, 130, 20);
        assert!(
            lines[3].contains("plot 1") && lines[18].starts_with("> joint_states:position[3]"),
            "{lines:#?}"
        );
        let keys = "q quit  tab table  a add  d remove  ↑↓ select  w last 10 s  h hold  p pause";
        assert_eq!(lines[19], keys);
        assert_eq!(press(&mut app, KeyCode::Char('p')), Some(Action::Pause));
        press(&mut app, KeyCode::Tab);
        assert_eq!(app.tab, Tab::Modules);
        assert_eq!(app.plot.len(), 1, "it goes on");
    }

    #[test]
    fn a_robot_is_paused_stepped_and_resumed() {
        let mut app = app();
        assert_eq!(press(&mut app, KeyCode::Char('n')), None);
        assert_eq!(press(&mut app, KeyCode::Char('p')), Some(Action::Pause));
        app.update(Snapshot { is_paused: true, ..snapshot(13) });
        assert!(screen(&app, 130, 10)[0].contains("paused"));
        assert_eq!(press(&mut app, KeyCode::Char('n')), Some(Action::Step));
        assert_eq!(press(&mut app, KeyCode::Char('p')), Some(Action::Resume));
        let interrupt = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
        assert_eq!(app.press(interrupt), Some(Action::Quit));
    }

    #[test]
    fn a_narrow_terminal_shows_fewer_columns_and_every_figure_whole() {
        for width in [60, 80, 100] {
            let mut app = app();
            for _ in 0..2 {
                let Some(grid) = app.grid() else { continue };
                let screen = screen(&app, width, 14);
                let head = screen.iter().position(|line| line.contains("modules 3")).unwrap();
                let whole = summary("darwin_op (process 7)", &snapshot(10), &snapshot(12), usize::MAX);
                assert_eq!(screen[..head].join("   "), whole.join("   "));
                let shown: Vec<_> =
                    screen[head + 1].split("  ").filter(|heading| !heading.is_empty()).collect();
                let is_all = shown.len() == grid.headings.len();
                assert!(shown.len() > 2 && (!is_all || app.tab == Tab::Topics), "{screen:#?}");
                for (row, line) in grid.rows.iter().zip(&screen[head + 2..]) {
                    let whole: Vec<_> = (0..row.len())
                        .filter(|column| shown.iter().any(|shown| shown.trim() == grid.headings[*column]))
                        .map(|column| row[column].as_str())
                        .collect();
                    let cells: Vec<_> =
                        line.split("  ").map(str::trim).filter(|cell| !cell.is_empty()).collect();
                    assert_eq!(cells, whole, "{screen:#?}");
                }
                press(&mut app, KeyCode::Tab);
            }
        }
    }

    #[test]
    fn a_terminal_too_small_shows_what_fits() {
        for (width, height) in [(1, 1), (20, 3), (40, 5)] {
            assert_eq!(screen(&app(), width, height).len(), usize::from(height));
        }
    }
}
