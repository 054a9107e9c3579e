"""Loops of 100 m on a simulated foot with three IMUs through the whole chain, over many seeds.

Run: OPENBLAS_NUM_THREADS=1 python -m benchmarks.loops [--seeds 20] [--only rough] [--each]

`informed` are the clean ones again, with the odometry told that this foot stands like a rock and
that its swings leave nothing behind.

Errors are of the distance walked; `path` is the rms along the way.  Rms over the seeds, then the
medians.  NEES is per axis, 1 if the covariance is honest; `at` is its mean over the seeds at eight
instants.
"""

import argparse
from functools import partial
from pathlib import Path
import sys

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))

import loop_trials

KINDS = {
    'clean': partial(loop_trials.trial, rough=False),
    'informed': loop_trials.informed_trial,
    'rough': partial(loop_trials.trial, rough=True),
}


def show_each(seed, score):
    """Print one walk in a line."""
    print(
        f'  seed {seed:3d}  end {100 * score.end:.3f} %  path {100 * score.path:.3f} %  '
        f'yaw {np.rad2deg(score.yaw):+.2f} deg  NEES {score.nees:.2f}',
        flush=True,
    )


def show(kind, found):
    """Print what the walks of a kind have in common."""
    print(
        f'{kind}: end {100 * found.end:.3f} %, path {100 * found.path:.3f} % '
        f'(median {100 * found.end_median:.3f}, {100 * found.path_median:.3f}; '
        f'in plan {100 * found.end_plan:.3f}, {100 * found.path_plan:.3f}), '
        f'yaw {np.rad2deg(found.yaw):.2f} deg, NEES {found.nees:.2f}, '
        f'at {" ".join(f"{x:.2f}" for x in found.nees_at)}',
        flush=True,
    )


def main():
    """Walk and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seeds', type=int, default=20)
    parser.add_argument('--only', choices=KINDS)
    parser.add_argument('--each', action='store_true', help='a line for each seed')
    options = parser.parse_args()
    for kind in KINDS if options.only is None else (options.only,):
        scores = []
        for seed in range(options.seeds):
            scores.append(KINDS[kind](seed))
            if options.each:
                show_each(seed, scores[-1])
        show(kind, loop_trials.summary(scores))
    for kind in ('clean', 'rough'):
        moved = loop_trials.moved_while_standing(0, rough=kind == 'rough')
        print(f'{kind}: moves {1e3 * moved:.4f} mm while standing for a minute after a walk')


if __name__ == '__main__':
    main()
