"""The serialised form (CDR) of sensor_msgs/Imu and nav_msgs/Odometry, many messages at a time.

Either type has a fixed layout but for the length of its frame names, so that the messages of one
topic are the rows of one structured numpy array: decoding is a view, encoding fills columns.

Four bytes of encapsulation come first and are not counted when the fields are aligned to their
size; strings carry their length, with the closing NUL, in four bytes [1]_.

.. [1] Object Management Group, "DDS Interoperability Wire Protocol", v2.5, 2022, clause 10; and
   "Common Object Request Broker Architecture, part 2", v3.3, 2012, clause 9.3.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from multiimu_ros.arrays import Matrix, NANOSECONDS, Stamps, Vectors
from multiimu_ros.samples import ImuSamples

Rows = NDArray[np.void]  # (N,) records of one layout
Fields = Sequence[tuple[str, str, tuple[int, ...]]]  # name, numpy kind, shape

ENCAPSULATION = 4  # bytes
BYTE_ORDERS = {b'\x00\x00': '>', b'\x00\x01': '<'}  # plain CDR; the others describe themselves
HEADER = (
    ('sec', 'i4', ()),
    ('nanosec', 'u4', ()),
    ('frame_size', 'u4', ()),
    ('frame_id', 'S', ()),
)
IMU = (
    ('orientation', 'f8', (4,)),
    ('orientation_covariance', 'f8', (3, 3)),
    ('angular_rate', 'f8', (3,)),
    ('angular_rate_covariance', 'f8', (3, 3)),
    ('specific_force', 'f8', (3,)),
    ('specific_force_covariance', 'f8', (3, 3)),
)
ODOMETRY = (
    ('child_frame_size', 'u4', ()),
    ('child_frame_id', 'S', ()),
    ('position', 'f8', (3,)),
    ('orientation', 'f8', (4,)),
    ('pose_covariance', 'f8', (6, 6)),
    ('velocity', 'f8', (3,)),
    ('angular_rate', 'f8', (3,)),
    ('twist_covariance', 'f8', (6, 6)),
)


def layout(
    fields: Fields, sizes: Sequence[int], order: str = '<', itemsize: int | None = None
) -> np.dtype[np.void]:
    """Return the record of a message: header, `fields`, and the frame names' `sizes` [bytes].

    `itemsize` [bytes] is the length of a message where the middleware padded it.
    """
    names, formats, offsets = ['encapsulation'], ['4u1'], [0]
    end, strings = ENCAPSULATION, iter(sizes)
    for name, kind, shape in (*HEADER, *fields):
        width = 1 if kind == 'S' else int(kind[1])
        begin = end + (ENCAPSULATION - end) % width
        size = next(strings) if kind == 'S' else width * int(np.prod(shape))
        end = begin + size
        names.append(name)
        formats.append(f'S{max(size, 1)}' if kind == 'S' else f'{shape}{order}{kind}')
        offsets.append(begin)
    return np.dtype(
        {'names': names, 'formats': formats, 'offsets': offsets, 'itemsize': itemsize or end}
    )


def decode_imus(messages: Sequence[bytes]) -> tuple[ImuSamples, frozenset[str]]:
    """Read serialised sensor_msgs/Imu messages.

    Returns
    -------
    ImuSamples
        Stamps, angular rates and specific forces, in the order of `messages`.
    frozenset of str
        The frame names that occur.

    Raises
    ------
    ValueError
        If a message is none; the text begins with `message <index>`.
    """
    groups: dict[tuple[int, bytes, bytes], list[int]] = {}
    for index, data in enumerate(messages):
        groups.setdefault((len(data), data[:2], data[12:16]), []).append(index)
    stamp_ns = np.empty(len(messages), np.int64)
    vectors = np.empty((2, len(messages), 3))
    frames: set[bytes] = set()
    for (size, kind, frame_size), indices in groups.items():
        try:
            record = _imu_record(size, kind, frame_size)
        except ValueError as error:
            msg = f'message {indices[0]} {error}'
            raise ValueError(msg) from error
        joined = b''.join([messages[index] for index in indices])
        rows: Rows = np.frombuffer(joined, record)
        stamp_ns[indices] = rows['sec'].astype(np.int64) * NANOSECONDS + rows['nanosec']
        vectors[0, indices] = rows['angular_rate']
        vectors[1, indices] = rows['specific_force']
        frames.update(np.unique(rows['frame_id']).tolist())
    names = frozenset(frame.decode('utf-8', 'replace') for frame in frames)
    return ImuSamples(stamp_ns, vectors[0], vectors[1]), names


def _imu_record(size: int, kind: bytes, frame_size: bytes) -> np.dtype[np.void]:
    """Return the record of an Imu message from its length and the bytes that shape it."""
    order = BYTE_ORDERS.get(kind)
    if order is None:
        msg = f'must be plain CDR (00 00 or 00 01), got the encapsulation `{kind.hex(" ")}`'
        raise ValueError(msg)
    frame = int.from_bytes(frame_size, 'little' if order == '<' else 'big')
    if frame > size:
        msg = f'must hold a frame name within its {size} bytes, got a name of {frame}'
        raise ValueError(msg)
    record = layout(IMU, (frame,), order)
    if not record.itemsize <= size < record.itemsize + 4:  # some middlewares pad to four bytes
        msg = f'must have the {record.itemsize} bytes of a sensor_msgs/Imu, got {size}'
        raise ValueError(msg)
    return layout(IMU, (frame,), order, size)


def encode_imus(
    frame_id: str,
    samples: ImuSamples,
    *,
    rate_covariance: ArrayLike = 0.0,
    force_covariance: ArrayLike = 0.0,
    orientation: Vectors | None = None,
    orientation_covariance: ArrayLike = 0.0,
) -> list[bytes]:
    """Serialise N sensor_msgs/Imu messages, little-endian.

    Parameters
    ----------
    frame_id : str
        Frame in which the samples are given.
    samples : ImuSamples
        Angular rates and specific forces.
    rate_covariance, force_covariance : (3, 3) or (N, 3, 3) array
        Covariances [rad^2/s^2], [m^2/s^4]; zeros mean unknown (REP-145).
    orientation : (N, 4) array, optional
        Unit quaternions x, y, z, w of R_nb; without them the message says that it has none.
    orientation_covariance : (3, 3) or (N, 3, 3) array
        Its covariance [rad^2].
    """
    rows = _rows(IMU, (frame_id,), samples.stamp_ns)
    rows['angular_rate'] = samples.angular_rate
    rows['angular_rate_covariance'] = rate_covariance
    rows['specific_force'] = samples.specific_force
    rows['specific_force_covariance'] = force_covariance
    if orientation is None:
        rows['orientation_covariance'][:, 0, 0] = -1.0
    else:
        rows['orientation'] = orientation
        rows['orientation_covariance'] = orientation_covariance
    return _split(rows)


def encode_odometry(
    frames: tuple[str, str],
    stamp_ns: Stamps,
    pose: tuple[Vectors, Vectors, Matrix],
    twist: tuple[Vectors, Vectors, Matrix],
) -> list[bytes]:
    """Serialise N nav_msgs/Odometry messages, little-endian.

    Parameters
    ----------
    frames : (str, str)
        The world's frame and the moving one.
    stamp_ns : (N,) int array
        Instants [ns].
    pose : (N, 3), (N, 4) and (N, 6, 6) arrays
        Position in the world [m], quaternion x, y, z, w [-], covariance [m^2, m rad, rad^2].
    twist : (N, 3), (N, 3) and (N, 6, 6) arrays
        Velocity [m/s] and angular rate [rad/s] in the moving frame, and their covariance.
    """
    rows = _rows(ODOMETRY, frames, stamp_ns)
    rows['position'], rows['orientation'], rows['pose_covariance'] = pose
    rows['velocity'], rows['angular_rate'], rows['twist_covariance'] = twist
    return _split(rows)


def _rows(fields: Fields, frames: Sequence[str], stamp_ns: Stamps) -> Rows:
    encoded = [frame.encode() for frame in frames]
    sizes = [len(name) + 1 for name in encoded]
    rows = np.zeros(len(stamp_ns), layout(fields, sizes))
    rows['encapsulation'][:, 1] = 1
    rows['sec'], rows['nanosec'] = np.divmod(stamp_ns, NANOSECONDS)
    for prefix, name, size in zip(('', 'child_'), encoded, sizes, strict=False):
        rows[f'{prefix}frame_size'] = size
        rows[f'{prefix}frame_id'] = name
    return rows


def _split(rows: Rows) -> list[bytes]:
    joined, size = rows.tobytes(), rows.dtype.itemsize
    return [joined[at : at + size] for at in range(0, len(joined), size)]
