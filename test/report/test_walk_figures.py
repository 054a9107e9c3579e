"""The figures of a walk: what is drawn is where it belongs, however long the recording."""

from dataclasses import replace
import io
from itertools import product

from made_up_walks import made, stepping, waved
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
import numpy as np
from numpy.testing import assert_allclose
from PIL import Image
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.report import figures, walk_axes, walk_motion_figures, walk_path_figures
from multiimu_ros.report.walk_motion_figures import attitude_angles, knows_biases

WALKS = {
    'foot': (stepping(), True),
    'hand': (waved(), False),
    'restless': (waved(rests=False), False),
    'motionless': (made(np.zeros((300, 3)), np.ones(300, bool)), True),
}


def figure_of(name, walk, foot):
    module = walk_path_figures if hasattr(walk_path_figures, name) else walk_motion_figures
    options = {'foot': foot} if name in ('plan', 'height', 'speed') else {}
    return getattr(module, name)(walk, **options)


@pytest.mark.parametrize(
    ('kind', 'name'),
    [
        *product(('foot', 'motionless'), ('plan', 'height', 'speed', 'attitude', 'biases')),
        *product(('hand', 'restless'), ('plan', 'height')),
    ],
)
def test_figure_is_a_picture_as_wide_as_the_others(kind, name):
    image = np.asarray(Image.open(io.BytesIO(figure_of(name, *WALKS[kind]))).convert('L'))
    assert image.shape[1] == round(figures.WIDTH * figures.STYLE['figure.dpi'])
    assert image.shape[0] <= round(7.5 * figures.STYLE['figure.dpi'])
    assert (image < 200).mean() > 0.003  # some ink


@pytest.fixture
def painted(monkeypatch):
    """Return a function that draws a figure and returns its axes instead of a PNG."""

    def paint(module, name, *arguments, **options):
        kept = []

        def keep(painter, height):
            figure = Figure(figsize=(figures.WIDTH, height))
            painter(figure)
            kept.append(figure)
            return b''

        monkeypatch.setattr(module, 'draw', keep)
        getattr(module, name)(*arguments, **options)
        return kept[0].axes

    return paint


def lines_of(axes):
    return {line.get_label(): line.get_xydata() for line in axes.get_lines()}


def test_the_plan_has_one_scale_and_marks_where_they_belong(painted):
    walk = stepping(strides=8, length=1.25)
    (axes,) = painted(walk_path_figures, 'plan', walk, foot=True)
    shown = lines_of(axes)
    assert axes.get_aspect() == 1.0
    assert_allclose(shown['start'], [[0.0, 0.0]], atol=1e-12)
    assert_allclose(shown['end'], [[10.0, 0.0]], atol=1e-12)
    assert_allclose(shown['stance'][:, 0], 1.25 * np.arange(9), atol=1e-12)
    last = [patch for patch in axes.patches if isinstance(patch, Ellipse)][-1]
    assert_allclose(last.center, [10.0, 0.0], atol=1e-12)
    # 2 sigma to either side: 0.4 m along y, which is the longer, and 0.3 m along x.
    assert_allclose([last.width, last.height], [1.6, 1.2])
    assert_allclose(abs(last.angle), 90.0)
    (bar,) = [artist for artist in axes.artists if hasattr(artist, 'size_bar')]
    assert bar.txt_label.get_text() == '2 m'  # of 11 m the longest of 1, 2, 5 below a third


def test_a_smoothed_walk_lies_over_the_live_one(painted):
    live = stepping()
    moved = replace(live, position_n=live.position_n + np.array([0.0, 0.3, 0.0]))
    (axes,) = painted(walk_path_figures, 'plan', moved, foot=True, live=live)
    shown = lines_of(axes)
    assert_allclose(shown['as known live'][:, 1], 0.0)
    assert_allclose(shown['smoothed'][:, 1], 0.3)
    upper = painted(walk_path_figures, 'height', moved, foot=True, live=live)[0]
    assert {'as known live', 'smoothed', 'stance'} <= set(lines_of(upper))


def test_huge_ellipses_do_not_shrink_the_path_to_a_point(painted):
    walk = stepping()
    lost = replace(walk, position_covariance=1e8 * walk.position_covariance)
    (axes,) = painted(walk_path_figures, 'plan', lost, foot=True)
    assert np.ptp(axes.get_xlim()) < 2 * np.ptp(walk.position_n[:, 0])


