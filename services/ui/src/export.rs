//! The dose map as files for other programs, and as the JSON that the page paints.

use std::fmt::Write;

use nalgebra::Vector3;
use serde_json::{Value, json};

use crate::snapshot::round;
use tangent_scene::dose::{Cell, DoseMap, Judgement};

/// Colours of the map: below the band, within it, above it.
const COLOURS: [[u8; 3]; 3] = [[64, 128, 230], [40, 165, 85], [220, 60, 50]];

/// Where a dose lies: 0 below the band, 1 within it, 2 above it.
fn place_in_band(dose: f64, band: [f64; 2]) -> usize {
    if dose < band[0] {
        0
    } else if dose <= band[1] {
        1
    } else {
        2
    }
}

/// Cells that have changed after a revision of this epoch, or all of them for another epoch.
///
/// Each cell is `[number, x_mm, y_mm, z_mm, nx, ny, nz, dose]`.
pub fn json(map: &DoseMap, judged: &Judgement, epoch: u64, revision: u64) -> Value {
    let after = if epoch == map.epoch() { revision } else { 0 };
    let cell = |cell: &Cell| {
        let [x, y, z] = millimetres(&cell.point);
        let n = cell.normal.map(|x| round(x, 1e3));
        json!([cell.number, x, y, z, n.x, n.y, n.z, round(cell.dose(), 1e4)])
    };
    json!({
        "epoch": map.epoch(),
        "revision": map.revision(),
        "cells": map.changed(after).map(cell).collect::<Vec<_>>(),
        "cell_mm": round(map.cell_m() * 1e3, 1e3),
        "band": judged.band.map(|x| round(x, 1e4)),
        "band_is_default": judged.is_default,
        "impulse_n_s": round(map.impulse_n_s(), 1e2),
        "missed_s": round(map.missed_s(), 1e2),
        "area_cm2": round(judged.area_cm2, 1e2),
        "good_cm2": round(judged.good_cm2, 1e2),
        "over_cm2": round(judged.over_cm2, 1e2),
        "hole_cm2": round(judged.hole_cm2, 1e2),
        "holes": judged.holes.iter().map(millimetres).collect::<Vec<_>>(),
    })
}

fn millimetres(point: &Vector3<f64>) -> [f64; 3] {
    [point.x, point.y, point.z].map(|x| round(x * 1e3, 1e1))
}

/// One line per cell. Places are in world axes; `band` is -1 below the wanted dose, 0 within it, 1
/// above it.
pub fn csv(map: &DoseMap, judged: &Judgement) -> String {
    let mut text =
        String::from("x_m,y_m,z_m,normal_x,normal_y,normal_z,dose_n_s_per_cm2,area_cm2,band\n");
    for cell in map.cells() {
        let (p, n) = (cell.point, cell.normal);
        let band = place_in_band(cell.dose(), judged.band) as i32 - 1;
        // Writing to a String does not fail.
        let _ = writeln!(
            text,
            "{:.6},{:.6},{:.6},{:.6},{:.6},{:.6},{:.6},{:.6},{band}",
            p.x,
            p.y,
            p.z,
            n.x,
            n.y,
            n.z,
            cell.dose(),
            cell.area_cm2
        );
    }
    text
}

/// A point cloud with normals, colours and the dose, as text.
pub fn ply(map: &DoseMap, judged: &Judgement) -> String {
    let mut text = format!(
        "ply\nformat ascii 1.0\ncomment pressure dose, N*s/cm2, world axes, m; wanted {:.4} to {:.4}\n\
         element vertex {}\n",
        judged.band[0],
        judged.band[1],
        map.cells().len()
    );
    for name in ["x", "y", "z", "nx", "ny", "nz"] {
        text += &format!("property float {name}\n");
    }
    for name in ["red", "green", "blue"] {
        text += &format!("property uchar {name}\n");
    }
    text += "property float dose\nend_header\n";
    for cell in map.cells() {
        let (p, n) = (cell.point, cell.normal);
        let [r, g, b] = COLOURS[place_in_band(cell.dose(), judged.band)];
        // Writing to a String does not fail.
        let _ = writeln!(
            text,
            "{:.6} {:.6} {:.6} {:.6} {:.6} {:.6} {r} {g} {b} {:.6}",
            p.x,
            p.y,
            p.z,
            n.x,
            n.y,
            n.z,
            cell.dose()
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use tangent_scene::Pressed;

    use super::*;

    fn map() -> DoseMap {
        let mut map = DoseMap::new(0.01);
        for step in 0..100 {
            map.press(
                &Pressed {
                    point: Vector3::new(f64::from(step) * 0.001, 0.0, 0.2),
                    normal: Vector3::z(),
                    force_n: 5.0,
                    reference_n: 5.0,
                },
                0.01,
            );
        }
        map
    }

    #[test]
    fn the_files_have_every_cell_and_the_whole_impulse() {
        let map = map();
        let judged = map.judge(None);
        let csv = csv(&map, &judged);
        let rows: Vec<Vec<f64>> = csv
            .lines()
            .skip(1)
            .map(|line| line.split(',').map(|x| x.parse().unwrap()).collect())
            .collect();
        assert_eq!(rows.len(), map.cells().len());
        assert!(rows.iter().all(|row| row.len() == 9));
        let total: f64 = rows.iter().map(|row| row[6] * row[7]).sum();
        assert!((total - 5.0).abs() < 1e-3, "{total}");

        let ply = ply(&map, &judged);
        let (head, body) = ply.split_once("end_header\n").unwrap();
        assert!(head.contains(&format!("element vertex {}\n", rows.len())));
        assert_eq!(head.matches("property").count(), 10);
        assert_eq!(body.lines().count(), rows.len());
        assert!(body.lines().all(|line| line.split(' ').count() == 10));
    }

    #[test]
    fn a_page_reads_the_changes_of_its_epoch_and_else_everything() {
        let map = map();
        let judged = map.judge(Some([0.1, 1.0]));
        let count = |epoch, revision| {
            let value = json(&map, &judged, epoch, revision);
            value["cells"].as_array().unwrap().len()
        };
        let all = map.cells().len();
        assert_eq!(count(map.epoch(), 0), all);
        assert_eq!(count(map.epoch(), map.revision()), 0);
        assert!((1..all).contains(&count(map.epoch(), map.revision() - 10)));
        assert_eq!(count(map.epoch() + 1, map.revision()), all);
        let value = json(&map, &judged, 0, 0);
        assert_eq!(value["band"], json!([0.1, 1.0]));
        assert_eq!(value["cells"][0].as_array().unwrap().len(), 8);
    }
}
