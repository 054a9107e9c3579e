"""The compiled sketch on its emulated board: builds both, runs scripts, decodes what comes out.

Needs avr-gcc, Debian's Arduino core and simavr; see docs/firmware.md.  Where they are missing the
tests are skipped, or fail if MULTIIMU_REQUIRE_FIRMWARE=1 asks for them.
"""

from contextlib import contextmanager
from dataclasses import dataclass
import fcntl
from functools import cache
import hashlib
import json
import os
from pathlib import Path
import shutil
import subprocess
import threading
import time

import pytest

from multiimu_ros.wire.decoder import FrameDecoder
from multiimu_ros.wire.packets import Counts, Hello, Packet, Scan, Status

FIRMWARE = Path(__file__).resolve().parents[1] / 'firmware'
TOOLS = ('make', 'gcc', 'avr-g++', 'avr-objcopy')
FILES = ('/usr/share/arduino/hardware/arduino/avr', '/usr/include/simavr/sim_avr.h')
PACKAGES = 'make gcc libc6-dev gcc-avr avr-libc binutils-avr arduino-core-avr libsimavr-dev'
FAST = '-DSCAN_RATE_HZ=180 -DBUS_POLLED=1'

BOOT_US = (500, 600)  # the sketch's clock starts so long after the board's
READ_S = 1.3e-3  # from a reading's stamp to the last of its chips
# Samples a second: angular rate, specific force; what the sketch sets, or the device can.
RATES = {
    'bmi160': (400, 400),
    'mpu9250': (500, 500),
    'mpu9255': (500, 500),
    'bno055': (100, 100),
    'sen0140': (500, 200),
}


def require(*tools, files=(), packages=PACKAGES):
    """Skip the test where something is missing, or fail it in CI."""
    missing = [tool for tool in tools if shutil.which(tool) is None]
    missing += [file for file in files if not Path(file).exists()]
    if not missing:
        return
    reason = f'{", ".join(missing)} not found: `apt-get install {packages}`'
    if os.environ.get('MULTIIMU_REQUIRE_FIRMWARE') == '1':
        pytest.fail(reason)
    pytest.skip(reason)


@contextmanager
def only_one(path):
    """Let no other process in meanwhile: two workers must not build the same."""
    with path.open('w') as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _digest(flags):
    sources = sorted(p for p in FIRMWARE.rglob('*') if 'build' not in p.parts and p.is_file())
    return hashlib.sha256(b'\0'.join([flags.encode(), *(p.read_bytes() for p in sources)]))


@cache
def built(flags=''):
    """Return the paths of sketch and emulator, built unless they are as their sources are."""
    require(*TOOLS, files=FILES)
    name = hashlib.sha256(flags.encode()).hexdigest()[:8]
    build = FIRMWARE / 'build' / 'test' / name
    build.mkdir(parents=True, exist_ok=True)
    stamp, digest = build / 'sources', _digest(flags).hexdigest()
    with only_one(FIRMWARE / 'build' / 'lock'):
        if not stamp.exists() or stamp.read_text() != digest:
            _make(FIRMWARE, f'BUILD={build}', f'FLAGS={flags}')
            stamp.write_text(digest)
    return build / 'imu_hub.elf', FIRMWARE / 'build' / 'imu_hub_sim'


def _make(folder, *arguments):
    made = subprocess.run(
        ['make', '-C', folder, *arguments], capture_output=True, text=True, check=False
    )
    said = made.stdout + made.stderr
    assert made.returncode == 0, said
    assert 'warning' not in said, said


def changed_sketch(folder, file, old, new):
    """Return a sketch, built in `folder`, of which one text is another."""
    built()  # what does not change comes from there
    copy = folder / 'firmware'
    shutil.copytree(FIRMWARE, copy, ignore=shutil.ignore_patterns('test', '*.o.d'))
    source = copy / 'imu_hub' / file
    text = source.read_text()
    assert text.count(old) == 1
    source.write_text(text.replace(old, new))
    _make(copy, 'sketch', 'BUILD=changed')
    return copy / 'changed' / 'imu_hub.elf'


def script(imus, events=(), *, seconds, motion='counter', skew_ppm=0):
    """Return the text of a script.

    Parameters
    ----------
    imus : sequence of (str, int, int)
        Type, channel, address of IMU 0, 1 ...
    events : sequence of str
        As firmware/sim/script.c names them, with their instants.
    seconds : float
        When it ends.
    """
    lines = [
        f'imu {k} {kind} {channel} {address}' for k, (kind, channel, address) in enumerate(imus)
    ]
    lines += [f'motion {motion}', f'skew {skew_ppm}', *(f'at {event}' for event in events)]
    return '\n'.join([*lines, f'at {seconds} end', ''])


def bmi160s(count):
    """Return so many BMI160, each on a channel of its own."""
    return [('bmi160', k, 0x68) for k in range(count)]


