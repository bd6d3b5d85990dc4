//! The page: one file that needs nothing else, no script, light and dark, readable on a phone.

use std::fmt::Write as _;

use super::plot;
use crate::compare::section::{Block, Bound, Cell, Curve, number};
use crate::compare::{Finding, Picture, Printed, Report};

const STYLE: &str = include_str!("style.css");

/// The whole report.
pub(in crate::compare) fn html(report: &Report) -> String {
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n\
         <title>Ghostlight: speed against error</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n\
         <header>\n<h1>Speed against error</h1>\n"
    );
    head(&mut page, report);
    page += "</header>\n<main>\n";
    for finding in &report.findings {
        section(&mut page, finding);
    }
    page + "</main>\n</body>\n</html>\n"
}

/// What was measured on, what holds, and where to find it.
fn head(page: &mut String, report: &Report) {
    let machine = &report.machine;
    let _ = writeln!(
        page,
        "<p>Every approximation of Ghostlight {} as a point of time against error, with its reference beside it. \
         Times are medians of rounds in which all variants take turns: trust ratios within one table, not \
         figures of different runs.</p>",
        machine.version
    );
    let mut facts = vec![
        ("processor", machine.cpu.clone()),
        (
            "threads",
            format!("{} of {}", report.settings.threads, machine.cores),
        ),
        ("backend", report.settings.backend.name().to_owned()),
        ("instructions", machine.instructions.clone()),
        ("system", machine.os.clone()),
        ("build", machine.build.to_owned()),
        ("date", machine.date.clone()),
        (
            "run",
            if report.settings.quick {
                "quick"
            } else {
                "full"
            }
            .to_owned(),
        ),
        ("recordings", report.settings.views.join(", ")),
    ];
    if let Some(commit) = &machine.commit {
        facts.insert(5, ("commit", commit.clone()));
    }
    page.push_str("<dl class=\"facts\">\n");
    for (name, value) in facts {
        let _ = writeln!(
            page,
            "<div><dt>{name}</dt><dd>{}</dd></div>",
            escape(&value)
        );
    }
    page.push_str("</dl>\n");
    let broken = report.broken();
    let n = report.n_bounds();
    if n == 0 && broken.is_empty() {
        // Nothing was bounded: nothing to say.
    } else if broken.is_empty() {
        let _ = writeln!(
            page,
            "<p class=\"verdict kept\">All {n} bounds are kept.</p>"
        );
    } else {
        let _ = writeln!(
            page,
            "<div class=\"verdict broken\"><p>{} of {n} bounds do not hold:</p><ul>",
            broken.len()
        );
        for line in &broken {
            let _ = writeln!(page, "<li>{}</li>", escape(line));
        }
        page.push_str("</ul></div>\n");
    }
    page.push_str("<nav><ol>\n");
    for finding in &report.findings {
        let _ = writeln!(
            page,
            "<li><a href=\"#{0}\">{1}</a> {2}<br><span>{3}</span></li>",
            finding.name,
            escape(finding.title),
            badge(finding),
            escape(finding.question),
        );
    }
    page.push_str("</ol></nav>\n");
}

fn badge(finding: &Finding) -> &'static str {
    let bounds = &finding.section.bounds;
    if finding.failed.is_some() {
        "<b class=\"broken\">failed</b>"
    } else if bounds.iter().any(|bound| !bound.kept) {
        "<b class=\"broken\">broken</b>"
    } else if bounds.is_empty() {
        ""
    } else {
        "<b class=\"kept\">kept</b>"
    }
}

fn section(page: &mut String, finding: &Finding) {
    let _ = writeln!(
        page,
        "<section id=\"{}\">\n<h2>{}</h2>\n<p class=\"question\">{}</p>",
        finding.name,
        escape(finding.title),
        escape(finding.question)
    );
    if let Some(failed) = &finding.failed {
        let _ = writeln!(
            page,
            "<p class=\"verdict broken\">This could not be finished: {}</p>",
            escape(failed)
        );
    }
    bounds(page, &finding.section.bounds);
    for block in &finding.section.blocks {
        match block {
            Block::Prose { text } => {
                let _ = writeln!(page, "<p>{}</p>", prose(text));
            }
            Block::Curve(c) => curve(page, c),
            Block::Pictures { pictures: all } => pictures(page, all),
        }
    }
    let _ = writeln!(
        page,
        "<p class=\"small\"><a href=\"{0}.csv\">{0}.csv</a> · took {1} s</p>\n</section>",
        finding.name,
        number(finding.seconds)
    );
}

fn bounds(page: &mut String, bounds: &[Bound]) {
    if bounds.is_empty() {
        return;
    }
    page.push_str(
        "<div class=\"scroll\"><table class=\"bounds\"><thead><tr><th>must hold</th><th>expected</th>\
         <th>got</th><th></th></tr></thead><tbody>\n",
    );
    for bound in bounds {
        let (class, word) = if bound.kept {
            ("kept", "kept")
        } else {
            ("broken", "broken")
        };
        let _ = writeln!(
            page,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td><b class=\"{class}\">{word}</b></td></tr>",
            prose(&bound.what),
            escape(&bound.expected),
            escape(&bound.got)
        );
    }
    page.push_str("</tbody></table></div>\n");
}

