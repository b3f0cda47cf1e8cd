//! From a file to a chart.

use super::*;
use crate::expressions::Syntax;
use downbeat_files::suggestion;
use roxmltree::{Document, Node, ParsingOptions};

/// Bytes of a file, elements in it, and how deep they may be nested.
pub(super) const LARGEST_FILE: usize = 1 << 20;
pub(super) const TOO_LARGE: &str = "it is larger than 1 MiB; split the chart";
const MOST_NODES: u32 = 50_000;
const DEEPEST: usize = 64;
/// How long a call waits for its answer unless the chart says otherwise.
const TIMEOUT: Duration = Duration::from_secs(5);

pub(super) fn parse(path: &Path, text: &str) -> Result<Chart, Vec<Problem>> {
    let whole = |text: String| vec![Problem { line: 1, text }];
    if text.len() > LARGEST_FILE {
        return Err(whole(TOO_LARGE.to_owned()));
    }
    if let Some(problem) = too_deep(text) {
        return Err(vec![problem]);
    }
    let options = ParsingOptions { nodes_limit: MOST_NODES, ..ParsingOptions::default() };
    let document = Document::parse_with_options(text, options).map_err(|error| {
        vec![Problem { line: error.pos().row, text: format!("it is no valid XML: {error}") }]
    })?;
    let root = document.root_element();
    if !is_scxml(root, "scxml") {
        return Err(whole(format!(
            "the outermost element is <{}>; a chart is in <scxml xmlns=\"{SCXML}\" version=\"1.0\">",
            root.tag_name().name()
        )));
    }
    let stem = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    let mut reader = Reader {
        chart: Chart {
            path: path.to_owned(),
            name: root.attribute("name").map_or(stem, str::to_owned),
            is_late: root.attribute("binding") == Some("late"),
            states: Vec::new(),
            transitions: Vec::new(),
            scripts: Vec::new(),
            interface: Interface::default(),
            findings: Vec::new(),
        },
        targets: Vec::new(),
        problems: Vec::new(),
    };
    reader.state(root, None);
    reader.resolve_targets();
    if reader.problems.is_empty() { Ok(reader.chart) } else { Err(reader.problems) }
}

/// Elements are parsed recursively, so their depth is bounded before.
fn too_deep(text: &str) -> Option<Problem> {
    let (mut depth, mut line) = (0_usize, 1);
    let bytes = text.as_bytes();
    for (at, &byte) in bytes.iter().enumerate() {
        match (byte, bytes.get(at + 1)) {
            (b'\n', _) => line += 1,
            (b'<', Some(b'/')) | (b'/', Some(b'>')) => depth = depth.saturating_sub(1),
            (b'<', Some(b'!' | b'?')) => {}
            (b'<', Some(_)) => depth += 1,
            _ => {}
        }
        if depth > 4 * DEEPEST {
            return Some(Problem { line, text: format!("elements are nested more than {DEEPEST} deep") });
        }
    }
    None
}

struct Reader {
    chart: Chart,
    /// The ids of each transition's targets, resolved when all states are known.
    targets: Vec<Vec<String>>,
    problems: Vec<Problem>,
}

/// The attributes of the elements of SCXML that may stand in states and in executable content.
const ATTRIBUTES: &[(&str, &[&str])] = &[
    ("scxml", &["initial", "name", "version", "datamodel", "binding", "exmode"]),
    ("state", &["id", "initial"]),
    ("parallel", &["id"]),
    ("final", &["id"]),
    ("history", &["id", "type"]),
    ("initial", &[]),
    ("transition", &["event", "cond", "target", "type"]),
    ("onentry", &[]),
    ("onexit", &[]),
    ("datamodel", &[]),
    ("data", &["id", "expr", "src"]),
    ("donedata", &[]),
    ("content", &["expr"]),
    ("param", &["name", "expr", "location"]),
    ("script", &["src"]),
    ("raise", &["event"]),
    ("if", &["cond"]),
    ("elseif", &["cond"]),
    ("else", &[]),
    ("foreach", &["array", "item", "index"]),
    ("log", &["label", "expr"]),
    ("assign", &["location", "expr"]),
    (
        "send",
        &[
            "event",
            "eventexpr",
            "target",
            "targetexpr",
            "type",
            "typeexpr",
            "id",
            "idlocation",
            "delay",
            "delayexpr",
            "namelist",
        ],
    ),
    ("cancel", &["sendid", "sendidexpr"]),
];

