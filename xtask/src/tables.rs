//! Tables of the docs, made of committed results.
//!
//! A table in a file of `docs` follows a comment that says what it holds, and ends at another comment:
//!
//! ```text
//! <!-- table
//! data aomask-table1
//! where sides=front
//! rows scene | radius=params.radius
//! name radius null unbounded
//! column mask | method=mask baseline=rays | {mrays_s:.1} ({speedup:.2})
//! column bias | method=mask | {maxabs bias[rays=64]:.4}
//! -->
//! | scene | radius | mask | bias |
//! ...
//! <!-- /table -->
//! ```
//!
//! - `data` names files `NAME.jsonl` in `docs/results/FOLDER`; the last folder by name that has one is taken. Several names are read as one.
//! - `where` and the second part of a column keep the rows of results with these values. A key without a dot is one of the row's own keys or
//!   one of its `params`; `!=` is the opposite.
//! - `rows` are the keys that tell the table's rows apart, in the order in which the results have them; `label=key` names the column.
//! - `name LABEL VALUE TEXT` writes a value of such a column in another way.
//! - A cell's `{key:.2}` is the number with two digits, `{key*1000:.1}` times a thousand, `{key:+.3}` with its sign, `{key}` as it is. Before the
//!   key may stand `mean`, `geomean`, `inverse` (one over the geometric mean), `max`, `min`, `maxabs`, `sum` or `count`, over all results that fit; without one there is one result, or none,
//!   which is a dash. `[filters]` after the key keep some of the results.

use anyhow::{Context, Result, anyhow, bail, ensure};
use serde_json::Value;
use std::{
    fs,
    path::{Path, PathBuf},
};

const BEGIN: &str = "<!-- table\n";
const END: &str = "<!-- /table -->";

/// Writes all tables of `root/docs` and the README, or says which of them differ from their data.
pub fn run(root: &Path, check: bool) -> Result<()> {
    let docs = root.join("docs");
    let mut files = vec![root.join("README.md")];
    markdown_files(&docs, &mut files)?;
    let (mut count, mut stale) = (0, Vec::new());
    for file in files {
        let text = fs::read_to_string(&file).with_context(|| file.display().to_string())?;
        let (made, tables) =
            rewritten(&text, &docs.join("results")).with_context(|| file.display().to_string())?;
        count += tables;
        if made != text {
            if check {
                stale.push(file.display().to_string());
            } else {
                fs::write(&file, made).with_context(|| file.display().to_string())?;
                println!("{}: written", file.display());
            }
        }
    }
    ensure!(
        stale.is_empty(),
        "tables differ from docs/results, `cargo xtask tables` writes them: {}",
        stale.join(", ")
    );
    println!("{count} tables agree with docs/results");
    Ok(())
}

fn markdown_files(folder: &Path, files: &mut Vec<PathBuf>) -> Result<()> {
    let mut entries: Vec<PathBuf> =
        fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect::<Result<_>>()?;
    entries.sort();
    for path in entries {
        if path.is_dir() {
            markdown_files(&path, files)?;
        } else if path.extension().is_some_and(|extension| extension == "md") {
            files.push(path);
        }
    }
    Ok(())
}

/// `text` with every table made anew, and how many there are.
fn rewritten(text: &str, results: &Path) -> Result<(String, usize)> {
    let (mut out, mut rest, mut count) = (String::new(), text, 0);
    while let Some(begin) = rest.find(BEGIN) {
        let specification = &rest[begin + BEGIN.len()..];
        let close = specification.find("-->\n").context("a table's comment does not end")?;
        let end = specification.find(END).with_context(|| format!("a table does not end with {END}"))?;
        ensure!(close < end, "a table's comment does not end");
        let table = Table::parse(&specification[..close])?;
        out += &rest[..begin + BEGIN.len() + close + "-->\n".len()];
        out += &table.markdown(&table.results(results)?)?;
        out += END;
        rest = &specification[end + END.len()..];
        count += 1;
    }
    Ok((out + rest, count))
}

/// What a comment says.
struct Table {
    data: Vec<String>,
    filters: Vec<Filter>,
    /// Labels and keys.
    rows: Vec<(String, String)>,
    /// Label, value and what is written for it.
    names: Vec<[String; 3]>,
    columns: Vec<Column>,
}

struct Column {
    title: String,
    filters: Vec<Filter>,
    parts: Vec<Part>,
}

