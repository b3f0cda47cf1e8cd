//! The blocks of a page, and the comparison of a line with the page.

/// Commands with their expected output.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Block {
    /// The line of the first command, from 1.
    pub(crate) line: usize,
    pub(crate) commands: String,
    pub(crate) steps: Vec<Step>,
}

/// An expected line of a running block, or an action.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// A line like this is printed.
    Line(String),
    /// The reader presses Ctrl-C.
    Interrupt,
}

pub(crate) fn blocks(page: &str) -> Vec<Block> {
    let mut blocks: Vec<Block> = Vec::new();
    let mut lines = page.lines().enumerate();
    while let Some((number, line)) = lines.next() {
        let Some(kind) = line.strip_prefix("```") else { continue };
        let body: Vec<&str> =
            lines.by_ref().map(|(_, line)| line).take_while(|line| !line.starts_with("```")).collect();
        match kind {
            "sh" => blocks.push(Block { line: number + 2, commands: body.join("\n"), steps: Vec::new() }),
            "text" => {
                let block = blocks.last_mut().filter(|block| block.steps.is_empty());
                if let Some(block) = block {
                    block.steps = body.into_iter().filter_map(step).collect();
                }
            }
            _ => {}
        }
    }
    blocks
}

fn step(line: &str) -> Option<Step> {
    match line.trim() {
        "" | "…" => None,
        "^C" => Some(Step::Interrupt),
        line => Some(Step::Line(line.to_owned())),
    }
}

/// Returns whether `line` matches `pattern`, in which `…` stands for any text.
pub(crate) fn is_like(line: &str, pattern: &str) -> bool {
    let (line, pattern) = (line.trim(), pattern.trim());
    let Some((first, rest)) = pattern.split_once('…') else { return line == pattern };
    let Some(mut line) = line.strip_prefix(first) else { return false };
    let mut parts = rest.split('…').peekable();
    while let Some(part) = parts.next() {
        if parts.peek().is_none() {
            return line.ends_with(part);
        }
        let Some(at) = line.find(part) else { return false };
        line = &line[at + part.len()..];
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_is_commands_with_the_text_that_follows() {
        let page = "Run it:\n```sh\ncargo run\n```\nwhich prints\n```text\nup\n…\n^C\ndown\n```\n```rust\nfn main() {}\n```\n```sh\nls\n```\n";
        let line = |text: &str| Step::Line(text.to_owned());
        let expected = [
            Block {
                line: 3,
                commands: "cargo run".into(),
                steps: vec![line("up"), Step::Interrupt, line("down")],
            },
            Block { line: 16, commands: "ls".into(), steps: Vec::new() },
        ];
        assert_eq!(blocks(page), expected);
    }

    #[test]
    fn an_ellipsis_stands_for_any_text() {
        for pattern in ["up 12 s", "up … s", "…12 s", "up…", "…", "up … …s", "up…12… s"] {
            assert!(is_like("  up 12 s", pattern), "{pattern}");
        }
        for pattern in ["up 12", "up … m", "down…", "…13…", "up … 12 s"] {
            assert!(!is_like("up 12 s", pattern), "{pattern}");
        }
    }
}
