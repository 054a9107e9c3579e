"""What all experiments have in common."""

from multiimu_ros.experiments.registry import EXPERIMENTS


def test_the_experiments_of_the_issue_are_there_each_under_its_name():
    assert list(EXPERIMENTS) == [
        'table43', 'filters', 'static', 'turntable', 'count', 'asynchronous', 'foot', 'zupt',
    ]  # fmt: skip
    for name, run in EXPERIMENTS.items():
        assert run.__module__ == f'multiimu_ros.experiments.{name}'