enum Part {
    Text(String),
    Number { aggregate: Option<String>, key: String, filters: Vec<Filter>, factor: f64, format: String },
}

struct Filter {
    key: String,
    value: String,
    equal: bool,
}

impl Filter {
    fn parse_all(text: &str) -> Result<Vec<Self>> {
        let one = |word: &str| {
            let (key, value) = word.split_once('=').ok_or_else(|| anyhow!("'{word}' is no KEY=VALUE"))?;
            let equal = !key.ends_with('!');
            Ok(Self { key: key.trim_end_matches('!').into(), value: value.into(), equal })
        };
        text.split_whitespace().map(one).collect()
    }

    fn keeps(&self, result: &Value) -> bool {
        let text = plain(value(result, &self.key));
        let same = text == self.value
            || matches!((text.parse::<f64>(), self.value.parse::<f64>()), (Ok(a), Ok(b)) if a == b);
        same == self.equal
    }
}

/// The value of a key: of the result, of its params, or along a path of dots.
fn value<'a>(result: &'a Value, key: &str) -> &'a Value {
    let direct = key.split('.').fold(result, |value, key| &value[key]);
    if direct.is_null() && !key.contains('.') { &result["params"][key] } else { direct }
}

/// A value as text; the elements of a list with blanks between them.
fn plain(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Array(list) => list.iter().map(plain).collect::<Vec<_>>().join(" "),
        other => other.to_string(),
    }
}

impl Table {
    fn parse(text: &str) -> Result<Self> {
        let mut table = Self {
            data: Vec::new(),
            filters: Vec::new(),
            rows: Vec::new(),
            names: Vec::new(),
            columns: Vec::new(),
        };
        for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
            let (word, rest) = line.split_once(' ').with_context(|| format!("'{line}' says nothing"))?;
            match word {
                "data" => table.data.extend(rest.split_whitespace().map(str::to_owned)),
                "where" => table.filters.extend(Filter::parse_all(rest)?),
                "rows" => table.rows.extend(rest.split('|').map(|part| {
                    let part = part.trim();
                    let (label, key) = part.split_once('=').unwrap_or((part, part));
                    (label.trim().to_owned(), key.trim().to_owned())
                })),
                "name" => {
                    let parts: Vec<String> = rest.splitn(3, ' ').map(str::to_owned).collect();
                    table
                        .names
                        .push(parts.try_into().map_err(|_| anyhow!("'{line}' is no name LABEL VALUE TEXT"))?);
                }
                "column" => {
                    let parts: Vec<&str> = rest.split(" | ").map(str::trim).collect();
                    let [title, filters, cell] = parts[..] else {
                        bail!("'{line}' is no column TITLE | FILTERS | CELL");
                    };
                    let (filters, parts) = (Filter::parse_all(filters)?, parts_of(cell)?);
                    table.columns.push(Column { title: title.into(), filters, parts });
                }
                _ => bail!("'{word}' is none of data, where, rows, name, column"),
            }
        }
        ensure!(!table.data.is_empty() && !table.columns.is_empty(), "a table needs data and a column");
        Ok(table)
    }

    /// The results that it is made of.
    fn results(&self, folder: &Path) -> Result<Vec<Value>> {
        let mut results = Vec::new();
        for name in &self.data {
            let path = newest(folder, name)?;
            let text = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
            for (number, line) in text.lines().enumerate() {
                let result: Value = serde_json::from_str(line)
                    .with_context(|| format!("{}, line {}", path.display(), number + 1))?;
                if self.filters.iter().all(|filter| filter.keeps(&result)) {
                    results.push(result);
                }
            }
        }
        Ok(results)
    }

    fn markdown(&self, results: &[Value]) -> Result<String> {
        let labels = |result: &Value| -> Vec<String> {
            self.rows.iter().map(|(label, key)| self.named(label, plain(value(result, key)))).collect()
        };
        let mut order: Vec<Vec<String>> = Vec::new();
        for result in results {
            let own = labels(result);
            let in_column = |column: &Column| column.filters.iter().all(|filter| filter.keeps(result));
            if !order.contains(&own) && self.columns.iter().any(in_column) {
                order.push(own);
            }
        }
        ensure!(!order.is_empty(), "no result fits the table of {}", self.data.join(", "));
        let titles =
            self.rows.iter().map(|row| &row.0).chain(self.columns.iter().map(|column| &column.title));
        let titles: Vec<&str> = titles.map(String::as_str).collect();
        let mut out = format!("| {} |\n|{}\n", titles.join(" | "), "---|".repeat(titles.len()));
        for own in order {
            let of_row: Vec<&Value> = results.iter().filter(|result| labels(result) == own).collect();
            let mut cells = own;
            for column in &self.columns {
                let fits = |result: &&&Value| column.filters.iter().all(|filter| filter.keeps(result));
                let fitting: Vec<&Value> = of_row.iter().filter(fits).copied().collect();
                let context = || format!("column {} of row {}", column.title, cells.join(", "));
                cells.push(column.cell(&fitting).with_context(context)?);
            }
            out += &format!("| {} |\n", cells.join(" | "));
        }
        Ok(out)
    }

    fn named(&self, label: &str, value: String) -> String {
        let name = self.names.iter().find(|name| name[0] == label && name[1] == value);
        name.map_or(value, |name| name[2].clone())
    }
}