impl Reader {
    fn fail(&mut self, node: Node<'_, '_>, text: impl Into<String>) {
        self.problems.push(Problem { line: line(node), text: text.into() });
    }

    /// Whether an element may stand here; reports elements and attributes that may not.
    fn is_allowed(&mut self, node: Node<'_, '_>, allowed: &[&str]) -> bool {
        let name = node.tag_name().name();
        match node.tag_name().namespace() {
            Some(SCXML) => {}
            Some(DOWNBEAT) => {
                self.fail(node, format!("<{name}> of {DOWNBEAT} stands at the begin of <scxml>, in <datamodel> if it is a setting"));
                return false;
            }
            None => {
                self.fail(node, format!("<{name}> is in no namespace; <scxml> needs xmlns=\"{SCXML}\""));
                return false;
            }
            // Of editors, for example.
            Some(_) => return false,
        }
        if !allowed.contains(&name) {
            let text = match (name, ATTRIBUTES.iter().any(|(known, _)| *known == name)) {
                ("invoke" | "finalize", _) => {
                    format!("<{name}> is not supported; another chart is another module")
                }
                (_, true) => format!("<{name}> cannot stand here; here may be: {}", allowed.join(", ")),
                (_, false) => {
                    format!("there is no element <{name}>{}", suggestion(name, allowed.iter().copied()))
                }
            };
            self.fail(node, text);
            return false;
        }
        let known = ATTRIBUTES.iter().find(|(known, _)| *known == name).map_or(&[][..], |(_, known)| *known);
        for attribute in node.attributes().filter(|attribute| attribute.namespace().is_none()) {
            if !known.contains(&attribute.name()) {
                let hint = suggestion(attribute.name(), known.iter().copied());
                self.fail(node, format!("<{name}> has no attribute `{}`{hint}", attribute.name()));
            }
        }
        true
    }

    fn needed<'a>(&mut self, node: Node<'a, '_>, attribute: &str) -> Option<&'a str> {
        let value = node.attribute(attribute).filter(|value| !value.trim().is_empty());
        if value.is_none() {
            self.fail(node, format!("<{}> needs the attribute `{attribute}`", node.tag_name().name()));
        }
        value.map(str::trim)
    }

    fn program(&mut self, node: Node<'_, '_>, text: &str, syntax: Syntax) -> Option<Program> {
        self.program_at(line(node), text, syntax)
    }

    fn program_at(&mut self, line: u32, text: &str, syntax: Syntax) -> Option<Program> {
        Program::new(text, line, syntax).map_err(|problem| self.problems.push(problem)).ok()
    }

    fn expression(&mut self, node: Node<'_, '_>, attribute: &str) -> Option<Program> {
        let text = node.attribute(attribute)?;
        self.program(node, text, Syntax::Expression)
    }

    /// The location to which a value is assigned, as the statement that does it.
    fn location(&mut self, node: Node<'_, '_>, attribute: &str) -> Option<Program> {
        let text = node.attribute(attribute)?.trim();
        // Checked alone first: the statement could hold others.
        self.program(node, text, Syntax::Expression)?;
        let mut program = self.program(node, &format!("{text} = {ASSIGNED}"), Syntax::Statements)?;
        text.clone_into(&mut program.text);
        Some(program)
    }

    fn text_or_expression(&mut self, node: Node<'_, '_>, text: &str, computed: &str) -> Option<Given> {
        if let (Some(_), Some(_)) = (node.attribute(text), node.attribute(computed)) {
            self.fail(node, format!("it has both `{text}` and `{computed}`; give one"));
        }
        match node.attribute(text) {
            Some(given) => Some(Given::Text(given.trim().to_owned())),
            None => self.expression(node, computed).map(Given::Computed),
        }
    }

