//! A container engine, the stand-in image, and a compose project that is removed after the test.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use serde_json::Value;

use crate::common::{root, tangent};

/// Profiles of the compose file that the tests use.
const PROFILES: [&str; 3] = ["sim", "spare", "tools"];

/// Timeout of the engine, s: on a busy machine it takes minutes for what takes a second on an idle
/// one.
const ENGINE_PATIENCE_S: &str = "300";

/// The Compose command of this machine.
pub struct Engine {
    compose: Vec<&'static str>,
}

/// The engine of this machine; `None`, with the reason printed, if there is none that can be used.
pub fn engine() -> Option<Engine> {
    let found = find();
    if let Err(reason) = &found {
        assert!(
            std::env::var_os("TANGENT_REQUIRE_DOCKER").is_none(),
            "TANGENT_REQUIRE_DOCKER is set, but {reason}"
        );
        eprintln!("skipped, because {reason}");
    }
    found.ok()
}

fn find() -> Result<Engine, String> {
    let works = |program: &str, arguments: &[&str]| {
        Command::new(program)
            .args(arguments)
            .stdin(Stdio::null())
            .output()
            .is_ok_and(|output| output.status.success())
    };
    if !works("docker", &["info"]) {
        return Err("`docker info` fails: no Docker Engine runs here".to_owned());
    }
    if works("docker", &["compose", "version"]) {
        return Ok(Engine {
            compose: vec!["docker", "compose"],
        });
    }
    if works("docker-compose", &["version"]) {
        return Ok(Engine {
            compose: vec!["docker-compose"],
        });
    }
    Err("neither `docker compose` nor `docker-compose` is here".to_owned())
}

/// Output and exit code of a command.
#[derive(Debug)]
pub struct Said {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

impl From<Output> for Said {
    fn from(output: Output) -> Self {
        Self {
            code: output.status.code(),
            stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }
}

/// Runs a command to its end.
pub fn call(command: &mut Command) -> Said {
    command.stdin(Stdio::null()).output().unwrap().into()
}

/// Runs a command to its end; panics if it fails.
pub fn must(command: &mut Command) -> String {
    let said = call(command);
    assert_eq!(
        said.code,
        Some(0),
        "{command:?}: {}{}",
        said.stdout,
        said.stderr
    );
    said.stdout
}

/// One deployment of the compose file, under a name of its own.
pub struct Project {
    engine: Engine,
    name: String,
    image: String,
    port: u16,
    folder: tempfile::TempDir,
    secured: bool,
}

/// The section `[zenoh.tls]` of a cell file beside the folder `keys`.
const CERTIFICATES: &str = r#"
[zenoh.tls]
ca = "keys/ca.pem"
certificate = "keys/{identity}.pem"
key = "keys/{identity}.key"

[estimators]
"#;

impl Project {
    /// Creates a project with the substitute image; nothing runs yet. `secured`: with certificates,
    /// as in docker-compose.tls.yml.
    pub fn new(engine: Engine, secured: bool) -> Self {
        let project = Self::without_image(engine, secured);
        build_image(&project.image, project.folder.path());
        project
    }

    /// Creates a project whose image is still to be built.
    pub fn without_image(engine: Engine, secured: bool) -> Self {
        let name = format!(
            "tangent-test-{}{}",
            std::process::id(),
            if secured { "-tls" } else { "" }
        );
        let image = format!("{name}:standin");
        let folder = tempfile::tempdir().unwrap();
        let port = tangent_live::ports::free();
        let mut cell = fs::read_to_string(root().join("deploy/cell.toml"))
            .unwrap()
            .replace("127.0.0.1:7447", &format!("127.0.0.1:{port}"));
        if secured {
            let keys = folder.path().join("keys");
            make_keys(&keys);
            cell = cell
                .replace("tcp/", "quic/")
                .replace("\n[estimators]\n", CERTIFICATES);
        }
        fs::write(folder.path().join("cell.toml"), cell).unwrap();
        Self {
            engine,
            name,
            image,
            port,
            folder,
            secured,
        }
    }

