//! The report as one page of HTML that needs nothing else: no scripts, no network.

use std::fmt::Write;

use anyhow::Result;

use super::super::curves::Clock;
use super::super::plot::{Paper, svg};
use super::section::Section;
use super::{Report, circumstances};

const STYLE: &str = "
:root { color-scheme: light dark; --ink: #1d1f23; --paper: #fbfbfa; --card: #ffffff; --rule: #d9dadd; --soft: #5d626b; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e5e8; --paper: #17191c; --card: #1f2226; --rule: #3a3e45; --soft: #a3a8b1; }
}
body { margin: 0 auto; max-width: 74rem; padding: 1.5rem; background: var(--paper); color: var(--ink);
  font: 15px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.6rem; margin: 0 0 .3rem; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 .4rem; padding-top: .8rem; border-top: 1px solid var(--rule); }
p { margin: .4rem 0; max-width: 60rem; }
.soft { color: var(--soft); font-size: .87rem; }
nav ul { columns: 3 16rem; padding-left: 1.1rem; }
figure { margin: .8rem 0; padding: .5rem; background: var(--card); border: 1px solid var(--rule); border-radius: 6px; overflow-x: auto; }
figure svg { max-width: 100%; height: auto; display: block; }
.table { overflow-x: auto; }
table { border-collapse: collapse; font-size: .84rem; margin: .5rem 0; }
th, td { padding: .18rem .6rem; text-align: right; border-bottom: 1px solid var(--rule); white-space: nowrap; }
th { font-weight: 600; }
th:first-child, td:first-child, th:nth-child(2), td:nth-child(2) { text-align: left; }
code { font: .92em ui-monospace, monospace; }
details { margin: .4rem 0; }
summary { cursor: pointer; color: var(--soft); }
pre { overflow-x: auto; font-size: .8rem; }
";

/// The page.
///
/// # Errors
/// When a picture cannot be drawn.
pub fn page(report: &Report) -> Result<String> {
    let mut out = String::from("<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n");
    out.push_str("<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n");
    let _ = writeln!(out, "<title>Error and time</title>\n<style>{STYLE}</style>\n</head>\n<body>");
    let _ = writeln!(out, "<h1>Error and time</h1>\n<p class=\"soft\">{}</p>", escaped(&report.summary()));
    out.push_str("<nav><ul>\n");
    for section in &report.sections {
        let _ = writeln!(out, "<li><a href=\"#{}\">{}</a></li>", escaped(&section.id), escaped(&section.title));
    }
    out.push_str("</ul></nav>\n");
    for section in &report.sections {
        out.push_str(&of_section(section, report.clock)?);
    }
    out.push_str("</body>\n</html>\n");
    Ok(out)
}

fn of_section(section: &Section, clock: Clock) -> Result<String> {
    let mut out = format!("<section id=\"{}\">\n<h2>{}</h2>\n", escaped(&section.id), escaped(&section.title));
    let _ = writeln!(out, "<p>{}</p>", marked(&section.note));
    let _ = writeln!(out, "<p class=\"soft\">{}</p>", escaped(&circumstances(section)));
    for figure in section.figures(clock) {
        let _ = writeln!(out, "<figure>\n{}\n</figure>", svg(&figure, Paper::Around)?);
    }
    for line in section.left_out().iter().chain(&section.remarks) {
        let _ = writeln!(out, "<p class=\"soft\">{}</p>", marked(line));
    }
    let (head, rows) = section.table();
    out.push_str("<details open><summary>Data</summary><div class=\"table\"><table>\n<thead><tr>");
    head.iter().for_each(|cell| out.push_str(&format!("<th>{}</th>", marked(cell))));
    out.push_str("</tr></thead>\n<tbody>\n");
    for row in rows {
        let cells: String = row.iter().map(|cell| format!("<td>{}</td>", marked(cell))).collect();
        let _ = writeln!(out, "<tr>{cells}</tr>");
    }
    out.push_str("</tbody></table></div></details>\n<details><summary>Command lines</summary><pre>");
    for curve in section.curves.iter().filter(|c| !c.command.is_empty()) {
        let _ = writeln!(out, "{}: {}", escaped(&curve.title), escaped(&curve.command));
    }
    out.push_str("</pre></details>\n</section>\n");
    Ok(out)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Escaped, with what stands between backticks as code.
fn marked(text: &str) -> String {
    let parts = text.split('`').enumerate();
    parts.map(|(i, part)| if i % 2 == 1 { format!("<code>{}</code>", escaped(part)) } else { escaped(part) }).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::report;
    use super::*;

    #[test]
    fn the_page_stands_alone_and_is_whole() {
        let page = page(&report()).unwrap();
        for outside in ["<script", "<link", "@import", "url(", "src="] {
            assert!(!page.contains(outside), "{outside}");
        }
        // The name of the vector format is the only address.
        assert!(page.replace("http://www.w3.org/2000/svg", "").find("http").is_none());
        for tag in ["section", "table", "figure", "svg", "tr", "td", "details", "pre", "nav", "body"] {
            let opened = page.matches(&format!("<{tag}>")).count() + page.matches(&format!("<{tag} ")).count();
            assert_eq!(opened, page.matches(&format!("</{tag}>")).count(), "{tag}");
        }
        assert_eq!(page.matches("<svg").count(), 2);
        assert_eq!(page.matches("<tr>").count(), 1 + 3);
    }

    #[test]
    fn text_is_escaped_and_code_is_code() {
        assert_eq!(marked("a `x < 1` & b"), "a <code>x &lt; 1</code> &amp; b");
        let page = page(&report()).unwrap();
        assert!(page.contains("Triangles &amp; time") && !page.contains("Triangles & time"));
        assert!(page.contains("Radiance is absent") && page.contains("hplt points"));
    }
}
