//! Who may read the page and command the cell: tokens and roles, and the checks that keep pages of
//! other sites out.

use std::fmt;
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::net::IpAddr;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::UiError;

/// Number of random bytes in a token.
const TOKEN_BYTES: usize = 20;
/// Longest name of a person, bytes.
const NAME_MAX: usize = 32;

/// What a person may do. Each role may do what the ones before it may.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Tasks, stop and tare.
    Operator,
    /// The choice of the estimator too.
    Engineer,
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Operator => "operator",
            Self::Engineer => "engineer",
        })
    }
}

/// A person with a token.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Person {
    /// Name in recordings.
    pub name: String,
    /// What the person may do.
    pub role: Role,
    /// SHA-256 of the token, in hexadecimal digits.
    pub token_sha256: String,
}

#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TokenFile {
    #[serde(default)]
    person: Vec<Person>,
}

/// The people with a token. The tokens themselves are not kept.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tokens(Vec<Person>);

impl Tokens {
    /// Reads the file of the tokens.
    ///
    /// # Errors
    /// It cannot be read, or has an entry that is not valid.
    pub fn read(file: &Path) -> Result<Self, UiError> {
        let wrong = |reason: String| UiError::Tokens {
            file: file.to_owned(),
            reason,
        };
        let text = fs::read_to_string(file).map_err(|error| {
            wrong(format!(
                "{error}. Make the file with `tangent ui --new-token NAME`, or leave the key out"
            ))
        })?;
        let read: TokenFile = toml::from_str(&text).map_err(|e| wrong(e.message().to_owned()))?;
        for person in &read.person {
            let digits = &person.token_sha256;
            if digits.len() != 64 || !digits.bytes().all(|b| b.is_ascii_hexdigit()) {
                return Err(wrong(format!(
                    "token_sha256 of \"{}\" is not a SHA-256 of 64 hexadecimal digits; make a token with \
                     `tangent ui --new-token NAME`",
                    person.name
                )));
            }
            if !is_name(&person.name) {
                return Err(wrong(format!(
                    "name = \"{}\" is not allowed: 1 to {NAME_MAX} letters, digits, - and _",
                    person.name
                )));
            }
        }
        if read.person.is_empty() {
            return Err(wrong(
                "it has no [[person]]; make a token with `tangent ui --new-token NAME`".to_owned(),
            ));
        }
        Ok(Self(read.person))
    }

    /// Adds a token for this process alone, and returns it.
    ///
    /// # Errors
    /// The system has no random numbers.
    pub fn add_for_this_process(&mut self, name: &str, role: Role) -> io::Result<String> {
        let token = new_token()?;
        self.0.push(Person {
            name: name.to_owned(),
            role,
            token_sha256: digest(&token),
        });
        Ok(token)
    }

    /// Whether nobody has a token.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Whose token this is.
    pub fn holder(&self, token: &str) -> Option<&Person> {
        // The digest is compared, so the time of the comparison says nothing of the token.
        let digest = digest(token);
        let is_holder = |p: &&Person| p.token_sha256.eq_ignore_ascii_case(&digest);
        self.0.iter().find(is_holder)
    }
}

/// Adds a person to the file of the tokens, which is made if it does not exist, readable by its
/// owner only. Returns the token, which is written nowhere.
///
/// # Errors
/// The name is not valid or taken, or the file cannot be read or written.
pub fn new_person(file: &Path, name: &str, role: Role) -> Result<String, UiError> {
    let wrong = |reason: String| UiError::Tokens {
        file: file.to_owned(),
        reason,
    };
    if !is_name(name) {
        return Err(wrong(format!(
            "name \"{name}\" is not allowed: 1 to {NAME_MAX} letters, digits, - and _"
        )));
    }
    let known = if file.exists() {
        Tokens::read(file)?
    } else {
        Tokens::default()
    };
    if known.0.iter().any(|person| person.name == name) {
        return Err(wrong(format!(
            "\"{name}\" has a token already; remove that entry first, or choose another name"
        )));
    }
    let token = new_token().map_err(|e| wrong(e.to_string()))?;
    let entry = TokenFile {
        person: vec![Person {
            name: name.to_owned(),
            role,
            token_sha256: digest(&token),
        }],
    };
    let text = toml::to_string(&entry).map_err(|e| wrong(e.to_string()))?;
    let mut opened = fs::OpenOptions::new()
        .create(true)
        .append(true)
        .mode(0o600)
        .open(file)
        .map_err(|e| wrong(e.to_string()))?;
    writeln!(opened, "{text}").map_err(|e| wrong(e.to_string()))?;
    Ok(token)
}

fn new_token() -> io::Result<String> {
    let mut bytes = [0; TOKEN_BYTES];
    File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(hex(&bytes))
}