def test_no_peak_is_lost_by_thinning():
    rng = np.random.default_rng(1)
    values = rng.standard_normal((100_003, 2))
    kept = walk_axes.thinned(values)
    assert len(kept) <= 4 * walk_axes.BINS + 2  # two extremes of two columns, first and last
    assert {0, len(values) - 1} <= set(kept.tolist())
    for column in values.T:
        width = -(-len(column) // walk_axes.BINS)
        for begin in range(0, len(column), width):
            inside = kept[(kept >= begin) & (kept < begin + width)]
            assert column[inside].max() == column[begin : begin + width].max()
            assert column[inside].min() == column[begin : begin + width].min()


def test_short_recordings_are_drawn_whole():
    assert walk_axes.thinned(np.zeros((2000, 3))).tolist() == list(range(2000))


def test_lines_break_where_frames_are_missing():
    walk = stepping()
    stamps = walk.stamp_ns.copy()
    stamps[120:] += 2 * 10**9
    time, rows = walk_axes.lines(replace(walk, stamp_ns=stamps), walk.position_n)
    assert np.flatnonzero(np.isnan(time)).tolist() == [120]
    assert np.isnan(rows[120]).all()
    assert_allclose(np.diff(time)[[118, 121]], 0.01, atol=1e-9)
    assert len(time) == len(walk) + 1


def test_near_level_the_angles_are_the_usual_ones():
    angles = np.deg2rad([[1.0, 2.0, 30.0], [-2.0, 1.0, 170.0], [2.0, 0.5, 190.0]])
    turned = Rotation.from_euler('ZYX', angles[:, ::-1]).as_quat(canonical=True)  # w > 0
    walk = made(np.zeros((3, 3)), np.zeros(3, bool), orientation=turned)
    # They differ by half the product of roll and pitch: 0.02 deg; and full turns go on.
    assert_allclose(attitude_angles(walk)[0], angles, atol=np.deg2rad(0.03))


def test_a_toe_that_points_straight_down_makes_no_jump():
    pitch = np.deg2rad(np.linspace(0, 150, 151))
    turns = Rotation.from_euler('Z', 0.5) * Rotation.from_euler('Y', pitch[:, np.newaxis])
    walk = made(np.zeros((151, 3)), np.zeros(151, bool), orientation=turns.as_quat())
    angles, _ = attitude_angles(walk)
    assert_allclose(angles, np.column_stack([0 * pitch, pitch, 0.5 + 0 * pitch]), atol=1e-9)


def test_sigmas_of_tilt_and_yaw_are_those_of_the_covariance():
    sigma = attitude_angles(stepping())[1]
    assert_allclose(sigma[-1], [1e-3, 1e-2])


def test_the_mean_speed_of_a_foot_is_its_stride_over_its_time(painted):
    walk = stepping(strides=20, length=1.2)  # one in 1.2 s; short enough to be drawn whole
    upper, lower = painted(walk_motion_figures, 'speed', walk, foot=True)
    middle = slice(len(walk) // 3, 2 * len(walk) // 3)
    # The window holds two strides and a tenth, and the foot goes up and down besides.
    speed, along = lines_of(upper)['mean over 2.5 s'], lines_of(lower)['x']
    assert_allclose(along[middle, 1].mean(), 1.0, atol=0.03)
    assert along[middle, 1].mean() < speed[middle, 1].mean() < 1.1
    assert lower.get_ylabel().startswith('mean velocity')


def test_biases_and_their_bands_are_in_the_units_of_people(painted):
    upper, lower = painted(walk_motion_figures, 'biases', stepping())
    assert_allclose(lines_of(upper)['x'][:, 1], np.rad2deg(1e-3))
    assert_allclose(lines_of(lower)['z'][:, 1], 20.0)  # mm/s^2
    band = upper.collections[0].get_paths()[0].vertices[:, 1]
    assert_allclose(np.ptp(band), np.rad2deg(4e-4))  # two sigma either way


def test_unknown_biases_are_not_drawn():
    unknown = np.full((len(stepping()), 3), np.nan)
    assert knows_biases(stepping())
    assert not knows_biases(replace(stepping(), gyro_bias=unknown))


def test_strides_and_a_close_up_are_drawn_of_a_walk(painted):
    walk = stepping(strides=12)
    upper, _ = painted(walk_motion_figures, 'stride_figure', walk)
    assert_allclose(upper.get_lines()[0].get_ydata(), 1.25)
    assert upper.get_ylim()[1] > 1.25
    panels = painted(walk_motion_figures, 'close_up', walk)
    assert len(panels) == 3
    shown = panels[0].get_lines()[0].get_xydata()
    assert 4.5 < shown[-1, 0] < 8.0  # five strides of 1.2 s
    assert_allclose(shown[:, 1].max(), 10.0, rtol=0.01)  # lifted by 10 cm
