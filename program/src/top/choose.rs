//! The input line that selects a field, with the topics and numbers that match it.

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use ratatui::style::{Style, Stylize};
use ratatui::text::Line;

use crate::topic_field::TopicField;
use downbeat_msgs::printable;
use downbeat_robot::table::NumberField;

/// An input line `TOPIC:FIELD`. Before the colon, topics are listed; after it, the numbers of the topic's
/// latest message.
#[derive(Default)]
pub(super) struct Chooser {
    text: String,
    /// The marked line of the list.
    marked: usize,
    /// The numbers of the topic, once it had a message.
    numbers: Vec<NumberField>,
    /// Why the topic cannot be watched.
    refusal: Option<String>,
}

/// How the choice ended.
pub(super) enum Chosen {
    Field(TopicField),
    Nothing,
}

impl Chooser {
    /// The topic, once it is chosen, unless it cannot be watched.
    pub(super) fn topic(&self) -> Option<&str> {
        let (topic, _) = self.text.split_once(':').filter(|_| self.refusal.is_none())?;
        Some(topic.trim_start_matches('/'))
    }

    /// True if the numbers of the topic have to be requested.
    pub(super) fn lacks_numbers(&self) -> bool {
        self.topic().is_some() && self.numbers.is_empty()
    }

    pub(super) fn set_numbers(&mut self, numbers: Option<Vec<NumberField>>) {
        self.numbers = numbers.unwrap_or_default();
    }

    pub(super) fn refuse(&mut self, refusal: String) {
        self.refusal = Some(refusal);
    }

    /// Takes a key. Returns the result when the choice is over.
    pub(super) fn press(&mut self, key: KeyEvent, topics: &[&str]) -> Option<Chosen> {
        let marked = self.candidates(topics).into_iter().nth(self.marked);
        match key.code {
            KeyCode::Esc => return Some(Chosen::Nothing),
            KeyCode::Down => {
                self.marked = (self.marked + 1).min(self.candidates(topics).len().saturating_sub(1))
            }
            KeyCode::Up => self.marked = self.marked.saturating_sub(1),
            KeyCode::Backspace => {
                let mut text = self.text.clone();
                text.pop();
                self.change(text);
            }
            KeyCode::Tab => {
                if let Some(marked) = marked {
                    self.change(marked.text);
                }
            }
            KeyCode::Enter => {
                // A field that is not listed may come with a later message.
                let text = marked.map_or_else(|| self.text.clone(), |marked| marked.text);
                match text.parse() {
                    Ok(field) => return Some(Chosen::Field(field)),
                    Err(_) => self.change(text),
                }
            }
            KeyCode::Char(char) if !key.modifiers.intersects(KeyModifiers::CONTROL | KeyModifiers::ALT) => {
                self.change(format!("{}{char}", self.text));
            }
            _ => {}
        }
        None
    }

    fn change(&mut self, text: String) {
        let topic = |text: &str| text.split_once(':').map(|(topic, _)| topic.to_owned());
        if topic(&text) != topic(&self.text) {
            self.numbers.clear();
            self.refusal = None;
        }
        (self.text, self.marked) = (text, 0);
    }

    fn candidates(&self, topics: &[&str]) -> Vec<Candidate> {
        let contains = |text: &str, wanted: &str| text.to_lowercase().contains(&wanted.to_lowercase());
        let Some((topic, field)) = self.text.split_once(':') else {
            let matching = topics.iter().filter(|topic| contains(topic, self.text.trim_start_matches('/')));
            return matching
                .map(|topic| Candidate { text: format!("{topic}:"), shown: (*topic).to_owned() })
                .collect();
        };
        let candidate = |number: &NumberField| {
            let shown = match &number.element {
                Some(element) => format!("{}  {element}", number.field),
                None => number.field.clone(),
            };
            contains(&shown, field).then(|| Candidate { text: format!("{topic}:{}", number.field), shown })
        };
        self.numbers.iter().filter_map(candidate).collect()
    }

