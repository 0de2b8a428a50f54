//! One page of all results: the pages of the docs that have tables or plots, with every picture inside.

use anyhow::{Context, Result, bail};
use base64::{Engine as _, prelude::BASE64_STANDARD};
use pulldown_cmark::{CowStr, Event, Options, Parser, Tag, TagEnd, html};
use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

/// Pages of `docs`, in this order.
const PAGES: [(&str, &str); 8] = [
    ("accuracy", "Accuracy"),
    ("aomask-exact", "Masks and fans, exact"),
    ("aomask", "Mask ambient occlusion (Laine and Karras 2010)"),
    ("prefilter", "Prefiltered occlusion (Lacewell 2008)"),
    ("volumetric", "Volumetric occluders (Djeu 2011)"),
    ("reyes", "Reyes with ray footprints (Djeu 2011)"),
    ("anyhit", "Single rays and batches"),
    ("benchmarks", "What the suites measure"),
];

/// Browsers that can open a page without a screen.
const BROWSERS: [&str; 3] = ["chromium", "chromium-browser", "google-chrome"];

/// Widths at which the page is opened, pixels: a desktop and a phone.
const WIDTHS: [u32; 2] = [1280, 390];

const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;margin:0 auto;max-width:70rem;padding:1rem;color:#222;background:#fff}\
    img,svg{max-width:100%;height:auto}table{border-collapse:collapse;font-size:.85rem;display:block;overflow-x:auto}\
    th,td{padding:.2rem .6rem;border-bottom:1px solid #ddd;text-align:left;vertical-align:top}\
    pre{overflow-x:auto;background:#f6f6f6;padding:.6rem}code{font-size:.9em;overflow-wrap:anywhere}\
    summary{cursor:pointer;font-size:1.4rem;font-weight:600;margin:1rem 0}";

/// Writes the page to `output`; with `open`, a browser opens it at two widths and leaves screenshots beside it.
pub fn run(root: &Path, output: &Path, open: bool) -> Result<()> {
    let docs = root.join("docs");
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width, \
         initial-scale=1\"><title>Umbrage: results</title><style>{STYLE}</style></head><body><h1>Umbrage: results</h1>\n"
    );
    page += &converted(&docs.join("results/README.md"))?;
    for (name, title) in PAGES {
        let text = converted(&docs.join(format!("{name}.md")))?;
        page += &format!("<details id=\"{name}\" open><summary>{title}</summary>\n{text}</details>\n");
    }
    page += "</body></html>\n";
    if let Some(folder) = output.parent() {
        fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    fs::write(output, &page).with_context(|| output.display().to_string())?;
    println!("{}: {:.1} MB", output.display(), page.len() as f64 * 1e-6);
    if open { opened(output) } else { Ok(()) }
}

/// A page of the docs as HTML. Pictures are inside, links to other pages lead within the report; its title is left
/// out.
fn converted(path: &Path) -> Result<String> {
    let text = fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let folder = path.parent().unwrap_or(Path::new("."));
    let mut events = Vec::new();
    let (mut is_title, mut in_picture, mut in_comment) = (false, false, false);
    for event in Parser::new_ext(&text, Options::ENABLE_TABLES) {
        match event {
            Event::Start(Tag::Heading { level: pulldown_cmark::HeadingLevel::H1, .. }) => is_title = true,
            Event::End(TagEnd::Heading(pulldown_cmark::HeadingLevel::H1)) => is_title = false,
            _ if is_title => {}
            Event::Start(Tag::Image { dest_url, title, .. }) => {
                in_picture = true;
                events.push(Event::InlineHtml(picture(&folder.join(&*dest_url), &title)?.into()));
            }
            Event::End(TagEnd::Image) => in_picture = false,
            _ if in_picture => {}
            Event::Start(Tag::Link { link_type, dest_url, title, id }) => {
                let dest_url = within(&dest_url);
                events.push(Event::Start(Tag::Link { link_type, dest_url, title, id }));
            }
            // Descriptions of tables are comments of several lines.
            Event::End(TagEnd::HtmlBlock) if in_comment => in_comment = false,
            Event::Html(text) if in_comment || text.starts_with("<!--") => in_comment = true,
            other => events.push(other),
        }
    }
    let mut out = String::new();
    html::push_html(&mut out, events.into_iter());
    Ok(out)
}

/// Where a link of the docs leads in the report.
fn within(url: &str) -> CowStr<'static> {
    let page = url.split('#').next().unwrap_or("").trim_end_matches(".md");
    let known = PAGES.iter().any(|(name, _)| *name == page);
    if known { format!("#{page}").into() } else { url.to_owned().into() }
}

/// An `img` with the file inside.
fn picture(path: &Path, title: &str) -> Result<String> {
    let bytes = fs::read(path).with_context(|| path.display().to_string())?;
    let kind = match path.extension().and_then(|extension| extension.to_str()) {
        Some("svg") => "svg+xml",
        Some("png") => "png",
        _ => bail!("{}: pictures are .svg or .png", path.display()),
    };
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let data = BASE64_STANDARD.encode(bytes);
    Ok(format!("<img alt=\"{name}\" title=\"{title}\" src=\"data:image/{kind};base64,{data}\">"))
}

/// Opens the page in a browser without a screen, fails on errors that its console names, and keeps screenshots.
fn opened(page: &Path) -> Result<()> {
    let page = std::path::absolute(page)?;
    let Some(browser) = BROWSERS.iter().find(|name| Command::new(name).arg("--version").output().is_ok())
    else {
        println!("skipped: none of {} is installed, so the page was not opened", BROWSERS.join(", "));
        return Ok(());
    };
    for width in WIDTHS {
        let picture: PathBuf = page.with_extension(format!("{width}.png"));
        let output = Command::new(browser)
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--enable-logging=stderr",
                "--hide-scrollbars",
            ])
            .arg(format!("--window-size={width},3000"))
            .arg(format!("--screenshot={}", picture.display()))
            .arg(format!("file://{}", page.display()))
            .output()
            .with_context(|| (*browser).to_owned())?;
        let log = String::from_utf8_lossy(&output.stderr).into_owned();
        let errors: Vec<&str> = log.lines().filter(|line| line.contains(":CONSOLE(")).collect();
        if !output.status.success() || !errors.is_empty() {
            bail!("{browser} at {width} pixels: {}", errors.join("; "));
        }
        println!("{}: no console errors", picture.display());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_report_holds_every_table_and_loads_nothing() {
        let folder = std::env::temp_dir().join(format!("xtask-report-{}", std::process::id()));
        let output = folder.join("report.html");
        run(&Path::new(env!("CARGO_MANIFEST_DIR")).join(".."), &output, false).unwrap();
        let page = fs::read_to_string(&output).unwrap();
        fs::remove_dir_all(&folder).unwrap();
        for expected in [
            "mask-prefilter",
            "data:image/svg+xml",
            "exact-final-approach",
            "<td>+ 5. hemisphere facing</td>",
        ] {
            assert!(page.contains(expected), "{expected}");
        }
        assert!(!page.contains("src=\"http") && !page.contains("<script") && !page.contains("column mask |"));
    }

    #[test]
    fn links_stay_within() {
        assert_eq!(&*within("reyes.md#rates-chosen-once"), "#reyes");
        assert_eq!(&*within("../crates/scene"), "../crates/scene");
    }
}
