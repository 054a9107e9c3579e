"""Smooth paths through keyframes: the one curve that every simulated motion is made of.

A path has six channels, the position of the base origin [m] and roll, pitch, yaw [rad].  Between
two keyframes, which give value, first and second derivative, each channel is the quintic that
meets both ends, so pose, velocity and acceleration are continuous and known exactly; no
difference quotient is ever taken.  Where all derivatives vanish and two keyframes agree, the path
stands still, and it does so exactly.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PPoly

from multiimu_ros.arrays import Flags, Matrix, Scalars

CHANNELS = ('x', 'y', 'z', 'roll', 'pitch', 'yaw')


@dataclass(frozen=True)
class Path:
    """M keyframes, at rest in the first and the last, whose poses are held before and after.

    Parameters
    ----------
    time : (M,) array
        Instants of the keyframes, increasing [s].
    value, first, second : (M, 6) arrays
        Channels and their derivatives [m] and [rad], per [s] and [s^2].
    """

    time: Scalars
    value: Matrix
    first: Matrix
    second: Matrix

    def __post_init__(self) -> None:
        if not np.all(np.diff(self.time) > 0):
            msg = '`time` of the keyframes must increase; move the keyframes apart.'
            raise ValueError(msg)
        if np.any(self.first[[0, -1]]) or np.any(self.second[[0, -1]]):
            msg = '`first` and `second` must be 0 at both ends, where the pose is held.'
            raise ValueError(msg)

    def __add__(self, other: 'Path') -> 'Path':
        """Superpose two paths; a quintic cut in two by a new keyframe stays the same quintic."""
        time = np.union1d(self.time, other.time)
        # Two keyframes within a nanosecond are one, told apart by rounding only.
        time = time[np.diff(time, prepend=-np.inf) > 1e-9]
        mine, others = self.at(time), other.at(time)
        return Path(time, *(a + b for a, b in zip(mine, others, strict=True)))

    def at(self, times: Scalars) -> tuple[Matrix, Matrix, Matrix]:
        """Return value, first and second derivative, each (N, 6), at `times` (N,) [s]."""
        polynomial = self.polynomial()
        inside = np.clip(times, self.time[0], self.time[-1])
        value, first, second = (polynomial(inside, nu=order) for order in range(3))
        after = times >= self.time[-1]
        value[after] = self.value[-1]
        first[after | (times < self.time[0])] = 0.0
        second[after | (times < self.time[0])] = 0.0
        return value, first, second

    def polynomial(self) -> PPoly:
        """Return the quintics between the keyframes (Hermite's data at both ends)."""
        h = np.diff(self.time)[:, np.newaxis]
        rise = np.diff(self.value, axis=0)
        v0, v1 = self.first[:-1] * h, self.first[1:] * h
        a0, a1 = self.second[:-1] * h**2, self.second[1:] * h**2
        coefficients = (
            (6 * rise - 3 * (v0 + v1) - (a0 - a1) / 2) / h**5,
            (-15 * rise + 8 * v0 + 7 * v1 + (3 * a0 - 2 * a1) / 2) / h**4,
            (10 * rise - 6 * v0 - 4 * v1 - (3 * a0 - a1) / 2) / h**3,
            self.second[:-1] / 2,
            self.first[:-1],
            self.value[:-1],
        )
        return PPoly(np.stack(coefficients), self.time)

    def still(self, times: Scalars) -> Flags:
        """Flag the `times` (N,) at which nothing moves, for a whole piece of the path."""
        moving = np.any(self.first != 0, axis=1) | np.any(self.second != 0, axis=1)
        stays = ~moving[:-1] & ~moving[1:] & np.all(np.diff(self.value, axis=0) == 0, axis=1)
        # Before the first and after the last keyframe the pose is held.
        stays = np.concatenate(([True], stays, [True]))
        return np.asarray(stays[np.searchsorted(self.time, times, side='right')])


def through(time: ArrayLike, **channels: ArrayLike) -> Path:
    """Return the path that pauses at every keyframe: minimum-jerk moves of the named channels."""
    instants = np.asarray(time, dtype=np.float64)
    value = np.zeros((len(instants), 6))
    for name, values in channels.items():
        value[:, CHANNELS.index(name)] = values
    return Path(instants, value, np.zeros_like(value), np.zeros_like(value))


def stepper_move(start: float, duration: float, **goals: float) -> Path:
    """Return one move of a stepper motor: accelerate, cruise, brake, each a third of `duration`.

    The acceleration is constant but for ramps of 1/30 of `duration`, for a jump would have no
    value at the sample that meets it.
    """
    ramp, third = duration / 30, duration / 3
    knots = np.array([0, ramp, third - ramp, third, 2 * third])
    knots = np.concatenate((knots, 2 * third + knots[1:4]))
    shape = np.array([0.0, 1.0, 1.0, 0.0, 0.0, -1.0, -1.0, 0.0])  # acceleration at the knots
    acceleration = PPoly(np.stack((np.diff(shape) / np.diff(knots), shape[:-1])), knots)
    profile = [acceleration.antiderivative(2)(knots), acceleration.antiderivative()(knots), shape]
    profile[1][-1] = 0.0  # it has come to rest, up to rounding
    goal = np.array([goals.get(name, 0.0) for name in CHANNELS]) / profile[0][-1]
    return Path(start + knots, *(np.outer(derivative, goal) for derivative in profile))
