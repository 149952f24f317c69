//! Reads a certificate file: its identity, its issuer and its validity.

use std::net::IpAddr;
use std::path::{Path, PathBuf};

use x509_parser::certificate::X509Certificate;
use x509_parser::extensions::GeneralName;
use x509_parser::pem::Pem;

use super::SecurityError;

const DAY_S: i64 = 24 * 3600;

/// Contents of a certificate file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Certificate {
    /// Path of the file.
    pub file: PathBuf,
    /// Common name.
    pub identity: String,
    /// Start of validity, s since the Unix epoch.
    pub from_s: i64,
    /// End of validity, s since the Unix epoch.
    pub until_s: i64,
    /// Names and addresses for which a router's certificate is valid.
    pub hosts: Vec<String>,
    pub(super) subject: Vec<u8>,
    pub(super) issuer: Vec<u8>,
    pub(super) issuer_words: String,
    pub(super) public_key: Vec<u8>,
}

impl Certificate {
    /// Reads the first certificate of a PEM file.
    ///
    /// # Errors
    /// The file cannot be read, or holds no certificate.
    pub fn read(file: &Path) -> Result<Self, SecurityError> {
        let bytes = read(file)?;
        Self::parse(file, &bytes)
    }

    pub(super) fn parse(file: &Path, bytes: &[u8]) -> Result<Self, SecurityError> {
        let wrong = |reason: String| SecurityError::Content {
            file: file.to_owned(),
            reason,
        };
        let pem = Pem::iter_from_buffer(bytes)
            .filter_map(Result::ok)
            .find(|pem| pem.label == "CERTIFICATE")
            .ok_or_else(|| {
                wrong("holds no certificate (no `-----BEGIN CERTIFICATE-----`); `tangent keys new` makes one".into())
            })?;
        let parsed = pem
            .parse_x509()
            .map_err(|error| wrong(format!("its certificate cannot be read: {error}")))?;
        Ok(Self {
            file: file.to_owned(),
            identity: parsed
                .subject()
                .iter_common_name()
                .next()
                .and_then(|name| name.as_str().ok())
                .unwrap_or_default()
                .to_owned(),
            hosts: hosts(&parsed),
            from_s: parsed.validity().not_before.timestamp(),
            until_s: parsed.validity().not_after.timestamp(),
            subject: parsed.subject().as_raw().to_vec(),
            issuer: parsed.issuer().as_raw().to_vec(),
            issuer_words: parsed.issuer().to_string(),
            public_key: parsed.public_key().subject_public_key.data.to_vec(),
        })
    }

    /// Whole days until it expires; negative if it has expired.
    pub fn days_left(&self, now_s: i64) -> i64 {
        (self.until_s - now_s).div_euclid(DAY_S)
    }

    /// Checks that it is valid now.
    ///
    /// # Errors
    /// [`SecurityError::Validity`], with what to do.
    pub fn check_time(&self, now_s: i64) -> Result<(), SecurityError> {
        let (what, remedy) = if now_s > self.until_s {
            (
                format!("expired {}", ago(now_s - self.until_s)),
                format!(
                    "make a new one with `tangent keys new FOLDER --renew {}`",
                    self.identity
                ),
            )
        } else if now_s < self.from_s {
            (
                format!("is valid only from {} on", in_words(self.from_s - now_s)),
                "is this machine's clock right?".to_owned(),
            )
        } else {
            return Ok(());
        };
        Err(SecurityError::Validity {
            file: self.file.clone(),
            identity: self.identity.clone(),
            what,
            remedy,
        })
    }
}

fn hosts(parsed: &X509Certificate<'_>) -> Vec<String> {
    let Ok(Some(names)) = parsed.subject_alternative_name() else {
        return Vec::new();
    };
    let host = |name: &GeneralName<'_>| match name {
        GeneralName::DNSName(name) => Some((*name).to_owned()),
        GeneralName::IPAddress(bytes) => {
            let v4 = <[u8; 4]>::try_from(*bytes).map(IpAddr::from);
            let v6 = <[u8; 16]>::try_from(*bytes).map(IpAddr::from);
            Some(v4.or(v6).ok()?.to_string())
        }
        _ => None,
    };
    names.value.general_names.iter().filter_map(host).collect()
}

fn ago(seconds: i64) -> String {
    match seconds / DAY_S {
        0 => "less than a day ago".to_owned(),
        1 => "1 day ago".to_owned(),
        days => format!("{days} days ago"),
    }
}

fn in_words(seconds: i64) -> String {
    match seconds / DAY_S {
        0 => "less than a day".to_owned(),
        days => format!("{days} days"),
    }
}

/// Reads a file's bytes.
pub(super) fn read(file: &Path) -> Result<Vec<u8>, SecurityError> {
    std::fs::read(file).map_err(|error| SecurityError::File {
        file: file.to_owned(),
        remedy: if error.kind() == std::io::ErrorKind::PermissionDenied {
            "give this user the right to read it"
        } else {
            "make keys with `tangent keys new`, or correct [zenoh.tls] in the cell file"
        },
        reason: error.to_string(),
    })
}
