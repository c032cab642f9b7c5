"""Measure where the time of a step with a picture goes, stage by stage, on one core.

``python benchmarks/picture_way.py [--rounds N]``

Each stage is timed by itself on the same observation of the segmentation track (49,152 bytes of pictures): driving,
painting, encoding as msgpack and as JSON, packing and unpacking the reply for the web process, and decoding by the
client. The rest of a step over HTTP (``benchmarks/http_step.py``) is HTTP itself.
"""

import statistics
import time
from collections.abc import Callable

import msgpack
import orjson
from common import finish, parser

from wrongturn_networks import load_suite
from wrongturn_protocol import Track
from wrongturn_protocol.observations import decode, encode
from wrongturn_sim import Episode

ACTION = (0.0, 0.3, 0.0)


def median_us(work: Callable[[], object], rounds: int) -> float:
    times = []
    for _ in range(rounds):
        begin = time.perf_counter_ns()
        work()
        times.append((time.perf_counter_ns() - begin) / 1000)
    return statistics.median(times)


def stepping(track: Track) -> Callable[[], object]:
    episode = Episode(load_suite("wrong-command@3").open_draw.twins[0], track)
    episode.reset()

    def step() -> None:
        if episode.outcome is not None or episode.steps > 20:
            episode.reset()
        episode.step(*ACTION)

    return step


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--rounds", type=int, default=2000)
    given = options.parse_args()
    rounds = 2 if given.short else given.rounds
    track = Track.SEGMENTATION
    drive = median_us(stepping(Track.STATE), rounds)
    paint = median_us(stepping(track), rounds) - drive
    observation = Episode(load_suite("wrong-command@3").trials[0], track).reset()
    packed = msgpack.packb(encode(observation, track, binary=True))
    text = orjson.dumps(encode(observation, track))
    framed = msgpack.packb([0, packed, 0.0, False, False, None])
    rows = {
        "drive 0.1 s": drive,
        "paint RGB and segmentation": paint,
        "encode as msgpack": median_us(lambda: msgpack.packb(encode(observation, track, binary=True)), rounds),
        "encode as JSON": median_us(lambda: orjson.dumps(encode(observation, track)), rounds),
        "pack the reply": median_us(lambda: msgpack.packb([0, packed, 0.0, False, False, None]), rounds),
        "unpack the reply": median_us(lambda: msgpack.unpackb(framed), rounds),
        "decode msgpack": median_us(lambda: decode(msgpack.unpackb(packed), track), rounds),
        "decode JSON": median_us(lambda: decode(orjson.loads(text), track), rounds),
    }
    print(f"pictures {64 * 192 * 4} bytes, msgpack {len(packed)}, JSON {len(text)}")
    for name, microseconds in rows.items():
        print(f"{name:<28}{microseconds:8.1f} us")
    finish({"us": rows}, given)


if __name__ == "__main__":
    main()
