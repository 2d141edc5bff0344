//! Does the list of `tests/mutants/run` still fit the sources?

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// An entry: its fields, the items of `tests` joined by line breaks.
type Entry = BTreeMap<String, String>;

/// The entries of the list: the part of TOML that it uses, tables of literal strings, whole numbers
/// and one array of strings.
fn entries(list: &str) -> Result<Vec<Entry>, String> {
    let mut entries: Vec<Entry> = Vec::new();
    let mut rest = list;
    while let Some((line, after)) = rest.split_once('\n') {
        let found = line.trim();
        if found.is_empty() || found.starts_with('#') {
            rest = after;
        } else if found == "[[mutant]]" {
            entries.push(Entry::new());
            rest = after;
        } else {
            let (key, value) = rest.split_once(" = ").ok_or(format!("no value in `{line}`"))?;
            let (value, after) = value_of(value)?;
            let entry = entries.last_mut().ok_or(format!("`{line}` belongs to no entry"))?;
            if entry.insert(key.to_string(), value).is_some() {
                return Err(format!("`{key}` is there twice"));
            }
            rest = after.strip_prefix('\n').ok_or(format!("more behind a value: `{line}`"))?;
        }
    }
    Ok(entries)
}

/// The value that a text begins with, and what follows it.
fn value_of(text: &str) -> Result<(String, &str), String> {
    let cut = || format!("a value without its end: `{}`", text.lines().next().unwrap_or_default());
    if let Some(mut items) = text.strip_prefix('[') {
        let mut all = Vec::new();
        while !items.starts_with(']') {
            let (item, after) = value_of(items)?;
            all.push(item);
            items = after.trim_start_matches([',', ' ', '\n']);
        }
        return Ok((all.join("\n"), &items[1..]));
    }
    for quote in ["'''", "'"] {
        if let Some(inside) = text.strip_prefix(quote) {
            let inside = if quote == "'" { inside } else { inside.trim_start_matches('\n') };
            let (value, after) = inside.split_once(quote).ok_or_else(cut)?;
            return Ok((value.to_string(), after));
        }
    }
    let (value, _) = text.split_once('\n').ok_or_else(cut)?;
    value.parse::<u32>().map_err(|_| format!("`{value}` is no value"))?;
    Ok((value.to_string(), &text[value.len()..]))
}

/// What is wrong with entries, by their names. `read` gives a file's text, `names` are those of all
/// test functions and modules.
fn faults(
    entries: &[Entry],
    read: impl Fn(&str) -> Option<String>,
    names: &BTreeSet<String>,
) -> Vec<String> {
    const FIELDS: [&str; 11] = [
        "id",
        "kind",
        "file",
        "form",
        "before",
        "pattern",
        "after",
        "replacement",
        "about",
        "tests",
        "why_harmless",
    ];
    let mut seen = BTreeSet::new();
    let mut faults = Vec::new();
    for entry in entries {
        let field = |name: &str| entry.get(name).map_or("", String::as_str);
        let mut say = |what: String| faults.push(format!("{}: {what}", field("id")));
        for name in ["id", "kind", "file", "pattern", "about"] {
            if field(name).is_empty() {
                say(format!("no `{name}`"));
            }
        }
        for name in entry.keys().filter(|name| !FIELDS.contains(&name.as_str())) {
            say(format!("an unknown field `{name}`"));
        }
        if !seen.insert(field("id")) {
            say("the name of another mutant".to_string());
        }
        if !["", "expression", "statement"].contains(&field("form")) {
            say(format!("the form `{}`", field("form")));
        }
        let whole = |text: &str| {
            ["()", "[]", "{}"].iter().all(|pair| {
                let [open, close] = [0, 1].map(|at| text.matches(&pair[at..=at]).count());
                open == close
            })
        };
        if !field("file").ends_with(".wgsl") && !whole(field("pattern")) {
            say("its pattern ends inside a bracket".to_string());
        }
        if field("pattern") == field("replacement") {
            say("its replacement is its pattern".to_string());
        }
        let whole = [field("before"), field("pattern"), field("after")].concat();
        let found = read(field("file")).map_or(0, |text| text.matches(&whole).count());
        if found != 1 {
            say(format!("its pattern is {found} times in {}, not once", field("file")));
        }
        for wanted in field("tests").lines() {
            let (binary, filter) = wanted.split_once(' ').unwrap_or((wanted, ""));
            let parts = || filter.split("::").filter(|part| !part.is_empty());
            let last = parts().last().unwrap_or_default();
            if !["lib", "suite", "allocations"].contains(&binary)
                || parts().any(|part| part != last && !names.contains(part))
                || !names.iter().any(|name| name.starts_with(last))
            {
                say(format!("no test is called `{wanted}`"));
            }
        }
    }
    faults
}

