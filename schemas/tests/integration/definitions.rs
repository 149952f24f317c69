//! Compares every Rust message with its `.msg` file: names, order and types of all fields.
use crate::common;
use crate::common::trace::{Kind, trace};
use tangent_schemas::Message;
use tangent_schemas::definition::{Base, Count, FILES, Field, SERVICES, fields, file};

/// Compares one type with its file, and adds its name to `checked`.
fn check<M: Message>(checked: &mut Vec<&'static str>) {
    let text = file(M::NAME).unwrap_or_else(|| panic!("{} has no .msg file", M::NAME));
    let package = M::NAME.split('/').next().unwrap();
    compare(M::NAME, &fields(text, package), &trace::<M>());
    checked.push(M::NAME);
}

fn compare(name: &str, in_file: &[Field], in_rust: &Kind) {
    let Kind::Struct(in_rust) = in_rust else {
        panic!("{name} is {in_rust:?} in Rust, not a struct");
    };
    let names: Vec<&str> = in_file.iter().map(|field| field.name.as_str()).collect();
    let rust_names: Vec<&str> = in_rust.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, rust_names, "fields of {name}: file, then Rust");
    for (field, (_, kind)) in in_file.iter().zip(in_rust) {
        let place = format!("{name}.{}", field.name);
        match (&field.count, kind) {
            (Count::One, kind) => compare_base(&place, &field.base, kind),
            (Count::Fixed(length), Kind::Array(found, kind)) => {
                assert_eq!(length, found, "length of {place}");
                compare_base(&place, &field.base, kind);
            }
            (Count::Sequence, Kind::Sequence(kind)) => compare_base(&place, &field.base, kind),
            (count, kind) => panic!("{place}: {count:?} in the file, {kind:?} in Rust"),
        }
    }
}

fn compare_base(place: &str, base: &Base, kind: &Kind) {
    match base {
        Base::Primitive(name) => assert_eq!(&Kind::Primitive(primitive(name)), kind, "{place}"),
        Base::Message(name) => {
            let text = file(name).unwrap_or_else(|| panic!("{place}: {name} has no .msg file"));
            compare(place, &fields(text, name.split('/').next().unwrap()), kind);
        }
    }
}

fn primitive(name: &str) -> &'static str {
    match name {
        "bool" => "bool",
        "uint8" => "u8",
        "int32" => "i32",
        "uint32" => "u32",
        "uint64" => "u64",
        "float32" => "f32",
        "float64" => "f64",
        "string" => "string",
        other => panic!("`{other}` is not a type that a .msg file may use here"),
    }
}

#[test]
fn every_message_is_as_its_file_says() {
    let mut checked = Vec::new();
    common::for_every_message!(check, &mut checked);
    let mut files: Vec<&str> = FILES.iter().map(|(name, _)| *name).collect();
    files.sort_unstable();
    checked.sort_unstable();
    assert_eq!(checked, files, "messages in Rust, then files");
}

#[test]
fn every_file_on_disk_is_in_the_list() {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/msg");
    let (mut messages, mut services) = (0, 0);
    for package in std::fs::read_dir(root).unwrap() {
        for file in std::fs::read_dir(package.unwrap().path()).unwrap() {
            let path = file.unwrap().path();
            match path.extension().and_then(|e| e.to_str()) {
                Some("msg") => messages += 1,
                Some("srv") => services += 1,
                // package.xml and CMakeLists.txt of the package for ROS 2.
                Some("xml" | "txt") => {}
                _ => panic!("{} is no definition", path.display()),
            }
        }
    }
    assert_eq!((messages, services), (FILES.len(), SERVICES.len()));
}

#[test]
fn a_drift_is_noticed() {
    let kind = trace::<tangent_schemas::standard::Wrench>();
    let swapped = fields("Vector3 torque\nVector3 force\n", "geometry_msgs");
    assert!(std::panic::catch_unwind(|| compare("swapped", &swapped, &kind)).is_err());
    let point = trace::<tangent_schemas::standard::Point>();
    let narrow = fields("float64 x\nfloat32 y\nfloat64 z\n", "geometry_msgs");
    assert!(std::panic::catch_unwind(|| compare("narrow", &narrow, &point)).is_err());
}
