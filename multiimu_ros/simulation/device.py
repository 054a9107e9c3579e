"""The emulated board without its port: what the firmware would send, as a function of time.

Time is a float in seconds since the motion began; the device's own clock starts with each boot
and runs fast by `skew_ppm`.  A frame is due when its last IMU has been read.
"""

import numpy as np

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.simulation.errors import ImuErrors
from multiimu_ros.simulation.faults import FaultPlan
from multiimu_ros.simulation.recording import SimulatedRecording
from multiimu_ros.wire import packets
from multiimu_ros.wire.decoder import FrameDecoder
from multiimu_ros.wire.packets import Counts, Hello, HelloRequest, ImuInfo, Scan

READ_TIME = 0.0004  # [s] the last IMU of a scan takes so long before the frame can go
TEMPERATURE = 26.0  # [Celsius]
INT16 = (-32768, 32767)
FIRMWARE = (1, 0)


class EmulatedDevice:
    """A board that sends a recording, whose stamps are the time since the motion began.

    Parameters
    ----------
    recording : SimulatedRecording
        Without dropouts, `start_ns` 0, of a class whose readings come in steps.
    faults : FaultPlan
        What goes wrong, and when; may change while the board runs.
    skew_ppm : float
        By how much the device clock is fast [ppm].
    dropout : float
        Share of readings that fail [-].
    seed : int
        Draws dropouts and garbage.
    """

    def __init__(
        self,
        recording: SimulatedRecording,
        faults: FaultPlan,
        *,
        skew_ppm: float = 0.0,
        dropout: float = 0.0,
        seed: int = 0,
    ) -> None:
        self._faults = faults
        self._counts = counts_of(recording)
        self._instants = np.column_stack([samples.stamp_ns for samples in recording.raw])
        self._due = self._instants.max(axis=1) / NANOSECONDS + READ_TIME
        self._hello = _hello_of(recording)
        self._tick_rate = 1e6 * (1 + 1e-6 * skew_ppm)
        self._dropout = dropout
        self._rng = np.random.default_rng(seed)
        self._frozen: dict[int, Counts] = {}
        self._failures = [0] * len(recording.raw)
        self._next = 0
        self.boot(0.0)

    def boot(self, now: float) -> None:
        """Start the firmware anew: clock, counters and scans begin at `now`."""
        self._booted = now
        self._seq = 0
        self._next = max(self._next, int(np.searchsorted(self._instants[:, 0], now * 1e9)))
        self._next_status = now + 1.0
        self._failures = [0] * len(self._failures)
        self._requests = FrameDecoder()

    def ticks(self, now: float) -> int:
        """Return the device time [us], modulo 2^32."""
        return round((now - self._booted) * self._tick_rate) % 2**32

    def hello(self, now: float, reason: int = packets.BOOT) -> bytes:
        """Return the frame that says who the board is."""
        imus, rate = self._hello.imus, self._hello.rate_hz
        return packets.encode(Hello(imus, rate, self.ticks(now), reason, FIRMWARE))

    def answer(self, data: bytes, now: float) -> bytes:
        """Return the answers to the requests in `data`, which came in at `now`."""
        answers = []
        for request in self._requests.push(data):
            if isinstance(request, HelloRequest):
                answers.append(self.hello(now, packets.ASKED))
            elif isinstance(request, packets.SyncRequest):
                answers.append(packets.encode(packets.Sync(request.token, self.ticks(now))))
        return b''.join(answers)

    @property
    def finished(self) -> bool:
        """Whether the whole recording has been sent."""
        return self._next == len(self._due)

    def next_due(self) -> float:
        """Return the instant at which the next frame can go [s]."""
        return np.inf if self.finished else float(self._due[self._next])

    def frames(self, now: float) -> list[bytes]:
        """Return the frames that are due by `now` and have not been sent, one for each scan."""
        frames = []
        while self.next_due() <= now:
            frames.append(self._scan(self._next))
            self._next += 1
        if now >= self._next_status:
            self._next_status += 1.0
            frames.append(self._status(now))
        return frames

    def _scan(self, k: int) -> bytes:
        instants = self._instants[k].tolist()
        begin = self.ticks(instants[0] / NANOSECONDS)
        imus = {}
        for imu, (instant, counts) in enumerate(
            zip(instants, self._counts[k].tolist(), strict=True)
        ):
            reading = self._reading(imu, tuple(counts), instant / NANOSECONDS)
            if reading is not None:
                offset = (self.ticks(instant / NANOSECONDS) - begin) % 2**32
                imus[imu] = (offset, reading)
        frame = packets.encode(Scan(self._seq, begin, imus))
        self._seq = (self._seq + 1) % 2**16
        return frame

    def _reading(self, imu: int, counts: Counts, now: float) -> Counts | None:
        """Return what the bus reads of an IMU, or None where it does not answer."""
        match self._faults.kind_of(imu, now):
            case 'stuck':
                return self._frozen.setdefault(imu, counts)
            case 'garbage':
                x, y, z, u, v, w = self._rng.integers(*INT16, 6, endpoint=True).tolist()
                return x, y, z, u, v, w
            case 'dead':
                self._failures[imu] += 1
                return None
        self._frozen.pop(imu, None)
        if self._dropout and self._rng.random() < self._dropout:
            self._failures[imu] += 1
            return None
        return counts

    def _status(self, now: float) -> bytes:
        imus = {k: (failures % 2**16, TEMPERATURE) for k, failures in enumerate(self._failures)}
        return packets.encode(packets.Status(self.ticks(now), imus=imus))


def counts_of(recording: SimulatedRecording) -> np.ndarray:
    """Return the readings as the registers hold them, (N, K, 6) integers.

    Raises
    ------
    ValueError
        If the IMUs have no steps, or have lost samples.
    """
    steps = _steps(recording.errors)
    if 0.0 in steps:
        msg = f'`recording` must be of IMUs with steps, got {recording.errors.model}; use BMI160.'
        raise ValueError(msg)
    if len({len(samples) for samples in recording.raw}) != 1:
        msg = '`recording` must have no dropouts, got some; let the device drop them.'
        raise ValueError(msg)
    values = np.stack([np.hstack((s.angular_rate, s.specific_force)) for s in recording.raw], 1)
    counts = np.round(values / np.repeat(steps, 3)).astype(np.int64)
    return np.asarray(np.clip(counts, *INT16))


def _steps(errors: ImuErrors) -> tuple[float, float]:
    return errors.gyroscope.step, errors.accelerometer.step


def _hello_of(recording: SimulatedRecording) -> Hello:
    errors = recording.errors
    models = {name: key for key, name in packets.MODELS.items()}
    angular_rate_range = round(np.rad2deg(errors.gyroscope.limit))
    specific_force_range = round(errors.accelerometer.limit / 9.80665)
    imus = tuple(
        ImuInfo(
            k,
            models.get(errors.model, 0),
            0x68 + k % 2,
            k // 2,
            angular_rate_range,
            specific_force_range,
            *_steps(errors),
        )
        for k in range(len(recording.raw))
    )
    return Hello(imus, round(recording.rate_hz), firmware=FIRMWARE)
