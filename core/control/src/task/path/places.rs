//! A path as a list of places, for checks of the whole path before it runs.

use nalgebra::Vector2;

use super::Path;
use super::shape::Shape;

/// Maximum number of places of one path: a longer path gets a wider spacing.
const PLACES_MAX: f64 = 20_000.0;

/// A point of the path and its distance along the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPlace {
    /// Distance along the path from its start, m.
    pub way_m: f64,
    /// Plane coordinates, m.
    pub position: Vector2<f64>,
}

impl Path {
    /// The path from start to end in steps of at most about `spacing_m`, m, with every corner. A
    /// path longer than 100 m at 5 mm gets wider steps and keeps its corners. Allocates.
    pub fn places(&self, spacing_m: f64) -> Vec<PathPlace> {
        let ends: Vec<(&Shape, f64)> = self
            .stretches
            .iter()
            .map(|stretch| {
                let (end, _) = stretch.profile.at(self.duration_s - stretch.start_s);
                (&stretch.shape, end)
            })
            .collect();
        let total_m: f64 = ends.iter().map(|(shape, end)| shape.way_max_m(*end)).sum();
        let spacing_m = spacing_m.max(total_m / PLACES_MAX);
        let mut last = PathPlace {
            way_m: 0.0,
            position: Vector2::zeros(),
        };
        let mut places = vec![last];
        for (shape, end) in ends {
            let steps = (shape.way_max_m(end) / spacing_m).ceil().max(1.0) as usize;
            for step in 1..=steps {
                let position = shape
                    .at(&self.points, end * step as f64 / steps as f64, 0.0)
                    .position;
                last = PathPlace {
                    way_m: last.way_m + (position - last.position).norm(),
                    position,
                };
                places.push(last);
            }
        }
        places
    }
}

#[cfg(test)]
mod tests {
    use super::super::PathSpec;
    use super::*;

    fn places(toml: &str) -> Vec<PathPlace> {
        let spec: PathSpec = toml::from_str(toml).unwrap();
        Path::new(&spec, 0.1, 1.0).unwrap().places(0.005)
    }

    #[test]
    fn places_are_near_each_other_and_hold_every_corner() {
        for (toml, length_m) in [
            (
                "kind = \"raster\"\nlength_m = 0.2\nstep_m = 0.05\nlines = 3\nspeed_m_per_s = 0.02",
                0.7,
            ),
            (
                "kind = \"circle\"\nradius_m = 0.05\nspeed_m_per_s = 0.03",
                0.314,
            ),
            (
                "kind = \"line\"\nto_m = [0.03, -0.04]\nspeed_m_per_s = 0.02\nstrokes = 3",
                0.15,
            ),
            ("kind = \"stay\"\nduration_s = 3.0", 0.0),
        ] {
            let places = places(toml);
            for pair in places.windows(2) {
                let step = (pair[1].position - pair[0].position).norm();
                assert!(step <= 0.005 + 1e-9, "{toml}: {step}");
            }
            let way = places.last().unwrap().way_m;
            assert!((way - length_m).abs() < 1e-3, "{toml}: {way} m");
        }
        let corner = Vector2::new(0.2, 0.05);
        let raster = places(
            "kind = \"raster\"\nlength_m = 0.2\nstep_m = 0.05\nlines = 3\nspeed_m_per_s = 0.02",
        );
        assert!(raster.iter().any(|p| (p.position - corner).norm() < 1e-12));
    }

    #[test]
    fn a_path_that_is_cut_off_by_its_duration_ends_where_it_runs_to() {
        let toml = "kind = \"raster\"\nlength_m = 0.2\nstep_m = 0.2\nspeed_m_per_s = 0.02\nduration_s = 5.0";
        let spec: PathSpec = toml::from_str(toml).unwrap();
        let path = Path::new(&spec, 0.1, 1.0).unwrap();
        let last = *path.places(0.005).last().unwrap();
        assert!((last.position - path.at(5.0).position).norm() < 1e-12);
        assert!(last.way_m < 0.11, "{last:?}");
    }

    #[test]
    fn a_path_of_kilometres_has_a_bounded_number_of_places() {
        let long = places(
            "kind = \"raster\"\nlength_m = 2.0\nstep_m = 0.002\nlines = 1000\nspeed_m_per_s = 0.2",
        );
        assert!(long.len() < 25_000, "{}", long.len());
    }
}
