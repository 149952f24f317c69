//! Certificate files of a session. They are checked before Zenoh reads them, since its errors say
//! little about what is wrong with a file.

use std::path::{Path, PathBuf};

use rcgen::KeyPair;

use super::SecurityError;
use super::certificate::{Certificate, read};
use crate::config::TlsConfig;

/// Stands for the identity in the cell file's paths.
const PLACEHOLDER: &str = "{identity}";
/// A certificate that is valid for fewer days than this causes a warning.
const DAYS_WARNED: i64 = 30;
const DAY_S: i64 = 24 * 3600;

/// Certificate files that passed the check.
#[derive(Clone, Debug)]
pub(crate) struct Credentials {
    pub(crate) ca: PathBuf,
    pub(crate) certificate: PathBuf,
    pub(crate) key: PathBuf,
}

/// Finds and checks the files of `[zenoh.tls]`.
///
/// # Errors
/// A file is missing, unreadable, expired, or does not belong to the others; the error is about the
/// first one.
pub(crate) fn check(tls: &TlsConfig, now_s: i64) -> Result<Credentials, SecurityError> {
    let identity = tls.identity.as_deref();
    let found = Credentials {
        ca: tls.ca.clone(),
        certificate: named("certificate", &tls.certificate, identity)?,
        key: named("key", &tls.key, identity)?,
    };
    let ca = Certificate::read(&found.ca)?;
    ca.check_time(now_s)?;
    let own = Certificate::read(&found.certificate)?;
    own.check_time(now_s)?;
    if own.issuer != ca.subject {
        return Err(SecurityError::Content {
            file: found.certificate,
            reason: format!(
                "was made by {}, not by the authority in {}: use files of one `tangent keys` folder",
                own.issuer_words,
                found.ca.display()
            ),
        });
    }
    check_key(&found, &own)?;
    Ok(found)
}

/// Expiry of the certificates of a process.
#[derive(Clone, Debug)]
pub(crate) struct Expiry {
    file: PathBuf,
    identity: String,
    until_s: i64,
    /// Expiry of the authority's certificate.
    ca: PathBuf,
    ca_until_s: i64,
}

impl Expiry {
    /// Expiry of the certificates in `[zenoh.tls]`.
    ///
    /// # Errors
    /// A file cannot be read.
    pub(crate) fn of(tls: &TlsConfig) -> Result<Self, SecurityError> {
        let path = named("certificate", &tls.certificate, tls.identity.as_deref())?;
        let (own, ca) = (Certificate::read(&path)?, Certificate::read(&tls.ca)?);
        Ok(Self {
            file: own.file,
            identity: own.identity,
            until_s: own.until_s,
            ca: ca.file,
            ca_until_s: ca.until_s,
        })
    }

    /// Warning that applies at this time; `None` while the certificates are valid long enough.
    pub(crate) fn remark(&self, now_s: i64) -> Option<String> {
        if self.ca_until_s - now_s < DAYS_WARNED * DAY_S {
            let when = when(self.ca_until_s - now_s);
            return Some(format!(
                "{}: the authority's certificate {when}; make a new folder of keys with `tangent keys new`",
                self.ca.display()
            ));
        }
        let left_s = self.until_s - now_s;
        (left_s < DAYS_WARNED * DAY_S).then(|| {
            format!(
                "{}: the certificate of `{}` {}; `tangent keys new FOLDER --renew {}` makes a new one, which the next start uses",
                self.file.display(),
                self.identity,
                when(left_s),
                self.identity
            )
        })
    }
}

fn when(left_s: i64) -> String {
    match left_s.div_euclid(DAY_S) {
        ..0 => "has expired, and the next connection is refused".to_owned(),
        0 => "is valid for less than a day".to_owned(),
        1 => "is valid for 1 more day".to_owned(),
        days => format!("is valid for {days} more days"),
    }
}

fn named(key: &'static str, path: &Path, identity: Option<&str>) -> Result<PathBuf, SecurityError> {
    let words = path.display().to_string();
    match identity {
        _ if !words.contains(PLACEHOLDER) => Ok(path.to_owned()),
        Some(identity) => Ok(PathBuf::from(words.replace(PLACEHOLDER, identity))),
        None => Err(SecurityError::NoIdentity { key, value: words }),
    }
}

fn check_key(found: &Credentials, own: &Certificate) -> Result<(), SecurityError> {
    let words = String::from_utf8_lossy(&read(&found.key)?).into_owned();
    let wrong = |reason: String| SecurityError::Content {
        file: found.key.clone(),
        reason,
    };
    if !words.contains("PRIVATE KEY-----") {
        return Err(wrong(
            "holds no private key (no `-----BEGIN PRIVATE KEY-----`)".to_owned(),
        ));
    }
    // Keys in another form than PKCS#8 are checked by Zenoh only.
    if let Ok(pair) = KeyPair::from_pem(&words)
        && pair.public_key_raw() != own.public_key
    {
        return Err(wrong(format!(
            "is not the key of the certificate in {}",
            found.certificate.display()
        )));
    }
    warn_of_rights(&found.key);
    Ok(())
}

