"""The sketch as users build it: by the Arduino IDE, and with settings of their own."""

import subprocess

from emulated_hub import (
    assert_clean,
    assert_exact,
    bmi160s,
    built,
    FIRMWARE,
    only_one,
    require,
    run,
    script,
)
import pytest

IDE = ('arduino-builder', 'arduino-ctags')


def test_the_ide_builds_it_without_a_warning_of_ours(tmp_path):
    require(*IDE, packages='arduino-builder')
    built()
    with only_one(FIRMWARE / 'build' / 'lock'):
        made = subprocess.run(
            ['make', '-C', FIRMWARE, 'ide', f'BUILD={tmp_path}'],
            capture_output=True,
            text=True,
            check=False,
        )
    said = made.stdout + made.stderr
    assert made.returncode == 0, said
    # Debian's core has some; ours would name a file of the sketch.
    ours = [line for line in said.splitlines() if 'warning:' in line and '/arduino/' not in line]
    assert ours == []
    sketch = tmp_path / 'ide' / 'imu_hub.ino.elf'
    session = run(tmp_path, script(bmi160s(8), seconds=1.0), sketch=sketch)
    assert_clean(session)
    assert_exact(session, bmi160s(8))
    assert len(session.scans) > 70


@pytest.mark.parametrize(
    ('flags', 'scale'),
    [
        ('-DANGULAR_RATE_RANGE_DPS=250 -DFORCE_RANGE_G=2', (250, 2)),
        ('-DANGULAR_RATE_RANGE_DPS=1000 -DFORCE_RANGE_G=16', (1000, 16)),
    ],
)
def test_the_ranges_are_set_in_the_devices_and_told_to_the_host(tmp_path, flags, scale):
    imus = [('bmi160', 0, 0x68), ('mpu9250', 1, 0x68), ('bno055', 2, 0x29), ('sen0140', 3, 0x68)]
    session = run(tmp_path, script(imus, seconds=1.6, motion='formula'), flags)
    assert_clean(session)
    for info in session.hellos[-1].imus:
        fixed = info.imu == 3  # an ITG-3200 has one range only
        assert info.angular_rate_range == (2000 if fixed else scale[0])
        assert info.specific_force_range == scale[1]
        force = [counts[5] * info.specific_force_scale for _, counts in session.of(info.imu)]
        rate = [counts[2] * info.angular_rate_scale for _, counts in session.of(info.imu)]
        # Noise of 0.03 m/s^2 and half a count of an ADXL345; a swing of 1 rad/s.
        assert force == pytest.approx([9.80665] * len(force), abs=0.051)
        assert max(rate) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize(
    ('flags', 'told'),
    [
        ('-DFORCE_RANGE_G=3', 'FORCE_RANGE_G must be 2, 4, 8 or 16'),
        ('-DANGULAR_RATE_RANGE_DPS=125', 'ANGULAR_RATE_RANGE_DPS must be'),
        ('-DSCAN_RATE_HZ=400 -DBAUD=115200', 'BAUD must be higher'),
    ],
)
def test_what_cannot_work_is_refused_by_the_compiler(tmp_path, flags, told):
    built()
    command = ['make', '-C', FIRMWARE, 'sketch', f'BUILD={tmp_path}', f'FLAGS={flags}']
    with only_one(FIRMWARE / 'build' / 'lock'):
        made = subprocess.run(command, capture_output=True, text=True, check=False)
    assert made.returncode != 0
    assert told in made.stderr