    fn state(&mut self, node: Node<'_, '_>, parent: Option<usize>) {
        let depth = parent.map_or(0, |parent| 1 + self.chart.ancestors(parent).count());
        if depth > DEEPEST {
            return self.fail(node, format!("states are nested more than {DEEPEST} deep"));
        }
        let name = node.tag_name().name();
        let number = self.chart.states.len();
        let has_children = node
            .children()
            .any(|child| ["state", "parallel", "final"].iter().any(|state| is_scxml(child, state)));
        let kind = match (name, node.attribute("type").map(str::trim)) {
            ("parallel", _) => StateKind::Parallel,
            ("final", _) => StateKind::Final,
            ("history", Some("deep")) => StateKind::Deep,
            ("history", Some("shallow") | None) => StateKind::Shallow,
            ("history", Some(other)) => {
                let text = format!("`type` of a history is \"shallow\" or \"deep\", not \"{other}\"");
                self.fail(node, text);
                StateKind::Shallow
            }
            _ if has_children || parent.is_none() => StateKind::Compound,
            _ => StateKind::Atomic,
        };
        let id = match (parent, node.attribute("id").map(str::trim)) {
            (None, _) => String::new(),
            (Some(_), Some(id)) if !id.is_empty() && !id.contains(char::is_whitespace) => id.to_owned(),
            (Some(_), Some(id)) => {
                self.fail(node, format!("\"{id}\" cannot be an id: ids are words"));
                format!("{name}.{number}")
            }
            (Some(_), None) => format!("{name}.{number}"),
        };
        self.chart.states.push(State {
            id,
            line: line(node),
            kind,
            parent,
            children: Vec::new(),
            histories: Vec::new(),
            initial: None,
            transitions: Vec::new(),
            entry: Vec::new(),
            exit: Vec::new(),
            data: Vec::new(),
            done_data: Payload::None,
            end: number + 1,
        });
        if let Some(initial) = node.attribute("initial") {
            let targets = initial.split_whitespace().map(str::to_owned).collect();
            let transition = self.new_transition(number, line(node), targets);
            self.chart.states[number].initial = Some(transition);
        }
        let allowed: &[&str] = match kind {
            _ if parent.is_none() => &["state", "parallel", "final", "datamodel", "script"],
            StateKind::Final => &["onentry", "onexit", "donedata"],
            StateKind::Shallow | StateKind::Deep => &["transition"],
            StateKind::Parallel => {
                &["onentry", "onexit", "transition", "state", "parallel", "history", "datamodel"]
            }
            _ => &[
                "onentry",
                "onexit",
                "transition",
                "initial",
                "state",
                "parallel",
                "final",
                "history",
                "datamodel",
            ],
        };
        for child in node.children().filter(Node::is_element) {
            if parent.is_none() && child.tag_name().namespace() == Some(DOWNBEAT) {
                self.port(child);
            } else if self.is_allowed(child, allowed) {
                self.part_of_state(child, number);
            }
        }
        self.chart.states[number].end = self.chart.states.len();
    }

    fn part_of_state(&mut self, node: Node<'_, '_>, state: usize) {
        match node.tag_name().name() {
            "history" => {
                let history = self.chart.states.len();
                self.chart.states[state].histories.push(history);
                self.state(node, Some(state));
            }
            "state" | "parallel" | "final" => {
                let child = self.chart.states.len();
                self.chart.states[state].children.push(child);
                self.state(node, Some(state));
            }
            "onentry" => {
                let block = self.block(node);
                self.chart.states[state].entry.push(block);
            }
            "onexit" => {
                let block = self.block(node);
                self.chart.states[state].exit.push(block);
            }
            "transition" => {
                let transition = self.transition(node, state);
                match self.chart.states[state].is_history() {
                    true if self.chart.states[state].initial.is_some() => {
                        self.fail(node, "a history has one transition, its default");
                    }
                    true => self.chart.states[state].initial = Some(transition),
                    false => self.chart.states[state].transitions.push(transition),
                }
            }
            "initial" => {
                let inner: Vec<_> = node.children().filter(|child| is_scxml(*child, "transition")).collect();
                let [inner] = inner[..] else {
                    return self.fail(node, "<initial> has one <transition>");
                };
                if self.chart.states[state].initial.is_some() {
                    self.fail(node, "the state has two initial states; give `initial` or one <initial>");
                }
                if self.is_allowed(inner, &["transition"]) {
                    let transition = self.transition(inner, state);
                    self.chart.states[state].initial = Some(transition);
                }
            }
            "datamodel" => self.data(node, state),
            "donedata" => {
                let payload = self.payload(node);
                self.chart.states[state].done_data = payload;
            }
            "script" => {
                if let Some(script) = self.script(node) {
                    self.chart.scripts.push(script);
                }
            }
            _ => {}
        }
    }