/// The file of results `name` in the last folder that has it.
fn newest(folder: &Path, name: &str) -> Result<PathBuf> {
    let entries = fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let files = entries.filter_map(|entry| Some(entry.ok()?.path().join(format!("{name}.jsonl"))));
    let newest = files.filter(|path| path.exists()).max();
    newest.with_context(|| format!("no folder of {} has {name}.jsonl", folder.display()))
}

fn parts_of(cell: &str) -> Result<Vec<Part>> {
    let (mut parts, mut rest) = (Vec::new(), cell);
    while let Some(begin) = rest.find('{') {
        let length = rest[begin..].find('}').with_context(|| format!("'{cell}' has a {{ without }}"))?;
        parts.push(Part::Text(rest[..begin].into()));
        parts.push(number_of(&rest[begin + 1..begin + length])?);
        rest = &rest[begin + length + 1..];
    }
    parts.push(Part::Text(rest.into()));
    Ok(parts)
}

/// What is between braces.
fn number_of(text: &str) -> Result<Part> {
    let (text, filters) = match text.split_once('[') {
        Some((key, rest)) => {
            let (filters, format) =
                rest.split_once(']').with_context(|| format!("'{text}' has a [ without ]"))?;
            (format!("{key}{format}"), Filter::parse_all(filters)?)
        }
        None => (text.to_owned(), Vec::new()),
    };
    let (key, format) = text.split_once(':').unwrap_or((&text, ""));
    let (aggregate, key) = match key.split_once(' ') {
        Some((aggregate, key)) => (Some(aggregate.to_owned()), key),
        None => (None, key),
    };
    let (key, factor) = match key.split_once('*') {
        Some((key, factor)) => (key, factor.parse().with_context(|| format!("'{factor}' is no number"))?),
        None => (key, 1.0),
    };
    Ok(Part::Number { aggregate, key: key.into(), filters, factor, format: format.into() })
}

impl Column {
    fn cell(&self, results: &[&Value]) -> Result<String> {
        let mut out = String::new();
        for part in &self.parts {
            match part {
                Part::Text(text) => out += text,
                Part::Number { aggregate, key, filters, factor, format } => {
                    let fits = |result: &&&Value| filters.iter().all(|filter| filter.keeps(result));
                    let values: Vec<&Value> = results.iter().filter(fits).map(|r| value(r, key)).collect();
                    match (aggregate, &values[..]) {
                        (_, []) => return Ok("-".into()),
                        (None, [text]) if format.is_empty() => out += &plain(text),
                        (None, [Value::Null]) => return Ok("-".into()),
                        (None, [_, _, ..]) => bail!("{} results fit {{{key}}}", values.len()),
                        (aggregate, values) => {
                            let numbers: Vec<f64> = values.iter().filter_map(|x| x.as_f64()).collect();
                            ensure!(!numbers.is_empty(), "{key} is no number");
                            out += &formatted(aggregated(aggregate.as_deref(), &numbers)? * factor, format)?;
                        }
                    }
                }
            }
        }
        Ok(out)
    }
}

