"""The reader thread on real pseudo-terminals: bytes, unplugging, stopping."""

from contextlib import contextmanager
import threading
import time
from types import SimpleNamespace

from ptys import PluggedPort, wait_until
import pytest
from serial.tools import list_ports

from multiimu_ros.errors import ConfigError
from multiimu_ros.transport.serial_port import SerialTransport


@contextmanager
def reading(**options):
    """Read a port for a while; return the transport and the blocks it delivers."""
    blocks = []
    transport = SerialTransport(lambda *block: blocks.append(block), **options)
    transport.start()
    try:
        yield transport, blocks
    finally:
        transport.stop()


@pytest.fixture
def device(tmp_path):
    port = PluggedPort(tmp_path / 'ttyIMU')
    port.plug()
    yield port
    port.unplug()


def received(blocks):
    return b''.join(data for _, data in list(blocks))


def test_bytes_arrive_unchanged_and_in_order(device):
    sent = bytes(range(256)) * 40
    with reading(port=device.path) as (transport, blocks):
        assert wait_until(lambda: transport.connected)
        device.send(sent)
        assert wait_until(lambda: len(received(blocks)) == len(sent))
    assert received(blocks) == sent
    assert transport.bytes == len(sent)


def test_arrival_is_the_system_time(device):
    with reading(port=device.path) as (transport, blocks):
        assert wait_until(lambda: transport.connected)
        before = time.time_ns()
        device.send(b'x')
        assert wait_until(lambda: blocks)
        after = time.time_ns()
    assert before - 1e6 <= blocks[0][0] <= after + 1e6  # 1 ms: the two clocks are read in turn


def test_a_replugged_port_is_found_again(device):
    with reading(port=device.path) as (transport, blocks):
        assert wait_until(lambda: transport.connected)
        device.send(b'before')
        assert wait_until(lambda: received(blocks) == b'before')
        device.unplug()
        assert wait_until(lambda: not transport.connected)
        device.plug()
        assert wait_until(lambda: transport.connected)
        device.send(b' and after')
        assert wait_until(lambda: received(blocks) == b'before and after')
    assert transport.connections == 2
    assert 'plug' in transport.last_error


def test_a_port_that_is_not_there_yet_is_waited_for(tmp_path):
    port = PluggedPort(tmp_path / 'later')
    with reading(port=port.path) as (transport, _):
        assert wait_until(lambda: 'Cannot open' in transport.last_error)
        transport.write(b'nobody hears this')
        port.plug()
        assert wait_until(lambda: transport.connected)
    port.unplug()


def test_the_device_hears_what_is_written(device):
    with reading(port=device.path) as (transport, _):
        assert wait_until(lambda: transport.connected)
        transport.write(b'hello')
        assert device.hear() == b'hello'


@pytest.mark.parametrize('plugged', [True, False])
def test_stop_is_quick_and_leaves_no_thread(device, plugged):
    if not plugged:
        device.unplug()
    threads = threading.active_count()
    with reading(port=device.path):
        time.sleep(0.05)
        start = time.monotonic()
    assert time.monotonic() - start < 0.3
    assert threading.active_count() == threads


def test_a_transport_that_never_started_can_be_stopped():
    SerialTransport(print, port='/dev/null').stop()


def test_the_port_is_found_by_its_usb_serial_number(device, monkeypatch):
    ports = [
        SimpleNamespace(serial_number=None, device='/dev/ttyS0'),
        SimpleNamespace(serial_number='A1', device=device.path),
    ]
    monkeypatch.setattr(list_ports, 'comports', lambda: ports)
    with reading(usb_serial='A1') as (transport, _):
        assert wait_until(lambda: transport.connected)
    with reading(usb_serial='B2') as (transport, _):
        assert wait_until(lambda: 'got `B2`; there are: A1' in transport.last_error)


def test_a_baud_rate_that_cannot_be_is_reported(device):
    with reading(port=device.path, baud=-1) as (transport, _):
        assert wait_until(lambda: 'Cannot open' in transport.last_error)


@pytest.mark.parametrize('names', [{}, {'port': 'a', 'usb_serial': 'b'}])
def test_the_port_must_be_named_once(names):
    with pytest.raises(ConfigError, match='Exactly one of `port` and `usb_serial`'):
        SerialTransport(print, **names)
