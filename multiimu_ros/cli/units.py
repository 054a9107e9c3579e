"""Which units the readings of one IMU come in, told from how it rests and turns.

At rest the force has the length of gravity, whatever the sensor.  And what the gyroscope says
between two poses must carry gravity from the one into the other: in the wrong unit it does not,
however slowly the board was turned.
"""

from dataclasses import dataclass

import numpy as np

from multiimu_ros.calibration.rests import Motion

GRAVITY = 9.80665
# Length of one reading: data sheets of 16-bit sensors at 2 to 16 g, and at 250 to 2000 deg/s.
FORCE_UNITS = {
    'm/s^2': 1.0,
    'g': GRAVITY,
    'mg': GRAVITY / 1000,
    **{f'counts ({lsb} LSB/g)': GRAVITY / lsb for lsb in (2048, 4096, 8192, 16384)},
}
RATE_UNITS = {
    'rad/s': 1.0,
    'deg/s': np.pi / 180,
    'mrad/s': 1e-3,
    **{f'counts ({lsb} LSB/(deg/s))': np.pi / 180 / lsb for lsb in (16.4, 32.8, 65.5, 131)},
}
NEAR = 0.1  # of gravity: what scale and bias of a cheap sensor make of it
MOVED = np.cos(np.deg2rad(20.0))  # gravity must move by more than that to tell anything
MISSED = 15.0  # [deg] an uncalibrated gyroscope through a turn of 3 s
ENOUGH = 10  # turns
UNKNOWN = 'unknown'


@dataclass(frozen=True, kw_only=True)
class Units:
    """The units of one IMU, and why.

    Parameters
    ----------
    force, rate : str
        Names; `unknown` where the recording does not tell, or none fits.
    force_unit, rate_unit : float
        What a reading of 1 is [m/s^2], [rad/s]; where nothing tells, gravity's length is taken
        for the former, and 1 for the latter.
    rest_force : float
        Length of the mean force at rest, median of all rests, in its own unit.
    turns : int
        Turns between poses that tell about the rate.
    miss_deg : float
        By how much the turned gravity misses the measured one [deg], median.
    """

    force: str
    rate: str
    force_unit: float
    rate_unit: float
    rest_force: float
    turns: int
    miss_deg: float

    def complaints(self) -> list[str]:
        """Say what is wrong beyond what the medians of a topic tell."""
        found = []
        if self.force.startswith('counts') or self.force == 'mg':
            found.append(
                f'at rest the force is {self.rest_force:.4g}: these are {self.force}; '
                'let the driver turn them into m/s^2.'
            )
        elif self.force == UNKNOWN and np.isfinite(self.rest_force):
            found.append(
                f'at rest the force is {self.rest_force:.4g}, which is gravity in no known unit; '
                'look at range and scale in the driver.'
            )
        if self.rate == UNKNOWN and self.turns:
            found.append(
                f'the rates miss the turn of gravity by {self.miss_deg:.2g} deg in any unit; are '
                'axes of the gyroscope swapped or mirrored?'
            )
        elif self.rate not in (UNKNOWN, 'rad/s'):
            found.append(
                f'the rates turn as gravity does if they are {self.rate}, within '
                f'{self.miss_deg:.2g} deg; turn them into rad/s.'
            )
        return found


def find_units(motion: Motion) -> Units:
    """Return the units that explain how one IMU rested and turned."""
    lengths = np.linalg.norm(motion.rests.mean_force, axis=1)
    rest_force = float(np.median(lengths)) if len(lengths) else float('nan')
    force = next(
        (
            name
            for name, unit in FORCE_UNITS.items()
            if abs(rest_force * unit / GRAVITY - 1) < NEAR
        ),
        UNKNOWN,
    )
    known = FORCE_UNITS.get(force, GRAVITY / rest_force if rest_force > 0 else 1.0)
    rate, miss_deg, turns = _find_rate(motion)
    return Units(
        force=force,
        rate=rate,
        force_unit=known,
        rate_unit=RATE_UNITS.get(rate, 1.0),
        rest_force=rest_force,
        turns=turns,
        miss_deg=miss_deg,
    )


def _find_rate(motion: Motion) -> tuple[str, float, int]:
    """Return the unit of the rate, by how much gravity is missed [deg], and by how many turns."""
    rests = motion.rests
    up = rests.up_s
    telling = np.zeros(len(rests), bool)
    if len(rests) > 1:
        moved = np.einsum('pi,pi->p', up[1:], up[:-1]) < MOVED
        telling[1:] = moved & rests.turned_soon[1:]
    telling[np.flatnonzero(telling)[:-ENOUGH]] = False
    if not telling.any():
        return UNKNOWN, float('nan'), 0
    misses = {}
    for name, unit in RATE_UNITS.items():
        along = np.einsum('pi,pi->p', motion.carried_up(unit), up)[telling]
        misses[name] = float(np.median(np.rad2deg(np.arccos(np.clip(along, -1.0, 1.0)))))
    best = min(misses, key=misses.__getitem__)
    return (best if misses[best] < MISSED else UNKNOWN), misses[best], int(telling.sum())
