"""IMUs that drift from their calibration in simulated hand motion: named, and nobody else."""

from functools import cache

from blocks import frames_of
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.fusion.age import utc_text
from multiimu_ros.fusion.drift import DriftMonitor
from multiimu_ros.nodes.biases import with_biases
from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.placements import row
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory

RATE_HZ = 100.0
SICK = 1  # the IMU that changes after its calibration
DEGREE = np.deg2rad(1.0)
DAY_NS = 86_400 * 10**9


def stretched(imu):
    return changed(imu, 'gyroscope', 'scale', [1.01 * x for x in imu.intrinsics.gyroscope.scale])


def skewed(imu):
    table = np.array(imu.intrinsics.gyroscope.misalignment)
    table[0, 1] += 0.5 * DEGREE
    return changed(imu, 'gyroscope', 'misalignment', table.tolist())


def twisted(imu):
    turn = Rotation.from_rotvec([0.0, 0.0, 0.5 * DEGREE])
    extrinsics = imu.extrinsics.model_copy(update={'rotation': tuple(turn.as_quat().tolist())})
    return imu.model_copy(update={'extrinsics': extrinsics})


def warmed(imu):
    x, y, z = imu.intrinsics.gyroscope.bias
    return changed(imu, 'gyroscope', 'bias', [x, y + 0.3 * DEGREE, z])


def dropped(imu):
    x, y, z = imu.intrinsics.accelerometer.bias
    return changed(imu, 'accelerometer', 'bias', [x + 5e-3 * 9.80665, y, z])


def changed(imu, triad, key, value):
    block = getattr(imu.intrinsics, triad).model_copy(update={key: value})
    return imu.model_copy(update={'intrinsics': imu.intrinsics.model_copy(update={triad: block})})


def nominal(rig):
    """Return what a user has who never calibrated."""
    imus = tuple(imu.model_copy(update={'intrinsics': None}) for imu in rig.imus)
    return rig.model_copy(update={'imus': imus})


@cache
def board(count, seed):
    """Return the truth about a board, and the file of its calibration."""
    truth = simulate(row(count), trajectory('static', 0.1), RATE_HZ, seed=seed).rig
    return truth, calibrated_rig(truth, seed)


def live(rig, truth, duration, seed=0, motion='hand'):
    """Return the frames and the pipeline at the end, of a board that is like `truth`."""
    path = trajectory(motion, duration, seed)
    recording = simulate(truth, path, RATE_HZ, seed=seed + 50)
    pipeline = Pipeline(rig, PipelineConfig())
    return frames_of(pipeline, recording.raw), pipeline


def raised(pipeline):
    """Return who is to be recalibrated, because of what."""
    return {
        (health.name, name): gap
        for health in pipeline.health()
        for name, gap in vars(health.disagreement).items()
        if gap.raised
    }


def with_sick(truth, change):
    imus = tuple(change(imu) if k == SICK else imu for k, imu in enumerate(truth.imus))
    return truth.model_copy(update={'imus': imus})


@pytest.mark.slow  # where nothing is compiled
@pytest.mark.parametrize(
    ('change', 'name', 'size'),
    [
        (stretched, 'turn', 0.01),
        (skewed, 'turn', 0.5 * DEGREE),
        (twisted, 'turn', 0.5 * DEGREE),
        (warmed, 'rate', 0.3 * DEGREE),
        (dropped, 'force', 5e-3 * 9.80665),
    ],
)
def test_one_that_changed_is_named_alone_within_20_seconds(change, name, size):
    truth, rig = board(3, 0)
    _, pipeline = live(rig, with_sick(truth, change), 20.0)
    found = raised(pipeline)
    assert found.keys() == {(f'imu{SICK}', name)}
    gap = found[f'imu{SICK}', name]
    # The true scale of the unit and the sigma of three calibrations blur it by some percent.
    assert gap.value == pytest.approx(size, rel=0.1)
    assert gap.value > 20 * gap.sigma
    assert gap.rivals == ()


@pytest.mark.slow  # where nothing is compiled
def test_of_two_both_are_named():
    truth, rig = board(2, 0)
    _, pipeline = live(rig, with_sick(truth, warmed), 20.0)
    found = raised(pipeline)
    assert found.keys() == {('imu0', 'rate'), ('imu1', 'rate')}
    assert found['imu0', 'rate'].rivals == (1,)
    assert found['imu1', 'rate'].rivals == (0,)


