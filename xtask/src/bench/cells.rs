//! Cells and tables as text.

use super::stats::Spread;

/// A Markdown table whose columns line up in plain text too.
pub fn table(head: &[impl AsRef<str>], rows: &[Vec<String>]) -> String {
    let width = |i: usize| {
        let cells = rows.iter().filter_map(|r| r.get(i)).map(|c| c.chars().count());
        cells.chain([head[i].as_ref().chars().count(), 3]).max().unwrap_or(3)
    };
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let line = |cells: Vec<&str>| {
        let padded = cells.iter().zip(&widths).map(|(cell, &w)| format!("{cell:<w$}"));
        format!("| {} |\n", padded.collect::<Vec<_>>().join(" | "))
    };
    let rule: Vec<String> = widths.iter().map(|&w| "-".repeat(w)).collect();
    let mut out = line(head.iter().map(AsRef::as_ref).collect());
    out.push_str(&line(rule.iter().map(String::as_str).collect()));
    rows.iter().for_each(|row| out.push_str(&line(row.iter().map(String::as_str).collect())));
    out
}

/// Lines of comma-separated values; cells that hold a comma, a quote or a line break are quoted.
pub fn csv(head: &[impl AsRef<str>], rows: &[Vec<String>]) -> String {
    let quoted = |cell: &str| match cell.contains([',', '"', '\n']) {
        true => format!("\"{}\"", cell.replace('"', "\"\"")),
        false => cell.to_owned(),
    };
    let line = |cells: Vec<String>| cells.join(",") + "\n";
    let head = line(head.iter().map(|h| quoted(h.as_ref())).collect());
    rows.iter().fold(head, |out, row| out + &line(row.iter().map(|c| quoted(c)).collect()))
}

/// `1.25 %`
pub fn percent(fraction: f64) -> String {
    format!("{:.2} %", 100.0 * fraction)
}

/// `+1.25 %`
pub fn signed_percent(fraction: f64) -> String {
    format!("{:+.2} %", 100.0 * fraction)
}

/// `12.3 s`
pub fn seconds(value: f64) -> String {
    format!("{} s", figures(value))
}

/// Median, and least and most where there are several runs.
pub fn spread(of: &Spread) -> String {
    match of.runs {
        0 | 1 => format!("{} (one run)", seconds(of.median)),
        n => format!("{} ({} to {}, {n} runs)", seconds(of.median), figures(of.least), figures(of.most)),
    }
}

/// Two or three figures.
pub fn figures(value: f64) -> String {
    match value {
        v if v >= 99.5 => format!("{v:.0}"),
        v if v >= 9.95 => format!("{v:.1}"),
        v => format!("{v:.2}"),
    }
}

/// `36`, `17.2k`, `1.05M`
pub fn count(n: u64) -> String {
    match n {
        0..=9_999 => n.to_string(),
        10_000..=99_949 => format!("{:.1}k", n as f64 / 1e3),
        99_950..=999_499 => format!("{:.0}k", n as f64 / 1e3),
        _ => format!("{:.2}M", n as f64 / 1e6),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_and_seconds_are_short() {
        assert_eq!([36, 17_234, 262_269, 1_050_000].map(count), ["36", "17.2k", "262k", "1.05M"]);
        assert_eq!([0.456, 12.34, 743.2].map(seconds), ["0.46 s", "12.3 s", "743 s"]);
        assert_eq!(spread(&Spread::of(&[8.5, 7.5, 9.5])), "8.50 s (7.50 to 9.50, 3 runs)");
        assert_eq!(spread(&Spread::of(&[8.5])), "8.50 s (one run)");
    }

    #[test]
    fn cells_with_commas_and_quotes_are_quoted() {
        let text = csv(&["a", "b,c"], &[vec!["1".into(), "say \"x\"".into()]]);
        assert_eq!(text, "a,\"b,c\"\n1,\"say \"\"x\"\"\"\n");
    }

    #[test]
    fn columns_line_up() {
        let text = table(&["a", "long"], &[vec!["12345".into(), "x".into()]]);
        assert_eq!(text, "| a     | long |\n| ----- | ---- |\n| 12345 | x    |\n");
    }
}
