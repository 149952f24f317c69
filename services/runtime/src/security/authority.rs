//! The fleet's own certificate authority, which creates one certificate per identity.

use std::fs::{self, OpenOptions};
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa,
    Issuer, KeyPair, KeyUsagePurpose,
};
use time::{Duration, OffsetDateTime};

use super::certificate::{Certificate, read};
use super::{SecurityError, roles};

/// File name of the authority's certificate, within its folder.
pub const CA: &str = "ca.pem";
const CA_KEY: &str = "ca.key";
/// Lifetime of the authority's certificate, days: longer than that of any certificate it issues.
const CA_DAYS: i64 = 3650;
/// Start of validity before the time of issue, so that a new certificate is valid at once on hosts
/// whose clocks are behind.
const EARLIER: Duration = Duration::hours(1);

/// Files of one identity.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Issued {
    /// Certificate.
    pub certificate: PathBuf,
    /// Private key.
    pub key: PathBuf,
}

/// A folder with an authority's key and certificate, and the files that it has issued.
pub struct Authority {
    folder: PathBuf,
    issuer: Issuer<'static, KeyPair>,
}

impl Authority {
    /// Opens the authority in a folder, or creates one if there is none.
    ///
    /// # Errors
    /// The folder cannot be written, or files in it are not those of an authority.
    pub fn open_or_create(folder: &Path) -> Result<Self, SecurityError> {
        fs::create_dir_all(folder).map_err(|error| cannot_write(folder, &error))?;
        let (certificate, key) = (folder.join(CA), folder.join(CA_KEY));
        let issuer = if key.exists() {
            let words = String::from_utf8_lossy(&read(&key)?).into_owned();
            let pair = KeyPair::from_pem(&words).map_err(|error| SecurityError::Content {
                file: key.clone(),
                reason: format!("is no private key in PKCS#8: {error}"),
            })?;
            let ca = Certificate::read(&certificate)?;
            if ca.public_key != pair.public_key_raw() {
                return Err(SecurityError::Content {
                    file: key,
                    reason: format!("is not the key of {}", certificate.display()),
                });
            }
            Issuer::new(ca_params(&ca.identity), pair)
        } else {
            let pair = KeyPair::generate().map_err(|error| making("the authority", &error))?;
            // Two authorities have different names, so that a certificate shows which one issued
            // it.
            let public = pair.public_key_raw();
            let mark: String = public[public.len().saturating_sub(4)..]
                .iter()
                .map(|byte| format!("{byte:02x}"))
                .collect();
            let params = ca_params(&format!("tangent authority {mark}"));
            let made = params
                .self_signed(&pair)
                .map_err(|error| making("the authority", &error))?;
            write(&key, &pair.serialize_pem(), 0o600)?;
            write(&certificate, &made.pem(), 0o644)?;
            Issuer::new(params, pair)
        };
        Ok(Self {
            folder: folder.to_owned(),
            issuer,
        })
    }

    /// Certificate of the authority, which every process needs.
    pub fn ca(&self) -> PathBuf {
        self.folder.join(CA)
    }

    /// Paths of an identity's files, whether they exist or not.
    pub fn files(&self, identity: &str) -> Issued {
        Issued {
            certificate: self.folder.join(format!("{identity}.pem")),
            key: self.folder.join(format!("{identity}.key")),
        }
    }

    /// Writes a text beside the keys, atomically: a router may be reading it.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn put(&self, name: &str, text: &str) -> Result<PathBuf, SecurityError> {
        let (file, new) = (
            self.folder.join(name),
            self.folder.join(format!(".{name}.new")),
        );
        write(&new, text, 0o644)?;
        fs::rename(&new, &file).map_err(|error| cannot_write(&file, &error))?;
        Ok(file)
    }

    /// Creates a key and a certificate for `identity`; existing files are replaced. `hosts` are
    /// names and addresses at which clients connect, for the router.
    ///
    /// # Errors
    /// The name is not a valid identity, a host is neither a name nor an address, or the folder
    /// cannot be written.
    pub fn issue(
        &self,
        identity: &str,
        hosts: &[String],
        days: i64,
    ) -> Result<Issued, SecurityError> {
        check_identity(identity)?;
        let failed = |error: &rcgen::Error| making(identity, error);
        let pair = KeyPair::generate().map_err(|error| failed(&error))?;
        let mut params = CertificateParams::new(hosts.to_vec()).map_err(|error| failed(&error))?;
        params.distinguished_name = name(identity);
        hold(&mut params, days);
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages = if identity == roles::ROUTER {
            vec![
                ExtendedKeyUsagePurpose::ServerAuth,
                ExtendedKeyUsagePurpose::ClientAuth,
            ]
        } else {
            vec![ExtendedKeyUsagePurpose::ClientAuth]
        };
        params.use_authority_key_identifier_extension = true;
        let made = params
            .signed_by(&pair, &self.issuer)
            .map_err(|error| failed(&error))?;
        let files = self.files(identity);
        write(&files.key, &pair.serialize_pem(), 0o600)?;
        write(&files.certificate, &made.pem(), 0o644)?;
        Ok(files)
    }
}

fn ca_params(words: &str) -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name = name(words);
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    hold(&mut params, CA_DAYS);
    params
}

fn name(common: &str) -> DistinguishedName {
    let mut name = DistinguishedName::new();
    name.push(DnType::CommonName, common);
    name
}

fn hold(params: &mut CertificateParams, days: i64) {
    let now = OffsetDateTime::now_utc();
    params.not_before = now - EARLIER;
    params.not_after = now + Duration::days(days);
}

fn check_identity(identity: &str) -> Result<(), SecurityError> {
    let good = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    if (1..=64).contains(&identity.len()) && identity.chars().all(good) && identity != "ca" {
        return Ok(());
    }
    Err(SecurityError::Identity {
        name: identity.to_owned(),
        allowed: "1 to 64 letters, digits, `_`, `-` or `.`, as in `controller.cell1`".to_owned(),
    })
}

fn making(identity: &str, error: &rcgen::Error) -> SecurityError {
    SecurityError::Making {
        identity: identity.to_owned(),
        reason: error.to_string(),
    }
}

fn cannot_write(file: &Path, error: &std::io::Error) -> SecurityError {
    SecurityError::File {
        file: file.to_owned(),
        reason: error.to_string(),
        remedy: "name a folder that can be written",
    }
}

/// Writes with this mode from the first byte on: a key is never readable by others.
fn write(file: &Path, words: &str, mode: u32) -> Result<(), SecurityError> {
    let failed = |error: std::io::Error| cannot_write(file, &error);
    match fs::remove_file(file) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(failed(error)),
        _ => {}
    }
    OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(mode)
        .open(file)
        .and_then(|mut open| open.write_all(words.as_bytes()))
        .map_err(failed)
}
