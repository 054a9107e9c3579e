"""The decoder against a line that mixes intact frames with random, cut and bit-flipped ones.

    python benchmarks/hostile_bytes.py [MEGABYTES] [SEED]

Exit code 0 says: no exception, every intact frame recovered, and no other frame accepted.  A
damaged frame passes both checks with probability 2^-31 or so; the figure printed says what that
means for the number of damaged frames of this run.
"""

import sys
import time

import numpy as np

from multiimu_ros.wire import packets
from multiimu_ros.wire.decoder import FrameDecoder

INTACT, RANDOM, CUT, FLIPPED = range(4)
POOL = 20_000  # different frames
READ = 4096  # [bytes] a push
ESCAPE = 2.0**-31  # of a heavily damaged frame: 2^-15 by the CRC, 2^-16 by the sum
BATCH = 20_000  # pieces; about 2.5 MB


def make_pool(rng):
    """Return packets of all kinds, most of them scans of up to 16 IMUs, and their frames."""
    pool = [packets.Sync(int(rng.integers(2**32)), k) for k in range(POOL // 50)]
    pool += [packets.Status(k, imus={k % 16: (k, 20.0)}) for k in range(POOL // 50)]
    while len(pool) < POOL:
        present = rng.permutation(16 if rng.random() < 0.2 else 8)[: rng.integers(1, 9)]
        spread = 10.0 ** rng.uniform(0, 4.5)  # small counts are full of zeros
        counts = np.clip(rng.normal(0, spread, (16, 6)), -32768, 32767).astype(int).tolist()
        readings = {int(k): (400 * int(k), tuple(counts[k])) for k in sorted(present)}
        pool.append(packets.Scan(len(pool) % 2**16, int(rng.integers(2**32)), readings))
    return pool, [packets.encode(packet) for packet in pool]


def damage(rng, kind, frame):
    """Return bytes that are not `frame`, in one of three ways."""
    if kind == RANDOM:
        return rng.bytes(int(rng.integers(1, 400)))
    if kind == CUT:  # three bytes: what follows may by chance make up for fewer
        return frame[: int(rng.integers(0, len(frame) - 2))]
    bits = rng.choice(8 * len(frame), int(rng.integers(1, 33)), replace=False, shuffle=False)
    damaged = bytearray(frame)
    for bit in bits.tolist():
        damaged[bit >> 3] ^= 1 << (bit & 7)
    return bytes(damaged)


def make_batch(rng, pool, frames):
    """Return bytes, the packets that stand intact in them, and the number of damaged pieces."""
    kinds = rng.integers(0, 4, BATCH).tolist()
    picks = rng.integers(0, POOL, BATCH).tolist()
    pieces = [
        frames[pick] if kind == INTACT else damage(rng, kind, frames[pick])
        for kind, pick in zip(kinds, picks, strict=True)
    ]
    sent = [pool[pick] for kind, pick in zip(kinds, picks, strict=True) if kind == INTACT]
    return b''.join(pieces), sent, BATCH - len(sent)


def main(megabytes=100.0, seed=20260711):
    """Run until that many bytes were decoded; return the exit code."""
    rng = np.random.default_rng(seed)
    pool, frames = make_pool(rng)
    decoder, spent, sent_total, damaged_total, wrong = FrameDecoder(), 0.0, 0, 0, 0
    while decoder.bytes < megabytes * 1e6:
        data, sent, damaged = make_batch(rng, pool, frames)
        start = time.perf_counter()
        found = []
        for k in range(0, len(data), READ):
            found += decoder.push(data[k : k + READ])
        found += decoder.push(b'\0')  # the last piece may be cut; the next batch starts afresh
        spent += time.perf_counter() - start
        wrong += found != sent
        sent_total, damaged_total = sent_total + len(sent), damaged_total + damaged
    print(f'{decoder.bytes / 1e6:.1f} MB in {spent:.1f} s: {decoder.bytes / 1e6 / spent:.1f} MB/s')
    print(f'intact frames sent {sent_total}, packets accepted {decoder.frames}')
    print(f'damaged pieces {damaged_total}: chance that one passed {damaged_total * ESCAPE:.0e}')
    print(f'crc errors {decoder.crc_errors}, cobs errors {decoder.cobs_errors}')
    print('every intact frame and no other' if not wrong else f'WRONG in {wrong} batches')
    return 1 if wrong else 0


if __name__ == '__main__':
    arguments = [float(sys.argv[1])] if len(sys.argv) > 1 else []
    sys.exit(main(*arguments, *map(int, sys.argv[2:3])))
