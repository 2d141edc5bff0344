//! What rustfmt leaves alone: comments and prose end at 100 columns, and links lead somewhere.

use std::fs;
use std::path::{Path, PathBuf};

const WIDTH: usize = 100;

/// Every Rust, WGSL and Markdown file of the crate, with its text.
fn files() -> Vec<(PathBuf, String)> {
    let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).to_path_buf()];
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder that can be read") {
            let path = entry.expect("an entry").path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if path.is_dir() && !name.starts_with('.') && !["target", "out"].contains(&&*name) {
                folders.push(path);
            } else if [".rs", ".wgsl", ".md"].iter().any(|end| name.ends_with(end)) {
                let text = fs::read_to_string(&path).expect("a text");
                files.push((path, text));
            }
        }
    }
    files
}

/// Lines of comments or prose beyond [`WIDTH`], except for tables, code fences, and lines without a
/// space at which they could break.
fn too_long(name: &str, text: &str) -> Vec<usize> {
    let (mut fenced, mut found) = (false, Vec::new());
    for (number, line) in text.lines().enumerate() {
        let mut body = line.trim_start();
        if !name.ends_with(".md") {
            let Some(comment) = body.strip_prefix("//") else {
                fenced = false;
                continue;
            };
            body = comment.trim_start_matches(['/', '!']).trim_start();
        }
        fenced ^= body.starts_with("```");
        let body = body.trim_start_matches(['-', '*', ' ']);
        let columns = line.chars().count();
        let room = WIDTH.saturating_sub(columns - body.chars().count());
        let breaks = body.chars().take(room + 1).any(|c| c == ' ');
        if columns > WIDTH && breaks && !fenced && !body.starts_with('|') {
            found.push(number + 1);
        }
    }
    found
}

/// The anchors of a page's headings, as hosts of repositories make them.
fn anchors(page: &str) -> Vec<String> {
    let mut fenced = false;
    let mut headings = Vec::new();
    for line in page.lines() {
        fenced ^= line.starts_with("```");
        if !fenced && line.starts_with('#') {
            let text = line.trim_start_matches('#').trim().to_lowercase();
            let kept = text.chars().filter(|c| c.is_alphanumeric() || [' ', '-', '_'].contains(c));
            headings.push(kept.map(|c| if c == ' ' { '-' } else { c }).collect());
        }
    }
    headings
}

/// Targets of a page's links that do not exist: files, or headings in pages.
fn dead_links(path: &Path, page: &str) -> Vec<String> {
    let targets = page.split("](").skip(1).filter_map(|rest| rest.split([')', ' ', '\n']).next());
    let local = targets.filter(|target| !target.contains("://"));
    let dead = local.filter(|target| {
        let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
        let file = if file.is_empty() { path.to_path_buf() } else { path.with_file_name(file) };
        let heading = |text: String| anchor.is_empty() || anchors(&text).contains(&anchor.into());
        !file.exists() || (target.contains('#') && !fs::read_to_string(file).is_ok_and(heading))
    });
    dead.map(String::from).collect()
}

#[test]
fn comments_and_prose_end_at_100_columns() {
    let mut long = Vec::new();
    for (path, text) in files() {
        let lines = too_long(&path.to_string_lossy(), &text);
        long.extend(lines.iter().map(|line| format!("{}:{line}", path.display())));
    }
    assert!(long.is_empty(), "{} lines beyond 100 columns:\n{}", long.len(), long.join("\n"));
}

#[test]
fn links_between_pages_lead_somewhere() {
    for (path, text) in files().iter().filter(|(path, _)| path.extension().unwrap() == "md") {
        let dead = dead_links(path, text);
        assert!(dead.is_empty(), "{}: {}", path.display(), dead.join(", "));
    }
}

#[test]
fn a_planted_line_and_a_planted_link_are_found() {
    let words = "word ".repeat(21);
    let url = format!("<https://{}>", "a".repeat(100));
    let rust =
        format!("let a = \"{words}\";\n/// {words}\n    // {words}\n// {url}\n//! | {words}|\n");
    assert_eq!(too_long("a.rs", &rust), [2, 3]);
    let fence = format!("/// ```\n/// {words}\n/// ```\n/// {words}\n");
    assert_eq!(too_long("a.wgsl", &fence), [4]);
    let page = format!("{words}\n- {words}\n- {url}\n| {words}|\n```sh\n{words}\n```\n");
    assert_eq!(too_long("a.md", &page), [1, 2]);
    let readme = Path::new(env!("CARGO_MANIFEST_DIR")).join("README.md");
    let links = "[a](docs/none.md) [b](#none) [c](docs/README.md) [d](https://a.b) [e](#licence)";
    assert_eq!(dead_links(&readme, &format!("# Licence\n{links}")), ["docs/none.md", "#none"]);
}
