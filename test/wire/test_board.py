"""A board's bytes become samples in SI units, with stamps, through resets and replugging."""

from types import MappingProxyType

import pytest

from multiimu_ros.wire import packets
from multiimu_ros.wire.board import Board
from multiimu_ros.wire.decoder import FrameDecoder

START = 1_780_000_000_000_000_000  # [ns]
# Powers of two: single precision holds them, so the products are exact.
INFOS = tuple(packets.ImuInfo(k, 1, 0x69, k, 2000, 16, 0.5**10, 0.5**8) for k in (0, 5))
HELLO = packets.Hello(INFOS, rate_hz=200, reason=packets.ASKED)
COUNTS = (1024, -2048, 0, 0, 256, -512)
SI = (1.0, -2.0, 0.0, 0.0, 1.0, -2.0)
BOTH = MappingProxyType({0: (0, COUNTS), 5: (400, COUNTS)})


def push(board, packet, arrival_ns=START):
    return board.push(packets.encode(packet), arrival_ns)


def test_counts_become_si_units_at_each_imus_own_instant():
    board = Board()
    assert push(board, HELLO) == []
    first, second = push(board, packets.Scan(0, 1000, BOTH))
    assert (first.imu, first.values, first.stamp_ns) == (0, SI, START)
    assert (second.imu, second.values, second.stamp_ns) == (5, SI, START + 400_000)


def test_scans_before_hello_are_held_back_and_hello_is_asked_for():
    board = Board()
    assert push(board, packets.Scan(0, 0, BOTH)) == []
    assert board.held_back == 1
    ask = packets.encode(packets.HelloRequest())
    assert board.requests(START).startswith(ask)
    push(board, HELLO)
    assert not board.requests(START).startswith(ask)
    assert len(push(board, packets.Scan(1, 5000, BOTH), START + 5_000_000)) == 2


def test_an_imu_that_hello_did_not_name_is_counted():
    board = Board()
    push(board, HELLO)
    samples = push(board, packets.Scan(0, 0, {0: (0, COUNTS), 1: (9, COUNTS)}))
    assert [sample.imu for sample in samples] == [0]
    assert board.unannounced == 1


def test_a_board_of_another_protocol_is_not_used():
    board = Board()
    push(board, packets.Hello(INFOS, 200, protocol=packets.PROTOCOL + 1))
    assert board.foreign_protocol == packets.PROTOCOL + 1
    assert push(board, packets.Scan(0, 0, BOTH)) == []
    push(board, HELLO)
    assert board.foreign_protocol is None


def test_a_board_that_boots_begins_a_new_epoch_and_loses_no_scan():
    board = Board()
    push(board, HELLO)
    push(board, packets.Scan(700, 90_000_000, BOTH))
    push(board, packets.Hello(INFOS, 200, reason=packets.BOOT), START + 10**9)
    push(board, packets.Scan(0, 91_000_000, BOTH), START + 10**9)
    assert board.clock.epochs == 2
    assert board.decoder.lost == 0


def test_an_answered_request_bounds_the_clock():
    plain, bounded = Board(), Board()
    for board in (plain, bounded):
        push(board, HELLO)
        for k in range(800):  # each 3 ms late: a long frame
            sent_ns = START + k * 5_000_000
            samples = push(board, packets.Scan(k, k * 5000, BOTH), sent_ns + 3_000_000)
            if board is bounded and k % 100 == 0:
                (request,) = FrameDecoder().push(board.requests(sent_ns - 100_000))
                push(board, packets.Sync(request.token, k * 5000), sent_ns + 100_000)
        board.last = samples[0].stamp_ns
    true_ns = START + 799 * 5_000_000
    assert plain.last - true_ns == pytest.approx(3e6, abs=1e3)
    assert bounded.last - true_ns == pytest.approx(0, abs=0.5e6)  # still bending towards it


def test_answers_that_nobody_asked_for_and_unanswered_requests_do_no_harm():
    board = Board()
    for k in range(100):
        board.requests(START + k)
    assert len(board._sent) <= 8
    assert push(board, packets.Sync(10**9, 5)) == []


def test_status_is_kept_and_reconnecting_forgets_the_scales():
    board = Board()
    push(board, HELLO)
    status = packets.Status(7, overruns=2, imus={0: (1, 21.5)})
    push(board, status)
    assert board.status == status
    board.push(packets.encode(HELLO)[:-3], START)
    board.reconnect()
    assert board.hello is None
    assert push(board, packets.Scan(9, 9, BOTH)) == []
    push(board, HELLO)
    assert len(push(board, packets.Scan(10, 5000, BOTH), START + 5_000_000)) == 2
