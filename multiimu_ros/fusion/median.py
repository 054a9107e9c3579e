"""The median of a handful of readings, without sorting them anew or allocating."""

from multiimu_ros.arrays import Vector
from multiimu_ros.compiled import compiled


@compiled
def insert(ordered: Vector, count: int, value: float) -> None:
    """Put a value into its place among the first `count` of `ordered`, which are in order."""
    place = count
    while place > 0 and ordered[place - 1] > value:
        ordered[place] = ordered[place - 1]
        place -= 1
    ordered[place] = value


@compiled
def middle(ordered: Vector, count: int) -> float:
    """Return the median of the first `count` of `ordered`, one at least, which are in order."""
    return float(0.5 * (ordered[(count - 1) // 2] + ordered[count // 2]))