    fn new_transition(&mut self, source: usize, line: u32, targets: Vec<String>) -> usize {
        self.chart.transitions.push(Transition {
            source,
            events: Vec::new(),
            condition: None,
            targets: Vec::new(),
            is_internal: false,
            actions: Vec::new(),
            line,
        });
        self.targets.push(targets);
        self.chart.transitions.len() - 1
    }

    fn transition(&mut self, node: Node<'_, '_>, source: usize) -> usize {
        let words = |name: &str| {
            let words = node.attribute(name).unwrap_or_default().split_whitespace();
            words.map(str::to_owned).collect::<Vec<_>>()
        };
        let number = self.new_transition(source, line(node), words("target"));
        let is_internal = match node.attribute("type").map(str::trim) {
            None | Some("external") => false,
            Some("internal") => true,
            Some(other) => {
                let text = format!("`type` of a transition is \"external\" or \"internal\", not \"{other}\"");
                self.fail(node, text);
                false
            }
        };
        let mut events = words("event");
        for event in &mut events {
            while let Some(shorter) = event.strip_suffix(".*").or_else(|| event.strip_suffix('.')) {
                *event = shorter.to_owned();
            }
        }
        let condition = self.expression(node, "cond");
        let actions = self.block(node);
        let transition = &mut self.chart.transitions[number];
        (transition.events, transition.condition) = (events, condition);
        (transition.is_internal, transition.actions) = (is_internal, actions);
        number
    }

    fn data(&mut self, datamodel: Node<'_, '_>, state: usize) {
        for node in datamodel.children().filter(Node::is_element) {
            if node.tag_name().namespace() == Some(DOWNBEAT) && node.tag_name().name() == "setting" {
                self.setting(node);
                continue;
            }
            if !self.is_allowed(node, &["data"]) {
                continue;
            }
            let Some(id) = self.needed(node, "id") else { continue };
            if !is_variable(id) {
                self.fail(node, format!("\"{id}\" cannot be a variable: letters, digits and `_`"));
            }
            if node.attribute("src").is_some() {
                self.fail(node, "`src` is not supported: data of a chart are in its file");
            }
            let value = match (node.attribute("expr"), content_of(node)) {
                (Some(_), Some(_)) => {
                    self.fail(node, "it has both `expr` and content; give one");
                    None
                }
                (Some(_), None) => self.expression(node, "expr"),
                (None, Some((line, text))) => self.program_at(line, &text, Syntax::Expression),
                (None, None) => None,
            };
            self.chart.states[state].data.push(Data { id: id.to_owned(), value, line: line(node) });
        }
    }

    fn block(&mut self, parent: Node<'_, '_>) -> Vec<Action> {
        let mut actions = Vec::new();
        for node in parent.children().filter(Node::is_element) {
            if is_scxml(node, "elseif") || is_scxml(node, "else") {
                self.fail(node, format!("<{}> stands in an <if>", node.tag_name().name()));
            } else {
                actions.extend(self.action(node));
            }
        }
        actions
    }

