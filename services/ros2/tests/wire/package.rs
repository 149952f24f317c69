//! `tangent_msgs` as a package of ROS 2: its list of files, its dependencies, and the type hashes
//! that ROS 2's own generator writes when colcon builds it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;

use tangent_live::interop;
use tangent_ros2::type_hash;
use tangent_schemas::definition;

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../schemas/msg/tangent_msgs")
}

/// Names of the files with this ending.
fn files(ending: &str) -> BTreeSet<String> {
    fs::read_dir(folder())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.ends_with(ending))
        .collect()
}

/// The names between `set(LIST` and its bracket.
fn listed(cmake: &str, list: &str) -> BTreeSet<String> {
    let (_, rest) = cmake.split_once(&format!("set({list}\n")).unwrap();
    let (names, _) = rest.split_once(')').unwrap();
    names.split_whitespace().map(str::to_owned).collect()
}

#[test]
fn every_definition_is_in_the_build() {
    let cmake = fs::read_to_string(folder().join("CMakeLists.txt")).unwrap();
    assert_eq!(listed(&cmake, "MESSAGES"), files(".msg"));
    assert_eq!(listed(&cmake, "SERVICES"), files(".srv"));
}

#[test]
fn every_package_that_is_used_is_a_dependency_of_both_files() {
    let mut used = BTreeSet::new();
    for name in files(".msg").iter().chain(&files(".srv")) {
        let text = fs::read_to_string(folder().join(name)).unwrap();
        for line in text.lines().filter(|line| !line.starts_with('#')) {
            if let Some((package, _)) = line.split_once('/') {
                used.insert(package.to_owned());
            }
        }
    }
    used.remove("tangent_msgs");
    let cmake = fs::read_to_string(folder().join("CMakeLists.txt")).unwrap();
    let (_, rest) = cmake.split_once("DEPENDENCIES ").unwrap();
    let depends: BTreeSet<String> = rest
        .lines()
        .next()
        .unwrap()
        .split_whitespace()
        .map(str::to_owned)
        .collect();
    assert_eq!(depends, used);
    let xml = fs::read_to_string(folder().join("package.xml")).unwrap();
    for package in &used {
        assert!(
            xml.contains(&format!("<depend>{package}</depend>")),
            "{package}"
        );
        assert!(
            cmake.contains(&format!("find_package({package} REQUIRED)")),
            "{package}"
        );
    }
    assert!(xml.contains("<name>tangent_msgs</name>") && cmake.contains("project(tangent_msgs)"));
    assert!(xml.contains("<member_of_group>rosidl_interface_packages</member_of_group>"));
}

/// ROS 2 accepts lower-case names without leading or double underscores.
#[test]
fn every_field_has_a_name_that_ros_accepts() {
    for name in files(".msg").iter().chain(&files(".srv")) {
        let text = fs::read_to_string(folder().join(name)).unwrap();
        let lines = text.lines().map(|line| line.split('#').next().unwrap());
        for field in lines.filter_map(|line| line.split_whitespace().nth(1)) {
            let good = field.starts_with(|c: char| c.is_ascii_lowercase())
                && field
                    .chars()
                    .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')
                && !field.contains("__")
                && !field.ends_with('_');
            assert!(good, "{name}: {field}");
        }
        let stem = name.split('.').next().unwrap();
        assert!(stem.starts_with(|c: char| c.is_ascii_uppercase()), "{name}");
        assert!(stem.chars().all(|c| c.is_ascii_alphanumeric()), "{name}");
    }
}

/// `tests/interop/ros2/build` builds the package with colcon.
#[test]
fn every_type_has_the_hash_that_the_generator_of_ros_writes() {
    let Some(text) = interop::output_with_ros2("ros2/hashes.py", &[""; 0]) else {
        return;
    };
    let theirs: BTreeMap<String, String> = serde_json::from_str(&text).unwrap();
    for (name, _) in definition::FILES {
        let ours = type_hash::of_message(name);
        assert_eq!(ours.as_ref(), theirs.get(*name), "{name}");
    }
    for name in definition::SERVICES
        .iter()
        .map(|(name, _)| *name)
        .chain(["std_srvs/srv/Trigger"])
    {
        let ours = type_hash::of_service(name);
        assert!(ours.is_some(), "{name}");
        assert_eq!(ours.as_ref(), theirs.get(name), "{name}");
    }
}
