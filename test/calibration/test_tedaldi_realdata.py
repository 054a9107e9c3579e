"""Two recordings of others, in counts, against what the programs that came with them found."""

from calibration_runs import GRAVITY
import numpy as np
from numpy.testing import assert_allclose
import pytest
from realdata import data_set

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.calibration.poses import find_transitions, read_poses
from multiimu_ros.calibration.preintegration import preintegrate
from multiimu_ros.calibration.static_intervals import (
    find_intervals,
    StaticConfig,
    StaticIntervals,
    THRESHOLDS,
    variance_ratio,
)
from multiimu_ros.calibration.tedaldi import fit_accelerometer, predicted_spread
from multiimu_ros.calibration.tedaldi_gyroscope import fit_gyroscope, fit_rest_rate
from multiimu_ros.errors import CalibrationError
from multiimu_ros.rig_calibration.imu_state import ImuState, ImuView, Weights
from multiimu_ros.rig_calibration.refinement import first_attitudes, refine
from multiimu_ros.samples import ImuSamples

pytestmark = pytest.mark.realdata

# Xsens MTi, the protocol and output of its reference program (Pretto and Tedaldi).
PADUA = 9.81744  # [m/s^2]
MIDDLE = 32768.0  # of 16 bits: where the biases are thought to be
ACCELEROMETER = {
    'scale': [0.00241278, 0.00242712, 0.00241168],
    'shear': [-0.0033593, -0.00890639, -0.0213341],
    'bias': [33124.2, 33275.2, 32364.4],
}
GYROSCOPE_SCALE = [0.000209295, 0.000209899, 0.000209483]
GYROSCOPE = [[1, 0.00593634, 0.00111101], [0.00808812, 1, -0.0535569], [0.0253067, -0.0025513, 1]]
GYROSCOPE_BIAS = [32777.1, 32459.8, 32511.8]
# MPU-6050, whose program leaves 4.2 mm/s^2 of |f| - g.
START_MPU6050 = (GRAVITY / 16384, 0.0)  # data sheet: 16384 LSB/g
PER_COUNT = np.deg2rad(1 / 131)  # data sheet: 131 LSB/(deg/s)


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


@pytest.fixture(scope='module')
def xsens():
    folder = data_set('imu_tk_xsens')
    time, *force = np.loadtxt(folder / 'xsens_acc.mat').T
    _, *rate = np.loadtxt(folder / 'xsens_gyro.mat').T
    stamp_ns = np.round(time * NANOSECONDS).astype(np.int64)
    return ImuSamples(stamp_ns, np.transpose(rate), np.transpose(force))


@pytest.fixture(scope='module')
def mpu6050():
    counts = np.loadtxt(
        data_set('mpu6050_tedaldi') / 'example_data_calibration.csv', delimiter=',', skiprows=5
    )
    return ImuSamples(10_000_000 * np.arange(len(counts)), counts[:, 3:], counts[:, :3])


class Fit:
    """Both fits of one recording."""

    def __init__(self, samples, intervals, gravity, start, rate_scale, rest=None, **choice):
        self.samples, self.gravity = samples, gravity
        self.poses = read_poses(samples, intervals)
        self.accelerometer = fit_accelerometer(self.poses, gravity, start)
        self.time = (samples.stamp_ns - samples.stamp_ns[0]) / NANOSECONDS
        usable, known = np.ones(len(samples), bool), self.poses.known
        self.moves = find_transitions(samples, intervals, usable, known)
        still = self.accelerometer.apply(self.poses.specific_force)
        self.up = still / np.linalg.norm(still, axis=1, keepdims=True)
        self.force = self.accelerometer.apply(samples.specific_force)
        self.gyroscope = fit_gyroscope(
            self.time,
            samples.angular_rate,
            self.force,
            self.up,
            self.moves,
            rest or fit_rest_rate(self.poses, still, **choice),
            rate_scale,
        )

    def refined(self):
        a, g = self.accelerometer, self.gyroscope
        parameters = g.E, g.bias, g.G
        rate = self.samples.angular_rate
        turns, _ = preintegrate(self.time, rate, self.force, self.moves, parameters)
        chain = [(m.start, m.stop, R) for m, R in zip(self.moves, turns, strict=True)]
        view = ImuView(self.poses, self.moves, self.time, rate, self.samples.specific_force)
        unit = np.mean(a.scale) ** 2
        weights = Weights((a.pose_variance / unit, a.walk / unit), (g.pose_variance, g.walk))
        state, R_k = ImuState.of(a, g, np.eye(3)), first_attitudes(self.up, chain)
        return refine([view], [state], [weights], R_k, self.gravity)


def as_the_program(xsens, **choice):
    """Fit from its start, wrong on purpose: scale 1 and 1/6258, bias 32768; window 101."""
    config = StaticConfig(window_s=1.01)
    intervals = find_intervals(xsens.stamp_ns, variance_ratio(xsens, config), 4.5, config)
    return Fit(xsens, intervals, PADUA, (1.0, MIDDLE), 1 / 6258, **choice)


def of_the_first_50_s(xsens):
    """Return the bias as the program takes it, and no g-sensitivity."""
    first = xsens.stamp_ns < xsens.stamp_ns[0] + 50 * NANOSECONDS
    return xsens.angular_rate[first].mean(axis=0), np.zeros((3, 3)), 0.0, 0.0


