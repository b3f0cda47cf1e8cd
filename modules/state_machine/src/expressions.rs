//! Expressions and scripts of charts, in the language rhai.
//!
//! They reach the data of their chart and nothing else: no files, no clock, no random numbers, no output.
//! What one evaluation may cost is bounded (the constants below), so that a loop without an end is an error
//! of the chart and not of the robot. Operations on long texts and large arrays take long, so their time is
//! bounded as well ([`Budget`]).
//!
//! Texts may be in single quotes as well, since attributes of XML are in double quotes; rhai's characters
//! therefore do not exist.

use crate::budget::{Budget, IsStopping, LIMIT, Over};
use crate::functions;
use crate::world::World;
use parking_lot::RwLock;
use rhai::packages::{Package, StandardPackage};
use rhai::{
    AST, ASTNode, Dynamic, Engine, EvalAltResult, Expr, OptimizationLevel, ParseError, Position, Scope, Stmt,
};
use std::collections::BTreeSet;
use std::fmt;
use std::sync::{Arc, LazyLock};
use std::time::Duration;

/// Statements, calls and turns of loops that one evaluation may take.
const MOST_OPERATIONS: u64 = 100_000;
/// The depth of calls of functions.
const MOST_CALLS: usize = 16;
/// The depth of nested expressions, and of those in functions.
const DEEPEST: (usize, usize) = (64, 32);
/// Bytes of a text.
const LONGEST_TEXT: usize = 16 << 10;
/// Elements of an array, and keys of a map.
const LARGEST: usize = 4096;
/// Variables and functions of a script.
const MOST_NAMES: usize = 256;

/// Evaluates the expressions of one chart.
pub(crate) struct Evaluator {
    engine: Engine,
    pub(crate) world: Arc<RwLock<World>>,
    budget: Budget,
}

/// The text of an expression or script that is syntactically valid.
#[derive(Clone)]
pub(crate) struct Program {
    pub(crate) text: String,
    /// Where it begins in the file.
    pub(crate) line: u32,
    pub(crate) ast: AST,
}

/// Whether a text is one expression or several statements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Syntax {
    Expression,
    Statements,
}

/// An error in a chart: found when it was read, or while it runs.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Problem {
    /// The line of the file, from 1.
    pub line: u32,
    /// What was found, and what to do.
    pub text: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.line, self.text)
    }
}

impl Program {
    /// Checks the syntax of a text that begins on this line.
    pub(crate) fn new(text: &str, line: u32, syntax: Syntax) -> Result<Self, Problem> {
        static PARSER: LazyLock<Engine> = LazyLock::new(engine);
        let translated = with_double_quotes(text);
        let ast = match syntax {
            Syntax::Expression => PARSER.compile_expression(&translated),
            Syntax::Statements => PARSER.compile(&translated),
        };
        let ast = ast.map_err(|ParseError(error, position)| Problem {
            line: line_of(line, position),
            text: format!("`{}` is no valid expression: {error}{}", shortened(text), column(position)),
        })?;
        Ok(Self { text: text.to_owned(), line, ast })
    }
}

/// A variable with the fields that an expression names after it.
pub(crate) struct Path {
    pub(crate) line: u32,
    pub(crate) names: Vec<String>,
}

impl Program {
    /// The variables that it names outside its functions, which have variables of their own.
    pub(crate) fn paths(&self) -> Vec<Path> {
        let mut paths = Vec::new();
        self.each_node(&mut |node| {
            let path = match node {
                ASTNode::Expr(Expr::Dot(chain, ..)) => names_of(&chain.lhs, Some(&chain.rhs)),
                ASTNode::Expr(variable) => names_of(variable, None),
                _ => None,
            };
            if let (Some(names), ASTNode::Expr(expression)) = (path, node) {
                paths.push(Path { line: line_of(self.line, expression.position()), names });
            }
        });
        paths
    }

