//! Connections of browsers: a bounded number of them, and none that stands still for long.

use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::extract::connect_info::Connected;
use axum::serve::{IncomingStream, Listener};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Instant, Sleep, sleep};

/// Largest number of connections. Further ones are closed at once.
pub const CONNECTIONS_MAX: usize = 128;
/// Bytes that wait in the system for one browser: about two seconds of snapshots.
const SEND_BUFFER: usize = 64 * 1024;
/// Time without a byte in either direction after which a connection is closed.
const STILL: Duration = Duration::from_secs(20);
/// Wait after an error of the system, such as too many open files.
const AGAIN: Duration = Duration::from_millis(200);

/// Accepts connections.
pub struct Bounded {
    listener: TcpListener,
    places: Arc<Semaphore>,
    still: Duration,
}

impl Bounded {
    /// Accepts the connections of this listener.
    pub fn new(listener: TcpListener) -> Self {
        Self {
            listener,
            places: Arc::new(Semaphore::new(CONNECTIONS_MAX)),
            still: STILL,
        }
    }
}

impl Listener for Bounded {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Self::Io, Self::Addr) {
        loop {
            let Ok((stream, address)) = self.listener.accept().await else {
                sleep(AGAIN).await;
                continue;
            };
            let Ok(place) = Arc::clone(&self.places).try_acquire_owned() else {
                continue;
            };
            // Both only improve the speed of the connection, or bound what it takes.
            let _ = stream.set_nodelay(true);
            let _ = socket2::SockRef::from(&stream).set_send_buffer_size(SEND_BUFFER);
            let connection = Connection {
                stream,
                still: self.still,
                deadline: Box::pin(sleep(self.still)),
                _place: place,
            };
            return (connection, address);
        }
    }

    fn local_addr(&self) -> io::Result<Self::Addr> {
        self.listener.local_addr()
    }
}

/// A connection, which ends when nothing is read or written for a while.
pub struct Connection {
    stream: TcpStream,
    still: Duration,
    deadline: Pin<Box<Sleep>>,
    _place: OwnedSemaphorePermit,
}

impl Connection {
    fn progress(&mut self) {
        let deadline = Instant::now() + self.still;
        self.deadline.as_mut().reset(deadline);
    }

    /// Takes the result of an operation into account; one that waits may wait until the deadline.
    fn outcome<T>(
        &mut self,
        result: Poll<io::Result<T>>,
        context: &mut Context<'_>,
    ) -> Poll<io::Result<T>> {
        match result {
            Poll::Ready(done) => {
                self.progress();
                Poll::Ready(done)
            }
            Poll::Pending if self.deadline.as_mut().poll(context).is_ready() => {
                Poll::Ready(Err(io::ErrorKind::TimedOut.into()))
            }
            Poll::Pending => Poll::Pending,
        }
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let result = Pin::new(&mut self.stream).poll_read(context, buffer);
        self.outcome(result, context)
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let result = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.outcome(result, context)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

/// Address of the browser.
#[derive(Clone, Copy, Debug)]
pub struct Peer(pub SocketAddr);

impl Connected<IncomingStream<'_, Bounded>> for Peer {
    fn connect_info(stream: IncomingStream<'_, Bounded>) -> Self {
        Self(*stream.remote_addr())
    }
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    use super::*;

    fn block_on(test: impl Future<Output = ()>) {
        tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .unwrap()
            .block_on(test);
    }

    #[test]
    fn a_connection_that_stands_still_ends_and_frees_its_place() {
        block_on(async {
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            let address = listener.local_addr().unwrap();
            let mut bounded = Bounded::new(listener);
            bounded.still = Duration::from_millis(50);
            let places = Arc::clone(&bounded.places);
            let mut browser = TcpStream::connect(address).await.unwrap();
            let (mut connection, _) = bounded.accept().await;
            browser.write_all(b"a").await.unwrap();
            let mut bytes = [0; 8];
            assert_eq!(connection.read(&mut bytes).await.unwrap(), 1);
            let ended = connection.read(&mut bytes).await.unwrap_err();
            assert_eq!(ended.kind(), io::ErrorKind::TimedOut);
            assert_eq!(places.available_permits(), CONNECTIONS_MAX - 1);
            drop(connection);
            assert_eq!(places.available_permits(), CONNECTIONS_MAX);
        });
    }

    /// A browser that reads nothing: the bytes that wait for it are bounded, and it is let go.
    #[test]
    fn a_reader_that_sleeps_takes_bounded_memory_and_is_let_go() {
        block_on(async {
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            let address = listener.local_addr().unwrap();
            let mut bounded = Bounded::new(listener);
            bounded.still = Duration::from_millis(200);
            let browser = TcpStream::connect(address).await.unwrap();
            let (mut connection, _) = bounded.accept().await;
            let (block, mut taken) = ([0; 4096], 0);
            let ended = loop {
                match connection.write(&block).await {
                    Ok(bytes) => taken += bytes,
                    Err(error) => break error,
                }
                assert!(taken < 64 << 20, "{taken} bytes for a browser that sleeps");
            };
            assert_eq!(ended.kind(), io::ErrorKind::TimedOut);
            drop(browser);
        });
    }
}