fn aggregated(how: Option<&str>, numbers: &[f64]) -> Result<f64> {
    let (n, all) = (numbers.len() as f64, || numbers.iter().copied());
    Ok(match how {
        None => numbers[0],
        Some("mean") => all().sum::<f64>() / n,
        Some("inverse") => (all().map(f64::ln).sum::<f64>() / -n).exp(),
        Some("geomean") => (all().map(f64::ln).sum::<f64>() / n).exp(),
        Some("max") => all().fold(f64::NEG_INFINITY, f64::max),
        Some("min") => all().fold(f64::INFINITY, f64::min),
        Some("maxabs") => all().map(f64::abs).fold(0.0, f64::max),
        Some("sum") => all().sum(),
        Some("count") => n,
        Some(other) => bail!("'{other}' is no way to put numbers together"),
    })
}

fn formatted(number: f64, format: &str) -> Result<String> {
    let sign = format.starts_with('+');
    let digits = format.trim_start_matches('+');
    if digits.is_empty() {
        return Ok(number.to_string());
    }
    let digits: usize = digits
        .strip_prefix('.')
        .and_then(|digits| digits.parse().ok())
        .with_context(|| format!("'{format}' is no .DIGITS"))?;
    // No sign for what rounds to nothing.
    let number = if number.abs() < 0.5 * 10f64.powi(-(digits as i32)) { 0.0 } else { number };
    Ok(if sign && number != 0.0 { format!("{number:+.digits$}") } else { format!("{number:.digits$}") })
}

#[cfg(test)]
mod tests {
    use super::*;

    const RESULTS: &str = r#"{"scene":"a","method":"mask","params":{"rays":32,"radius":null},"rmse":0.02,"bias":-0.001}
{"scene":"a","method":"mask","params":{"rays":64,"radius":null},"rmse":0.01,"bias":0.0005}
{"scene":"b","method":"mask","params":{"rays":32,"radius":0.1},"rmse":0.04,"bias":0.002}
{"scene":"b","method":"rays","params":{"rays":32,"radius":0.1},"rmse":0.5,"bias":null}
"#;

    fn made(specification: &str, folders: &[(&str, &str)]) -> Result<String> {
        let root =
            std::env::temp_dir().join(format!("xtask-tables-{}-{:p}", std::process::id(), &specification));
        for (folder, text) in folders {
            fs::create_dir_all(root.join(folder))?;
            fs::write(root.join(folder).join("t.jsonl"), text)?;
        }
        let text = format!("before\n<!-- table\n{specification}\n-->\nold\n<!-- /table -->\nafter\n");
        let made = rewritten(&text, &root);
        fs::remove_dir_all(&root)?;
        let (made, count) = made?;
        assert_eq!(count, 1);
        let table = made.split_once("-->\n").unwrap().1;
        assert!(made.starts_with("before\n") && table.ends_with("<!-- /table -->\nafter\n"));
        Ok(table.split_once("<!-- /table").unwrap().0.to_owned())
    }

    #[test]
    fn cells_are_filtered_put_together_and_formatted() {
        let text = "data t\nrows scene | radius=params.radius\nname radius null unbounded\n\
            column 32 rays | method=mask rays=32 | {rmse:.3} ({bias*1000:+.1})\n\
            column all | method=mask | {geomean rmse:.4}, {maxabs bias[rays=32]:.4}, {count rmse}\n\
            column rays | method=rays | {method}";
        let table = made(text, &[("1", "{}"), ("2", RESULTS)]).unwrap();
        assert_eq!(
            table,
            "| scene | radius | 32 rays | all | rays |\n|---|---|---|---|---|\n\
             | a | unbounded | 0.020 (-1.0) | 0.0141, 0.0010, 2 | - |\n\
             | b | 0.1 | 0.040 (+2.0) | 0.0400, 0.0020, 1 | rays |\n"
        );
    }

    #[test]
    fn what_is_wrong_is_said() {
        for (text, expected) in [
            ("data t\nrows scene\ncolumn all | method=mask | {rmse:.2}", "2 results fit"),
            ("data t\nrows scene\ncolumn all | method=none | {rmse:.2}", "no result fits"),
            ("data other\nrows scene\ncolumn all | method=mask | {rmse:.2}", "other.jsonl"),
            ("data t\nrows scene\ncolumn all | mask | {rmse:.2}", "KEY=VALUE"),
            ("data t\nlines scene", "none of data"),
        ] {
            let error = format!("{:#}", made(text, &[("1", RESULTS)]).unwrap_err());
            assert!(error.contains(expected), "{error}");
        }
    }
}
