//! Tests every shape against finite differences of its own distance.

use nalgebra::Vector3;
use proptest::prelude::*;

use super::*;
use crate::pose_config::PoseConfig;

use super::graph::Graph;
use super::wave::Wave;

const TABLE: &str = "
# x to the right, y down, metres
y\\x,   -0.15, -0.10, -0.05,  0.00,  0.05,  0.10, 0.15
-0.10,  0.000, 0.001, 0.004, 0.003, 0.001, 0.000, 0.000
-0.05,  0.001, 0.004, 0.008, 0.009, 0.004, 0.001, 0.000
 0.00,  0.002, 0.006, 0.012, 0.010, 0.006, 0.002, 0.001
 0.05,  0.001, 0.004, 0.007, 0.006, 0.003, 0.002, 0.001
 0.10,  0.000, 0.001, 0.002, 0.002, 0.001, 0.001, 0.000
";

/// Every shape, with a point on it that is far from its edges compared with a small step.
fn shapes() -> Vec<(&'static str, ShapeConfig, Vector3<f64>)> {
    vec![
        ("plane", ShapeConfig::Plane {}, Vector3::new(0.1, 0.2, 0.0)),
        (
            "cylinder",
            ShapeConfig::Cylinder { radius_m: 0.25 },
            Vector3::new(0.1, 0.2, 0.3),
        ),
        (
            "cone",
            ShapeConfig::Cone {
                height_m: 0.75,
                base_radius_m: 0.18,
            },
            Vector3::new(0.05, 0.1, 0.3),
        ),
        (
            "sphere",
            ShapeConfig::Sphere { radius_m: 0.2 },
            Vector3::new(0.05, 0.1, 0.1),
        ),
        (
            "ellipsoid",
            ShapeConfig::Ellipsoid {
                semi_axes_m: [0.3, 0.2, 0.15],
            },
            Vector3::new(0.1, 0.1, 0.1),
        ),
        (
            "step",
            ShapeConfig::Step {
                height_m: 0.02,
                edge_radius_m: 0.001,
            },
            Vector3::new(0.05, 0.1, 0.02),
        ),
        (
            "torus outside",
            ShapeConfig::Torus {
                major_radius_m: 0.3,
                minor_radius_m: 0.1,
            },
            Vector3::new(0.3, 0.2, 0.07),
        ),
        (
            "torus inside",
            ShapeConfig::Torus {
                major_radius_m: 0.3,
                minor_radius_m: 0.1,
            },
            Vector3::new(0.15, 0.15, 0.05),
        ),
        (
            "sheet",
            ShapeConfig::Sheet {
                amplitude_m: [0.01, 0.006],
                wavelength_m: [0.2, 0.3],
            },
            Vector3::new(0.07, 0.03, 0.0),
        ),
        (
            "wave",
            ShapeConfig::Wave {
                amplitude_m: 0.02,
                wavelength_m: 0.38,
                phase_rad: 0.44,
                offset_m: 0.02,
                size_m: [0.26, 0.51],
            },
            Vector3::new(0.05, -0.08, 0.01),
        ),
        (
            "height field",
            ShapeConfig::HeightField {
                csv: Some(TABLE.to_owned()),
                csv_file: None,
            },
            Vector3::new(0.02, 0.013, 0.0),
        ),
    ]
}

fn pose() -> PoseConfig {
    PoseConfig {
        position_m: [0.4, -0.1, 0.2],
        roll_pitch_yaw_rad: [0.4, -0.7, 1.1],
    }
}