    /// The variables that it declares outside its functions.
    pub(crate) fn declared(&self) -> BTreeSet<String> {
        let mut names = BTreeSet::new();
        self.each_node(&mut |node| match node {
            ASTNode::Stmt(Stmt::Var(declaration, ..)) => drop(names.insert(declaration.0.name.to_string())),
            ASTNode::Stmt(Stmt::For(each, ..)) => {
                names.insert(each.0.name.to_string());
                names.extend(each.1.iter().map(|counter| counter.name.to_string()));
            }
            _ => {}
        });
        names
    }

    /// The functions that it calls and that nothing defines, with their lines.
    pub(crate) fn unknown_calls(&self) -> Vec<(u32, String)> {
        let own: BTreeSet<&str> = self.ast.iter_functions().map(|function| function.name).collect();
        let mut unknown = Vec::new();
        self.ast.walk(&mut |nodes: &[ASTNode<'_>]| {
            if let Some(ASTNode::Expr(Expr::FnCall(call, position) | Expr::MethodCall(call, position))) =
                nodes.last()
                && !call.is_operator_call()
                && !own.contains(&*call.name)
                && !functions().contains(&*call.name)
            {
                unknown.push((line_of(self.line, *position), call.name.to_string()));
            }
            true
        });
        unknown
    }

    fn each_node(&self, visit: &mut dyn FnMut(&ASTNode<'_>)) {
        for statement in self.ast.statements() {
            statement.walk(&mut Vec::new(), &mut |nodes: &[ASTNode<'_>]| {
                nodes.last().into_iter().for_each(&mut *visit);
                true
            });
        }
    }
}

/// The names of all functions that expressions may call.
pub(crate) fn functions() -> &'static BTreeSet<String> {
    static NAMES: LazyLock<BTreeSet<String>> = LazyLock::new(|| {
        let engine = Evaluator::new().engine;
        let registered =
            engine.collect_fn_metadata(None, |function| Some(function.metadata.name.to_string()), true);
        // The parser knows these.
        let built_in =
            ["Fn", "call", "curry", "debug", "is_def_fn", "is_def_var", "is_shared", "print", "type_of"];
        let names = registered.into_iter().chain(built_in.map(str::to_owned));
        names.filter(|name| name.chars().all(|c| c == '_' || c.is_ascii_alphanumeric())).collect()
    });
    &NAMES
}

fn names_of(variable: &Expr, fields: Option<&Expr>) -> Option<Vec<String>> {
    let Expr::Variable(variable, ..) = variable else { return None };
    let mut names = vec![variable.1.to_string()];
    let mut rest = fields;
    while let Some(field) = rest {
        let (field, next) = match field {
            Expr::Dot(chain, ..) => (&chain.lhs, Some(&chain.rhs)),
            last => (last, None),
        };
        let Expr::Property(property, ..) = field else { break };
        names.push(property.2.to_string());
        rest = next;
    }
    Some(names)
}

impl fmt::Debug for Program {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "`{}` on line {}", self.text, self.line)
    }
}

impl Evaluator {
    pub(crate) fn new() -> Self {
        let world = Arc::new(RwLock::new(World::default()));
        let mut engine = engine();
        functions::register_world(&mut engine, &world);
        let budget = Budget::default();
        let of_engine = budget.clone();
        engine.on_progress(move |count| of_engine.is_over_after(count).then_some(Dynamic::UNIT));
        Self { engine, world, budget }
    }

    /// An event begins at this time: the expressions that it leads to share a time limit.
    pub(crate) fn begin(&self, now: Duration) {
        self.world.write().now = now;
        self.budget.begin();
    }

    /// # Errors
    /// If expressions for this event have taken too long already.
    fn check_time(&self, program: &Program) -> Result<(), Problem> {
        match self.budget.over() {
            Some(_) => {
                Err(self.problem(program, &EvalAltResult::ErrorTerminated(Dynamic::UNIT, Position::NONE)))
            }
            None => Ok(()),
        }
    }

    /// Interrupts expressions that run for long when the robot is asked to stop.
    pub(crate) fn interrupt_when(&self, is_stopping: IsStopping) {
        self.budget.interrupt_when(is_stopping);
    }

