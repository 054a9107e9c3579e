"""The emulated board as a program sees it: a port that may be opened, closed and opened again."""

import os
import select
import subprocess
import time

from emulated_hub import bmi160s, built, live_port, script
import serial

from multiimu_ros.wire import packets
from multiimu_ros.wire.decoder import FrameDecoder
from multiimu_ros.wire.packets import BOOT, Hello, HelloRequest, Scan


def listen(port, until, seconds=5.0):
    """Return the packets that come until one passes; fail where none does."""
    decoder, found, end = FrameDecoder(), [], time.monotonic() + seconds
    while not any(until(packet) for packet in found):
        assert time.monotonic() < end, found[-3:]
        if select.select([port.fileno()], [], [], 0.1)[0]:
            found += decoder.push(os.read(port.fileno(), 4096))
    return found


def is_hello(packet):
    return isinstance(packet, Hello)


def test_each_opening_resets_the_board(tmp_path):
    with live_port(tmp_path, script(bmi160s(8), seconds=20.0)) as board:
        for _ in range(2):
            with serial.Serial(str(board.path), 500_000, timeout=0, exclusive=True) as port:
                first = listen(port, lambda packet: isinstance(packet, Scan))
                assert first[0].reason == BOOT
                # It just started: what it said before was lost with the port.
                assert first[0].ticks_us < 100_000
                assert first[-1].seq < 30
                os.write(port.fileno(), packets.encode(HelloRequest()))
                asked = listen(port, is_hello)
                assert asked[-1].reason == packets.ASKED
            time.sleep(0.1)
        report = board.end()
    assert report['resets'] == 1  # the first opening is the beginning of time
    assert report['violations'] == report['contentions'] == []


def test_a_wrong_script_is_refused_in_a_sentence(tmp_path):
    sketch, emulator = built()
    wrong = tmp_path / 'script'
    wrong.write_text('imu 0 xyz 0 0\n')
    run = subprocess.run([emulator, sketch, wrong], capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert run.stderr == 'No device is called `xyz`.\n'