fn digest(token: &str) -> String {
    hex(&Sha256::digest(token.as_bytes()))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

fn is_name(name: &str) -> bool {
    let good = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_');
    (1..=NAME_MAX).contains(&name.len()) && name.chars().all(good)
}

/// Whether a browser may use this `Host`: an IP address, which no other site can rebind,
/// `localhost`, or a name of the cell file.
pub fn is_own_host(host: &str, names: &[String]) -> bool {
    let name = without_port(host);
    let bare = name.trim_start_matches('[').trim_end_matches(']');
    bare.parse::<IpAddr>().is_ok()
        || name.eq_ignore_ascii_case("localhost")
        || names.iter().any(|known| known.eq_ignore_ascii_case(name))
}

fn without_port(host: &str) -> &str {
    match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) && !name.ends_with(':') => {
            name
        }
        _ => host,
    }
}

/// Whether a request with this `Origin` comes from the page that this `Host` served. A program that
/// is not a browser sends no `Origin`.
pub fn is_own_origin(origin: Option<&str>, host: &str) -> bool {
    let own = |origin: &str| {
        let rest = origin.strip_prefix("http://");
        // Behind a proxy with certificates.
        let rest = rest.or_else(|| origin.strip_prefix("https://"));
        rest.is_some_and(|rest| rest.eq_ignore_ascii_case(host))
    };
    origin.is_none_or(own)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn a_token_is_made_once_and_only_its_digest_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tokens.toml");
        let anna = new_person(&file, "anna", Role::Operator).unwrap();
        let ben = new_person(&file, "ben", Role::Engineer).unwrap();
        assert_ne!(anna, ben);
        let text = fs::read_to_string(&file).unwrap();
        assert!(!text.contains(&anna) && !text.contains(&ben), "{text}");
        let mode = fs::metadata(&file).unwrap().permissions().mode();
        assert_eq!(mode & 0o077, 0, "{mode:o}");
        let tokens = Tokens::read(&file).unwrap();
        assert_eq!(tokens.holder(&anna).unwrap().name, "anna");
        assert_eq!(tokens.holder(&ben).unwrap().role, Role::Engineer);
        for wrong in ["", "anna", &anna[1..], &format!("{anna} ")] {
            assert_eq!(tokens.holder(wrong), None, "{wrong}");
        }
        let again = new_person(&file, "anna", Role::Operator).unwrap_err();
        assert!(again.to_string().contains("has a token already"), "{again}");
    }

    #[test]
    fn a_file_that_gives_nobody_or_everybody_rights_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tokens.toml");
        let missing = Tokens::read(&file).unwrap_err().to_string();
        assert!(missing.contains("--new-token"), "{missing}");
        for (text, word) in [
            ("", "no [[person]]"),
            (
                "[[person]]\nname = 'a'\nrole = 'king'\ntoken_sha256 = ''",
                "king",
            ),
            (
                "[[person]]\nname = 'a'\nrole = 'operator'\ntoken_sha256 = ''",
                "64",
            ),
            (
                "[[person]]\nname = 'a'\nrole = 'operator'\ntoken = 'secret'",
                "token",
            ),
        ] {
            fs::write(&file, text).unwrap();
            let said = Tokens::read(&file).unwrap_err().to_string();
            assert!(
                said.contains(word) && said.contains("tokens.toml"),
                "{said}"
            );
        }
        assert!(new_person(&file, "a b", Role::Operator).is_err());
        assert!(new_person(&file, "", Role::Operator).is_err());
        assert!(Role::Operator < Role::Engineer);
    }

    #[test]
    fn names_that_another_site_can_rebind_are_refused() {
        let names = ["robot.local".to_owned()];
        for own in [
            "127.0.0.1:8780",
            "localhost:8780",
            "LOCALHOST",
            "[::1]:8780",
            "[::1]",
            "192.168.1.4",
            "robot.local:80",
        ] {
            assert!(is_own_host(own, &names), "{own}");
        }
        for other in [
            "",
            "evil.example",
            "evil.example:8780",
            "127.0.0.1.evil.example",
            "localhost.evil.example",
            "robot.local.evil.example",
            "robot.local@evil.example",
        ] {
            assert!(!is_own_host(other, &names), "{other}");
        }
    }

    #[test]
    fn requests_of_other_sites_are_known_by_their_origin() {
        let host = "127.0.0.1:8780";
        assert!(is_own_origin(None, host));
        assert!(is_own_origin(Some("http://127.0.0.1:8780"), host));
        for other in [
            "null",
            "http://evil.example",
            "http://127.0.0.1:8781",
            "http://127.0.0.1",
            "http://127.0.0.1:8780.evil.example",
            "file://",
            "",
        ] {
            assert!(!is_own_origin(Some(other), host), "{other}");
        }
    }
}