    /// Writes a file that commands on this host can read.
    pub fn file(&self, name: &str, text: &str) -> PathBuf {
        let path = self.folder.path().join(name);
        fs::write(&path, text).unwrap();
        path
    }

    /// Compose on this project, with its files and environment variables.
    fn base(&self) -> Command {
        let mut command = Command::new(self.engine.compose[0]);
        command.args(&self.engine.compose[1..]);
        if self.secured {
            command.args(["-f", "docker-compose.yml", "-f", "docker-compose.tls.yml"]);
        }
        command
            .args(["--project-name", &self.name])
            .current_dir(root())
            .env("TANGENT_IMAGE", &self.image)
            .env("TANGENT_PORT", self.port.to_string())
            .env("TANGENT_KEYS", self.folder.path().join("keys"))
            .env("COMPOSE_HTTP_TIMEOUT", ENGINE_PATIENCE_S);
        command
    }

    /// A Compose command on this project.
    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = self.base();
        for profile in PROFILES {
            command.args(["--profile", profile]);
        }
        command.args(arguments);
        command
    }

    /// Runs Compose; panics if it fails.
    pub fn compose(&self, arguments: &[&str]) -> String {
        must(&mut self.command(arguments))
    }

    /// Builds the image as a user does, but from base images of this host.
    pub fn build(&self, build_image: &str, run_image: &str) {
        let bases = [
            format!("BUILD_IMAGE={build_image}"),
            format!("RUN_IMAGE={run_image}"),
        ];
        let mut command = self.command(&["build"]);
        for base in &bases {
            command.args(["--build-arg", base]);
        }
        must(command.arg("tangent"));
    }

    /// A folder that is removed with the project.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Runs `up` as a user does first, on an existing image; only waits until it returns.
    pub fn up(&self) {
        must(self.base().args(["up", "--no-build", "-d"]));
    }

    /// Runs the program on this host, through the port that the router's container publishes.
    pub fn tangent(&self, arguments: &[&str]) -> Said {
        let cell = self.folder.path().join("cell.toml");
        call(tangent().args(arguments).arg("--cell").arg(cell))
    }

    /// Runs the program in a container of its own, with the volume of the recordings.
    pub fn inside(&self, arguments: &[&str]) -> Said {
        let all = [&["run", "--rm", "-T", "tangent"][..], arguments].concat();
        call(&mut self.command(&all))
    }

    /// The container of a service, even if it has stopped.
    pub fn container(&self, service: &str) -> String {
        let filters = [
            format!("label=com.docker.compose.project={}", self.name),
            format!("label=com.docker.compose.service={service}"),
        ];
        let mut command = Command::new("docker");
        command.args(["ps", "-aq"]);
        for filter in &filters {
            command.args(["--filter", filter]);
        }
        let ids = must(&mut command);
        ids.lines()
            .next()
            .unwrap_or_else(|| panic!("no container of {service}"))
            .to_owned()
    }

    /// The engine's data on a service's container.
    pub fn inspect(&self, service: &str) -> Value {
        let text = must(Command::new("docker").args(["inspect", &self.container(service)]));
        serde_json::from_str::<Value>(&text).unwrap()[0].clone()
    }

    /// Disconnects a container's network cable, or reconnects it.
    pub fn cable(&self, service: &str, plugged: bool) {
        let network = format!("{}_cell", self.name);
        let container = self.container(service);
        let action = if plugged { "connect" } else { "disconnect" };
        let mut command = Command::new("docker");
        command.args(["network", action]);
        if plugged {
            command.args(["--alias", service]);
        }
        must(command.args([&network, &container]));
    }
}

impl Drop for Project {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let logs = call(&mut self.command(&["logs", "--no-color", "--tail", "40"]));
            eprintln!("{}{}", logs.stdout, logs.stderr);
        }
        let _ = call(&mut self.command(&["down", "--volumes", "--remove-orphans", "-t", "2"]));
        let _ = call(Command::new("docker").args(["rmi", "-f", &self.image]));
    }
}

