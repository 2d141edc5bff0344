//! The import table of `docs/architecture.md`, enforced: a module may use the modules of its own row only.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Module and what it may import; `error` and `twin` are open to all.
const TABLE: &[(&str, &[&str])] = &[
    ("error", &[]),
    ("twin", &[]),
    ("math", &[]),
    ("stats", &["math"]),
    ("picture", &["math"]),
    ("metrics", &["picture", "stats", "math"]),
    ("scene", &["math"]),
    ("accel", &["scene", "math"]),
    ("surface", &["accel", "scene", "math"]),
    ("light", &["surface", "accel", "scene", "math"]),
    ("world", &["light", "surface", "accel", "scene", "math"]),
    ("path", &["world", "light", "surface", "accel", "scene", "math"]),
    ("resampling", &["math"]),
    ("direct", &["resampling", "path", "world", "light", "surface", "accel", "scene", "math"]),
    ("gpu", &["direct", "resampling", "world", "light", "surface", "accel", "scene", "math"]),
    ("plan", &["resampling", "world", "light", "surface", "scene", "math"]),
    (
        "techniques",
        &[
            "plan",
            "direct",
            "resampling",
            "path",
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
            "plan",
            "direct",
            "resampling",
            "path",
            "world",
            "light",
            "surface",
            "accel",
            "scene",
            "math",
            "picture",
        ],
    ),
    ("report", &["metrics", "picture", "stats", "math", "plan", "path"]),
    (
        "cli",
        &[
            "report",
            "frame",
            "gpu",
            "techniques",
            "direct",
            "plan",
            "path",
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

/// Every `crate::name` of a source with its line number; test modules may use anything.
fn imports(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (number, line) in text.lines().enumerate() {
        if line.trim_start().starts_with("#[cfg(test)]") {
            break;
        }
        if line.trim_start().starts_with("//") {
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
