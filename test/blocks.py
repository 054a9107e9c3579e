"""Recordings as the blocks of readings that `Pipeline.push_block` takes."""

import numpy as np


def block_of(streams):
    """Return index, stamp and reading of all samples in the order of their stamps."""
    stamps = np.concatenate([stream.stamp_ns for stream in streams])
    imus = np.repeat(np.arange(len(streams)), [len(stream) for stream in streams])
    values = [np.hstack([s.angular_rate, s.specific_force]) for s in streams]
    order = np.lexsort((imus, stamps))
    return imus[order], stamps[order], np.concatenate(values)[order]


def frames_of(pipeline, streams):
    """Return the frames of all samples, pushed in one block; single pushes give the same."""
    return list(pipeline.push_block(*block_of(streams)))
