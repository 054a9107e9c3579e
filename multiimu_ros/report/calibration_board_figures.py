"""Figures of the board as found: where its IMUs sit and point, beside the drawing."""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke
from matplotlib.transforms import ScaledTranslation
from mpl_toolkits.mplot3d import Axes3D  # type: ignore[import-untyped]
import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Matrix, Scalars, Vector, Vectors
from multiimu_ros.report.figures import draw, XYZ
from multiimu_ros.report.noise_figures import COLOURS
from multiimu_ros.rig import Extrinsics, Rig
from multiimu_ros.rig_calibration.calibrate import Calibration

DRAWN = '#7C8791'
MILLIMETRES = 1e3
VISIBLE = 0.01  # of the size of the board: smaller bars would hide behind the markers
FLAT = 0.02  # of the size of the board
LEAST_SIZE = 1e-6  # [m] what all sit in one place


def poses_of(rig: Rig) -> tuple[Extrinsics, ...] | None:
    """Return the poses of all IMUs, or None where the rig lacks one."""
    poses = tuple(imu.extrinsics for imu in rig.imus if imu.extrinsics is not None)
    return poses if len(poses) == len(rig.imus) else None


def size(poses: Sequence[Extrinsics]) -> float:
    """Return the greatest extent of a board along a base axis [m]."""
    return float(np.ptp([pose.lever_arm_b for pose in poses], axis=0).max())


def has_board(calibration: Calibration) -> bool:
    """Say whether several IMUs have poses that a picture can show."""
    poses = poses_of(calibration.after)
    return poses is not None and len(poses) > 1 and size(poses) > LEAST_SIZE


def board(calibration: Calibration) -> bytes:
    """Draw the IMUs as found with their axes, and in grey as drawn, in the base frame [mm]."""
    found, drawn = poses_of(calibration.after) or (), poses_of(calibration.before)
    extent = MILLIMETRES * size(found)
    length = 0.16 * extent
    height = MILLIMETRES * float(np.mean([pose.lever_arm_b[2] for pose in found]))

    def paint(figure: Figure) -> None:
        figure.set_layout_engine('none')
        axes = figure.add_axes((0.02, 0.02, 0.94, 0.9), projection='3d')
        for pose in drawn or ():
            place = MILLIMETRES * pose.lever_arm_b
            axes.plot(*place, 's', mfc='none', mec=DRAWN, ms=9, mew=1.0, clip_on=False)
            _axes_of(axes, pose, 1.25 * length, [DRAWN] * 3, 1.0)
        for name, pose in zip(calibration.after.names, found, strict=True):
            place = MILLIMETRES * pose.lever_arm_b
            axes.plot(*place, 'o', color='#1b2530', ms=4, clip_on=False)
            _axes_of(axes, pose, length, COLOURS, 2.0)
            _uncertainty(axes, pose, extent)
            _label(axes, name, place, float(place[2] - height) / extent)
        _in_proportion(axes)
        for axis, colour in zip(XYZ, COLOURS, strict=True):
            axes.plot([], [], [], color=colour, lw=2.0, label=f'{axis} of the IMU')
        if drawn:
            axes.plot([], [], [], 's-', mfc='none', color=DRAWN, lw=1.0, label='as drawn')
        figure.legend(loc='upper center', ncols=4, handlelength=1.4)

    return draw(paint, 4.6)


def _axes_of(
    axes: Axes3D, pose: Extrinsics, length: float, colours: Sequence[str], width: float
) -> None:
    origin = MILLIMETRES * pose.lever_arm_b
    for column, colour in zip(pose.R_bs.T, colours, strict=True):
        axes.plot(*np.column_stack([origin, origin + length * column]), color=colour, lw=width,
                  clip_on=False)  # fmt: skip


