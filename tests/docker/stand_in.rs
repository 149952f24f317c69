//! Base images for the Dockerfile, made from the host's own programs: for a build without a
//! registry of images and without a network.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::engine::{call, libraries, must};

/// Debian packages that compile and link C programs, for crates with C sources.
const COMPILER: [&str; 7] = [
    "binutils",
    "cpp",
    "gcc",
    "libc-dev-bin",
    "libc6-dev",
    "libgcc-dev",
    "linux-libc-dev",
];
/// Packages that every stand-in has: a shell and `install`, which the Dockerfile's `RUN` lines
/// call.
const SHELL: [&str; 2] = ["coreutils", "dash"];

/// An image that stands in for `BUILD_IMAGE`: a C compiler, this host's Rust toolchain, and the
/// registry cache that its cargo has filled. `None`, with the reason printed, on a host that does
/// not keep its packages with dpkg.
pub fn build_image(image: &str, folder: &Path) -> Option<()> {
    let tree = Tree::new(folder.join("build-image"));
    let mut packages: Vec<String> = SHELL.map(str::to_owned).to_vec();
    for package in COMPILER {
        // `gcc` stands for `gcc-12`, and that for `libgcc-12-dev`.
        packages.extend(closure(package));
    }
    packages.sort();
    packages.dedup();
    if !tree.packages(&packages) {
        eprintln!("skipped, because dpkg does not know the C compiler's files here");
        return None;
    }
    // A link of Debian's alternatives, which belongs to no package.
    tree.file(Path::new("/usr/bin/cc"));
    let sysroot = must(Command::new("rustc").args(["--print", "sysroot"]));
    tree.folder(
        Path::new(sysroot.trim()),
        "usr/local/rust",
        &["bin", "lib", "libexec"],
    );
    let home = std::env::var_os("CARGO_HOME").map_or_else(
        || PathBuf::from(std::env::var_os("HOME").unwrap()).join(".cargo"),
        PathBuf::from,
    );
    tree.folder(
        &home,
        "usr/local/cargo",
        &["config.toml", "registry/index", "registry/cache"],
    );
    tree.import(
        image,
        &[
            "ENV PATH=/usr/local/rust/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
            "ENV CARGO_HOME=/usr/local/cargo CARGO_NET_OFFLINE=true",
        ],
    );
    Some(())
}

/// An image that stands in for `RUN_IMAGE`: a shell, `install`, and the libraries that `program` is
/// linked to.
pub fn run_image(image: &str, folder: &Path, program: &str) {
    let tree = Tree::new(folder.join("run-image"));
    assert!(tree.packages(&SHELL.map(str::to_owned)));
    for library in libraries(program) {
        tree.file(Path::new(&library));
    }
    tree.import(image, &[]);
}

/// Folders of the system's libraries; a toolchain brings its own along.
const SYSTEM: [&str; 3] = ["/lib", "/usr/lib", "/usr/local/lib"];

/// Packages of one name, and those of the compiler's versions that it depends on.
fn closure(package: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut open = vec![package.to_owned()];
    while let Some(name) = open.pop() {
        let asked = call(Command::new("dpkg-query").args(["-W", "-f=${Depends}", &name]));
        if asked.code != Some(0) || !found.insert(name) {
            continue;
        }
        for needed in asked.stdout.split([',', '|']) {
            let needed = needed.split([' ', '(', ':']).find(|w| !w.is_empty());
            let compiles = |n: &&str| {
                ["gcc", "cpp", "binutils", "libgcc", "libc6-dev"]
                    .iter()
                    .any(|p| n.starts_with(p))
            };
            open.extend(needed.filter(compiles).map(str::to_owned));
        }
    }
    found
}

/// A root file system under construction.
struct Tree(PathBuf);