    fn problem(&self, program: &Program, error: &EvalAltResult) -> Problem {
        problem(program, error, self.budget.over())
    }

    /// The value of an expression. Variables that it makes are forgotten.
    pub(crate) fn value(&self, program: &Program, scope: &mut Scope<'static>) -> Result<Dynamic, Problem> {
        self.check_time(program)?;
        let variables = scope.len();
        let value = self.engine.eval_ast_with_scope::<Dynamic>(scope, &program.ast);
        scope.rewind(variables);
        value.map(Dynamic::flatten).map_err(|error| self.problem(program, &error))
    }

    /// Whether a condition holds.
    pub(crate) fn holds(&self, program: &Program, scope: &mut Scope<'static>) -> Result<bool, Problem> {
        let value = self.value(program, scope)?;
        value.as_bool().map_err(|found| Problem {
            line: program.line,
            text: format!("the condition `{}` is of type {found}; it has to be true or false", program.text),
        })
    }

    /// A text in a chart as a value: a number, an object in JSON, or the text.
    pub(crate) fn read(&self, text: &str) -> Dynamic {
        if let Ok(integer) = text.parse::<i64>() {
            return integer.into();
        }
        match text.parse::<f64>() {
            Ok(number) => number.into(),
            Err(_) if text.starts_with('{') => {
                self.engine.parse_json(text, true).map_or_else(|_| text.to_owned().into(), Dynamic::from_map)
            }
            Err(_) => text.to_owned().into(),
        }
    }

    /// Runs a script. Its variables stay; one that is made again takes the place of the one before.
    pub(crate) fn run(&self, program: &Program, scope: &mut Scope<'static>) -> Result<(), Problem> {
        self.check_time(program)?;
        let variables = scope.len();
        let result = self.engine.run_ast_with_scope(scope, &program.ast);
        let made: Vec<(String, Dynamic)> = scope
            .iter_raw() // from the newest
            .take(scope.len() - variables)
            .map(|(name, _, value)| (name.to_owned(), value.clone()))
            .collect();
        scope.rewind(variables);
        if made.len() <= MOST_NAMES {
            for (name, value) in made.into_iter().rev() {
                scope.set_value(name, value);
            }
        }
        result.map_err(|error| self.problem(program, &error))
    }
}

impl fmt::Debug for Evaluator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Evaluator").field("world", &self.world).finish_non_exhaustive()
    }
}

/// The language without the functions that belong to one chart.
fn engine() -> Engine {
    let mut engine = Engine::new_raw();
    engine.register_global_module(StandardPackage::new().as_shared_module());
    engine.disable_symbol("eval");
    engine.set_optimization_level(OptimizationLevel::None);
    engine.set_fast_operators(false); // which would pass over our own `**`
    engine.set_max_operations(MOST_OPERATIONS);
    engine.set_max_call_levels(MOST_CALLS);
    engine.set_max_expr_depths(DEEPEST.0, DEEPEST.1);
    engine.set_max_string_size(LONGEST_TEXT);
    engine.set_max_array_size(LARGEST);
    engine.set_max_map_size(LARGEST);
    engine.set_max_variables(MOST_NAMES);
    engine.set_max_functions(MOST_NAMES);
    engine.set_fail_on_invalid_map_property(true);
    functions::register(&mut engine);
    engine
}

fn problem(program: &Program, error: &EvalAltResult, over: Option<Over>) -> Problem {
    let position = error.position();
    let mut bare = error.to_string();
    if let Some(end) = bare.rfind(" (line ") {
        bare.truncate(end);
    }
    if matches!(error, EvalAltResult::ErrorTooManyOperations(_)) {
        bare = format!("it takes more than {MOST_OPERATIONS} operations; does a loop in it end?");
    }
    if matches!(error, EvalAltResult::ErrorTerminated(..)) {
        bare = match over {
            Some(Over::Stop) => "interrupted, since the robot stops".to_owned(),
            _ => format!(
                "what the chart computes for one event takes longer than {LIMIT:?}; are texts or arrays in a loop large?"
            ),
        };
    }
    let text = format!("`{}`: {bare}", shortened(&program.text));
    Problem { line: line_of(program.line, position), text }
}