/// Names of the functions and modules that tests may be in.
fn names() -> BTreeSet<String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut names = BTreeSet::from(["tests".to_string()]);
    let mut folders = vec![root.join("src"), root.join("tests")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            names.insert(path.file_stem().unwrap().to_string_lossy().into_owned());
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|end| end == "rs") {
                let text = fs::read_to_string(&path).unwrap();
                let functions = text.lines().filter_map(|l| l.trim_start().strip_prefix("fn "));
                names.extend(functions.filter_map(|l| Some(l.split_once('(')?.0.to_string())));
            }
        }
    }
    names
}

#[test]
fn every_mutant_matches_once() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let list = fs::read_to_string(root.join("tests/mutants/list.toml")).unwrap();
    let entries = entries(&list).unwrap();
    assert!(entries.len() >= 80, "only {} mutants", entries.len());
    let read = |file: &str| fs::read_to_string(root.join(file)).ok();
    let found = faults(&entries, read, &names());
    assert!(found.is_empty(), "tests/mutants/list.toml:\n{}", found.join("\n"));
}

/// The control: each fault that an entry may have is found.
#[test]
fn a_mutant_that_fits_no_more_is_found() {
    let text = "let a = b - c;\nlet d = b - c;\nlet e = b + c;\n";
    let read = |file: &str| (file == "src/a.rs").then(|| text.to_string());
    let names = BTreeSet::from(["sums".to_string(), "a_sum_is_right".to_string()]);
    let entry = |change: &str| {
        let good = "[[mutant]]\nid = 'a'\nkind = 0\nfile = 'src/a.rs'\npattern = 'b + c'\n\
                    replacement = 'b'\nabout = 'x'\ntests = ['lib sums::a_sum', 'suite sums']\n";
        let key = change.split(" = ").next().unwrap();
        let lines: Vec<&str> = good.lines().filter(|l| !l.starts_with(key)).collect();
        let list = format!("# A list.\n\n{}\n{change}\n", lines.join("\n"));
        faults(&entries(&list).unwrap(), read, &names)
    };
    assert_eq!(entry("about = '''\nit''s'''"), Vec::<String>::new());
    assert_eq!(entry("pattern = 'b - c'"), ["a: its pattern is 2 times in src/a.rs, not once"]);
    assert_eq!(entry("pattern = 'b * c'"), ["a: its pattern is 0 times in src/a.rs, not once"]);
    assert_eq!(
        entry("pattern = '(b + c'").first().unwrap(),
        "a: its pattern ends inside a bracket"
    );
    assert_eq!(entry("file = 'src/b.rs'"), ["a: its pattern is 0 times in src/b.rs, not once"]);
    assert_eq!(entry("replacement = 'b + c'"), ["a: its replacement is its pattern"]);
    assert_eq!(entry("before = 'let d = '").len(), 1);
    assert_eq!(entry("before = 'let e = '"), Vec::<String>::new());
    assert_eq!(entry("form = 'block'"), ["a: the form `block`"]);
    assert_eq!(entry("why = 'x'"), ["a: an unknown field `why`"]);
    assert_eq!(entry("tests = ['lib gone']"), ["a: no test is called `lib gone`"]);
    assert_eq!(entry("tests = ['lib gone::a_sum']"), ["a: no test is called `lib gone::a_sum`"]);
    let twice = entry("kind = 1\n[[mutant]]\nid = 'a'");
    assert!(twice.contains(&"a: the name of another mutant".to_string()), "{twice:?}");
    for bad in ["[[mutant]]\nid = 'a\n", "id = 'a'\n", "[[mutant]]\nkind = x\n", "[[mutant]]\nid\n"]
    {
        assert!(entries(bad).is_err(), "{bad}");
    }
}