proptest! {
    #[test]
    fn distance_normal_point_and_curvature_agree(offset in prop::array::uniform3(-0.02f64..0.02)) {
        for (name, shape, near) in shapes() {
            let surface = Surface::new(&shape, &pose()).unwrap();
            let anchor = surface.query(&pose().isometry().transform_point(&near.into()).coords);
            let p = anchor.point + Vector3::from(offset) * 0.4;
            let at = surface.query(&p);
            prop_assert!((at.normal.norm() - 1.0).abs() < 1e-12, "{name}");
            // The closest point lies on the surface, and the normal there is the same.
            let on = surface.query(&at.point);
            prop_assert!(on.distance.abs() < 1e-10, "{name}: {}", on.distance);
            prop_assert!((on.normal - at.normal).norm() < 1e-8, "{name}");
            // The normal is the gradient of the distance.
            let h = 1e-6;
            for axis in 0..3 {
                let step = Vector3::ith(axis, h);
                let (plus, _) = surface.distance_and_normal(&(p + step));
                let (minus, _) = surface.distance_and_normal(&(p - step));
                prop_assert!(((plus - minus) / (2.0 * h) - at.normal[axis]).abs() < 1e-7, "{name}");
            }
            // The shape operator is the derivative of the normal along the surface.
            prop_assert!((at.curvature - at.curvature.transpose()).norm() < 1e-9, "{name}");
            prop_assert!((at.curvature * at.normal).norm() < 1e-9, "{name}");
            for axis in 0..3 {
                let along = Vector3::ith(axis, 1.0) - at.normal * at.normal[axis];
                let (_, plus) = surface.distance_and_normal(&(at.point + along * h));
                let (_, minus) = surface.distance_and_normal(&(at.point - along * h));
                let turned = (plus - minus) / (2.0 * h);
                prop_assert!((turned - at.curvature * along).norm() < 1e-4, "{name}: {turned} {}", at.curvature * along);
            }
        }
    }
}

#[test]
fn outside_is_positive_and_convex_bodies_have_positive_curvature() {
    let identity = PoseConfig::default();
    for (name, shape, near) in shapes() {
        let surface = Surface::new(&shape, &identity).unwrap();
        let on = surface.query(&near);
        let out = surface.query(&(on.point + on.normal * 0.01));
        assert!(
            (out.distance - 0.01).abs() < 1e-9,
            "{name}: {}",
            out.distance
        );
        let inside = surface.query(&(on.point - on.normal * 0.005));
        assert!(
            (inside.distance + 0.005).abs() < 1e-9,
            "{name}: {}",
            inside.distance
        );
    }
    let radius = |shape: &ShapeConfig, p: Vector3<f64>| {
        Surface::new(shape, &identity)
            .unwrap()
            .query(&p)
            .curvature
            .symmetric_eigenvalues()
            .max()
    };
    let pipe = ShapeConfig::Cylinder { radius_m: 0.25 };
    assert!((radius(&pipe, Vector3::new(0.3, 0.0, 0.0)) - 4.0).abs() < 1e-9);
    let ball = ShapeConfig::Sphere { radius_m: 0.2 };
    assert!((radius(&ball, Vector3::new(0.3, 0.0, 0.0)) - 5.0).abs() < 1e-9);
    let ring = ShapeConfig::Torus {
        major_radius_m: 0.3,
        minor_radius_m: 0.1,
    };
    let inner = Surface::new(&ring, &identity)
        .unwrap()
        .query(&Vector3::new(0.19, 0.0, 0.0));
    assert!(
        (inner.curvature[(1, 1)] + 5.0).abs() < 1e-9,
        "the inner side is a saddle"
    );
}

#[test]
fn a_height_field_goes_through_its_table() {
    let field = HeightField::from_csv(TABLE).unwrap();
    for (p, z) in [
        ((-0.05, 0.0), 0.012),
        ((-0.15, -0.10), 0.0),
        ((0.15, 0.0), 0.001),
    ] {
        let (distance, _) = field.distance_and_normal(&Vector3::new(p.0, p.1, z));
        assert!(distance.abs() < 1e-12, "{p:?}: {distance}");
    }
}

#[test]
fn a_bad_table_is_refused_with_its_place() {
    let error = |text: &str| HeightField::from_csv(text).unwrap_err().to_string();
    assert!(error("").contains("at least 4"));
    assert!(error(",0,1,2,3\n0,0,0,x,0").contains("line 2, column 4: `x`"));
    assert!(error(",0,1,2,3\n0,0,0,0").contains("line 2 has 4 cells, but 5"));
    let uneven = ",0,1,2,5\n0,0,0,0,0\n1,0,0,0,0\n2,0,0,0,0\n3,0,0,0,0";
    assert!(error(uneven).contains("x coordinates must increase"));
    assert!(error(",0,1,2,3\n0,0,0,inf,0").contains("inf"));
}

#[test]
fn a_bad_dimension_is_refused() {
    let pose = PoseConfig::default();
    let error = Surface::new(&ShapeConfig::Sphere { radius_m: -0.1 }, &pose).unwrap_err();
    assert!(error.to_string().contains("radius_m"));
    let fat = ShapeConfig::Torus {
        major_radius_m: 0.1,
        minor_radius_m: 0.2,
    };
    assert!(
        Surface::new(&fat, &pose)
            .unwrap_err()
            .to_string()
            .contains("smaller than")
    );
}