fn line_of(first: u32, position: Position) -> u32 {
    first + u32::try_from(position.line().unwrap_or(1).saturating_sub(1)).unwrap_or(0)
}

fn column(position: Position) -> String {
    position.position().map_or_else(String::new, |column| format!(", at character {column}"))
}

fn shortened(text: &str) -> String {
    const SHOWN: usize = 80;
    let text = text.trim();
    match text.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

/// Replaces the single quotes around texts by double quotes. Positions of characters stay, unless a text
/// holds double quotes.
fn with_double_quotes(text: &str) -> String {
    let mut translated = String::with_capacity(text.len() + 8);
    let mut characters = text.chars().peekable();
    // The quote that ends the text or comment in which the scan is.
    let mut inside: Option<char> = None;
    while let Some(c) = characters.next() {
        match (inside, c) {
            (None, '\'') => {
                inside = Some('\'');
                translated.push('"');
            }
            (None, '"' | '`') => {
                inside = Some(c);
                translated.push(c);
            }
            (None, '/') if characters.peek() == Some(&'/') => {
                inside = Some('\n');
                translated.push(c);
            }
            (None, '/') if characters.peek() == Some(&'*') => {
                inside = Some('*');
                translated.push(c);
            }
            (Some('*'), '*') if characters.peek() == Some(&'/') => {
                inside = None;
                translated.push(c);
                translated.extend(characters.next());
            }
            (Some('\''), '\'') => {
                inside = None;
                translated.push('"');
            }
            (Some('\''), '"') => translated.push_str("\\\""),
            (Some('\'' | '"'), '\\') => match characters.next() {
                // rhai knows no \' in texts.
                Some('\'') => translated.push('\''),
                next => {
                    translated.push(c);
                    translated.extend(next);
                }
            },
            (Some(end), c) if end == c && end != '*' => {
                inside = None;
                translated.push(c);
            }
            (_, c) => translated.push(c),
        }
    }
    translated
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::atomic::{AtomicBool, Ordering};

    use super::*;

    fn value(text: &str) -> Result<Dynamic, Problem> {
        let program = Program::new(text, 7, Syntax::Expression)?;
        Evaluator::new().value(&program, &mut Scope::new())
    }

    #[test]
    fn texts_may_be_in_single_quotes() {
        for (text, expected) in [
            ("'kick'", "kick"),
            (r#"'say "hi"'"#, "say \"hi\""),
            (r"'it\'s'", "it's"),
            (r#""it's""#, "it's"),
            ("`it's ${1 + 1}`", "it's 2"),
            ("/* don't */ 'a' + 'b'", "ab"),
        ] {
            assert_eq!(value(text).unwrap().into_string().unwrap(), expected, "{text}");
        }
    }

    #[test]
    fn what_never_ends_or_grows_is_an_error_with_its_line() {
        for script in [
            "let x = 0;\nloop { x += 1; }",
            "let s = 'ab';\nloop { s += s; }",
            "let a = [1];\nloop { a += a; }",
            "fn f(x) { f(x + 1) }\nf(0)",
            "let x = [];\nloop { x = [x]; }",
        ] {
            let program = Program::new(script, 10, Syntax::Statements).unwrap();
            let problem = Evaluator::new().run(&program, &mut Scope::new()).unwrap_err();
            assert!((10..=11).contains(&problem.line), "{problem}");
        }
    }

    #[test]
    fn what_takes_long_with_few_operations_is_an_error_and_so_is_what_follows_it() {
        let long = "let s = 'a';\nwhile s.len < 8000 { s += s; }\n";
        let sorted = "let a = []; for i in 0..4000 { a.push((i * 7919) % 4001); }\n";
        for script in [
            format!("{long}let n = 0;\nloop {{ if s.contains(s + 'b') {{ n += 1; }} }}"),
            format!("{long}loop {{ let t = s + 'b'; t.replace('ab', 'ba'); }}"),
            format!("{long}loop {{ s.to_upper(); }}"),
            format!("{sorted}loop {{ let b = a; b.sort(); }}"),
            format!("{sorted}loop {{ a.index_of(-1); }}"),
            format!("{sorted}loop {{ let b = a + []; b.reverse(); }}"),
        ] {
            let program = Program::new(&script, 1, Syntax::Statements).unwrap();
            let evaluator = Evaluator::new();
            evaluator.begin(Duration::ZERO);
            let begun = std::time::Instant::now();
            let problem = evaluator.run(&program, &mut Scope::new()).unwrap_err();
            // The machine may be busy; without a limit it takes 25 s and more.
            assert!(begun.elapsed() < Duration::from_secs(10), "{script}: {:?}", begun.elapsed());
            let is_long = problem.text.contains("takes longer than 500ms");
            assert!(is_long || problem.text.contains("operations"), "{problem}");
            let next = Program::new("1 + 1", 9, Syntax::Expression).unwrap();
            assert_eq!(evaluator.value(&next, &mut Scope::new()).is_err(), is_long, "{script}");
            evaluator.begin(Duration::ZERO);
            assert!(evaluator.value(&next, &mut Scope::new()).is_ok(), "the next event has its own time");
        }
    }

    #[test]
    fn a_stop_request_interrupts_what_runs_for_long_and_only_that() {
        let is_stopping = Arc::new(AtomicBool::new(true));
        let evaluator = Evaluator::new();
        let seen = Arc::clone(&is_stopping);
        evaluator.interrupt_when(Box::new(move || seen.load(Ordering::Relaxed)));
        let short = Program::new("1 + 1", 1, Syntax::Expression).unwrap();
        evaluator.begin(Duration::ZERO);
        assert!(evaluator.value(&short, &mut Scope::new()).is_ok());

        let long =
            "let a = [];\nfor i in 0..4000 { a.push((i * 7919) % 4001); }\nloop { let b = a; b.sort(); }";
        let long = Program::new(long, 1, Syntax::Statements).unwrap();
        is_stopping.store(false, Ordering::Relaxed);
        evaluator.begin(Duration::ZERO);
        let stop = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(100));
            is_stopping.store(true, Ordering::Relaxed);
        });
        let problem = evaluator.run(&long, &mut Scope::new()).unwrap_err();
        // Otherwise it ends by its limit, with another text.
        assert!(problem.text.contains("interrupted, since the robot stops"), "{problem}");
        stop.join().unwrap();
        evaluator.begin(Duration::ZERO);
        assert!(evaluator.value(&short, &mut Scope::new()).is_err(), "nothing begins any more");
    }

    #[test]
    fn a_script_that_runs_again_makes_its_variables_again() {
        let program =
            Program::new("let x = 1;\nconst y = x + 1;\nlet x = y + 1;", 1, Syntax::Statements).unwrap();
        let (evaluator, mut scope) = (Evaluator::new(), Scope::new());
        scope.push("before", 7_i64);
        for _ in 0..1000 {
            evaluator.run(&program, &mut scope).unwrap();
        }
        assert_eq!(scope.len(), 3);
        for (name, value) in [("before", 7), ("x", 3), ("y", 2)] {
            assert_eq!(scope.get_value::<i64>(name), Some(value));
        }
    }

    #[test]
    fn there_is_no_way_out() {
        for text in
            ["eval('1')", "open_file('x')", "import 'x' as y", "timestamp()", "sleep(1)", "rand()", "exit()"]
        {
            assert!(value(text).is_err(), "{text}");
        }
        // Printing leads nowhere.
        let _ = value("print('x')");
    }

    #[test]
    fn a_syntax_error_names_the_line_and_the_text() {
        let problem = Program::new("1 +\n* 2", 3, Syntax::Expression).unwrap_err();
        assert_eq!(problem.line, 4);
        assert!(problem.text.contains("is no valid expression"), "{problem}");
        assert!(Program::new(&"(".repeat(5000), 1, Syntax::Expression).is_err());
    }
}