@pytest.mark.slow  # where nothing is compiled
@pytest.mark.parametrize('known', [True, False], ids=['calibrated', 'nominal'])
def test_boards_that_are_as_their_files_say_raise_nothing(known):
    for seed in range(6):
        truth, rig = board(3, seed)
        _, pipeline = live(rig if known else nominal(truth), truth, 40.0, seed)
        gaps = [gap for h in pipeline.health() for gap in vars(h.disagreement).values()]
        assert not any(gap.raised for gap in gaps)
        # At the ends of 165 such runs 3.6 sigma at the most; 6 raise.
        assert max(gap.value / gap.sigma for gap in gaps) < 5.0


@pytest.mark.slow  # where nothing is compiled
def test_one_that_is_outside_even_a_data_sheet_is_named():
    truth, _ = board(3, 0)
    # 50 deg/s: 0.87 rad/s beside sigmas of 0.05.
    broken = with_sick(truth, lambda imu: changed(imu, 'gyroscope', 'bias', [50 * DEGREE, 0, 0]))
    _, pipeline = live(nominal(truth), broken, 20.0)
    assert raised(pipeline).keys() == {(f'imu{SICK}', 'rate')}


@pytest.mark.slow  # where nothing is compiled
def test_one_imu_alone_has_nobody_to_disagree_with():
    truth, rig = board(1, 0)
    _, pipeline = live(rig, truth, 12.0)
    gaps = vars(pipeline.health()[0].disagreement).values()
    assert all(np.isnan(gap.value) and not gap.raised for gap in gaps)


@pytest.mark.slow  # where nothing is compiled
def test_watching_does_not_change_a_bit_of_what_is_fused(monkeypatch):
    truth, rig = board(3, 0)
    watched, _ = live(rig, with_sick(truth, stretched), 20.0)
    monkeypatch.setattr(DriftMonitor, 'take', lambda *_args: None)
    alone, _ = live(rig, with_sick(truth, stretched), 20.0)
    assert np.array_equal([f.record for f in watched], [f.record for f in alone])


@pytest.mark.slow  # where nothing is compiled
def test_the_biases_of_a_rest_are_as_good_as_their_sigma_says():
    scores, fused = [], []
    for seed in range(20):
        truth, _ = board(3, seed)
        _, pipeline = live(nominal(truth), truth, 6.0, seed)
        saved = with_biases(nominal(truth), *pipeline.biases(), 0.0)
        errors, sigmas = [], []
        for imu, true in zip(saved.imus, truth.imus, strict=True):
            errors.append(
                np.subtract(imu.intrinsics.gyroscope.bias, true.intrinsics.gyroscope.bias)
            )
            sigmas.append(imu.intrinsics.gyroscope.bias_sigma)
        scores.append((np.array(errors) / sigmas) ** 2)
        fused.append(np.mean(errors, axis=0) ** 2 / (np.mean(np.square(sigmas), axis=0) / 3))
    # 180 and 60 squares of Gaussians: standard errors 0.11 and 0.18, three of them.
    assert np.mean(scores) == pytest.approx(1.0, abs=0.33)
    assert np.mean(fused) == pytest.approx(1.0, abs=0.55)


def test_the_age_of_a_saved_bias_counts_from_the_first_stamp():
    truth, _ = board(3, 0)
    rested, pipeline = live(nominal(truth), truth, 4.0, motion='static')
    saved = with_biases(nominal(truth), *pipeline.biases(), 0.0)
    start_ns = rested[0].stamp_ns

    def first(date_ns):
        history = {} if date_ns is None else {'biases_last_rest': utc_text(date_ns)}
        imus = tuple(imu.model_copy(update={'provenance': history}) for imu in saved.imus)
        frames, _ = live(saved.model_copy(update={'imus': imus}), truth, 0.2, motion='static')
        return frames

    undated, fresh, old = first(None), first(start_ns), first(start_ns - 30 * DAY_NS)
    assert np.array_equal([f.record for f in undated], [f.record for f in fresh])
    variances = [np.diag(frames[0].angular_rate_covariance) for frames in (fresh, old)]
    # 1e-6 rad/s^2/sqrt(Hz) walk for 30 days; the mean of three has a third of that variance.
    walked = 1e-12 * 30 * 86_400 / 3
    assert_allclose(variances[1] - variances[0], walked, rtol=1e-3)