fn curve(page: &mut String, curve: &Curve) {
    let names = plot::series(curve);
    let _ = writeln!(
        page,
        "<figure>\n<figcaption>{}</figcaption>",
        prose(&curve.title)
    );
    if curve.plot.is_some() {
        page.push_str("<div class=\"plot\">\n");
        page.push_str(&plot::svg(curve));
        if names.len() > 1
            || curve
                .points
                .iter()
                .any(|p| p.printed.is_some() || p.reference)
        {
            legend(page, curve, &names);
        }
        page.push_str("</div>\n");
    }
    page.push_str("<div class=\"scroll\"><table><thead><tr><th></th>");
    for column in &curve.columns {
        let _ = write!(page, "<th>{}</th>", escape(&plot::named(column)));
    }
    page.push_str("</tr></thead><tbody>\n");
    for point in curve.points.iter().filter(|point| point.printed.is_none()) {
        let class = if point.reference {
            " class=\"reference\""
        } else {
            ""
        };
        let swatch = if curve.plot.is_some() && names.len() > 1 {
            format!("<i class=\"{}\"></i>", plot::color(&names, &point.series))
        } else {
            String::new()
        };
        let series = if names.len() > 1 && !point.series.is_empty() && point.series != point.label {
            format!("<span>{}</span> ", escape(&point.series))
        } else {
            String::new()
        };
        let _ = write!(
            page,
            "<tr{class}><th>{swatch}{series}{}</th>",
            escape(&point.label)
        );
        for value in &point.values {
            let class = match value {
                Cell::Number(_) => "",
                Cell::Text(_) => " class=\"text\"",
            };
            let _ = write!(page, "<td{class}>{}</td>", escape(&cell(value)));
        }
        page.push_str("</tr>\n");
    }
    page.push_str("</tbody></table></div>\n");
    printed(page, curve);
    page.push_str("</figure>\n");
}

/// Figures that others printed, under their sources.
fn printed(page: &mut String, curve: &Curve) {
    let mut sources: Vec<Printed> = Vec::new();
    for printed in curve.points.iter().filter_map(|point| point.printed) {
        if !sources.contains(&printed) {
            sources.push(printed);
        }
    }
    for source in sources {
        let points = curve.points.iter().filter(|p| p.printed == Some(source));
        let figures: Vec<String> = points
            .map(|point| {
                let known = curve.columns.iter().zip(&point.values);
                let known = known.filter(|(_, value)| !value.number().is_nan());
                let known: Vec<String> = known
                    .map(|(column, value)| format!("{} {}", cell(value), column.unit))
                    .collect();
                format!(
                    "{}: <b>{}</b>",
                    escape(&point.label),
                    escape(known.join(", ").trim())
                )
            })
            .collect();
        let _ = writeln!(
            page,
            "<p class=\"printed\">Printed by {} ({}): {}.</p>",
            escape(source.source),
            escape(source.machine),
            figures.join("; ")
        );
    }
}

fn legend(page: &mut String, curve: &Curve, names: &[&str]) {
    page.push_str("<p class=\"legend\">");
    if names.len() > 1 {
        for name in names {
            let _ = write!(
                page,
                "<span><i class=\"{}\"></i>{}</span> ",
                plot::color(names, name),
                escape(name)
            );
        }
    }
    if curve.points.iter().any(|point| point.reference) {
        page.push_str("<span><i class=\"ring\"></i>reference</span> ");
    }
    if curve.points.iter().any(|point| point.printed.is_some()) {
        page.push_str("<span><i class=\"diamond\"></i>printed in a paper, its machine</span>");
    }
    page.push_str("</p>\n");
}

fn pictures(page: &mut String, pictures: &[Picture]) {
    page.push_str("<div class=\"pictures\">\n");
    for picture in pictures {
        let _ = writeln!(
            page,
            "<figure><img src=\"data:image/png;base64,{}\" width=\"{}\" height=\"{}\" alt=\"{}\">\
             <figcaption>{}</figcaption></figure>",
            base64(&picture.png),
            picture.width,
            picture.height,
            escape(&picture.caption),
            prose(&picture.caption)
        );
    }
    page.push_str("</div>\n");
}

/// A cell as text.
pub(super) fn cell(cell: &Cell) -> String {
    match cell {
        Cell::Number(x) => number(*x),
        Cell::Text(text) => text.clone(),
    }
}

/// Text that HTML takes for text.
pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// [`escape`], and what stands between backticks as code.
fn prose(text: &str) -> String {
    let mut told = String::new();
    for (i, part) in text.split('`').enumerate() {
        if i % 2 == 0 {
            told += &escape(part);
        } else {
            let _ = write!(told, "<code>{}</code>", escape(part));
        }
    }
    told
}

/// RFC 4648, section 4.
fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let byte = |i: usize| u32::from(chunk.get(i).copied().unwrap_or(0));
        let bits = byte(0) << 16 | byte(1) << 8 | byte(2);
        for i in 0..4 {
            if i <= chunk.len() {
                text.push(char::from(LETTERS[(bits >> (18 - 6 * i) & 63) as usize]));
            } else {
                text.push('=');
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_as_in_rfc_4648() {
        for (plain, coded) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
        assert_eq!(base64(&[0xfb, 0xff, 0xfe]), "+//+");
    }

    #[test]
    fn text_stays_text() {
        assert_eq!(
            prose("a < b & `x > \"y\"`"),
            "a &lt; b &amp; <code>x &gt; &quot;y&quot;</code>"
        );
    }
}
