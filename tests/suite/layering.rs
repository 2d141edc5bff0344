//! The import table of `docs/architecture.md`, enforced: a module may use the modules of its own
//! row only.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Module and what it may import; `error` and `twin` are open to all.
const TABLE: &[(&str, &[&str])] = &[
    ("error", &[]),
    ("twin", &[]),
    ("math", &[]),
    ("counters", &[]),
    ("stats", &["math"]),
    ("picture", &["math"]),
    ("metrics", &["picture", "stats", "math"]),
    ("scene", &["math"]),
    ("accel", &["scene", "math"]),
    ("surface", &["accel", "scene", "math"]),
    ("light", &["surface", "accel", "scene", "math"]),
    ("world", &["light", "surface", "accel", "scene", "math"]),
    ("path", &["counters", "world", "light", "surface", "accel", "scene", "math"]),
    ("resampling", &["math"]),
    ("spec", &[]),
    ("plan", &["resampling", "world", "light", "surface", "scene", "math"]),
    ("pass", &["plan", "world", "light", "surface", "accel", "scene", "math"]),
    (
        "reuse",
        &[
            "spec",
            "pass",
            "plan",
            "resampling",
            "path",
            "counters",
            "world",
            "light",
            "surface",
            "accel",
            "scene",
            "math",
        ],
    ),
    (
        "gpu",
        &[
            "reuse",
            "plan",
            "resampling",
            "counters",
            "world",
            "light",
            "surface",
            "accel",
            "scene",
            "math",
        ],
    ),
    (
        "techniques",
        &[
            "spec",
            "pass",
            "plan",
            "reuse",
            "resampling",
            "path",
            "counters",
            "world",
            "light",
            "surface",
            "accel",
            "scene",
            "math",
        ],
    ),
    (
        "frame",
        &[
            "gpu",
            "techniques",
            "spec",
            "pass",
            "plan",
            "reuse",
            "resampling",
            "path",
            "counters",
            "world",
            "light",
            "surface",
            "accel",
            "scene",
            "math",
            "picture",
        ],
    ),
    ("report", &["metrics", "picture", "stats", "math", "plan", "counters"]),
    (
        "experiment",
        &[
            "report",
            "frame",
            "techniques",
            "reuse",
            "plan",
            "path",
            "counters",
            "world",
            "light",
            "accel",
            "scene",
            "metrics",
            "picture",
            "stats",
            "math",
        ],
    ),
    (
        "cli",
        &[
            "experiment",
            "report",
            "frame",
            "gpu",
            "techniques",
            "reuse",
            "pass",
            "plan",
            "path",
            "counters",
            "world",
            "light",
            "surface",
            "accel",
            "scene",
            "metrics",
            "picture",
            "stats",
            "math",
        ],
    ),
];

fn sources(folder: &Path, out: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("src is readable") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            sources(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
}

/// Every `crate::name` of a source with its line number; items that only tests see may use
/// anything.
fn imports(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    let mut lines = text.lines().enumerate();
    while let Some((number, line)) = lines.next() {
        let trimmed = line.trim_start();
        if trimmed.starts_with("#[cfg(test)]") || trimmed.starts_with("#[cfg(all(test") {
            skip_item(&mut lines, line.len() - trimmed.len());
            continue;
        }
        if trimmed.starts_with("//") {
            continue;
        }
        for part in line.split("crate::").skip(1) {
            let names: Vec<&str> = match part.strip_prefix('{') {
                Some(group) => group.split(['{', '}', ',']).map(str::trim).collect(),
                None => vec![part],
            };
            for name in names {
                let name: String =
                    name.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
                if name.chars().next().is_some_and(char::is_lowercase) {
                    found.push((number + 1, name));
                }
            }
        }
    }
    found
}

/// Skips the item behind an attribute, by rustfmt's indentation: it ends where a line of the same
/// indentation ends in `;` or `,`, or begins with `}`.
fn skip_item<'a>(lines: &mut impl Iterator<Item = (usize, &'a str)>, indent: usize) {
    for (_, line) in lines {
        let trimmed = line.trim_start();
        let outermost = line.len() - trimmed.len() == indent && !trimmed.is_empty();
        let attribute = trimmed.starts_with("#[") || trimmed.starts_with("//");
        if outermost
            && !attribute
            && (trimmed.starts_with('}') || trimmed.ends_with([';', ',', '}']))
        {
            return;
        }
    }
}

