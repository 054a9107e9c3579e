"""Recordings through a pipeline, block by block."""

from multiimu_ros.report.tracks import in_order


def frames_of(pipeline, streams):
    """Return the frames of all samples, pushed in one block; single pushes give the same."""
    return list(pipeline.push_block(*in_order(streams)))
