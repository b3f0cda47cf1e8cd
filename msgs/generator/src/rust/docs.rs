//! Doc comments of generated items.

/// The lines of a doc comment: the comment in the definition, then `code`, in code style.
pub(super) fn doc(comment: &[String], code: &str, indentation: &str) -> String {
    let mut lines: Vec<String> = comment.iter().map(|line| escape(line)).collect();
    while lines.last().is_some_and(String::is_empty) {
        lines.pop();
    }
    let written: Vec<String> = lines.into_iter().skip_while(String::is_empty).collect();
    let separator = if written.is_empty() { None } else { Some(String::new()) };
    let mut text = String::new();
    for line in written.into_iter().chain(separator).chain([format!("`{code}`")]) {
        text.push_str(&format!("{indentation}/// {line}"));
        text.truncate(text.trim_end().len());
        text.push('\n');
    }
    text
}

/// The constant with a hash, on two lines like `rustfmt`.
pub(super) fn hash_line(hash: &str) -> String {
    format!("    const TYPE_HASH: &'static str =\n        \"{hash}\";\n")
}

/// Escapes Markdown in a comment.
fn escape(line: &str) -> String {
    let words = line.split(' ').map(|word| {
        if word.starts_with("http://") || word.starts_with("https://") {
            return format!("<{word}>");
        }
        // In the middle of other text, such as HTML, rustdoc wants neither a link nor plain text.
        if word.contains("://") && !word.contains('`') {
            return format!("`{word}`");
        }
        let mut escaped = String::new();
        for character in word.chars() {
            if "\\`*_[]<>#|~".contains(character) {
                escaped.push('\\');
            }
            escaped.push(character);
        }
        escaped
    });
    words.collect::<Vec<_>>().join(" ")
}