fn warn_of_rights(key: &Path) {
    use std::os::unix::fs::PermissionsExt;
    if let Ok(found) = std::fs::metadata(key)
        && found.permissions().mode() & 0o077 != 0
    {
        tracing::warn!(
            "{}: others on this machine can read this private key; `chmod 600` it",
            key.display()
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::security::Authority;

    fn now_s() -> i64 {
        crate::clock::now_ns() / 1_000_000_000
    }

    fn tls(folder: &Path, identity: Option<&str>) -> TlsConfig {
        TlsConfig {
            ca: folder.join("ca.pem"),
            certificate: folder.join("{identity}.pem"),
            key: folder.join("{identity}.key"),
            identity: identity.map(str::to_owned),
        }
    }

    fn refused(tls: &TlsConfig, now_s: i64) -> String {
        check(tls, now_s).unwrap_err().to_string()
    }

    #[test]
    fn created_certificates_are_valid_also_with_the_authority_read_again() {
        let folder = tempfile::tempdir().unwrap();
        Authority::open_or_create(folder.path())
            .unwrap()
            .issue("operator", &[], 10)
            .unwrap();
        Authority::open_or_create(folder.path())
            .unwrap()
            .issue("viewer", &[], 10)
            .unwrap();
        for identity in ["operator", "viewer"] {
            let found = check(&tls(folder.path(), Some(identity)), now_s()).unwrap();
            let own = Certificate::read(&found.certificate).unwrap();
            assert_eq!(own.identity, identity);
            // The result is in whole days, and part of a second has passed.
            assert!((9..=10).contains(&own.days_left(now_s())));
        }
    }

    #[test]
    fn expiry_is_reported_thirty_days_in_advance() {
        let folder = tempfile::tempdir().unwrap();
        let authority = Authority::open_or_create(folder.path()).unwrap();
        authority.issue("operator", &[], 100).unwrap();
        let expiry = Expiry::of(&tls(folder.path(), Some("operator"))).unwrap();
        let after = |days: i64| expiry.remark(now_s() + days * DAY_S);
        assert_eq!(after(0), None);
        assert_eq!(after(69), None);
        for (days, words) in [
            (71, "`operator` is valid for 2"),
            (99, "`operator` is valid for "),
            (101, "has expired"),
        ] {
            let said = after(days).unwrap();
            assert!(said.contains(words), "{days}: {said}");
            assert!(said.contains("--renew operator"), "{said}");
        }
        assert!(after(3640).unwrap().contains("ca.pem: the authority's"));
    }

    #[test]
    fn each_wrong_file_is_named_with_what_to_do() {
        let (folder, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let authority = Authority::open_or_create(folder.path()).unwrap();
        authority.issue("operator", &[], 10).unwrap();
        authority.issue("viewer", &[], 10).unwrap();
        let good = tls(folder.path(), Some("operator"));

        let said = refused(&tls(folder.path(), None), now_s());
        assert!(
            said.contains("zenoh.tls.certificate") && said.contains("--identity"),
            "{said}"
        );
        let said = refused(&tls(folder.path(), Some("nobody")), now_s());
        assert!(
            said.contains("nobody.pem") && said.contains("tangent keys new"),
            "{said}"
        );
        let said = refused(&good, now_s() + 12 * DAY_S);
        assert!(said.contains("`operator` expired 2 days ago"), "{said}");
        assert!(said.contains("--renew operator"), "{said}");
        let said = refused(&good, now_s() - 3 * DAY_S);
        assert!(said.contains("clock"), "{said}");

        let swapped = TlsConfig {
            key: folder.path().join("viewer.key"),
            ..good.clone()
        };
        let said = refused(&swapped, now_s());
        assert!(said.contains("viewer.key: is not the key of"), "{said}");
        let no_key = TlsConfig {
            key: folder.path().join("viewer.pem"),
            ..good.clone()
        };
        let said = refused(&no_key, now_s());
        assert!(said.contains("holds no private key"), "{said}");
        let no_certificate = TlsConfig {
            certificate: folder.path().join("viewer.key"),
            ..good
        };
        let said = refused(&no_certificate, now_s());
        assert!(said.contains("holds no certificate"), "{said}");

        Authority::open_or_create(other.path()).unwrap();
        let unidentified = TlsConfig {
            ca: other.path().join("ca.pem"),
            ..tls(folder.path(), Some("operator"))
        };
        let said = refused(&unidentified, now_s());
        assert!(said.contains("was made by CN=tangent authority"), "{said}");
        assert!(said.contains("not by the authority in"), "{said}");
    }
}