def test_an_xsens_has_the_intrinsics_that_the_reference_program_finds(xsens):
    fit = as_the_program(xsens, rest=of_the_first_50_s(xsens))
    assert len(fit.poses) == 38
    accelerometer, gyroscope = fit.accelerometer, fit.gyroscope
    assert_allclose(accelerometer.scale, ACCELEROMETER['scale'], rtol=2e-4)
    assert_allclose(accelerometer.shear, ACCELEROMETER['shear'], atol=1e-3)
    assert_allclose(accelerometer.bias, ACCELEROMETER['bias'], atol=1.0)  # counts: 2.4 mm/s^2
    assert_allclose(gyroscope.bias, GYROSCOPE_BIAS, atol=0.1)  # as printed
    assert_allclose(np.diag(gyroscope.E), GYROSCOPE_SCALE, rtol=5e-4)
    assert_allclose(gyroscope.E / np.diag(gyroscope.E), GYROSCOPE, atol=1e-3)
    assert np.rad2deg(rms(gyroscope.residual)) < 0.51  # its own


def test_biases_from_all_poses_fit_an_xsens_better_and_g_sensitivity_better_still(xsens):
    first = as_the_program(xsens, rest=of_the_first_50_s(xsens))
    bias = as_the_program(xsens, with_g_sensitivity=False)
    both = as_the_program(xsens)
    residuals = [np.rad2deg(rms(fit.gyroscope.residual)) for fit in (first, bias, both)]
    assert residuals[0] > residuals[1] > 3 * residuals[2]
    assert residuals[2] < 0.15
    # Without it, four terms in five of what the poses disagree by were g-sensitivity.
    assert both.gyroscope.pose_variance < 0.2 * bias.gyroscope.pose_variance


def test_the_joint_fit_of_an_xsens_explains_its_residuals(xsens):
    fit = as_the_program(xsens)
    refined = fit.refined()
    state = refined.states[0]
    # 339 residuals, 143 unknowns and a yaw: a standard error of sqrt(2 / 197) = 0.1.
    assert refined.chi_square == pytest.approx(1.0, abs=0.3)
    assert_allclose(state.scale, ACCELEROMETER['scale'], rtol=2e-4)
    assert_allclose(state.shear, ACCELEROMETER['shear'], atol=1e-3)
    still = (fit.poses.specific_force - state.force_bias) @ state.E_a.T
    before = rms(fit.accelerometer.residual)
    assert rms(np.linalg.norm(still, axis=1) - PADUA) < 1.05 * before  # least of all fits


def theirs():
    """Return the ten rests as the program found them, some of which last a few samples."""
    lines = np.loadtxt(data_set('mpu6050_tedaldi') / 'static_intervals.csv', delimiter=',')
    begin, end = 10_000_000 * lines.astype(np.int64)
    return StaticIntervals(begin, end)


def ours(samples):
    """Return the rests under the threshold that promises most, as a calibration takes them."""
    ratio = variance_ratio(samples)
    choices = [find_intervals(samples.stamp_ns, ratio, threshold) for threshold in THRESHOLDS]
    forces = [read_poses(samples, intervals).specific_force for intervals in choices]
    spreads = [predicted_spread(force, GRAVITY, START_MPU6050) for force in forces]
    return choices[int(np.argmin(spreads))]


def parameters_of(name):
    """Return shear or misalignment, scale and bias; theirs is T K (raw + b)."""
    values = np.loadtxt(data_set('mpu6050_tedaldi') / f'params_{name}.csv')
    return values[:-6], values[-6:-3], -values[-3:]


@pytest.mark.parametrize('detector', ['theirs', 'ours'])
def test_the_poses_of_an_mpu6050_read_gravity(mpu6050, detector):
    intervals = theirs() if detector == 'theirs' else ours(mpu6050)
    poses = read_poses(mpu6050, intervals)
    assert len(poses) >= 10
    model = fit_accelerometer(poses, GRAVITY, START_MPU6050)
    assert rms(model.residual) < 0.0042
    _, scale, bias = parameters_of('acc')
    # Ten poses for nine parameters, two of them of a fraction of a second.
    assert_allclose(model.scale, scale, rtol=1e-3)
    assert_allclose(model.bias, bias, atol=30)  # counts, of which 1670 are 1 m/s^2


def test_rests_of_an_mpu6050_that_are_none_end_in_a_refusal(mpu6050):
    # Eighty times the quietest variance: the board is put down, not lying.
    loose = find_intervals(mpu6050.stamp_ns, variance_ratio(mpu6050), 80.0)
    fit = Fit(mpu6050, loose, GRAVITY, START_MPU6050, PER_COUNT)
    with pytest.raises(CalibrationError, match='does not settle'):
        fit.refined()


def test_the_published_parameters_of_an_mpu6050_leave_what_they_say(mpu6050):
    """This settles units and signs of the file."""
    shear, scale, bias = parameters_of('acc')
    raw = read_poses(mpu6050, theirs()).specific_force
    assert len(shear) == 3
    felt = np.linalg.norm((raw - bias) * scale, axis=1)  # a shear of 1e-5 is none
    assert rms(felt - GRAVITY) == pytest.approx(0.0042, abs=4e-4)
    assert rms(np.linalg.norm(raw, axis=1) * START_MPU6050[0] - GRAVITY) > 0.5


def test_the_gyroscope_of_an_mpu6050_agrees_with_the_published_one(mpu6050):
    fit = Fit(mpu6050, ours(mpu6050), GRAVITY, START_MPU6050, PER_COUNT, with_g_sensitivity=False)
    _, scale, _ = parameters_of('gyro')
    # A degree is left of turns of some ninety: a hundredth.
    assert_allclose(np.diag(fit.gyroscope.E), scale, rtol=0.01)
    assert np.rad2deg(rms(fit.gyroscope.residual)) < 1.5