impl Tree {
    fn new(root: PathBuf) -> Self {
        // Where `/bin` and `/lib` are links into `/usr`, they are so in the image as well.
        fs::create_dir_all(root.join("usr")).unwrap();
        for link in ["bin", "sbin", "lib", "lib32", "lib64", "libx32"] {
            if let Ok(target) = fs::read_link(Path::new("/").join(link)) {
                fs::create_dir_all(root.join("usr").join(link)).unwrap();
                std::os::unix::fs::symlink(target, root.join(link)).unwrap();
            }
        }
        fs::create_dir_all(root.join("tmp")).unwrap();
        Self(root)
    }

    fn place(&self, path: &Path) -> PathBuf {
        self.0.join(path.strip_prefix("/").unwrap())
    }

    /// Adds a file, or a link with its target.
    fn file(&self, path: &Path) {
        let to = self.place(path);
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        if to.symlink_metadata().is_ok() {
            return;
        }
        if let Ok(target) = fs::read_link(path) {
            std::os::unix::fs::symlink(&target, &to).unwrap();
            let target = path.parent().unwrap().join(target);
            if target.is_file() {
                self.file(&target);
            }
        } else {
            fs::copy(path, to).unwrap();
        }
    }

    /// Adds the files of packages, and the libraries to which their programs are linked. False if
    /// dpkg knows none of them.
    fn packages(&self, packages: &[String]) -> bool {
        let mut known = false;
        for package in packages {
            let files = call(Command::new("dpkg").args(["-L", package]));
            for path in files.stdout.lines().map(Path::new) {
                if path.starts_with("/usr/share") || !path.is_file() {
                    continue;
                }
                known = true;
                self.file(path);
                self.libraries_of(path);
            }
        }
        known
    }

    /// Adds the libraries to which a program is linked; nothing for a file that is not a program.
    fn libraries_of(&self, program: &Path) {
        if is_program(program) {
            for library in linked(program) {
                self.file(Path::new(&library));
            }
        }
    }

    /// Adds the system's libraries to which the programs in a folder are linked.
    fn libraries_in(&self, folder: &Path) {
        let Ok(entries) = fs::read_dir(folder) else {
            return;
        };
        for path in entries.map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                self.libraries_in(&path);
            } else {
                self.libraries_of(&path);
            }
        }
    }

    /// Adds those parts of a folder that exist, at another path.
    fn folder(&self, from: &Path, to: &str, parts: &[&str]) {
        for part in parts.iter().filter(|part| from.join(part).exists()) {
            let to = self.0.join(to).join(part);
            fs::create_dir_all(to.parent().unwrap()).unwrap();
            must(Command::new("cp").arg("-rL").arg(from.join(part)).arg(to));
            self.libraries_in(&from.join(part));
        }
    }

    /// Imports the tree as an image, and removes it.
    fn import(self, image: &str, settings: &[&str]) {
        let archive = self.0.with_extension("tar");
        must(
            Command::new("tar")
                .args(["--owner=0", "--group=0", "-C"])
                .arg(&self.0)
                .arg("-cf")
                .arg(&archive)
                .arg("."),
        );
        fs::remove_dir_all(&self.0).unwrap();
        let mut import = Command::new("docker");
        import.arg("import");
        for line in settings {
            import.args(["--change", line]);
        }
        must(import.arg(&archive).arg(image));
        fs::remove_file(archive).unwrap();
    }
}

fn is_program(path: &Path) -> bool {
    use std::io::Read;
    let mut magic = [0; 4];
    let read = fs::File::open(path).and_then(|mut file| file.read_exact(&mut magic));
    read.is_ok() && magic == *b"\x7fELF"
}

/// Libraries of a program; empty if it is not linked dynamically.
fn linked(path: &Path) -> Vec<String> {
    let said = call(Command::new("ldd").arg(path));
    said.stdout
        .lines()
        .filter_map(|line| line.split_whitespace().find(|word| word.starts_with('/')))
        .filter(|library| SYSTEM.iter().any(|folder| library.starts_with(folder)))
        .map(str::to_owned)
        .collect()
}