/// Keys for the cell in `folder`, readable by the user in the containers.
fn make_keys(folder: &Path) {
    let mut make = tangent();
    make.args(["keys", "new"]).arg(folder);
    make.args(["--for", "cell1", "--host", "router", "--host", "127.0.0.1"]);
    must(&mut make);
    for entry in fs::read_dir(folder).unwrap() {
        std::os::unix::fs::chown(entry.unwrap().path(), Some(10001), Some(10001)).unwrap();
    }
}

/// An image without a base: the program, the libraries it is linked to, what the Dockerfile copies,
/// and its settings.
fn build_image(image: &str, folder: &Path) {
    let tree = folder.join("image");
    let program = env!("CARGO_BIN_EXE_tangent");
    let inside = tree.join("usr/local/bin/tangent");
    copy(Path::new(program), &inside);
    // As in the Dockerfile's build; without the tool, the image is only larger.
    let _ = Command::new("strip").arg(&inside).status();
    for library in libraries(program) {
        copy(
            Path::new(&library),
            &tree.join(library.trim_start_matches('/')),
        );
    }
    for (path, text) in [
        (
            "etc/passwd",
            "root:x:0:0::/:\ntangent:x:10001:10001::/tangent:\n",
        ),
        ("etc/group", "root:x:0:\ntangent:x:10001:\n"),
        ("etc/nsswitch.conf", "hosts: files dns\n"),
    ] {
        let path = tree.join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
    let settings = settings();
    for line in &settings {
        if let [word, from, to] = line.split_whitespace().collect::<Vec<_>>()[..]
            && word == "COPY"
        {
            let to = tree.join(to.trim_start_matches('/'));
            fs::create_dir_all(to.parent().unwrap()).unwrap();
            must(Command::new("cp").arg("-r").arg(root().join(from)).arg(to));
        }
    }
    let owned: Vec<String> = owned_folders()
        .iter()
        .map(|folder| format!(".{folder}"))
        .collect();
    for folder in &owned {
        fs::create_dir_all(tree.join(folder)).unwrap();
    }
    let archive = folder.join("image.tar");
    let tar = |mode: &str, owner: &str| {
        let mut command = Command::new("tar");
        command.arg("-C").arg(&tree).arg(format!("--owner={owner}"));
        command
            .arg(format!("--group={owner}"))
            .arg(mode)
            .arg(&archive);
        command
    };
    let excluded = owned.iter().map(|folder| format!("--exclude={folder}"));
    must(tar("-cf", "0").args(excluded).arg("."));
    must(tar("-rf", "10001").args(&owned));
    let mut import = Command::new("docker");
    import.arg("import");
    for line in &settings {
        let word = line.split_whitespace().next().unwrap_or_default();
        if ["USER", "WORKDIR", "EXPOSE", "ENTRYPOINT", "CMD", "ENV"].contains(&word) {
            import.args(["--change", line]);
        }
    }
    must(import.arg(&archive).arg(image));
    fs::remove_dir_all(&tree).unwrap();
    fs::remove_file(&archive).unwrap();
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to.parent().unwrap()).unwrap();
    fs::copy(from, to).unwrap();
}

/// Instructions of the Dockerfile's last stage.
pub fn settings() -> Vec<String> {
    let text = fs::read_to_string(root().join("Dockerfile")).unwrap();
    let (_, last) = text.rsplit_once("\nFROM ").unwrap();
    last.lines()
        .skip(1)
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
        .map(str::to_owned)
        .collect()
}

/// Folders that the Dockerfile gives to its user.
fn owned_folders() -> Vec<String> {
    settings()
        .iter()
        .filter_map(|line| line.strip_prefix("RUN install -d -o 10001 -g 10001 "))
        .flat_map(str::split_whitespace)
        .map(str::to_owned)
        .collect()
}

/// Libraries that the dynamic linker would load.
pub fn libraries(program: &str) -> Vec<String> {
    must(Command::new("ldd").arg(program))
        .lines()
        .filter_map(|line| line.split_whitespace().find(|word| word.starts_with('/')))
        .map(str::to_owned)
        .collect()
}
