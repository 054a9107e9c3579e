"""The figures of what a calibration was made from, and of the board that it found."""

from dataclasses import replace
import io

from calibrated_board import bare_rig, calibrated, DELAY, DURATION, POSES, RATE, rested, WAVING
import numpy as np
from numpy.testing import assert_allclose
from PIL import Image
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.calibration.coverage import missing_poses
from multiimu_ros.calibration.static_intervals import StaticIntervals
from multiimu_ros.report import calibration_board_figures, calibration_figures, figures
from multiimu_ros.rig import Extrinsics
from multiimu_ros.rig_calibration.board import Board

DRAWN = {
    'recording': calibration_figures,
    'pose_sphere': calibration_figures,
    'residuals': calibration_figures,
    'turn_residuals': calibration_figures,
    'correlations': calibration_figures,
    'board': calibration_board_figures,
    'differences': calibration_board_figures,
}


@pytest.mark.parametrize('name', DRAWN)
def test_figure_is_a_picture_as_wide_as_the_others(name):
    png = getattr(DRAWN[name], name)(calibrated())
    image = np.asarray(Image.open(io.BytesIO(png)).convert('L'))
    assert image.shape[1] == round(figures.WIDTH * figures.STYLE['figure.dpi'])
    assert (image < 200).mean() > 0.005  # some ink


@pytest.fixture
def painted(monkeypatch):
    """Return a function that draws a figure and returns its axes instead of a PNG."""
    from matplotlib.figure import Figure

    def paint(name, calibration):
        kept = []

        def keep(painter, height):
            kept.append(Figure())
            painter(kept[0])
            return b''

        monkeypatch.setattr(DRAWN[name], 'draw', keep)
        getattr(DRAWN[name], name)(calibration)
        return kept[0].axes

    return paint


def lines_of(axes, marker):
    return [line for line in axes.get_lines() if line.get_marker() == marker]


