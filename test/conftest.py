"""What every test may rely on: a seeded generator, hypothesis profiles, an own ROS domain."""

import os
import zlib

# Before numpy: two workers whose linear algebra uses two threads each get into each other's way.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

from hypothesis import settings
import numpy as np
import pytest

# `ci` draws the same examples every time; `dev` new ones, so that the two together find more.
settings.register_profile('ci', derandomize=True, deadline=None, print_blob=True)
settings.register_profile('dev', deadline=None)
settings.load_profile(os.environ.get('HYPOTHESIS_PROFILE', 'dev'))

# Another domain in each run: what a killed process leaves behind in shared memory may deafen the
# next one in its domain.  Above 101 the DDS ports would fall among Linux's ephemeral ones.
RUN = os.environ.get('PYTEST_XDIST_TESTRUNUID', str(os.getpid()))
FIRST_DOMAIN = 1 + zlib.crc32(RUN.encode()) % 60
WORKER = int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0').removeprefix('gw'))

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ['ROS_DOMAIN_ID'] = str(int(os.environ.get('ROS_DOMAIN_ID', FIRST_DOMAIN)) + WORKER)


@pytest.fixture
def rng():
    """Return a generator that draws the same numbers in every run."""
    return np.random.default_rng(20260711)


def pytest_collection_modifyitems(items):
    """Let coverage look away from slow tests: quicker ones must reach the same lines."""
    for item in items:
        if item.get_closest_marker('slow'):
            item.add_marker(pytest.mark.no_cover)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Where the recordings must be there (CI), a skipped test of real data is a failed one."""
    report = yield
    required = os.environ.get('MULTIIMU_REQUIRE_DATA') == '1'
    if required and report.skipped and item.get_closest_marker('realdata'):
        report.outcome = 'failed'
        report.longrepr = f'{item.nodeid} was skipped, but MULTIIMU_REQUIRE_DATA=1 asks for it.'
    return report