def _label(axes: Axes3D, name: str, place: Vector, above: float) -> None:
    """Write a name below the IMU, or to either side where IMUs sit on both sides of a board."""
    points = (0.0, -12.0) if abs(above) < FLAT else (-16.0, 11.0) if above > 0 else (16.0, -11.0)
    text = axes.text(*place, name, fontsize=9, ha='center', va='center')
    inches = ScaledTranslation(points[0] / 72, points[1] / 72, axes.figure.dpi_scale_trans)
    text.set_transform(text.get_transform() + inches)
    text.set_path_effects([Stroke(linewidth=2.5, foreground='white'), Normal()])


def _uncertainty(axes: Axes3D, pose: Extrinsics, extent: float) -> None:
    """Draw three sigma of the position along each base axis, where they are to be seen."""
    origin = MILLIMETRES * pose.lever_arm_b
    for bar in 3 * MILLIMETRES * np.diag(pose.lever_arm_sigma or (0.0,) * 3):
        if np.abs(bar).max() > VISIBLE * extent:
            axes.plot(*np.column_stack([origin - bar, origin + bar]), color='#1b2530', lw=0.8)


def _in_proportion(axes: Axes3D) -> None:
    """Give a millimetre the same length along x, y and z, and each axis its name."""
    limits = [axes.get_xlim3d(), axes.get_ylim3d(), axes.get_zlim3d()]
    spans = np.ptp(limits, axis=1)
    axes.set_box_aspect(spans / spans.max(), zoom=1.15)
    axes.view_init(elev=32, azim=-62)
    for name, span in zip(XYZ, spans, strict=True):
        axes.locator_params(axis=name, nbins=int(np.clip(round(7 * span / spans.max()), 2, 7)))
    axes.set(xlabel='x [mm]', ylabel='y [mm]', zlabel='z [mm]')
    axes.tick_params(labelsize=9)


def pose_differences(before: Rig, after: Rig) -> tuple[Matrix, Matrix]:
    """Return how far found is off drawn, (K, 3) [m] in the base frame, and (K, 3) [rad].

    The angles are about the axes of each IMU.
    """
    moved, turned = [], []
    for old, new in zip(poses_of(before) or (), poses_of(after) or (), strict=True):
        moved.append(new.lever_arm_b - old.lever_arm_b)
        turned.append(Rotation.from_matrix(old.R_bs.T @ new.R_bs).as_rotvec())
    return np.array(moved), np.array(turned)


def differences(calibration: Calibration) -> bytes:
    """Draw found less drawn, positions [mm] and angles [deg], with a bar of one sigma."""
    moved, turned = pose_differences(calibration.before, calibration.after)
    poses = poses_of(calibration.after) or ()
    move_sigma = np.array([pose.lever_arm_sigma or (0.0,) * 3 for pose in poses])
    turn_sigma = np.array([pose.rotation_sigma or (0.0,) * 3 for pose in poses])

    def paint(figure: Figure) -> None:
        left, right = figure.subplots(1, 2)
        names = calibration.after.names
        _bars(left, MILLIMETRES * moved, MILLIMETRES * move_sigma, names)
        _bars(right, np.rad2deg(turned), np.rad2deg(turn_sigma), names)
        left.set_title('position, found less drawn [mm]')
        right.set_title('rotation, found less drawn [deg]')
        figure.legend(*left.get_legend_handles_labels(), loc='outside upper center', ncols=3)

    return draw(paint, 3.3)


def _bars(axes: Axes, values: Vectors, sigma: Scalars, names: Sequence[str]) -> None:
    rows = np.arange(len(names))
    for axis, colour in enumerate(COLOURS):
        axes.errorbar(rows + 0.22 * (axis - 1), values[:, axis], sigma[:, axis], fmt='o', ms=4,
                      color=colour, capsize=2, label=XYZ[axis])  # fmt: skip
    axes.axhline(0.0, color='black', lw=0.8)
    axes.set_xticks(rows, names, rotation=35, ha='right', rotation_mode='anchor', fontsize=9)
    axes.grid(visible=False, axis='x')
