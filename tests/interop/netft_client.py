"""Third-party Net F/T clients against the simulated box.

usage: netft_client.py ADDRESS HTTP_PORT; the box must read (1e6, -2e6, 3e6, 4, -5, 6) counts and speak RDT on UDP 49152.
Exits with 77, and says what is missing, when `netft` is not installed; `pynetft` is optional.
"""

import sys

COUNTS = [1_000_000, -2_000_000, 3_000_000, 4, -5, 6]


def with_netft(address):
    try:
        from NetFT import Sensor
    except ImportError as error:
        print(f"{error}: pip install -r tests/interop/requirements.txt")
        sys.exit(77)
    sensor = Sensor(address)
    sensor.sock.settimeout(10)
    assert sensor.getMeasurement() == COUNTS, sensor.data
    assert sensor.getForce() == COUNTS[:3]
    assert sensor.getTorque() == COUNTS[3:]
    mean = sensor.tare(20)
    assert all(abs(m - c) < 1e-6 * max(1, abs(c)) for m, c in zip(mean, COUNTS)), mean
    sensor.zero()
    sensor.startStreaming(handler=False)
    for _ in range(700):
        assert sensor.receive() == COUNTS
    sensor.stopStreaming()
    print("netft: ok")


def with_pynetft(address, http_port):
    try:
        import pynetft
    except ImportError:
        print("pynetft: missing")
        return
    config = pynetft.Config(
        sensor_host=address,
        rdt_port=49152,
        http_port=http_port,
        receive_timeout=2.0,
        configuration_connect_timeout=5.0,
        configuration_timeout=10.0,
    )
    with pynetft.Client(config, queue_size=1024) as client:
        assert client.wait_for_first_sample(20.0), client.health()
        seen = 0
        for sample in client.samples(timeout=10.0):
            assert list(sample.raw_wrench) == COUNTS, sample
            assert abs(sample.force[2] - 3.0) < 1e-9, sample
            assert sample.force_unit == pynetft.ForceUnit.NEWTON, sample
            assert sample.torque_unit == pynetft.TorqueUnit.NEWTON_METER, sample
            seen += 1
            if seen == 700:
                break
    print("pynetft: ok")


if __name__ == "__main__":
    with_netft(sys.argv[1])
    with_pynetft(sys.argv[1], int(sys.argv[2]))
