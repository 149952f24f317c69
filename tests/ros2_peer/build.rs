//! Generates the types of `tangent_msgs` with hiroz's own generator, from the same files as the
//! cell's: names, layout and type hashes come from there.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use hiroz_codegen::{GeneratorConfig, MessageGenerator, discover_bundled_packages};

fn main() -> Result<()> {
    let files = Path::new("../../schemas/msg/tangent_msgs");
    println!("cargo:rerun-if-changed={}", files.display());
    println!("cargo:rerun-if-changed=build.rs");
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    // The folders of a package as it is installed.
    let package = out.join("tangent_msgs");
    for kind in ["msg", "srv"] {
        fs::create_dir_all(package.join(kind))?;
    }
    for entry in fs::read_dir(files)? {
        let path = entry?.path();
        let Some(kind) = path.extension().and_then(|e| e.to_str()) else {
            continue;
        };
        let name = path.file_name().context("a file has a name")?;
        match kind {
            "msg" | "srv" => fs::copy(&path, package.join(kind).join(name))?,
            _ => fs::copy(&path, package.join(name))?,
        };
    }
    let standard = discover_bundled_packages(false)?;
    let config = GeneratorConfig {
        generate_cdr: true,
        generate_protobuf: false,
        generate_type_info: true,
        is_humble: false,
        output_dir: out,
        external_crate: Some("hiroz_msgs".to_owned()),
        local_packages: HashSet::from(["tangent_msgs".to_owned()]),
        json_out: None,
    };
    let standard: Vec<&Path> = standard.iter().map(PathBuf::as_path).collect();
    MessageGenerator::new(config).generate_from_msg_files_with_deps(&[&package], &standard)
}