fn violations(module: &str, text: &str) -> Vec<String> {
    let table: BTreeMap<&str, BTreeSet<&str>> =
        TABLE.iter().map(|(m, allowed)| (*m, allowed.iter().copied().collect())).collect();
    imports(text)
        .into_iter()
        .filter(|(_, name)| {
            name != module && name != "error" && name != "twin" && table.contains_key(name.as_str())
        })
        .filter(|(_, name)| !table[module].contains(name.as_str()))
        .map(|(line, name)| format!("line {line}: `{module}` must not import `{name}`"))
        .collect()
}

#[test]
fn modules_import_only_what_the_table_allows() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    let mut failures = Vec::new();
    for file in files {
        let relative = file.strip_prefix(&root).expect("inside src");
        let first = relative
            .components()
            .next()
            .expect("a name")
            .as_os_str()
            .to_string_lossy()
            .replace(".rs", "");
        // A module's unit tests may use anything.
        if first == "lib"
            || first == "main"
            || file.file_stem().is_some_and(|name| name.to_string_lossy().ends_with("tests"))
            || relative.components().any(|part| part.as_os_str() == "tests")
        {
            continue;
        }
        assert!(
            TABLE.iter().any(|(module, _)| *module == first),
            "`{first}` has no row in the import table"
        );
        let text = fs::read_to_string(&file).expect("a source file");
        failures.extend(
            violations(&first, &text).into_iter().map(|v| format!("{}: {v}", relative.display())),
        );
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// An upward import is found wherever it stands: behind each of a file's test-only items, too.
#[test]
fn an_import_behind_test_only_items_is_found() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    let mut planted = 0;
    for file in files {
        let text = fs::read_to_string(&file).expect("a source file");
        let lines: Vec<&str> = text.lines().collect();
        let attributes = (0..lines.len()).filter(|&at| lines[at] == "#[cfg(test)]");
        for at in attributes {
            let mut rest = lines.iter().copied().enumerate().skip(at + 1);
            skip_item(&mut rest, 0);
            let end = rest.next().map_or(lines.len(), |(end, _)| end);
            let mut with = lines.clone();
            with.insert(end, "use crate::cli::run;");
            let found = violations("math", &with.join("\n"));
            let expected = format!("line {}: `math` must not import `cli`", end + 1);
            assert!(found.contains(&expected), "{}: {found:?}", file.display());
            planted += 1;
        }
    }
    assert!(planted > 50, "only {planted} places were tried");
}

#[test]
fn a_planted_import_is_found() {
    let text = "//! crate::cli in a comment is fine\nuse crate::path::Limits;\nuse crate::{error::Error, frame::FrameLoop};\n";
    assert_eq!(
        violations("math", text),
        ["line 2: `math` must not import `path`", "line 3: `math` must not import `frame`"]
    );
}

#[test]
fn the_table_has_no_cycles() {
    for (at, (module, allowed)) in TABLE.iter().enumerate() {
        for name in *allowed {
            let below = TABLE[..at].iter().any(|(earlier, _)| earlier == name);
            assert!(
                below,
                "`{module}` imports `{name}`, which does not stand above it in the table"
            );
        }
    }
}

/// Path seeds are made at one door, `FrameInputs::seeds`: what seeds are can change without a word
/// to any technique.
#[test]
fn path_seeds_are_made_at_one_place() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    let makes = |text: &str| text.contains("path_seed(") || text.contains("PathSeeds::new(");
    assert!(makes("let seed = path_seed(run, pixel, frame, 0);"), "the planted call is found");
    let doors: Vec<String> = files
        .iter()
        .filter(|file| {
            let text = fs::read_to_string(file).expect("a source file");
            makes(text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default())
        })
        .map(|file| file.strip_prefix(&root).expect("inside src").display().to_string())
        .filter(|name| !name.contains("tests"))
        .collect::<BTreeSet<String>>()
        .into_iter()
        .collect();
    assert_eq!(doors, ["math/rng.rs", "pass.rs"], "where path seeds are made");
}