    fn action(&mut self, node: Node<'_, '_>) -> Option<Action> {
        if node.ancestors().count() > 2 * DEEPEST {
            self.fail(node, format!("elements are nested more than {DEEPEST} deep"));
            return None;
        }
        if !self.is_allowed(node, &["raise", "send", "cancel", "log", "assign", "if", "foreach", "script"]) {
            return None;
        }
        let line = line(node);
        match node.tag_name().name() {
            "raise" => self.needed(node, "event").map(|event| Action::Raise { event: event.to_owned() }),
            "send" => self.send(node).map(|send| Action::Send(Box::new(send))),
            "cancel" => {
                let id = self.text_or_expression(node, "sendid", "sendidexpr");
                if id.is_none() {
                    self.fail(node, "<cancel> needs `sendid` or `sendidexpr`");
                }
                Some(Action::Cancel { id: id?, line })
            }
            "log" => {
                let label = node.attribute("label").unwrap_or_default().to_owned();
                Some(Action::Log { label, value: self.expression(node, "expr"), line })
            }
            "assign" => {
                self.needed(node, "location")?;
                let location = self.location(node, "location")?;
                let value = match (node.attribute("expr"), content_of(node)) {
                    (Some(_), None) => self.expression(node, "expr")?,
                    (None, Some((line, text))) => self.program_at(line, &text, Syntax::Expression)?,
                    _ => {
                        self.fail(node, "<assign> needs either `expr` or content");
                        return None;
                    }
                };
                Some(Action::Assign { location, value })
            }
            "if" => self.branches(node),
            "foreach" => self.for_each(node),
            _ => self.script(node).map(Action::Script),
        }
    }

    fn branches(&mut self, node: Node<'_, '_>) -> Option<Action> {
        self.needed(node, "cond")?;
        let mut branches = vec![(Some(self.expression(node, "cond")?), Vec::new())];
        for child in node.children().filter(Node::is_element) {
            let is_after_else = branches.last().is_some_and(|(condition, _)| condition.is_none());
            if is_scxml(child, "elseif") || is_scxml(child, "else") {
                self.is_allowed(child, &["elseif", "else"]);
                if is_after_else {
                    self.fail(child, "nothing but the actions of the last case stands after <else>");
                }
                let condition = match child.tag_name().name() {
                    "else" => None,
                    _ => {
                        self.needed(child, "cond")?;
                        Some(self.expression(child, "cond")?)
                    }
                };
                branches.push((condition, Vec::new()));
            } else if let Some(action) = self.action(child)
                && let Some((_, actions)) = branches.last_mut()
            {
                actions.push(action);
            }
        }
        Some(Action::If { branches })
    }

    fn for_each(&mut self, node: Node<'_, '_>) -> Option<Action> {
        self.needed(node, "array")?;
        let array = self.expression(node, "array")?;
        let item_name = self.needed(node, "item")?;
        let names =
            [Some(item_name), node.attribute("index")].map(|name| name.map(|name| name.trim().to_owned()));
        for name in names.iter().flatten().filter(|name| !is_variable(name)) {
            self.fail(node, format!("\"{name}\" cannot be a variable: letters, digits and `_`"));
        }
        let item = self.location(node, "item")?;
        let index = self.location(node, "index");
        Some(Action::ForEach(Box::new(ForEach { array, item, index, body: self.block(node), names })))
    }

    fn script(&mut self, node: Node<'_, '_>) -> Option<Program> {
        if node.attribute("src").is_some() {
            self.fail(node, "`src` is not supported: scripts of a chart are in its file");
        }
        let (line, text) = content_of(node)?;
        self.program_at(line, &text, Syntax::Statements)
    }

    fn send(&mut self, node: Node<'_, '_>) -> Option<Send> {
        let event = self.text_or_expression(node, "event", "eventexpr");
        let target = self.text_or_expression(node, "target", "targetexpr");
        if event.is_none() && target.is_none() {
            self.fail(node, "<send> needs `event`, or `target` to reach a topic, service or action");
        }
        let delay = self.text_or_expression(node, "delay", "delayexpr");
        if let Some(Given::Text(text)) = &delay
            && duration(text).is_none()
        {
            self.fail(node, format!("`delay` is a time such as \"500ms\" or \"1.5s\", not \"{text}\""));
        }
        let mut payload = self.payload(node);
        for name in node.attribute("namelist").unwrap_or_default().split_whitespace() {
            let Some(value) = self.program(node, name, Syntax::Expression) else { continue };
            match &mut payload {
                Payload::Parameters(parameters) => parameters.push((name.to_owned(), value)),
                Payload::None => payload = Payload::Parameters(vec![(name.to_owned(), value)]),
                Payload::Content(_) => self.fail(node, "<send> has both <content> and `namelist`; give one"),
            }
        }
        Some(Send {
            event,
            target,
            kind: self.text_or_expression(node, "type", "typeexpr"),
            id: node.attribute("id").map(str::to_owned),
            id_location: self.location(node, "idlocation"),
            delay,
            payload,
            line: line(node),
        })
    }