def test_map_keeps_areas(rng):
    directions = rng.standard_normal((2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    radius = np.linalg.norm(calibration_figures.on_map(directions), axis=1)
    # Of a uniform sphere, the part within radius r of a unit disc of equal area is r^2.
    assert kstest(radius**2, 'uniform').pvalue > 1e-3


def test_faces_lie_on_the_map_where_their_names_are():
    faces = np.vstack([np.eye(3), -np.eye(3)])
    expected = [[1, 0], [0, 1], [0, 0], [-1, 0], [0, -1], [0, 0]]
    assert_allclose(calibration_figures.on_map(faces), expected)


def test_each_rest_is_drawn_on_its_half(painted):
    up = calibration_figures.up_directions(calibrated())
    for axes, sign in zip(painted('pose_sphere', calibrated()), (1, -1), strict=True):
        drawn = max(lines_of(axes, 'o'), key=lambda line: len(line.get_xdata()))
        expected = calibration_figures.on_map(up[sign * up[:, 2] > 0])
        assert_allclose(np.column_stack(drawn.get_data()), expected)


def test_missing_poses_are_numbered_by_how_useful_they_are(painted):
    upper, lower = painted('pose_sphere', rested(30.0))
    missing = missing_poses([[0.0, 0.0, 1.0]])
    assert len(missing) == 17  # of 6 faces and 12 edges only +z was up
    places = {
        text.get_text(): text.get_position() for text in upper.texts if text.get_text().isdigit()
    }
    number = str(missing.index('-x up') + 1)
    assert_allclose(places[number], [-1.0, 0.0])
    below = {text.get_text() for text in lower.texts}
    assert str(missing.index('-z up') + 1) in below - set(places)


def test_residuals_are_those_of_the_fits(painted):
    upper, lower = painted('residuals', calibrated())
    for k, fit in enumerate(calibrated().intrinsics):
        assert_allclose(lines_of(upper, 'o')[k].get_ydata(), 1e3 * fit.residual_before)
        assert_allclose(lines_of(lower, 'o')[k].get_ydata(), 1e3 * fit.residual_after)


def test_the_drift_that_the_fit_found_is_drawn(painted):
    fits = list(calibrated().intrinsics)
    drift = np.linspace(-0.002, 0.003, len(fits[2].fit.accelerometer.drift))
    model = replace(fits[2].fit.accelerometer, drift=drift)
    fits[2] = replace(fits[2], fit=replace(fits[2].fit, accelerometer=model))
    _, lower = painted('residuals', replace(calibrated(), intrinsics=tuple(fits)))
    assert any(np.array_equal(line.get_ydata(), 1e3 * drift) for line in lower.get_lines())


def test_residuals_without_a_fit_come_from_the_readings():
    before, after = calibration_figures.force_residuals(rested(30.0, 2))
    assert before.shape == (1, 2)
    # Readings of 9.9 m/s^2; the mean of 30 s is good to 0.0018 / sqrt(30), drift to 0.003.
    assert_allclose(before, 9.9 - 9.80665, atol=0.01)
    assert_allclose(after, before)  # no intrinsics: calibrated is as read


def test_turn_residuals_are_in_degrees_between_their_rests(painted):
    (axes,) = painted('turn_residuals', calibrated())
    fit, line = calibrated().intrinsics[1], lines_of(axes, 'o')[1]
    assert_allclose(line.get_ydata(), np.rad2deg(fit.turn_residual))
    minutes = calibration_figures.rest_minutes(calibrated())
    move = fit.fit.view.transitions[0]
    assert minutes[move.start] < line.get_xdata()[0] < minutes[move.stop]


def test_waving_is_found_after_the_poses():
    ((begin, end),) = calibration_figures.waving(calibrated())
    assert begin >= (DURATION - WAVING) / 60 - 0.01  # the rest's edges are good to half a window
    assert 60 * (end - begin) > WAVING / 2  # a bout or more
    assert end <= DURATION / 60
    assert calibration_figures.waving(rested(30.0)) == []


@pytest.mark.parametrize(
    ('seconds', 'rate', 'found'),
    [
        (20.0, 1.0, 1),
        (8.0, 1.0, 0),  # a slow move from pose to pose
        (20.0, 0.05, 0),  # a table that is carried
    ],
)
def test_waving_is_long_and_fast(seconds, rate, found):
    given = rested(30.0)
    track = given.board.tracks[0]
    stamps, turned = track.samples.stamp_ns, track.samples.angular_rate.copy()
    stop = round((3.0 + seconds) * RATE)
    turned[round(3.0 * RATE) : stop] += [rate, 0.0, 0.0]
    board = Board(
        given.board.rig, (replace(track, samples=replace(track.samples, angular_rate=turned)),)
    )
    rests = StaticIntervals(stamps[[0, stop]], stamps[[round(3.0 * RATE), -1]])
    spans = calibration_figures.waving(replace(given, board=board, intervals=rests))
    assert len(spans) == found
    if found:
        assert_allclose(spans, [[3.0 / 60, (3.0 + seconds) / 60]], atol=2 / RATE / 60)


def test_bouts_of_waving_with_short_rests_between_are_one():
    given = rested(30.0)
    stamps = given.board.tracks[0].samples.stamp_ns
    turned = given.board.tracks[0].samples.angular_rate + 1.0
    track = given.board.tracks[0]
    board = Board(
        given.board.rig, (replace(track, samples=replace(track.samples, angular_rate=turned)),)
    )
    edges = np.array([[0.0, 2.0], [12.0, 14.0], [24.0, 29.0]])  # a rest of 2 s between two bouts
    begin, end = stamps[(edges * RATE).astype(int)].T
    spans = calibration_figures.waving(
        replace(given, board=board, intervals=StaticIntervals(begin, end))
    )
    assert_allclose(spans, [[2.0 / 60, 24.0 / 60]], atol=2 / RATE / 60)


def test_recording_shades_every_rest_and_names_the_waving(painted):
    (axes,) = painted('recording', calibrated())
    intervals, start_ns = calibrated().intervals, calibrated().board.tracks[0].samples.stamp_ns[0]
    assert len(axes.patches) == len(intervals) > POSES
    shaded = [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in axes.patches]
    rests = np.column_stack([intervals.begin_ns, intervals.end_ns]) - start_ns
    assert_allclose(60 * np.array(shaded), rests / NANOSECONDS, atol=1e-6)
    assert 'waving' in {text.get_text() for text in axes.texts}
    assert not lines_of(axes, '|')


def test_readings_out_of_range_are_marked_when_they_happened(painted):
    given = calibrated()
    track = given.board.tracks[2]
    usable = track.usable.copy()
    usable[5000:5003] = False
    spoilt = replace(track, usable=usable)
    board = Board(given.board.rig, (*given.board.tracks[:2], spoilt))
    (axes,) = painted('recording', replace(given, board=board))
    start_ns = given.board.tracks[0].samples.stamp_ns[0]
    when = (track.samples.stamp_ns[5001] - start_ns) / NANOSECONDS / 60
    marks = lines_of(axes, '|')[0].get_xdata()
    assert_allclose(marks, when, atol=2 * DURATION / 60 / calibration_figures.BINS)  # columns


def test_correlation_peaks_at_the_delay_of_each_imu(painted):
    left, right = painted('correlations', calibrated())
    curves = lines_of(left, 'o')
    for k, curve in enumerate(curves, start=1):
        lag, value = curve.get_data()
        # The IMU is late, so its stamps must be moved ahead; samples are 10 ms apart.
        assert_allclose(lag[np.argmax(value)], 1e3 * DELAY * k, atol=10.0)
    assert len(curves) == 2
    assert [label.get_text() for label in right.get_yticklabels()] == ['imu1', 'imu2']
    assert float(right.texts[1].get_text().split()[0]) == pytest.approx(2e3 * DELAY, abs=0.1)


def test_sixteen_imus_look_different():
    looks = {tuple(calibration_figures.look(k).values()) for k in range(16)}
    assert len(looks) == 16


def test_differences_are_in_the_base_and_about_the_axes_of_the_imu():
    mounted, turn = Rotation.from_rotvec([0.3, 1.2, -0.5]), Rotation.from_rotvec([0.01, 0, -0.02])
    drawn = Extrinsics(rotation=tuple(mounted.as_quat().tolist()), lever_arm=(0.1, 0.2, 0.3))
    found = Extrinsics(
        rotation=tuple((mounted * turn).as_quat().tolist()), lever_arm=(0.1, 0.201, 0.3)
    )
    before, after = (
        bare_rig(1).model_copy(
            update={'imus': (bare_rig(1).imus[0].model_copy(update={'extrinsics': pose}),)}
        )
        for pose in (drawn, found)
    )
    moved, turned = calibration_board_figures.pose_differences(before, after)
    assert_allclose(moved, [[0, 0.001, 0]], atol=1e-12)
    assert_allclose(turned, [[0.01, 0, -0.02]], atol=1e-12)


def test_differences_are_drawn_in_millimetres_with_their_sigma(painted):
    left, right = painted('differences', calibrated())
    moved, turned = calibration_board_figures.pose_differences(
        calibrated().before, calibrated().after
    )
    assert_allclose(left.containers[1].lines[0].get_ydata(), 1e3 * moved[:, 1])
    assert_allclose(right.containers[2].lines[0].get_ydata(), np.rad2deg(turned[:, 2]))
    (bars,) = left.containers[0].lines[2]
    length = [np.ptp(segment[:, 1]) for segment in bars.get_segments()]
    sigma = [imu.extrinsics.lever_arm_sigma[0] for imu in calibrated().after.imus]
    assert_allclose(length, 2e3 * np.array(sigma))


def test_board_is_drawn_in_proportion_and_beside_the_drawing(painted):
    (axes,) = painted('board', calibrated())
    spans = np.ptp([axes.get_xlim3d(), axes.get_ylim3d(), axes.get_zlim3d()], axis=1)
    assert_allclose(np.ptp(spans / axes._box_aspect), 0.0, atol=1e-9 * spans.max())
    squares = [line.get_data_3d() for line in axes.get_lines() if line.get_marker() == 's']
    arms = [1e3 * imu.extrinsics.lever_arm_b for imu in calibrated().before.imus]
    assert_allclose(np.hstack(squares).T, arms)
    (bare,) = painted('board', calibrated(drawn=False))
    assert not lines_of(bare, 's')


def test_there_is_no_picture_of_a_board_without_places():
    assert calibration_board_figures.has_board(calibrated())
    assert not calibration_board_figures.has_board(rested(30.0, 2))  # no poses
    one_place = [imu.model_copy(update={'extrinsics': Extrinsics()}) for imu in bare_rig(2).imus]
    together = bare_rig(2).model_copy(update={'imus': tuple(one_place)})
    assert not calibration_board_figures.has_board(replace(rested(30.0, 2), after=together))