#[test]
fn past_its_sides_a_wave_is_not_there() {
    let shape = ShapeConfig::Wave {
        amplitude_m: 0.02,
        wavelength_m: 0.38,
        phase_rad: 0.44,
        offset_m: 0.02,
        size_m: [0.26, 0.51],
    };
    let wave = Surface::new(&shape, &PoseConfig::default()).unwrap();
    // At y = 0 the top is at 0.02 sin(0.44) + 0.02.
    let top = 0.02 * 0.44f64.sin() + 0.02;
    let inside = wave.query(&Vector3::new(0.129, 0.0, top));
    assert!(inside.distance.abs() < 1e-12);
    for (x, y) in [(0.131, 0.0), (-0.2, 0.1), (0.0, 0.256), (0.0, -0.3)] {
        let (distance, normal) = wave.distance_and_normal(&Vector3::new(x, y, -0.01));
        assert!(distance > 0.0 && (normal.norm() - 1.0).abs() < 1e-12);
    }
}

proptest! {
    /// The depth of a point that enters through the side of the block is its distance from the
    /// side, not from the top.
    #[test]
    fn nothing_is_deep_in_a_block_at_once(
        from in prop::array::uniform3(-1.0f64..1.0),
        step in prop::array::uniform3(-0.005f64..0.005),
    ) {
        let shape = ShapeConfig::Wave {
            amplitude_m: 0.02,
            wavelength_m: 0.38,
            phase_rad: 0.44,
            offset_m: 0.02,
            size_m: [0.26, 0.51],
        };
        let block = Surface::new(&shape, &PoseConfig::default()).unwrap();
        let p = Vector3::from(from).component_mul(&Vector3::new(0.2, 0.3, 0.08));
        let q = p + Vector3::from(step);
        let [a, b] = [p, q].map(|at| block.distance_and_normal(&at).0);
        prop_assume!(a >= 0.0);
        prop_assert!(b >= a - (q - p).norm() * 1.01 - 0.1 * a, "{a} m outside, {} m further {b} m", (q - p).norm());
    }
}

proptest! {
    /// Beyond a focal distance there are several foot points. Whichever is found, the sign of the
    /// distance is right, and its size is at most the vertical distance and at least the true
    /// distance.
    #[test]
    fn a_point_far_above_or_below_is_not_on_the_other_side(
        at in prop::array::uniform3(-1.0f64..1.0),
        amplitude in 0.002f64..0.04,
        wavelength in 0.05f64..0.6,
        phase in 0.0f64..6.0,
    ) {
        let wave = Wave::new(amplitude, wavelength, phase, 0.02, [2.0, 4.0]);
        let p = Vector3::from(at).component_mul(&Vector3::new(0.2, 0.3, 0.6));
        let above = p.z - wave.height(p.x, p.y).0;
        let (distance, normal) = graph::distance_and_normal(&wave, &p);
        prop_assert!((normal.norm() - 1.0).abs() < 1e-9);
        prop_assert!(distance * above >= 0.0 || distance.abs() < 1e-6, "{distance} m, {above} m above");
        prop_assert!(distance.abs() <= above.abs() + 1e-9, "{distance} m, {above} m above");
        let nearest = (0..=8000)
            .map(|i| p.y + f64::from(i - 4000) * 2e-4)
            .map(|y| (p.y - y).hypot(p.z - wave.height(p.x, y).0))
            .fold(f64::INFINITY, f64::min);
        prop_assert!(distance.abs() >= nearest - 1e-4, "{distance} m, {nearest} m to the nearest point");
    }
}

/// The bug: a plane accepted any key, so that a misspelt one had no effect.
#[test]
fn unknown_keys_of_every_shape_are_refused() {
    for shape in [
        "shape = \"plane\"",
        "shape = \"cylinder\"\nradius_m = 0.1",
        "shape = \"sphere\"\nradius_m = 0.1",
    ] {
        toml::from_str::<SurfaceConfig>(shape).unwrap();
        let text = format!("{shape}\nstiffness_n_per_m = 1.0");
        let error = toml::from_str::<SurfaceConfig>(&text).unwrap_err();
        assert!(error.to_string().contains("stiffness_n_per_m"), "{error}");
    }
}