    fn payload(&mut self, parent: Node<'_, '_>) -> Payload {
        let mut payload = Payload::None;
        for node in parent.children().filter(Node::is_element) {
            if !self.is_allowed(node, &["param", "content"]) {
                continue;
            }
            if node.tag_name().name() == "param" {
                let Some(name) = self.needed(node, "name") else { continue };
                let attribute = if node.attribute("expr").is_some() { "expr" } else { "location" };
                if node.attribute(attribute).is_none() {
                    self.fail(node, "<param> needs `expr` or `location`");
                }
                let Some(value) = self.expression(node, attribute) else { continue };
                match &mut payload {
                    Payload::None => payload = Payload::Parameters(vec![(name.to_owned(), value)]),
                    Payload::Parameters(parameters) => parameters.push((name.to_owned(), value)),
                    Payload::Content(_) => self.fail(node, "<content> and <param> exclude each other"),
                }
                continue;
            }
            if !matches!(payload, Payload::None) {
                self.fail(node, "there is one <content>, and no <param> beside it");
            }
            if let Some(value) = self.expression(node, "expr") {
                payload = Payload::Content(Given::Computed(value));
            } else if let Some((_, text)) = content_of(node) {
                let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
                payload = Payload::Content(Given::Text(text));
            }
        }
        payload
    }

    /// Reads an element that connects the chart to its robot.
    fn port(&mut self, node: Node<'_, '_>) {
        let element = node.tag_name().name();
        let known: &[&str] = match element {
            "subscribe" => &["topic", "type", "as", "event"],
            "publish" => &["topic", "type", "as"],
            "service" | "action" => &["name", "type", "as", "timeout"],
            "every" => &["period", "event"],
            "setting" => return self.fail(node, "<setting> stands in <datamodel>"),
            other => {
                let hint =
                    suggestion(other, ["subscribe", "publish", "service", "action", "every", "setting"]);
                return self.fail(node, format!("there is no element <{other}> in {DOWNBEAT}{hint}"));
            }
        };
        self.check_attributes(node, known);
        if element == "every" {
            let (Some(period), Some(event)) = (self.needed(node, "period"), self.needed(node, "event"))
            else {
                return;
            };
            match duration(period).filter(|period| *period >= Duration::from_millis(1)) {
                Some(period) => {
                    self.chart.interface.timers.push(Timer { period, event: event.to_owned() });
                }
                None => self.fail(
                    node,
                    format!("`period` is a time of 1 ms or more such as \"0.1s\", not \"{period}\""),
                ),
            }
            return;
        }
        let topic = self.needed(node, known[0]);
        let (Some(topic), Some(type_name)) = (topic, self.needed(node, "type")) else { return };
        let last = topic.rsplit('/').next().unwrap_or(topic);
        let name = node.attribute("as").unwrap_or(last).trim().to_owned();
        if !is_variable(&name) {
            let text = format!("\"{name}\" cannot be a variable; give another name with `as`");
            return self.fail(node, text);
        }
        let timeout = node.attribute("timeout").map(|text| (text, duration(text)));
        if let Some((text, None)) = timeout {
            self.fail(node, format!("`timeout` is a time such as \"2s\", not \"{text}\""));
        }
        let port = Port {
            topic: topic.to_owned(),
            type_name: type_name.to_owned(),
            name,
            event: node.attribute("event").map(|event| event.trim().to_owned()),
            timeout: timeout.and_then(|(_, timeout)| timeout).unwrap_or(TIMEOUT),
            line: line(node),
        };
        let interface = &mut self.chart.interface;
        match element {
            "subscribe" => interface.subscriptions.push(port),
            "publish" => interface.publishers.push(port),
            "service" => interface.services.push(port),
            _ => interface.actions.push(port),
        }
    }

