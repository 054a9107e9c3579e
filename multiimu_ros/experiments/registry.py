"""The experiments by name."""

from typing import Protocol

from multiimu_ros.experiments import (
    asynchronous,
    count,
    filters,
    foot,
    static,
    table43,
    turntable,
    zupt,
)
from multiimu_ros.experiments.board import Progress
from multiimu_ros.report.experiment_page import Result


class Experiment(Protocol):
    """A pure function of its seed; `progress` is told the share that is done."""

    def __call__(self, seed: int, progress: Progress) -> Result:
        """Run it."""


EXPERIMENTS: dict[str, Experiment] = {
    'table43': table43.run,
    'filters': filters.run,
    'static': static.run,
    'turntable': turntable.run,
    'count': count.run,
    'asynchronous': asynchronous.run,
    'foot': foot.run,
    'zupt': zupt.run,
}
