//! The folder of a paper's figures: one SVG file each, and a page with all of them.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result};

use crate::report::plot::{Axes, PALETTE, Series, draw};

/// A page under construction.
pub(super) struct FigurePage<'a> {
    folder: &'a Path,
    html: String,
}

impl<'a> FigurePage<'a> {
    /// Creates the folder.
    ///
    /// # Errors
    /// The folder cannot be created.
    pub fn new(folder: &'a Path, paper: &str, heading: &str, introduction: &str) -> Result<Self> {
        fs::create_dir_all(folder).with_context(|| format!("folder {}", folder.display()))?;
        let html = format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>tangent reproduce {paper}</title>\
<style>body {{ font: 15px/1.5 system-ui, sans-serif; max-width: 960px; margin: 2em auto; }} figure {{ margin: 1em 0; }} \
svg {{ width: 100%; height: auto; }}</style></head><body>\n<h1>{heading}</h1>\n<p>{introduction}</p>\n"
        );
        Ok(Self { folder, html })
    }

    /// Starts the section of a system; the next figures belong to it.
    pub fn system(&mut self, name: &str) {
        let _ = writeln!(self.html, "<h2>{name}</h2>");
    }

    /// Draws a figure into `FILE.svg` and the page.
    ///
    /// # Errors
    /// The figure cannot be drawn or written.
    pub fn figure(
        &mut self,
        file: &str,
        axes: &Axes<'_>,
        curves: &[(&str, Vec<(f64, f64)>)],
    ) -> Result<()> {
        let series: Vec<Series<'_>> = curves
            .iter()
            .zip(PALETTE)
            .map(|((name, points), colour)| Series {
                name,
                points,
                colour,
            })
            .collect();
        let svg = draw(axes, &series)?;
        let path = self.folder.join(format!("{file}.svg"));
        fs::write(&path, &svg).with_context(|| format!("file {}", path.display()))?;
        let _ = writeln!(self.html, "<figure>{svg}</figure>");
        Ok(())
    }

    /// Writes `index.html`.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(mut self) -> Result<()> {
        self.html += "</body></html>\n";
        let file = self.folder.join("index.html");
        fs::write(&file, self.html).with_context(|| format!("file {}", file.display()))
    }
}