@dataclass(frozen=True)
class Session:
    """What a run without a port said, and what the emulator says of it."""

    data: bytes
    report: dict
    decoder: FrameDecoder
    packets: list[Packet]
    ends: list[float]  # when the last byte of each frame had gone [s]

    def all(self, kind):
        return [packet for packet in self.packets if isinstance(packet, kind)]

    @property
    def scans(self) -> list[Scan]:
        return self.all(Scan)

    @property
    def statuses(self) -> list[Status]:
        return self.all(Status)

    @property
    def hellos(self) -> list[Hello]:
        return self.all(Hello)

    def delays_us(self):
        """Return how long after its instant each scan was on the line."""
        pairs = zip(self.packets, self.ends, strict=True)
        return [1e6 * end - scan.ticks_us for scan, end in pairs if isinstance(scan, Scan)]

    def of(self, imu):
        """Return (instant [s], counts) of all readings of one IMU."""
        scans = [scan for scan in self.scans if imu in scan.imus]
        return [((s.ticks_us + s.imus[imu][0]) / 1e6, s.imus[imu][1]) for s in scans]


def run(folder, text, flags='', *, sketch=None):
    """Run a script as fast as it goes, on the sketch with these flags or on the one given."""
    as_is, emulator = built(flags)
    script_file, report_file, ends_file = (folder / name for name in ('script', 'report', 'ends'))
    script_file.write_text(text)
    command = [emulator, sketch or as_is, script_file]
    command += ['--report', report_file, '--ends', ends_file]
    data = subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout
    decoder = FrameDecoder()
    packets = decoder.push(data)
    ends = [float(line) for line in ends_file.read_text().split()]
    return Session(data, json.loads(report_file.read_text()), decoder, packets, ends)


def counter(imu, n, axis) -> int:
    """Return what firmware/sim/motion.c counts: sample n of one axis of an IMU."""
    return (n * (2 * axis + 3) + 4001 * imu + 611 * axis + 2**15) % 2**16 - 2**15


def _is_sample(imu, instant_s, counts, axes, rate_hz) -> bool:
    first = int((instant_s + BOOT_US[0] / 1e6) * rate_hz)
    last = int((instant_s + BOOT_US[1] / 1e6 + READ_S) * rate_hz)
    return any(
        all(counts[axis] == counter(imu, n, axis) for axis in axes) for n in range(first, last + 1)
    )


def is_exact(imu, kind, instant_s, counts: Counts) -> bool:
    """Say whether all six counts are of one sample, and of the one that was due."""
    rate, force = RATES[kind]
    if rate == force:
        return _is_sample(imu, instant_s, counts, range(6), rate)
    return _is_sample(imu, instant_s, counts, range(3), rate) and _is_sample(
        imu, instant_s, counts, range(3, 6), force
    )


def assert_exact(session, imus):
    """Check every reading of a session whose motion is the counter."""
    for k, (kind, _, _) in enumerate(imus):
        readings = session.of(k)
        wrong = [reading for reading in readings if not is_exact(k, kind, *reading)]
        assert not wrong, (k, kind, wrong[:3])


def assert_clean(session):
    """Check that no frame was damaged, no scan lost, and no data sheet offended."""
    decoder = session.decoder
    assert (decoder.cobs_errors, decoder.crc_errors, decoder.unknown, decoder.lost) == (0, 0, 0, 0)
    assert session.report['violations'] == []
    assert session.report['contentions'] == []
    assert session.report['overrun_bytes'] == 0


class LivePort:
    """An emulated board on a port, in real time; its time 0 is when the port is first opened.

    Attributes
    ----------
    events : list of (float, str)
        What has happened: host time [s] and the word of the script; the first is `open`.
    """

    def __init__(self, folder, text, flags=''):
        sketch, emulator = built(flags)
        self.path, self._report = folder / 'board', folder / 'report.json'
        self.events = []
        (folder / 'script').write_text(text)
        options = ['--port', self.path, '--report', self._report]
        self._process = subprocess.Popen(
            [emulator, sketch, folder / 'script', *options], stdout=subprocess.PIPE, text=True
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        for line in self._process.stdout:
            instant_ns, what = line.split()
            self.events.append((int(instant_ns) / 1e9, what))

    def has(self, what):
        return any(word == what for _, word in self.events)

    def end(self):
        """End it, where its script has not; return the report."""
        self._process.terminate()
        assert self._process.wait(10) == 0
        return json.loads(self._report.read_text())

    def close(self):
        """Kill it if it still runs."""
        self._process.kill()
        self._process.wait()
        self._reader.join()
        self._process.stdout.close()


@contextmanager
def live_port(folder, text, flags=''):
    """Run a script on a port; killed at the end if it still runs."""
    port = LivePort(folder, text, flags)
    try:
        end = time.monotonic() + 5.0
        while not port.path.is_symlink():
            assert time.monotonic() < end, 'the emulator made no port'
            time.sleep(0.01)
        yield port
    finally:
        port.close()
