//! Tests of the files that are created, kept, renewed and revoked in a folder.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use tangent_runtime::CellConfig;
use tangent_runtime::security::{Certificate, Fleet, MANIFEST, access};

use crate::folder::{ACCESS, NewKeys, new, revoke};

/// Arguments of `tangent keys new FOLDER` without options.
fn asked(folder: &Path) -> NewKeys {
    NewKeys {
        folder: folder.to_owned(),
        cells: Vec::new(),
        hosts: Vec::new(),
        estimator_hosts: Vec::new(),
        also: Vec::new(),
        renew: Vec::new(),
        days: 100,
    }
}

fn words(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

fn read(folder: &Path, name: &str) -> String {
    fs::read_to_string(folder.join(name)).unwrap()
}

fn refused(args: &NewKeys) -> String {
    new(args, None).unwrap_err().to_string()
}

#[test]
fn additions_and_renewals_keep_all_identities() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let first = NewKeys {
        cells: words(&["cell1"]),
        hosts: words(&["router.local", "10.0.0.7"]),
        ..asked(folder)
    };
    new(&first, None).unwrap();
    let router = || Certificate::read(&folder.join("router.pem")).unwrap();
    let hosts = ["localhost", "127.0.0.1", "router.local", "10.0.0.7"];
    assert_eq!(router().hosts, hosts);
    let (before, rules) = (read(folder, "router.pem"), read(folder, ACCESS));

    // A renewed router certificate keeps its host names.
    let renewed = NewKeys {
        renew: words(&["router"]),
        ..asked(folder)
    };
    new(&renewed, None).unwrap();
    assert_eq!(router().hosts, hosts);
    assert_ne!(read(folder, "router.pem"), before);
    assert_eq!(read(folder, ACCESS), rules);

    // Adding a second cell keeps all files of the first.
    let (robot, router_now) = (read(folder, "robot.cell1.pem"), read(folder, "router.pem"));
    let second = NewKeys {
        cells: words(&["cell2"]),
        ..asked(folder)
    };
    new(&second, None).unwrap();
    assert_eq!(read(folder, "robot.cell1.pem"), robot);
    assert_eq!(read(folder, "router.pem"), router_now);
    for cell in ["cell1", "cell2"] {
        assert!(read(folder, ACCESS).contains(&format!("\"controller.{cell}\"")));
    }
    let of_both = Fleet::of(&["cell1", "cell2"]);
    assert_eq!(read(folder, ACCESS), access::text(&of_both));

    // A further host name renews the router's certificate, and no other.
    let further = NewKeys {
        hosts: words(&["other.local"]),
        ..asked(folder)
    };
    new(&further, None).unwrap();
    assert_eq!(router().hosts.len(), 5);
    assert_eq!(read(folder, "robot.cell1.pem"), robot);
}

#[test]
fn a_folder_without_a_list_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let first = NewKeys {
        cells: words(&["cell1"]),
        hosts: words(&["router.local"]),
        ..asked(folder)
    };
    new(&first, None).unwrap();
    fs::remove_file(folder.join(MANIFEST)).unwrap();
    let renewed = NewKeys {
        renew: words(&["router"]),
        ..asked(folder)
    };
    new(&renewed, None).unwrap();
    let router = Certificate::read(&folder.join("router.pem")).unwrap();
    assert!(router.hosts.contains(&"router.local".to_owned()));
    assert!(read(folder, ACCESS).contains("\"robot.cell1\""));
}

#[test]
fn one_estimator_host_is_locked_out_permanently() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let first = NewKeys {
        cells: words(&["cell1"]),
        estimator_hosts: words(&["lab", "desk"]),
        also: words(&["operator-anna"]),
        ..asked(folder)
    };
    new(&first, None).unwrap();
    let subject = |name: &str| read(folder, ACCESS).contains(&format!("\"{name}\""));
    assert!(subject("estimator-lab.cell1") && subject("operator-anna"));
    assert!(folder.join("estimator-desk.cell1.key").exists());

    revoke(folder, &words(&["estimator-lab.cell1"])).unwrap();
    assert!(!subject("estimator-lab.cell1"));
    assert!(subject("estimator-desk.cell1") && subject("estimator.cell1"));
    // Neither a later cell nor a renewal restores a revoked identity.
    let later = NewKeys {
        cells: words(&["cell2"]),
        ..asked(folder)
    };
    new(&later, None).unwrap();
    assert!(!subject("estimator-lab.cell1") && subject("robot.cell2"));
    let again = NewKeys {
        renew: words(&["estimator-lab.cell1"]),
        ..asked(folder)
    };
    let said = refused(&again);
    assert!(
        said.contains("revoked") && said.contains("--also estimator-lab2.cell1"),
        "{said}"
    );
    let other = NewKeys {
        also: words(&["estimator-lab2.cell1"]),
        ..asked(folder)
    };
    new(&other, None).unwrap();
    assert!(subject("estimator-lab2.cell1"));
    for nobody in ["router", "nobody.cell1"] {
        assert!(revoke(folder, &words(&[nobody])).is_err(), "{nobody}");
    }
}

#[test]
fn one_command_makes_a_cell_that_can_be_run() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    assert!(refused(&asked(folder)).contains("--for CELL"));
    let first = NewKeys {
        cells: words(&["cell1"]),
        hosts: words(&["router.local"]),
        ..asked(folder)
    };
    new(&first, None).unwrap();
    let mut cell = CellConfig::load(&folder.join("cell1.toml")).unwrap();
    assert_eq!(cell.cell.name, "cell1");
    cell.zenoh.identify("router");
    let tls = cell.zenoh.tls.clone().unwrap();
    assert_eq!(tls.ca, folder.join("ca.pem"));
    assert_eq!(cell.zenoh.access, Some(folder.join(ACCESS)));
    tangent_runtime::Bus::check_access(&cell.zenoh).unwrap();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "key") {
            let mode = fs::metadata(&path).unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o600, "{}", path.display());
        }
    }
    // Manual changes to the cell file are kept.
    fs::write(folder.join("cell1.toml"), "changed").unwrap();
    new(&first, None).unwrap();
    assert_eq!(read(folder, "cell1.toml"), "changed");
    for bad in ["estimator", "estimator-x.elsewhere", "anna.cell1"] {
        let args = NewKeys {
            also: words(&[bad]),
            ..asked(folder)
        };
        assert!(refused(&args).contains(bad), "{bad}");
    }
}
