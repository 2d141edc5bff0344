//! The command line as reports show it.

/// The command line as it was typed, with the program's bare name; arguments with other than plain
/// characters are quoted.
pub(super) fn command_line() -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./:=,+@%".contains(c);
    let mut words = vec!["afterimage".to_string()];
    words.extend(std::env::args_os().skip(1).map(|a| {
        let word = a.to_string_lossy().into_owned();
        if !word.is_empty() && word.chars().all(plain) {
            word
        } else {
            format!("'{}'", word.replace('\'', r"'\''"))
        }
    }));
    words.join(" ")
}