    /// The input line, and the part of the list with the marked line, `most` lines in all.
    pub(super) fn lines(&self, topics: &[&str], most: usize) -> Vec<Line<'static>> {
        let input = format!("field: {}▏", printable(&self.text));
        let mut lines = vec![Line::raw(input).bold()];
        let candidates = self.candidates(topics);
        let room = most.saturating_sub(1).max(1);
        if candidates.is_empty() {
            let note = match &self.refusal {
                Some(refusal) => printable(refusal).into_owned(),
                None if self.lacks_numbers() => "waiting for a message with numbers".to_owned(),
                None => "nothing matches".to_owned(),
            };
            lines.push(Line::raw(note).dim());
        }
        let first = (self.marked + 1).saturating_sub(room);
        for (index, candidate) in candidates.iter().enumerate().skip(first).take(room) {
            let is_marked = index == self.marked;
            let text = format!("{} {}", if is_marked { '>' } else { ' ' }, printable(&candidate.shown));
            lines.push(Line::styled(text, if is_marked { Style::new().reversed() } else { Style::new() }));
        }
        lines
    }
}

/// A line of the list.
struct Candidate {
    /// The input line that it completes.
    text: String,
    shown: String,
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    const TOPICS: [&str; 2] = ["joint_states", "joint_commands"];

    fn press(chooser: &mut Chooser, code: KeyCode) -> Option<Chosen> {
        chooser.press(KeyEvent::new(code, KeyModifiers::NONE), &TOPICS)
    }

    fn write(chooser: &mut Chooser, text: &str) {
        text.chars().for_each(|char| drop(press(chooser, KeyCode::Char(char))));
    }

    fn positions(count: usize) -> Vec<NumberField> {
        let number = |index| NumberField {
            field: format!("position[{index}]"),
            element: Some(format!("joint_{}", index + 100)),
        };
        (0..count).map(number).collect()
    }

    fn text(chooser: &Chooser, most: usize) -> Vec<String> {
        chooser.lines(&TOPICS, most).iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_key_completes_the_line_and_backspace_returns_to_the_topics() {
        let mut chooser = Chooser::default();
        write(&mut chooser, "COMM");
        assert_eq!(text(&chooser, 9), ["field: COMM▏", "> joint_commands"]);
        press(&mut chooser, KeyCode::Tab);
        assert_eq!((chooser.text.as_str(), chooser.topic()), ("joint_commands:", Some("joint_commands")));
        chooser.set_numbers(Some(positions(3)));
        press(&mut chooser, KeyCode::Tab);
        assert_eq!(chooser.text, "joint_commands:position[0]");
        for _ in 0.."position[0]:".len() {
            press(&mut chooser, KeyCode::Backspace);
        }
        assert_eq!(chooser.topic(), None);
        assert!(chooser.numbers.is_empty(), "they are of that topic");
        assert_eq!(text(&chooser, 9)[1], "> joint_commands");
    }

    #[test]
    fn an_element_is_found_by_its_name() {
        let mut chooser = Chooser::default();
        write(&mut chooser, "joint_states:");
        chooser.set_numbers(Some(positions(20)));
        write(&mut chooser, "joint_107");
        assert_eq!(text(&chooser, 9)[1..], ["> position[7]  joint_107"]);
        let Some(Chosen::Field(field)) = press(&mut chooser, KeyCode::Enter) else { panic!("not chosen") };
        assert_eq!(field.to_string(), "joint_states:position[7]");
    }

    #[test]
    fn a_field_can_be_written_before_there_is_a_message() {
        let mut chooser = Chooser::default();
        write(&mut chooser, "joint_states:position[head_tilt]");
        let Some(Chosen::Field(field)) = press(&mut chooser, KeyCode::Enter) else { panic!("not chosen") };
        assert_eq!(field, "joint_states:position[head_tilt]".parse().unwrap());
    }

    #[test]
    fn the_list_scrolls_to_the_marked_line() {
        let mut chooser = Chooser::default();
        write(&mut chooser, "joint_states:");
        chooser.set_numbers(Some(positions(20)));
        (0..30).for_each(|_| drop(press(&mut chooser, KeyCode::Down)));
        assert_eq!(text(&chooser, 3)[1..], ["  position[18]  joint_118", "> position[19]  joint_119"]);
    }

    #[test]
    fn a_refused_topic_is_not_asked_again_until_it_is_changed() {
        let mut chooser = Chooser::default();
        write(&mut chooser, "joint:");
        chooser.refuse("there is no topic \"joint\"".into());
        assert_eq!(chooser.topic(), None);
        assert_eq!(text(&chooser, 9)[1], "there is no topic \"joint\"");
        press(&mut chooser, KeyCode::Backspace);
        write(&mut chooser, "_states:");
        assert_eq!(chooser.topic(), Some("joint_states"));
    }
}
