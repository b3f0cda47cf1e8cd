//! The commands of the debugger as words.

use downbeat_files::duration;

/// Where to go.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Goal {
    /// By so many cycles.
    By(i64),
    /// To the next, or the last, run of a module or message of a topic.
    Run {
        name: String,
        is_back: bool,
    },
    /// Until a condition becomes true.
    Condition {
        expression: String,
        is_back: bool,
    },
    /// This long into the bag.
    Time(i64),
    /// To a stamp in nanoseconds.
    Stamp(i64),
    Cycle(u64),
    Message {
        topic: String,
        number: u64,
    },
    Difference,
    Start,
    End,
}

/// A command.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Command {
    Go(Goal),
    Print(String),
    Module(String),
    /// Of a message of a topic, the latest if there is no number.
    Why {
        topic: String,
        number: Option<u64>,
    },
    List,
    Notes,
    Help,
    Quit,
}

pub(super) const HELP: &str = "\
step [N], back [N]        go N cycles forwards or backwards
next NAME, last NAME      go to the next or the last run of a module, or cycle with messages of a topic
until EXPRESSION          go on until this becomes true, such as until battery_state.voltage < 11
back until EXPRESSION     go back to where it last became true
go 12.3s                  go to this time in the bag; also 500ms, 2min, or a stamp in nanoseconds
go #1234                  go to this cycle
go joint_goals#17         go to the cycle with this message of a topic, counted from 0
go difference             go to the first difference from the bag
go start, go end          go to the first or the last cycle
why TOPIC, why TOPIC#17   print what led to the latest, or to this, message of a topic
print TOPIC               print the latest message
module NAME               print settings and state of a module
list                      list modules and topics
notes                     list what differs from the recorded run
quit                      end; so does Ctrl-D
An empty line repeats the last command. The first letter of a command is enough: s, b, n, l, u, g, w, p, m, q.
";

impl Command {
    /// Reads a line.
    ///
    /// # Errors
    /// What is wrong with it.
    pub(super) fn parse(line: &str) -> Result<Self, String> {
        let line = line.trim();
        let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = rest.trim();
        let name = || match rest {
            "" => Err(format!("{word} what? Write a name after it; `list` lists them")),
            name => Ok(name.trim_start_matches('/').to_owned()),
        };
        let condition = |expression: &str, is_back| match expression.trim() {
            "" => {
                Err("until what? Write an expression after it, such as battery_state.voltage < 11".to_owned())
            }
            expression => Ok(Self::Go(Goal::Condition { expression: expression.to_owned(), is_back })),
        };
        match word {
            "s" | "step" => Ok(Self::Go(Goal::By(count(rest)?))),
            "b" | "back" => match rest.strip_prefix("until") {
                Some(expression) => condition(expression, true),
                None => Ok(Self::Go(Goal::By(-count(rest)?))),
            },
            "n" | "next" => Ok(Self::Go(Goal::Run { name: name()?, is_back: false })),
            "l" | "last" => Ok(Self::Go(Goal::Run { name: name()?, is_back: true })),
            "u" | "until" => condition(rest, false),
            "g" | "go" => goal(rest).map(Self::Go),
            "p" | "print" => Ok(Self::Print(name()?)),
            "m" | "module" => Ok(Self::Module(name()?)),
            "w" | "why" => why(name()?),
            "list" => Ok(Self::List),
            "notes" => Ok(Self::Notes),
            "h" | "help" | "?" => Ok(Self::Help),
            "q" | "quit" | "exit" => Ok(Self::Quit),
            _ => Err(format!("unknown command \"{word}\"; `help` lists them")),
        }
    }
}

fn why(text: String) -> Result<Command, String> {
    let Some((topic, number)) = text.split_once('#') else {
        return Ok(Command::Why { topic: text, number: None });
    };
    let number = number.parse().map_err(|_| format!("\"{number}\" is not a number, as in joint_goals#17"))?;
    Ok(Command::Why { topic: topic.to_owned(), number: Some(number) })
}

fn count(text: &str) -> Result<i64, String> {
    let count = if text.is_empty() { Some(1) } else { text.parse().ok() };
    count.filter(|count| *count > 0).ok_or_else(|| format!("\"{text}\" is not a number of cycles"))
}

fn goal(text: &str) -> Result<Goal, String> {
    match text {
        "start" => return Ok(Goal::Start),
        "end" => return Ok(Goal::End),
        "difference" | "d" => return Ok(Goal::Difference),
        _ => {}
    }
    if let Some((topic, number)) = text.split_once('#') {
        let number = number
            .parse()
            .map_err(|_| format!("\"{number}\" is not a number, as in #1234 or joint_goals#17"))?;
        return Ok(match topic {
            "" => Goal::Cycle(number),
            topic => Goal::Message { topic: topic.trim_start_matches('/').to_owned(), number },
        });
    }
    // Plain numbers of this size are stamps, as bags have them.
    if let Some(stamp) = text.parse::<i64>().ok().filter(|number| *number > 1_000_000_000_000) {
        return Ok(Goal::Stamp(stamp));
    }
    match duration::parse_or_seconds(text) {
        Ok(time) => Ok(Goal::Time(i64::try_from(time.as_nanos()).unwrap_or(i64::MAX))),
        Err(problem) => Err(format!(
            "go where? A time such as 12.3s, #CYCLE, TOPIC#NUMBER, difference, start or end; {problem}"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_read() {
        let go = |line: &str| match Command::parse(line) {
            Ok(Command::Go(goal)) => goal,
            other => panic!("{line}: {other:?}"),
        };
        assert_eq!((go("s"), go(" step 12 "), go("b 3")), (Goal::By(1), Goal::By(12), Goal::By(-3)));
        assert_eq!(go("n /joint_goals"), Goal::Run { name: "joint_goals".into(), is_back: false });
        let expression = "battery_state.voltage < 11".to_owned();
        assert_eq!(
            go("until battery_state.voltage < 11"),
            Goal::Condition { expression: expression.clone(), is_back: false }
        );
        assert_eq!(
            go("back until battery_state.voltage < 11"),
            Goal::Condition { expression, is_back: true }
        );
        assert_eq!((go("go 1.5"), go("g 500ms")), (Goal::Time(1_500_000_000), Goal::Time(500_000_000)));
        assert_eq!(go("go 1795281744602397600"), Goal::Stamp(1_795_281_744_602_397_600));
        assert_eq!((go("go #12"), go("go d")), (Goal::Cycle(12), Goal::Difference));
        assert_eq!(go("go /imu/data_raw#7"), Goal::Message { topic: "imu/data_raw".into(), number: 7 });
        for (line, problem) in [
            ("jump", "unknown command \"jump\""),
            ("step x", "\"x\" is not a number of cycles"),
            ("next", "next what?"),
            ("until ", "until what?"),
            ("go somewhere", "go where?"),
            ("go a#b", "\"b\" is not a number"),
        ] {
            assert!(Command::parse(line).is_err_and(|error| error.contains(problem)), "{line}");
        }
    }
}
