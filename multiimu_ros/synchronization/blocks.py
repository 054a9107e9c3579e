"""Many readings in one compiled call; what `streams` does with each, nothing else."""

from multiimu_ros.arrays import Matrix, Stamps, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.synchronization.streams import advance, JUMPED, Streams, take


@compiled
def take_block(
    streams: Streams, ks: Stamps, stamps: Stamps, values: Vectors, scans: Matrix, due: Stamps
) -> tuple[int, int]:
    """Admit readings until all are in, time jumps back, or there is no room for their scans.

    Parameters
    ----------
    ks, stamps, values : (N,), (N,), (N, 6) arrays
        Stream, stamp and reading.
    scans, due : (M, K, 8), (M,) arrays
        Filled with the scans that became due, as in `Streams.scan`, and their stamps.

    Returns
    -------
    int, int
        Readings taken (fewer than N where the next one jumps), and scans made.
    """
    made = 0
    for n in range(len(ks)):
        if made == len(due):
            return n, made
        streams.sample[:] = values[n]
        stamp = take(streams, ks[n], stamps[n])
        if stamp == JUMPED:
            return n, made
        while stamp >= 0:
            scans[made], due[made] = streams.scan, stamp
            made += 1
            if made == len(due):  # what else is due comes with the next reading
                break
            stamp = advance(streams)
    return len(ks), made
