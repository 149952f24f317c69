//! Cuts a byte stream into packages: `u16` size of the whole package, `u8` kind, payload.

/// Bytes of a package's header.
pub const HEADER_BYTES: usize = 3;
/// Largest package that the size field can express.
pub const PACKAGE_BYTES_MAX: usize = u16::MAX as usize;

/// Error of a stream that cannot be cut into packages: the rest is meaningless, so close the
/// connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// The size field counts the header, so it is at least 3.
    #[error(
        "a package states a length of {size} bytes, less than its header of 3 bytes; this is not an RTDE stream"
    )]
    TooShort {
        /// Value of the size field.
        size: usize,
    },
    /// The package is longer than this end accepts.
    #[error("a package states a length of {size} bytes; at most {limit} are accepted")]
    TooLong {
        /// Value of the size field.
        size: usize,
        /// Longest package that this end accepts, bytes.
        limit: usize,
    },
}

/// One package, still in the framer's buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Package<'a> {
    /// Kind byte, see [`super::PackageKind`].
    pub kind: u8,
    /// Everything after the header.
    pub payload: &'a [u8],
}

/// Collects received bytes and returns whole packages; its memory is allocated once.
///
/// ```
/// use tangent_rtde::codec::Framer;
/// let mut framer = Framer::new(2048);
/// assert_eq!(framer.push(&[0, 4, b'V', 1, 0]), 5);
/// let package = framer.next_package().unwrap().unwrap();
/// assert_eq!((package.kind, package.payload), (b'V', &[1u8][..]));
/// assert!(framer.next_package().unwrap().is_none());
/// ```
#[derive(Debug)]
pub struct Framer {
    buffer: Box<[u8]>,
    start: usize,
    end: usize,
    limit: usize,
}

impl Framer {
    /// `limit` is the longest accepted package, bytes with header; at most [`PACKAGE_BYTES_MAX`].
    pub fn new(limit: usize) -> Self {
        let limit = limit.clamp(HEADER_BYTES, PACKAGE_BYTES_MAX);
        Self {
            // Twice the limit, so that a whole package fits behind the one being read.
            buffer: vec![0; 2 * limit].into_boxed_slice(),
            start: 0,
            end: 0,
            limit,
        }
    }

    /// Takes as many bytes as fit and returns their number. After all packages are taken out, there
    /// is always room for more.
    pub fn push(&mut self, bytes: &[u8]) -> usize {
        let space = self.space();
        let n = space.len().min(bytes.len());
        space[..n].copy_from_slice(&bytes[..n]);
        self.filled(n);
        n
    }

    /// Free room to read into from a socket; follow with [`Framer::filled`].
    pub fn space(&mut self) -> &mut [u8] {
        if self.start > 0 {
            self.buffer.copy_within(self.start..self.end, 0);
            self.end -= self.start;
            self.start = 0;
        }
        &mut self.buffer[self.end..]
    }

    /// `n` bytes of [`Framer::space`] now hold data; more than its length counts as its length.
    pub fn filled(&mut self, n: usize) {
        self.end = (self.end + n).min(self.buffer.len());
    }

    /// Number of bytes not yet taken out.
    pub fn waiting(&self) -> usize {
        self.end - self.start
    }

    /// The next whole package; `None` if its end has not arrived yet.
    pub fn next_package(&mut self) -> Result<Option<Package<'_>>, FrameError> {
        let bytes = &self.buffer[self.start..self.end];
        if bytes.len() < HEADER_BYTES {
            return Ok(None);
        }
        let size = usize::from(u16::from_be_bytes([bytes[0], bytes[1]]));
        if size < HEADER_BYTES {
            return Err(FrameError::TooShort { size });
        }
        if size > self.limit {
            return Err(FrameError::TooLong {
                size,
                limit: self.limit,
            });
        }
        if bytes.len() < size {
            return Ok(None);
        }
        self.start += size;
        Ok(Some(Package {
            kind: bytes[2],
            payload: &bytes[HEADER_BYTES..size],
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn packages() -> impl Strategy<Value = Vec<(u8, Vec<u8>)>> {
        prop::collection::vec(
            (any::<u8>(), prop::collection::vec(any::<u8>(), 0..200)),
            0..20,
        )
    }

    proptest! {
        #[test]
        fn however_it_is_split_the_packages_are_the_same(packages in packages(), cuts in prop::collection::vec(1usize..97, 1..50)) {
            let mut stream = Vec::new();
            for (kind, payload) in &packages {
                stream.extend_from_slice(&((payload.len() + HEADER_BYTES) as u16).to_be_bytes());
                stream.push(*kind);
                stream.extend_from_slice(payload);
            }
            let mut framer = Framer::new(256);
            let mut got = Vec::new();
            let (mut at, mut cut) = (0, cuts.iter().cycle());
            while at < stream.len() {
                let n = (*cut.next().unwrap()).min(stream.len() - at);
                let taken = framer.push(&stream[at..at + n]);
                prop_assert!(taken > 0);
                at += taken;
                while let Some(p) = framer.next_package().unwrap() {
                    got.push((p.kind, p.payload.to_vec()));
                }
            }
            prop_assert_eq!(got, packages);
            prop_assert_eq!(framer.waiting(), 0);
        }

        #[test]
        fn garbage_never_grows_it(chunks in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..600), 0..30)) {
            let mut framer = Framer::new(512);
            'stream: for chunk in chunks {
                framer.push(&chunk);
                prop_assert!(framer.waiting() <= 1024);
                loop {
                    match framer.next_package() {
                        Ok(Some(p)) => prop_assert!(p.payload.len() <= 509),
                        Ok(None) => break,
                        Err(_) => break 'stream,
                    }
                }
            }
        }
    }

    #[test]
    fn impossible_sizes_are_named() {
        let mut framer = Framer::new(100);
        framer.push(&[0, 2, b'V']);
        assert_eq!(framer.next_package(), Err(FrameError::TooShort { size: 2 }));
        let mut framer = Framer::new(100);
        framer.push(&[0xff, 0xff, b'V']);
        assert_eq!(
            framer.next_package(),
            Err(FrameError::TooLong {
                size: 65535,
                limit: 100
            })
        );
    }
}