    fn setting(&mut self, node: Node<'_, '_>) {
        self.check_attributes(node, &["name", "default", "about", "min", "max"]);
        let Some(name) = self.needed(node, "name") else { return };
        let default = node.attribute("default");
        let Some(default) = default else {
            return self.fail(node, "<setting> needs the attribute `default`, which is also its type");
        };
        let default = match default.trim() {
            "true" => SettingDefault::Bool(true),
            "false" => SettingDefault::Bool(false),
            text => match (text.parse::<i64>(), text.parse::<f64>()) {
                (Ok(integer), _) => SettingDefault::Integer(integer),
                (_, Ok(number)) if number.is_finite() => SettingDefault::Number(number),
                _ => SettingDefault::Text(default.to_owned()),
            },
        };
        let mut bound = |attribute: &str, missing: f64| match node
            .attribute(attribute)
            .map(|text| (text, text.trim().parse::<f64>()))
        {
            None => missing,
            Some((_, Ok(bound))) if !bound.is_nan() => bound,
            Some((text, _)) => {
                self.fail(node, format!("`{attribute}` is a number, not \"{text}\""));
                missing
            }
        };
        let range = (bound("min", f64::NEG_INFINITY), bound("max", f64::INFINITY));
        let is_limited = node.attribute("min").is_some() || node.attribute("max").is_some();
        let number = match default {
            SettingDefault::Integer(value) => Some(value as f64),
            SettingDefault::Number(value) => Some(value),
            _ => None,
        };
        if is_limited && number.is_none_or(|number| !(range.0..=range.1).contains(&number)) {
            self.fail(node, "`default` is no number from `min` to `max`");
        }
        if !is_variable(name) {
            return self.fail(node, format!("\"{name}\" cannot be a setting: letters, digits and `_`"));
        }
        self.chart.interface.settings.push(ChartSetting {
            name: name.to_owned(),
            about: node.attribute("about").unwrap_or_default().to_owned(),
            default,
            range: is_limited.then_some(range),
            line: line(node),
        });
    }

    fn check_attributes(&mut self, node: Node<'_, '_>, known: &[&str]) {
        for attribute in node.attributes().filter(|attribute| attribute.namespace().is_none()) {
            if !known.contains(&attribute.name()) {
                let hint = suggestion(attribute.name(), known.iter().copied());
                let element = node.tag_name().name();
                self.fail(node, format!("<{element}> has no attribute `{}`{hint}", attribute.name()));
            }
        }
    }

    fn resolve_targets(&mut self) {
        for (number, targets) in std::mem::take(&mut self.targets).into_iter().enumerate() {
            for target in targets {
                match self.chart.state(&target).filter(|&state| state > 0) {
                    Some(state) => self.chart.transitions[number].targets.push(state),
                    None => {
                        let line = self.chart.transitions[number].line;
                        let names = self.chart.states.iter().map(|state| state.id.as_str());
                        let hint = suggestion(&target, names.filter(|name| !name.is_empty()));
                        self.problems
                            .push(Problem { line, text: format!("there is no state \"{target}\"{hint}") });
                    }
                }
            }
        }
    }
}

/// The variable that holds a value on its way to a location.
pub(crate) const ASSIGNED: &str = "_assigned";

fn is_scxml(node: Node<'_, '_>, name: &str) -> bool {
    node.tag_name().name() == name && node.tag_name().namespace() == Some(SCXML)
}

fn line(node: Node<'_, '_>) -> u32 {
    node.document().text_pos_at(node.range().start).row
}

/// The text in an element, with the line on which it begins; `None` if there is only space.
fn content_of(node: Node<'_, '_>) -> Option<(u32, String)> {
    let mut texts = node.children().filter(Node::is_text);
    let first = texts.next()?;
    let row = node.document().text_pos_at(first.range().start).row;
    let text: String = std::iter::once(first).chain(texts).filter_map(|text| text.text()).collect();
    (!text.trim().is_empty()).then_some((row, text))
}

fn is_variable(name: &str) -> bool {
    let mut characters = name.chars();
    characters.next().is_some_and(|first| first.is_ascii_alphabetic() || first == '_')
        && characters.all(|c| c.is_ascii_alphanumeric() || c == '_')
}

/// Reads a time, as in CSS `500ms`, `1.5s`, or with another unit.
pub(crate) fn duration(text: &str) -> Option<Duration> {
    downbeat_files::duration::parse(text).ok().filter(|time| time.as_secs() < 1 << 32)
}
