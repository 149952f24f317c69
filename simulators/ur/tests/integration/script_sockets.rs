//! Programs that open TCP connections to their client: every function that sends and reads.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};

use crate::common::{PATIENCE, cb3, connect};
use tangent_live::timed;
use tangent_simulated_ur::SimulatedUr;

/// Runs a program that has opened the connection `socket_0`, and returns its other end.
fn talk(cell: &SimulatedUr, body: &str) -> TcpStream {
    let server = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = server.local_addr().unwrap().port();
    let text = format!(
        "def talk():\n  if socket_open(\"127.0.0.1\", {port}):\n{body}\n    socket_close()\n  end\nend\n"
    );
    let mut script = connect(cell.endpoints().secondary);
    script.write_all(text.as_bytes()).unwrap();
    let (stream, _) = server.accept().unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream
}

fn next_line(from: &mut impl BufRead) -> String {
    let mut line = String::new();
    from.read_line(&mut line).unwrap();
    line.trim_end().to_owned()
}

#[test]
fn a_program_sends_what_it_is_told() {
    timed(|| {
        let cell = cb3();
        let mut stream = talk(
            &cell,
            "socket_send_string(\"pos \")
             socket_send_line([1, 2.5])
             socket_send_int(-2)
             socket_send_byte(200)
             socket_set_var(\"speed\", 7)",
        );
        let mut all = Vec::new();
        stream.read_to_end(&mut all).unwrap();
        let wanted = [
            b"pos [1, 2.5]\n".as_slice(),
            &(-2_i32).to_be_bytes(),
            &[200],
            b"SET speed 7\n",
        ]
        .concat();
        assert_eq!(all, wanted);
    });
}

#[test]
fn a_program_reads_what_it_is_sent() {
    timed(|| {
        let cell = cb3();
        let stream = talk(
            &cell,
            "socket_send_line(socket_read_ascii_float(3))
             socket_send_line(socket_read_binary_integer(2))
             socket_send_line(socket_read_byte_list(3))
             socket_send_line(socket_read_line())
             socket_send_line(socket_read_string(prefix=\">\", suffix=\"<\"))
             socket_send_line(socket_get_var(\"speed\"))
             socket_send_line(socket_read_binary_integer(1, \"socket_0\", 0.1))
             socket_send_line(socket_read_string(\"socket_0\", timeout=0.1))
             socket_send_line(socket_read_line(timeout=0))
             # The other side closes: this does not wait for ever.
             x = socket_read_binary_integer(1, \"socket_0\", 0)
             textmsg(\"closed \", x)",
        );
        let mut to = stream.try_clone().unwrap();
        let mut from = BufReader::new(stream);
        let from = &mut from;
        let mut line = || next_line(from);
        // Torn between two writes.
        to.write_all(b"(1.5, -2").unwrap();
        to.write_all(b", 3e2)").unwrap();
        assert_eq!(line(), "[3, 1.5, -2, 300]");
        to.write_all(&[0, 0, 1, 0, 255, 255]).unwrap();
        to.write_all(&[255, 255, 9, 8, 7]).unwrap();
        assert_eq!(line(), "[2, 256, -1]");
        assert_eq!(line(), "[3, 9, 8, 7]");
        to.write_all(b"hello robot\r\n").unwrap();
        assert_eq!(line(), "hello robot");
        to.write_all(b"noise >move< ").unwrap();
        assert_eq!(line(), "move");
        assert_eq!(line(), "GET speed");
        to.write_all(b"\nspeed 12\n").unwrap();
        assert_eq!(line(), "12");
        // Nothing comes in time.
        assert_eq!(line(), "[0, -1]");
        assert_eq!(line(), "");
        to.write_all(b"late\n").unwrap();
        assert_eq!(line(), "late");
        to.shutdown(Shutdown::Both).unwrap();
        assert!(cell.wait_for(PATIENCE, |s| s.program.is_none()));
        let log = cell.log().join("\n");
        assert!(log.contains("closed [0, -1]"), "{log}");
    });
}

/// Some clients send set points as fast as the connection takes them.
#[test]
fn a_client_may_send_faster_than_a_program_reads() {
    timed(|| {
        let cell = cb3();
        let mut stream = talk(
            &cell,
            "n = 0
             sum = 0
             while n < 20000:
               list = socket_read_binary_integer(8)
               n = n + 1
               sum = sum + list[8]
             end
             socket_send_line(sum)",
        );
        let mut numbers = [0_u8; 32];
        numbers[31] = 1;
        stream.write_all(&numbers.repeat(20_000)).unwrap();
        let mut line = String::new();
        BufReader::new(stream).read_line(&mut line).unwrap();
        assert_eq!(line, "20000\n");
    });
}

#[test]
fn a_server_that_is_not_there_is_false_and_threads_go_on() {
    timed(|| {
        let cell = cb3();
        let closed = {
            let server = TcpListener::bind("127.0.0.1:0").unwrap();
            server.local_addr().unwrap().port()
        };
        let text = format!(
            "def lonely():
               thread count():
                 n = 0
                 while True:
                   n = n + 1
                   write_output_integer_register(0, n)
                   sync()
                 end
               end
               run count()
               textmsg(\"open \", socket_open(\"127.0.0.1\", {closed}, \"a\"))
               textmsg(\"send \", socket_send_int(1, \"a\"))
               textmsg(\"read \", socket_read_binary_integer(2, \"a\", 0))
               textmsg(\"name \", socket_open(\"no such host\", 1, \"b\"))
end\n"
        );
        let mut script = connect(cell.endpoints().secondary);
        script.write_all(text.as_bytes()).unwrap();
        assert!(cell.wait_for(PATIENCE, |s| s.program.is_some()));
        assert!(cell.wait_for(PATIENCE, |s| s.program.is_none()));
        let log = cell.log().join("\n");
        for said in ["open False", "send False", "read [0, -1, -1]", "name False"] {
            assert!(log.contains(said), "{said}: {log}");
        }
    });
}
